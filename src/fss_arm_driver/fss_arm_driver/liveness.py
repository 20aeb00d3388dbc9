"""Checks whether a motion may continue: its client, this process and its clocks; times in s."""

from dataclasses import dataclass

DISCOVERY = 3.0  # time in which ROS discovers the client [s]


class GoalClient:
    """Client of a goal; it must send keep-alives if it has announced them.

    Args:
        keep_alive: silence after which the client is gone [s]; 0: it sends no keep-alives.
        now: time of the request.
    """

    def __init__(self, keep_alive: float, now: float) -> None:
        self.keep_alive, self.last_alive = keep_alive, now
        self._deadline = now + DISCOVERY

    def lost_reason(self, now: float, connected: bool) -> str:
        """Return why the client counts as gone, else empty.

        `connected`: ROS knows of a client that awaits a result.
        """
        if self.keep_alive and now - self.last_alive > self.keep_alive:
            return f"its client has been silent for {now - self.last_alive:.1f} s"
        if connected:
            self._deadline = 0.0  # from now on its absence counts at once
        return "its client is gone" if not connected and now > self._deadline else ""


@dataclass
class Stall:
    """Detector of pauses of a process; it reports one for a while, as received messages may be old.

    `now` may jump back, as simulated time does when it restarts.
    """

    max_interval: float  # from one check to the next without being a stall [s]
    duration: float = 0.0  # the last one [s]
    end: float = float("-inf")
    last_check: float | None = None

    def check(self, now: float) -> str:
        """Describe the last pause while it is recent; empty: there was none."""
        late, self.last_check = now - (now if self.last_check is None else self.last_check), now
        if late > self.max_interval:
            self.duration, self.end = late, now
        recent = 0.0 <= now - self.end < self.max_interval
        return f"this node paused for {self.duration:.1f} s" if recent else ""


@dataclass
class ClockSteps:
    """Detector of steps of the time of day; it reports one for a while.

    Motions are planned by the time of day, and commands and measurements stamped with it.
    """

    min_step: float  # smaller changes are adjustments [s]
    report_time: float  # for which a step is reported [s]
    step: float = 0.0  # the last one [s]
    detected: float = float("-inf")
    offset: float | None = None

    def check(self, offset: float, now: float) -> str:
        """Describe a recent step; empty: there was none.

        Args:
            offset: time of day minus `now` [s].
            now: time of a clock that is never set [s].
        """
        before, self.offset = self.offset, offset
        if before is not None and abs(offset - before) > self.min_step:
            self.step, self.detected = offset - before, now
        recent = 0.0 <= now - self.detected < self.report_time
        return f"the clock of this computer was set by {self.step:+.1f} s" if recent else ""
