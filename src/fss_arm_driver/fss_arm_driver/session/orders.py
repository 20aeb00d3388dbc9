"""The set point in force: until it expires, another takes its place, or the link is disarmed.

A set point given again prolongs the one in force. Without one, and while one pushes the joint on
at its limit, an armed link holds its place. Times are the caller's, in nanoseconds.
"""

from fss_arm_driver.protocol import Mode, Order, Telemetry
from fss_arm_driver.scale import Scale, SetPoint
from fss_arm_driver.session.paths import SentPath
from fss_arm_driver.session.progress import Progress, Status

NO_SET_POINT = SetPoint(Mode.OFF, 0, 0, 0, clamped=False)


class Orders:
    """What an armed link is to do.

    Args:
        scale: the link's units and limits.
        timeout: for how long a command to hold is in force.
    """

    def __init__(self, scale: Scale, timeout: int) -> None:
        self.progress: Progress | None = None  # of the last set point
        self._scale, self._timeout = scale, timeout
        self._set_point: SetPoint | None = None  # in force
        self._expiry = 0  # of it

    def give(self, set_point: SetPoint, expiry: int, now: int) -> None:
        """Put a set point in force until `expiry`."""
        if set_point != self._set_point:
            self.end(Status.ABORTED, "another command took its place")
            self.progress = Progress(set_point, now, self._scale)
        self._set_point, self._expiry = set_point, expiry

    @property
    def path(self) -> int:
        """Number of the path that is in force; 0: none is."""
        order = self._set_point
        return order.value if order and order.mode == Mode.PATH else 0

    def end(self, status: Status, why: str) -> None:
        """Put the set point out of force, if there is one."""
        if self._set_point and self.progress:
            self.progress.end(status, why)
        self._set_point = None

    def tick(self, now: int) -> None:
        """Let time pass."""
        if self._set_point and now > self._expiry:
            self.end(Status.TIMED_OUT, "its time to live ended")

    def follow(
        self, frame: Telemetry, echoed: int | None, now: int, path: SentPath | None = None
    ) -> None:
        """Learn from telemetry that echoes a command sent at `echoed`, `path` being in force."""
        if self._set_point and self.progress:
            taken = echoed is not None and echoed >= self.progress.given
            self.progress.follow(frame, taken, now, path)
            if self.progress.broken:
                self._set_point = None

    def wanted(self, position: int, now: int) -> tuple[int, int, SetPoint]:
        """Flags beside ARM, expiry and set point of a command, the joint at `position` [counts]."""
        if self._set_point is None or self._scale.outward(self._set_point, position):
            return Order.HOLD, now + self._timeout, NO_SET_POINT
        return Order.HOME * self._set_point.home, self._expiry, self._set_point
