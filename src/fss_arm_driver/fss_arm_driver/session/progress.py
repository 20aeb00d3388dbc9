"""How far a link has come with a command, by its status words and not by its having taken it."""

from enum import IntEnum

from fss_arm_driver.faults import IN_MOTION
from fss_arm_driver.protocol import Mode, State, Telemetry
from fss_arm_driver.scale import Scale, SetPoint
from fss_arm_driver.session.clock import SECOND

START_TIMEOUT = 2 * SECOND  # in which a link takes a command and begins to move
STALL_TIME = SECOND  # at rest for so long away from its goal, a joint will not go on
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
        self._moved = given  # last seen moving

    @property
    def ended(self) -> bool:
        """Whether nothing more will come of it."""
        return self.status >= Status.REACHED

    def end(self, status: Status, reason: str) -> None:
        """It ends like this, unless it has ended before."""
        if not self.ended:
            self.status, self.reason = status, reason

    def follow(self, frame: Telemetry, taken: bool, now: int) -> None:
        """Learn from a frame; `taken`: it was measured after the link had taken the command."""
        if not taken:
            if now - self.given > START_TIMEOUT:
                self.end(Status.TIMED_OUT, "the link has not taken it")
        elif not frame.flags & State.ARMED:
            self.end(Status.ABORTED, "the link has disarmed itself")
        elif self._arrived(frame):
            self.end(Status.REACHED, "")
        elif frame.status & IN_MOTION or frame.velocity:
            self._moved = now
            self.status = max(self.status, Status.MOVING)
        elif self.status == Status.MOVING and now - self._moved > STALL_TIME:
            self.end(Status.ABORTED, "the joint came to rest before it")
        elif self.status == Status.ACCEPTED and now - self.given > START_TIMEOUT:
            self.end(Status.TIMED_OUT, "the joint has not begun to move")

    def _arrived(self, frame: Telemetry) -> bool:
        order = self.order
        if order.home:
            return bool(frame.flags & State.REFERENCED) and not frame.status & IN_MOTION
        if frame.mode != order.mode:
            return False
        if order.mode == Mode.POSITION:
            off = abs(self.scale.position(frame.position - order.value))
            return off < POSITION_TOLERANCE and not frame.status & IN_MOTION
        measured = frame.velocity if order.mode == Mode.VELOCITY else frame.current
        return abs(measured - order.value) <= max(2, abs(order.value) // 20)
