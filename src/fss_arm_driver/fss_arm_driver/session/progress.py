"""Progress of a command, by the link's status words and not by its receipt alone."""

from enum import IntEnum

from fss_arm_driver.faults import IN_MOTION
from fss_arm_driver.protocol import MAX_ERROR_TIME, Mode, State, Telemetry
from fss_arm_driver.scale import Scale, SetPoint
from fss_arm_driver.session.paths import SentPath
from fss_arm_model.units import SECOND

START_TIMEOUT = 2 * SECOND  # within which a link must accept a command and start to move
STALL_TIME = SECOND  # a joint at rest away from its goal this long has stalled
START_DELAY = 100_000  # within which a link must follow a path that has started [us]
POSITION_TOLERANCE = 0.005  # a joint this close to its goal has reached it [rad]


class Status(IntEnum):
    """Status of a command, by its numbers in CommandStatus."""

    REFUSED = 0
    ACCEPTED = 1
    MOVING = 2
    REACHED = 3
    ABORTED = 4
    TIMED_OUT = 5


class Progress:
    """Progress of one command, from telemetry. All times are the caller's, in nanoseconds.

    Args:
        set_point: the command.
        given: when it was first given.
        scale: the link's units.
    """

    def __init__(self, set_point: SetPoint, given: int, scale: Scale) -> None:
        self.set_point, self.given, self.scale = set_point, given, scale
        self.status, self.reason = Status.ACCEPTED, ""
        self.broken = False  # it was a path, which the link has aborted
        self._moved = given  # last seen moving

    @property
    def ended(self) -> bool:
        """True if the status is final."""
        return self.status >= Status.REACHED

    def end(self, status: Status, reason: str) -> None:
        """Set the final status, unless there is one already."""
        if not self.ended:
            self.status, self.reason = status, reason

    def update(
        self, frame: Telemetry, accepted: bool, now: int, path: SentPath | None = None
    ) -> None:
        """Update the status from a frame.

        Args:
            frame: telemetry of the link.
            accepted: whether it was measured after the link had accepted the command.
            now: when it was received.
            path: the path that the command follows, if it was given.
        """
        if not accepted:
            if now - self.given > START_TIMEOUT:
                self.end(Status.TIMED_OUT, "the link has not accepted it")
        elif not frame.flags & State.ARMED:
            self.end(Status.ABORTED, "the link has disarmed itself")
        elif self.set_point.mode == Mode.PATH:
            self._follow_path(frame, now, path)
        elif self._arrived(frame):
            self.end(Status.REACHED, "")
        elif frame.status & IN_MOTION or frame.velocity:
            self._moved = now
            self.status = max(self.status, Status.MOVING)
        elif self.status == Status.MOVING and now - self._moved > STALL_TIME:
            self.end(Status.ABORTED, "the joint stopped before its goal")
        elif self.status == Status.ACCEPTED and now - self.given > START_TIMEOUT:
            self.end(Status.TIMED_OUT, "the joint did not start to move")

    def _follow_path(self, frame: Telemetry, now: int, path: SentPath | None) -> None:
        if path and frame.clock < path.start + START_DELAY:
            self._moved = now
        elif path and frame.flags & State.FOLLOWING:
            self.status, self._moved = max(self.status, Status.MOVING), now
        elif path and frame.flags & State.BROKEN:
            self.broken = True
            self.end(Status.ABORTED, self._breakage(frame, path))
        elif path and frame.clock >= path.end and self._is_near(frame, path.knots[-1].position):
            self.end(Status.REACHED, "")
        elif now - self._moved > START_TIMEOUT:
            why = "the link does not follow it" if path else "it was not received"
            if path and self.status == Status.MOVING:
                why = "the joint is at rest, but not at its end"
            self.end(Status.TIMED_OUT, f"path {self.set_point.value}: {why}")

    def _breakage(self, frame: Telemetry, path: SentPath) -> str:
        """Describe the probable reason why the link aborted its path."""
        name = f"path {path.number} of link {frame.link} was aborted"
        if frame.clock < path.end and path.missing <= path.segment_index(frame.clock):
            return f"{name}: no segment after {path.missing} of {len(path.knots) - 1} was received"
        off = abs(self.scale.position(round(path.position(frame.clock)) - frame.position))
        reach = abs(self.scale.velocity(round(MAX_ERROR_TIME * self.set_point.velocity)))
        return f"{name}: the joint is {off:.3g} rad off the path, at most {reach:.3g} allowed"

    def _is_near(self, frame: Telemetry, position: int) -> bool:
        """Return True if the joint rests at `position` [counts]."""
        off = abs(self.scale.position(frame.position - position))
        return off < POSITION_TOLERANCE and not frame.status & IN_MOTION

    def _arrived(self, frame: Telemetry) -> bool:
        set_point = self.set_point
        if set_point.home:
            return bool(frame.flags & State.REFERENCED) and not frame.status & IN_MOTION
        if frame.mode != set_point.mode:
            return False
        if set_point.mode == Mode.POSITION:
            return self._is_near(frame, set_point.value)
        measured = frame.velocity if set_point.mode == Mode.VELOCITY else frame.current
        return abs(measured - set_point.value) <= max(2, abs(set_point.value) // 20)
