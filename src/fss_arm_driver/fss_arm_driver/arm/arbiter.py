"""Arbitration of who moves the arm: one motion at a time.

A trajectory or a stream that begins takes the turn from whatever has it; a move waits for nobody,
it is refused. A stop ends whatever there is.
"""

from collections.abc import Callable
from dataclasses import dataclass
from threading import RLock
from typing import Any

Plan = Callable[[int], tuple[Any, Any]]  # angles and rates (n) at a time [ns]


@dataclass(eq=False)
class Motion:
    """What has the turn, or had it."""

    name: str
    until: int | None = None  # it is over by itself then [ns]
    ended: str = ""  # why it must end, in words
    plan: Plan | None = None


class Arbiter:
    """Who moves the arm, for several threads. Times are the caller's, in nanoseconds.

    Who holds `lock` keeps the turn from changing.
    """

    def __init__(self) -> None:
        self.lock = RLock()
        self._motion: Motion | None = None

    def holder(self, now: int) -> str:
        """The motion under way, in words; empty: none."""
        motion = self._motion
        over = motion is None or (motion.until is not None and now > motion.until)
        return "" if motion is None or over or motion.ended else motion.name

    def planned(self, now: int) -> Plan | None:
        """The plan of the motion under way; None: there is none."""
        motion = self._motion
        return motion.plan if motion and self.holder(now) else None

    def has(self, motion: Motion | None, now: int) -> bool:
        """Whether this motion is under way."""
        return motion is self._motion and bool(self.holder(now))

    def take(self, name: str, now: int, until: int | None = None) -> Motion:
        """Begin a motion; the one under way, if any, shall end."""
        with self.lock:
            if self._motion and self.holder(now):
                self._motion.ended = f"preempted by {name}"
            self._motion = motion = Motion(name, until)
        return motion

    def leave(self, motion: Motion) -> None:
        """End a motion."""
        with self.lock:
            if motion is self._motion:
                self._motion = None

    def stop(self) -> None:
        """End whatever is under way."""
        with self.lock:
            if self._motion:
                self._motion.ended = "stopped"
