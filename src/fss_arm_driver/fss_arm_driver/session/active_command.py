"""The active set point. It ends when it expires, is replaced, or the link is disarmed.

The same set point given again extends the active one. An armed link holds its position if there is
no set point, or if the set point pushes a joint at its limit further outward. Times are the
caller's, in nanoseconds.
"""

from fss_arm_driver.protocol import LinkCommandFlag, Mode, Telemetry
from fss_arm_driver.scale import Scale, SetPoint
from fss_arm_driver.session.paths import SentPath
from fss_arm_driver.session.progress import Progress, Status

NO_SET_POINT = SetPoint(Mode.OFF, 0, 0, 0, clamped=False)


class ActiveCommand:
    """Active command of an armed link.

    Args:
        scale: the link's units and limits.
        timeout: time for which a command to hold is valid.
    """

    def __init__(self, scale: Scale, timeout: int) -> None:
        self.progress: Progress | None = None  # of the last set point
        self._scale, self._timeout = scale, timeout
        self._set_point: SetPoint | None = None  # active
        self._expiry = 0  # of the active set point

    def activate(self, set_point: SetPoint, expiry: int, now: int) -> None:
        """Activate a set point until `expiry`."""
        if set_point != self._set_point:
            self.end(Status.ABORTED, "replaced by another command")
            self.progress = Progress(set_point, now, self._scale)
        self._set_point, self._expiry = set_point, expiry

    @property
    def path(self) -> int:
        """Number of the active path; 0: none."""
        set_point = self._set_point
        return set_point.value if set_point and set_point.mode == Mode.PATH else 0

    def end(self, status: Status, why: str) -> None:
        """Deactivate the set point, if there is one."""
        if self._set_point and self.progress:
            self.progress.end(status, why)
        self._set_point = None

    def tick(self, now: int) -> None:
        """Deactivate the set point if it has expired."""
        if self._set_point and now > self._expiry:
            self.end(Status.TIMED_OUT, "its time to live expired")

    def update(
        self, frame: Telemetry, echoed: int | None, now: int, path: SentPath | None = None
    ) -> None:
        """Update the progress from telemetry.

        Args:
            frame: the telemetry.
            echoed: when the command that it echoes was sent, if that is known.
            now: when it was received.
            path: the active path, if any.
        """
        if self._set_point and self.progress:
            accepted = echoed is not None and echoed >= self.progress.given
            self.progress.update(frame, accepted, now, path)
            if self.progress.broken:
                self._set_point = None

    def next_command(self, position: int, now: int) -> tuple[int, int, SetPoint]:
        """Return flags besides ARM, expiry and set point of the next command.

        `position` is that of the joint [counts].
        """
        if self._set_point is None or self._scale.pushes_outward(self._set_point, position):
            return LinkCommandFlag.HOLD, now + self._timeout, NO_SET_POINT
        return LinkCommandFlag.HOME * self._set_point.home, self._expiry, self._set_point
