"""Log lines for each change of state of a link or of the base's board."""

from typing import Any

from fss_arm_ros.log_line import LogLine
from fss_link.protocol import StatusFlag
from fss_link.session.arming import Arming
from fss_link.session.session import Session

ABSENCE_TIMEOUT = 5_000_000_000  # before a partner that never sent a frame is reported [ns]


class StatusLog:
    """Reporter of the changes of a session since the last call; times are in nanoseconds."""

    def __init__(self, session: Session[Any]) -> None:
        self._session, self._name = session, session.partner.name
        self._lost, self._losses = True, 0
        self._last_accepted = 0  # when a frame was last accepted
        self._first_call, self._absence_logged = 0, False
        self._arming = Arming.DISARMED
        self._faults: list[str] = []
        self._tripped, self._last_stall = False, ""

    def __call__(self, now: int) -> list[LogLine]:
        """Return a line for each change, and one if none was accepted for ABSENCE_TIMEOUT."""
        session, lines = self._session, self._stall_lines()
        if session.lost != self._lost:
            lines += [self._loss_or_return(now)]
        elif not session.lost and session.counts["lost"] > self._losses:
            lines += [self._short_loss()]
        else:
            lines += [] if lines else self._arming_changes()
            lines += [*self._watchdog(), *self._fault_changes()]
        self._first_call = self._first_call or now
        known = self._last_accepted or self._absence_logged
        if session.lost and not known and now > self._first_call + ABSENCE_TIMEOUT:
            self._absence_logged = True
            words = session.version_problem or f"{self._name}: {session.loss_reason}"
            lines.append(LogLine(words, bad=True))
        if not session.lost:
            self._last_accepted = now - round(1e9 * session.silence(now))
        self._lost, self._losses = session.lost, session.counts["lost"]
        self._arming = session.arming
        return lines

    def _stall_lines(self) -> list[LogLine]:
        """Return a line if the driver itself was stalled."""
        before, self._last_stall = self._last_stall, self._session.stall
        words = f"{self._name} is disarmed: its driver {self._last_stall}"
        new = self._last_accepted and self._last_stall and self._last_stall != before
        return [LogLine(words, bad=True, for_operator=True)] if new else []

    def _loss_or_return(self, now: int) -> LogLine:
        """Return a line that the partner is lost, or that it is received (again)."""
        name, session = self._name, self._session
        if session.lost:
            words = f"{name} is lost: {session.loss_reason}{self._state_before()}"
            return LogLine(words, bad=True, for_operator=True)
        if not self._last_accepted:
            return LogLine(f"{name} is connected and {session.arming.value}")
        away = 1e-9 * (now - self._last_accepted)
        words = f"{name} is connected again after {away:.1f} s{self._state_now()}"
        return LogLine(words, for_operator=True)

    def _short_loss(self) -> LogLine:
        """Return a line that the partner was lost and has returned since the last call."""
        words = f"{self._name} was lost{self._state_before()}; connected again{self._state_now()}"
        return LogLine(words, bad=True, for_operator=True)

    def _state_before(self) -> str:
        """Return words about its state at the last call; empty if it was disarmed."""
        return f"; it was {self._arming.value}" if self._arming is not Arming.DISARMED else ""

    def _state_now(self) -> str:
        """Return words about its state after a loss, which has disarmed it."""
        state = self._session.arming
        requested = "; it was disarmed, arming was requested"
        return requested if state is Arming.ARMING else f" and {state.value}"

    def _arming_changes(self) -> list[LogLine]:
        before, state = self._arming, self._session.arming
        if state is before:
            return []
        why = self._session.disarm_reason
        if state is Arming.DISARMED and before is Arming.ARMING:
            return [LogLine(f"{self._name} did not arm{': ' * bool(why)}{why}", bad=True)]
        if state is Arming.DISARMED and why:
            return [LogLine(f"{self._name} is disarmed: {why}", bad=True, for_operator=True)]
        stopped = state is Arming.STOPPED
        return [LogLine(f"{self._name} is {state.value}", bad=stopped, for_operator=stopped)]

    def _watchdog(self) -> list[LogLine]:
        """Return a line if the partner disarmed itself as it received no commands.

        Arming clears this state.
        """
        frame = self._session.frame
        before, self._tripped = self._tripped, bool(frame and frame.flags & StatusFlag.WATCHDOG)
        words = f"{self._name}: its watchdog tripped, as it received no commands"
        tripped = self._tripped and not before
        return [LogLine(words, bad=True, for_operator=True)] if tripped else []

    def _fault_changes(self) -> list[LogLine]:
        faults = self._session.faults if self._session.frame else self._faults
        before, self._faults = self._faults, faults
        if new := [fault for fault in faults if fault not in before]:
            words = f"{self._name} has a fault: {', '.join(new)}"
            return [LogLine(words, bad=True, for_operator=True)]
        cleared = before and not faults
        return (
            [LogLine(f"{self._name} has no fault any more", for_operator=True)] if cleared else []
        )
