"""Arming of one link: what the driver wants of its drive, and what the link has confirmed.

    DISARMED --arm--> ARMING --the link is armed, in answer to a later command--> ARMED
    ARMING --ARMING_TIMEOUT--> DISARMED
    ARMING, ARMED --a fault, loss, the link disarms itself--> DISARMED
    any --stop--> STOPPED --arm--> ARMING
    any --disarm--> DISARMED, and `released` once the link confirms that its drive is off

Only a person leaves STOPPED, by arming or disarming. Each command repeats what is wanted, so a
lost one costs nothing. Times are the caller's, in nanoseconds.
"""

from enum import Enum

from fss_arm_driver.protocol import Heard, Order, State
from fss_arm_driver.session.clock import SECOND

ARMING_TIMEOUT = 2 * SECOND  # a link that has not armed by then is left disarmed
RELEASE_TIMEOUT = 4 * SECOND  # a disarmed link's drive is off by then, its joint at rest or not
CLEAR_FAULTS_TIME = 2 * SECOND  # for which commands ask to clear the drive's faults


class Arming(Enum):
    """What the driver wants of the link, and how far that has come."""

    DISARMED = "disarmed"
    ARMING = "arming"
    ARMED = "armed"
    STOPPED = "stopped"


class ArmingMachine:
    """The state that the commands ask for, by what is asked and what the link reports.

    Args:
        name: of what is armed, for words.
        latches: flags of its telemetry that forbid to arm until it was disarmed.
    """

    def __init__(self, name: str, latches: int) -> None:
        self._name, self._latches = name, latches
        self.state = Arming.DISARMED
        self.released = False  # the link has confirmed that its drive is off, as asked
        self.releasing = False  # it may still confirm that
        self._arm_time = self._disarm_time = 0  # when each was asked
        self._timeout = ARMING_TIMEOUT  # of arming
        self._clear_end = 0  # of asking to clear faults

    def arm(self, now: int, grace: int) -> None:
        """Ask to arm, allowing `grace` beyond the usual time."""
        self.released = self.releasing = False
        if self.state is not Arming.ARMED:
            self.state, self._arm_time = Arming.ARMING, now
            self._timeout = ARMING_TIMEOUT + grace

    def disarm(self, now: int, lost: bool) -> None:
        """Ask to switch the drive off, also after a stop; a lost link cannot confirm it."""
        self.state, self._disarm_time = Arming.DISARMED, now
        self.released, self.releasing = False, not lost

    def drop(self) -> None:
        """Disarm for another reason than a person's request: a stop stays."""
        if self.state is not Arming.STOPPED:
            self.state = Arming.DISARMED

    def stop(self) -> None:
        """Stop, and hold that place until armed anew or disarmed."""
        self.state = Arming.STOPPED

    def clear_faults(self, now: int) -> None:
        """Have the drive forget its latched faults, while disarmed."""
        self._clear_end = now + CLEAR_FAULTS_TIME

    def forget(self) -> None:
        """The caller's clock was set back: when to end asking means nothing any more."""
        self._clear_end = 0

    def tick(self, now: int, delay: int, lost: bool) -> None:
        """Let time pass, the way to the link and back taking `delay`."""
        timeout = self._timeout + 2 * delay  # its latches are cleared first
        if self.state is Arming.ARMING and now - self._arm_time > timeout:
            self.state = Arming.DISARMED
        if lost or now - self._disarm_time > RELEASE_TIMEOUT:
            self.releasing = False

    def follow(self, frame: Heard, echoed: int | None, off: bool, faults: list[str]) -> str:
        """Learn from telemetry that echoes a command sent at `echoed`; why to drop, if at all.

        `off`: what must be off when disarmed is.
        """
        armed = bool(frame.flags & State.ARMED)
        trouble = ""
        if self.state is Arming.ARMED and not armed:
            trouble = f"{self._name} has disarmed itself"
        elif self.state is not Arming.DISARMED and faults:
            trouble = ", ".join(faults)
        elif self.state is Arming.ARMING and armed and echoed and echoed >= self._arm_time:
            self.state = Arming.ARMED
        if self.releasing and off and not armed and echoed and echoed > self._disarm_time:
            self.releasing, self.released = False, True
        return trouble

    def flags(self, frame: Heard | None, answered: bool, now: int) -> int:
        """Of the next command, the link's last frame being `frame`, and any command `answered`.

        A link's latches are cleared, and a session begun, by a command that does not arm.
        """
        if self.state is Arming.STOPPED:
            return Order.STOP
        if frame is None or self.state is Arming.DISARMED:
            return Order.CLEAR_FAULTS if now < self._clear_end else 0
        latched = frame.flags & self._latches
        if self.state is Arming.ARMING and (latched or not answered):
            return 0
        return Order.ARM
