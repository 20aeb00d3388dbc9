"""Evaluation of a link's echoes: communication delay, and whose commands the link accepts.

The rules and their reasons are in docs/reference/protocol.md, section "The computer". All times
are the caller's, in nanoseconds.
"""

from collections import deque
from secrets import randbelow
from typing import NamedTuple

from fss_arm_model.units import SECOND
from fss_link.protocol import TelemetryHead
from fss_link.session.clock import MICROSECOND

ECHO_MEMORY = 60 * SECOND  # for which sent commands are remembered
STAMP_SPREAD = 100_000  # a stamp lies at most this long before its command [us]
MASK = 0xFFFFFFFF  # an echo is the low 32 bits of a stamp
MAX_STAMP_LEAD = 86_400_000_000  # largest lead of stamps over the time of day [us]
CROWD_COMMANDS = 5  # commands to send before the share of refused datagrams is checked


class Refusals(NamedTuple):
    """Number of datagrams that a link had refused when `sent` commands had been sent to it."""

    boot: int
    refused: int
    sent: int


class Echoes:
    """Record of the commands sent to a link and of the echoes in its telemetry.

    Args:
        epoch: time of day minus the caller's clock.
        timeout: age of a frame that is too old.
        watchdog: silence after which a link accepts commands of another driver.
        signed: whether frames are signed; the link then accepts only commands with a later stamp
            than all it has accepted.
        refused: the slow field that counts the datagrams that the link refused.
    """

    def __init__(self, epoch: int, timeout: int, watchdog: int, signed: bool, refused: int) -> None:
        self._epoch, self._timeout, self._watchdog = epoch, timeout, watchdog
        self._signed, self._refused = signed, refused
        self.sent = 0  # commands and segments
        self.delay = 0  # round trip of the last command known to be accepted
        self.answered = -1  # when the last command known to be accepted was sent
        self.crowded = False  # the link refuses many datagrams of other senders
        self._answer = 0  # echo of that command
        self._first_sent = 0  # when the first command was sent
        self._clock = 0  # stamp of the last command [us]
        self._ours: dict[int, int] = {}  # sending times, by the low 32 bits of a command's stamp
        self._others: deque[int] = deque(maxlen=2)  # when the link accepted other commands
        self._refusals: Refusals | None = None

    def stamp(self, now: int, latest: bool = False) -> int:
        """Draw the stamp of a command sent now: the time of day [us], strictly increasing.

        The stamp is random within STAMP_SPREAD, so that a recording does not contain it, even if
        both use simulated time. With `latest` it is the latest possible one, so that it is later
        than the stamps of other drivers.
        """
        self._first_sent = self._first_sent or now
        self.sent += 1
        day = (now + self._epoch) // MICROSECOND
        least = max(self._clock + 1, day if latest else day - STAMP_SPREAD)
        self._clock = least + randbelow(max(1, day + 1 - least))
        self._ours[self._clock & MASK] = now
        while now - self._ours[oldest := next(iter(self._ours))] > ECHO_MEMORY:
            del self._ours[oldest]
        return self._clock

    def last_stamp(self) -> int:
        """Return the stamp of the last command [us], for a path segment that is sent with it."""
        self.sent += 1
        return self._clock

    def reset(self) -> None:
        """Discard the sending times, which are invalid once the caller's clock was set back."""
        self._ours.clear()
        self._others.clear()
        self._first_sent, self.answered = 0, -1

    def sent_at(self, frame: TelemetryHead) -> int | None:
        """Return when the command that a frame echoes was sent; None if it is not ours."""
        if frame.echo == self._answer and self.answered >= 0:  # however long ago
            return self.answered
        return self._ours.get(frame.echo) if frame.echo else None

    def has_other_driver(self, now: int) -> bool:
        """Return True if the link accepts commands of another driver."""
        return len(self._others) == 2 and now - self._others[0] <= 2 * self._timeout

    def update(self, frame: TelemetryHead, now: int) -> None:
        """Update from an accepted frame, or from any frame while the link is lost."""
        if (sent := self.sent_at(frame)) is not None:
            self._answer, self.answered = frame.echo, sent
            self.delay = max(0, now - sent - frame.turnaround * MICROSECOND)
        elif frame.echo not in (0, self._answer) and self._first_sent:
            self._update_other(frame, now)
        if frame.slow_id == self._refused:
            self._count_refused(frame, sent is not None)

    def _update_other(self, frame: TelemetryHead, now: int) -> None:
        """Handle the echo of a command of another driver or of an earlier session."""
        accepted = now - frame.turnaround * MICROSECOND  # at the latest
        if accepted > self._first_sent + self._watchdog and now - accepted <= self._timeout:
            self._others.append(now)
        elif self._signed and min(now - accepted, now - self._first_sent) > self._watchdog:
            # No driver commands the link, yet it refuses ours: it has accepted later stamps.
            later_stamp = self._clock + ((frame.echo - self._clock) & MASK)
            if later_stamp <= (now + self._epoch) // MICROSECOND + MAX_STAMP_LEAD:
                self._clock = later_stamp

    def _count_refused(self, frame: TelemetryHead, accepted: bool) -> None:
        """Compare the refused with the sent datagrams, while the link accepts our commands."""
        then, now = self._refusals, Refusals(frame.boot, frame.slow_value & MASK, self.sent)
        if not accepted or then is None or then.boot != now.boot:
            self.crowded, self._refusals = False, now if accepted else None
        elif now.sent - then.sent >= CROWD_COMMANDS:
            self.crowded = 2 * (now.refused - then.refused) > now.sent - then.sent
            self._refusals = now
