"""Whether a motion may go on: who asked for it, this process and its clocks; times in s."""

from dataclasses import dataclass

DISCOVERY = 3.0  # by then ROS knows of a client that has asked already [s]


class GoalClient:
    """Whoever asked for a move: shall confirm that again and again, if it said it would.

    Args:
        keep_alive: silence that means it is gone [s]; 0: it never does.
        now: when it asked.
    """

    def __init__(self, keep_alive: float, now: float) -> None:
        self.keep_alive, self.heard = keep_alive, now
        self._unseen = now + DISCOVERY

    def gone(self, now: float, seen: bool) -> str:
        """That it is gone, in words; `seen`: ROS knows of a client that awaits a result."""
        if self.keep_alive and now - self.heard > self.keep_alive:
            return f"whoever asked for it is silent for {now - self.heard:.1f} s"
        if seen:
            self._unseen = 0.0  # from now on it is missed at once
        return "whoever asked for it is gone" if not seen and now > self._unseen else ""


@dataclass
class Stall:
    """Detects pauses of a process, and reports one for as long again: its messages may be old.

    `now` may jump back, as simulated time does when it restarts.
    """

    max_interval: float  # from one check to the next without being a stall [s]
    lasted: float = 0.0  # the last one [s]
    ended: float = float("-inf")
    checked: float | None = None

    def check(self, now: float) -> str:
        """Describe the last pause while it is recent; empty: there was none."""
        late, self.checked = now - (now if self.checked is None else self.checked), now
        if late > self.max_interval:
            self.lasted, self.ended = late, now
        recent = 0.0 <= now - self.ended < self.max_interval
        return f"this node paused for {self.lasted:.1f} s" if recent else ""


@dataclass
class Steps:
    """Finds that the time of day was set, and says so for a while.

    Motions are planned by the time of day, and commands and measurements stamped with it.
    """

    least: float  # change that is no adjustment [s]
    lasts: float  # for how long to say so [s]
    step: float = 0.0  # the last one [s]
    found: float = float("-inf")
    ahead: float | None = None

    def check(self, ahead: float, now: float) -> str:
        """What to say of a step that was just now, if there was one.

        Args:
            ahead: the time of day less `now` [s].
            now: time by a clock that nobody sets [s].
        """
        before, self.ahead = self.ahead, ahead
        if before is not None and abs(ahead - before) > self.least:
            self.step, self.found = ahead - before, now
        recent = 0.0 <= now - self.found < self.lasts
        return f"the clock of this computer was set by {self.step:+.1f} s" if recent else ""
