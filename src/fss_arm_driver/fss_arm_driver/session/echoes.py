"""What the link's echo says of the commands: how long the way is, and whose commands it takes.

The rules and their reasons are in docs/reference/protocol.md, The computer. All times are the
caller's, in nanoseconds.
"""

from collections import deque
from secrets import randbelow
from typing import NamedTuple

from fss_arm_driver.protocol import Heard
from fss_arm_driver.session.clock import MICROSECOND, SECOND

ECHO_MEMORY = 60 * SECOND  # for so long an echo is known as that of a command of ours
STAMP_SPREAD = 100_000  # a stamp is drawn from this time before its command [us]
MASK = 0xFFFFFFFF  # an echo is the low 32 bits of a stamp
MAX_STAMP_LEAD = 86_400_000_000  # that stamps may run ahead of the time of day at most [us]
CROWD_COMMANDS = 5  # to send before the share of refused datagrams is checked


class Refusals(NamedTuple):
    """How many datagrams a link had refused when so many commands had been sent to it."""

    boot: int
    refused: int
    sent: int


class Echoes:
    """The commands sent to a link, and what its telemetry says of them.

    Args:
        epoch: what to add to the caller's clock to have the time of day.
        timeout: age of a frame that is too old.
        watchdog: silence after which a link takes commands of another driver.
        signed: whether the link takes only commands later than all that it took.
        refused: the slow field that says how many datagrams it refused.
    """

    def __init__(self, epoch: int, timeout: int, watchdog: int, signed: bool, refused: int) -> None:
        self._epoch, self._timeout, self._watchdog = epoch, timeout, watchdog
        self._signed, self._refused = signed, refused
        self.sent = 0  # commands and segments
        self.delay = 0  # there and back, of the last command known to be taken
        self.answered = -1  # when the last command known to be taken was sent
        self.crowded = False  # the link refuses many commands that are not ours
        self._answer = 0  # its echo
        self._begun = 0  # when the first command was sent
        self._clock = 0  # stamp of the last [us]
        self._ours: dict[int, int] = {}  # low 32 bits of a command's stamp: when it was sent
        self._others: deque[int] = deque(maxlen=2)  # when another's commands were seen taken
        self._refusals: Refusals | None = None

    def stamp(self, now: int, latest: bool = False) -> int:
        """Draw the stamp of a command sent now: the time of day [us], greater each time.

        It is random within STAMP_SPREAD, so that a recording does not hold it, even if both are of
        simulated time. The `latest` possible one comes after those of other drivers.
        """
        self._begun = self._begun or now
        self.sent += 1
        day = (now + self._epoch) // MICROSECOND
        least = max(self._clock + 1, day if latest else day - STAMP_SPREAD)
        self._clock = least + randbelow(max(1, day + 1 - least))
        self._ours[self._clock & MASK] = now
        while now - self._ours[oldest := next(iter(self._ours))] > ECHO_MEMORY:
            del self._ours[oldest]
        return self._clock

    def last_stamp(self) -> int:
        """The stamp of the last command, for one more segment of a path that goes with it [us]."""
        self.sent += 1
        return self._clock

    def forget(self) -> None:
        """The caller's clock was set back: when commands were sent means nothing any more."""
        self._ours.clear()
        self._others.clear()
        self._begun, self.answered = 0, -1

    def sent_at(self, frame: Heard) -> int | None:
        """Time at which the command that a frame echoes was sent, if it is one of ours."""
        if frame.echo == self._answer and self.answered >= 0:  # however long ago
            return self.answered
        return self._ours.get(frame.echo) if frame.echo else None

    def rival(self, now: int) -> bool:
        """Whether the link takes commands of another driver."""
        return len(self._others) == 2 and now - self._others[0] <= 2 * self._timeout

    def hear(self, frame: Heard, now: int) -> None:
        """Learn from a frame that is believed, or that came while none is."""
        if (sent := self.sent_at(frame)) is not None:
            self._answer, self.answered = frame.echo, sent
            self.delay = max(0, now - sent - frame.turnaround * MICROSECOND)
        elif frame.echo not in (0, self._answer) and self._begun:
            self._hear_other(frame, now)
        if frame.slow_id == self._refused:
            self._count_refused(frame, sent is not None)

    def _hear_other(self, frame: Heard, now: int) -> None:
        """The link took a command that is none of ours: another driver's, or our predecessor's."""
        taken = now - frame.turnaround * MICROSECOND  # at the latest
        if taken > self._begun + self._watchdog and now - taken <= self._timeout:
            self._others.append(now)
        elif self._signed and min(now - taken, now - self._begun) > self._watchdog:
            # Nobody commands the link, and yet it takes none of ours: it has taken later ones.
            later = self._clock + ((frame.echo - self._clock) & MASK)
            if later <= (now + self._epoch) // MICROSECOND + MAX_STAMP_LEAD:
                self._clock = later

    def _count_refused(self, frame: Heard, taken: bool) -> None:
        """Compare what the link refused with what was sent, while it takes that."""
        then, now = self._refusals, Refusals(frame.boot, frame.slow_value & MASK, self.sent)
        if not taken or then is None or then.boot != now.boot:
            self.crowded, self._refusals = False, now if taken else None
        elif now.sent - then.sent >= CROWD_COMMANDS:
            self.crowded = 2 * (now.refused - then.refused) > now.sent - then.sent
            self._refusals = now
