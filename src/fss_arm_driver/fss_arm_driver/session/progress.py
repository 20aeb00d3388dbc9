"""How far a link has come with a command, by its status words and not by its having taken it."""

from enum import IntEnum

from fss_arm_driver.faults import IN_MOTION
from fss_arm_driver.protocol import REACH, Mode, State, Telemetry
from fss_arm_driver.scale import Scale, SetPoint
from fss_arm_driver.session.clock import SECOND
from fss_arm_driver.session.paths import SentPath

START_TIMEOUT = 2 * SECOND  # in which a link takes a command and begins to move
STALL_TIME = SECOND  # at rest for so long away from its goal, a joint will not go on
LATENESS = 100_000  # by which a link follows a path once it has begun [us]
POSITION_TOLERANCE = 0.005  # a joint nearer to its goal has reached it [rad]


class Status(IntEnum):
    """How far a command has come, by its numbers in CommandStatus."""

    REFUSED = 0
    ACCEPTED = 1
    MOVING = 2
    REACHED = 3
    ABORTED = 4
    TIMED_OUT = 5


class Progress:
    """Follows one command through the telemetry. All times are the caller's, in nanoseconds.

    Args:
        order: the command.
        given: when it was given first.
        scale: the link's units.
    """

    def __init__(self, order: SetPoint, given: int, scale: Scale) -> None:
        self.order, self.given, self.scale = order, given, scale
        self.status, self.reason = Status.ACCEPTED, ""
        self.broken = False  # it was a path, which the link has broken off
        self._moved = given  # last seen moving

    @property
    def ended(self) -> bool:
        """Whether nothing more will come of it."""
        return self.status >= Status.REACHED

    def end(self, status: Status, reason: str) -> None:
        """It ends like this, unless it has ended before."""
        if not self.ended:
            self.status, self.reason = status, reason

    def follow(self, frame: Telemetry, taken: bool, now: int, path: SentPath | None = None) -> None:
        """Learn from a frame.

        Args:
            frame: the link's.
            taken: it was measured after the link had taken the command.
            now: when it came.
            path: that the command is to follow, if it was given.
        """
        if not taken:
            if now - self.given > START_TIMEOUT:
                self.end(Status.TIMED_OUT, "the link has not taken it")
        elif not frame.flags & State.ARMED:
            self.end(Status.ABORTED, "the link has disarmed itself")
        elif self.order.mode == Mode.PATH:
            self._follow_path(frame, now, path)
        elif self._arrived(frame):
            self.end(Status.REACHED, "")
        elif frame.status & IN_MOTION or frame.velocity:
            self._moved = now
            self.status = max(self.status, Status.MOVING)
        elif self.status == Status.MOVING and now - self._moved > STALL_TIME:
            self.end(Status.ABORTED, "the joint came to rest before it")
        elif self.status == Status.ACCEPTED and now - self.given > START_TIMEOUT:
            self.end(Status.TIMED_OUT, "the joint has not begun to move")

    def _follow_path(self, frame: Telemetry, now: int, path: SentPath | None) -> None:
        if path and frame.clock < path.begin + LATENESS:
            self._moved = now
        elif path and frame.flags & State.FOLLOWING:
            self.status, self._moved = max(self.status, Status.MOVING), now
        elif path and frame.flags & State.BROKEN:
            self.broken = True
            self.end(Status.ABORTED, self._breakage(frame, path))
        elif path and frame.clock >= path.end and self._is_near(frame, path.knots[-1].position):
            self.end(Status.REACHED, "")
        elif now - self._moved > START_TIMEOUT:
            why = "the link does not follow it" if path else "it was not given"
            if path and self.status == Status.MOVING:
                why = "the joint rests away from its end"
            self.end(Status.TIMED_OUT, f"path {self.order.value}: {why}")

    def _breakage(self, frame: Telemetry, path: SentPath) -> str:
        """Why the link broke off its path, as far as can be told from here."""
        name = f"path {path.number} of link {frame.link} broke off"
        if frame.clock < path.end and path.missing <= path.present(frame.clock):
            return f"{name}: no segment after {path.missing} of {len(path.knots) - 1} has come"
        off = abs(self.scale.position(round(path.position(frame.clock)) - frame.position))
        reach = abs(self.scale.velocity(round(REACH * self.order.velocity)))
        return f"{name}: the joint is {off:.3g} rad off it, at most {reach:.3g} allowed"

    def _is_near(self, frame: Telemetry, position: int) -> bool:
        """Whether the joint rests there [counts]."""
        off = abs(self.scale.position(frame.position - position))
        return off < POSITION_TOLERANCE and not frame.status & IN_MOTION

    def _arrived(self, frame: Telemetry) -> bool:
        order = self.order
        if order.home:
            return bool(frame.flags & State.REFERENCED) and not frame.status & IN_MOTION
        if frame.mode != order.mode:
            return False
        if order.mode == Mode.POSITION:
            return self._is_near(frame, order.value)
        measured = frame.velocity if order.mode == Mode.VELOCITY else frame.current
        return abs(measured - order.value) <= max(2, abs(order.value) // 20)
