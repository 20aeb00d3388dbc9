"""Arming of one link: the state that the driver requests and what the link has confirmed.

    DISARMED --arm--> ARMING --the link is armed and echoes a later command--> ARMED
    ARMING --ARMING_TIMEOUT--> DISARMED
    ARMING, ARMED --a fault, loss, the link disarms itself--> DISARMED
    any --stop--> STOPPED --arm--> ARMING
    any --disarm--> DISARMED, and `released` once the link confirms that its drive is off

Only the operator can leave STOPPED, by arming or disarming. Each command repeats the requested
state, so a lost command does no harm. Times are read from the caller's clock, in nanoseconds.
"""

from enum import Enum

from fss_arm_model.units import SECOND
from fss_link.protocol import CommandFlag, StatusFlag, TelemetryHead

ARMING_TIMEOUT = 2 * SECOND  # a link that is not armed by then stays disarmed
RELEASE_TIMEOUT = 4 * SECOND  # by then the drive is off, even if the joint still moves
CLEAR_FAULTS_TIME = 2 * SECOND  # during which commands ask to clear the drive's faults


class Arming(Enum):
    """State that the driver requests of the link, with the progress of arming."""

    DISARMED = "disarmed"
    ARMING = "arming"
    ARMED = "armed"
    STOPPED = "stopped"


class ArmingMachine:
    """State machine that arms one partner, driven by requests and by its telemetry.

    Args:
        name: of the partner, for messages.
        latches: telemetry flags that prevent arming until the partner has been disarmed.
    """

    def __init__(self, name: str, latches: int) -> None:
        self._name, self._latches = name, latches
        self.state = Arming.DISARMED
        self.released = False  # the link has confirmed that its drive is off, as requested
        self.releasing = False  # the confirmation is still expected
        self._arm_time = self._disarm_time = 0  # times of the last requests
        self._timeout = ARMING_TIMEOUT  # of arming
        self._clear_end = 0  # end of the request to clear faults

    def arm(self, now: int, grace: int) -> None:
        """Request arming, with `grace` added to the usual timeout."""
        self.released = self.releasing = False
        if self.state is not Arming.ARMED:
            self.state, self._arm_time = Arming.ARMING, now
            self._timeout = ARMING_TIMEOUT + grace

    def disarm(self, now: int, lost: bool) -> None:
        """Request that the drive switches off, also after a stop; a lost link cannot confirm it."""
        self.state, self._disarm_time = Arming.DISARMED, now
        self.released, self.releasing = False, not lost

    def drop(self) -> None:
        """Disarm for a reason other than the operator's request; a stop stays in effect."""
        if self.state is not Arming.STOPPED:
            self.state = Arming.DISARMED

    def stop(self) -> None:
        """Stop, and hold the position until armed again or disarmed."""
        self.state = Arming.STOPPED

    def clear_faults(self, now: int) -> None:
        """Request that the drive clears its latched faults, while disarmed."""
        self._clear_end = now + CLEAR_FAULTS_TIME

    def reset(self) -> None:
        """Discard the times that are invalid once the caller's clock was set back."""
        self._clear_end = 0

    def tick(self, now: int, delay: int, lost: bool) -> None:
        """Apply the timeouts at time `now`, with a round trip of `delay`."""
        timeout = self._timeout + 2 * delay  # the latches are cleared first
        if self.state is Arming.ARMING and now - self._arm_time > timeout:
            self.state = Arming.DISARMED
        if lost or now - self._disarm_time > RELEASE_TIMEOUT:
            self.releasing = False

    def follow(self, frame: TelemetryHead, echoed: int | None, off: bool, faults: list[str]) -> str:
        """Update the state from telemetry; return the reason to disarm, empty if there is none.

        Args:
            frame: the telemetry.
            echoed: when the command that it echoes was sent, if that is known.
            off: whether everything that must be off when disarmed is off.
            faults: names of the faults that forbid motion.
        """
        armed = bool(frame.flags & StatusFlag.ARMED)
        reason = ""
        if self.state is Arming.ARMED and not armed:
            reason = f"{self._name} has disarmed itself"
        elif self.state is not Arming.DISARMED and faults:
            reason = ", ".join(faults)
        elif self.state is Arming.ARMING and armed and echoed and echoed >= self._arm_time:
            self.state = Arming.ARMED
        if self.releasing and off and not armed and echoed and echoed > self._disarm_time:
            self.releasing, self.released = False, True
        return reason

    def flags(self, frame: TelemetryHead | None, answered: bool, now: int) -> int:
        """Return the flags of the next command.

        A command that does not arm clears the link's latches and starts a session.

        Args:
            frame: the link's last frame.
            answered: whether the link has echoed any command.
            now: the time.
        """
        if self.state is Arming.STOPPED:
            return CommandFlag.STOP
        if frame is None or self.state is Arming.DISARMED:
            return CommandFlag.CLEAR_FAULTS if now < self._clear_end else 0
        latched = frame.flags & self._latches
        if self.state is Arming.ARMING and (latched or not answered):
            return 0
        return CommandFlag.ARM
