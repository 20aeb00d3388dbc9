"""Arbitration between motions of the arm: one motion at a time.

A trajectory or a stream that starts preempts the current motion. A move does not preempt: it is
rejected during another motion. A stop ends any motion.
"""

from collections.abc import Callable
from dataclasses import dataclass
from threading import RLock
from typing import Any

Plan = Callable[[int], tuple[Any, Any]]  # angles and rates (n) at a time [ns]


@dataclass(eq=False)
class Motion:
    """Motion of the arm, current or past."""

    name: str
    expiry: int | None = None  # time at which it expires [ns]
    end_reason: str = ""  # why it must end, in words
    plan: Plan | None = None


class Arbiter:
    """Arbiter of the arm's motions, thread-safe. Times are the caller's, in nanoseconds.

    While a thread holds `lock`, the current motion does not change.
    """

    def __init__(self) -> None:
        self.lock = RLock()
        self._motion: Motion | None = None

    def current_name(self, now: int) -> str:
        """Return the name of the current motion; empty: none."""
        motion = self._motion
        expired = motion is None or (motion.expiry is not None and now > motion.expiry)
        return "" if motion is None or expired or motion.end_reason else motion.name

    def current_plan(self, now: int) -> Plan | None:
        """Return the plan of the current motion; None: there is none."""
        motion = self._motion
        return motion.plan if motion and self.current_name(now) else None

    def is_current(self, motion: Motion | None, now: int) -> bool:
        """Return True if this motion is the current one."""
        return motion is self._motion and bool(self.current_name(now))

    def start(self, name: str, now: int, expiry: int | None = None) -> Motion:
        """Start a motion; it preempts the current one, if any."""
        with self.lock:
            if self._motion and self.current_name(now):
                self._motion.end_reason = f"preempted by {name}"
            self._motion = motion = Motion(name, expiry)
        return motion

    def finish(self, motion: Motion) -> None:
        """End a motion."""
        with self.lock:
            if motion is self._motion:
                self._motion = None

    def stop(self) -> None:
        """End the current motion, if any."""
        with self.lock:
            if self._motion:
                self._motion.end_reason = "stopped"
