"""The driver's side of one link, or of the base's board: datagrams in and out, no I/O, no clock.

What is sent when it is lost, adopted, armed, commanded or stopped is as in
docs/reference/protocol.md. All times are the caller's, in integer nanoseconds.
"""

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable
from math import inf, nan
from typing import Any, Generic, NamedTuple, TypedDict, TypeVar

from fss_arm_driver.protocol import VERSION, FrameError, Head, Heard, Order, Refusal, spoken
from fss_arm_driver.scale import CommandError
from fss_arm_driver.session.arming import Arming, ArmingMachine
from fss_arm_driver.session.battery import Battery
from fss_arm_driver.session.clock import SECOND
from fss_arm_driver.session.echoes import Echoes
from fss_arm_driver.session.reception import Reception, Rules

CLOCK_CORRECTION = SECOND // 10  # a simulated clock that is set back by less is being corrected

#: What may happen to a telemetry frame but to be believed.
TROUBLES = (
    *(reason.value for reason in Refusal),
    *("foreign", "impossible", "unproven"),
    *("stale", "repeated", "reordered", "candidates", "missed"),
)
COUNTS = ("received", "believed", *TROUBLES, "adopted", "lost", "sent", "commands_refused")

T = TypeVar("T", bound=Heard)


class Partner(NamedTuple, Generic[T]):
    """What a session talks to."""

    name: str  # in words
    number: int  # in its frames
    telemetry: type[T]
    decode: Callable[[bytes, bytes | None], Head]
    rules: Rules[T]  # of its telemetry
    latches: int  # flags of its telemetry that forbid to arm until it was disarmed
    battery: int  # slow field of its battery's voltage [0.1 V]
    refused: int  # that of the datagrams it refused
    armed_by: str  # the command that a person arms it by


class CommandHead(TypedDict):
    """What all commands begin with."""

    link: int
    flags: int
    boot: int
    sequence: int
    clock: int
    watchdog: int


class Session(ABC, Generic[T]):
    """What the driver knows and wants of a partner; a kind of partner adds its commands.

    Args:
        partner: to talk to.
        timeout: silence after which it is lost [s].
        watchdog: silence after which it shall disarm itself [s].
        resolution: step of the clock that the caller reads [s].
        key: that frames are signed under; None: they are not signed.
        empty: voltage of its battery at which it must be switched off [V].
        epoch: what to add to the caller's clock to have the time of day [ns]: commands are
            stamped by that, once, so that they come after those of an earlier session.
    """

    def __init__(
        self,
        partner: Partner[T],
        timeout: float,
        watchdog: float,
        resolution: float,
        key: bytes | None,
        empty: float,
        epoch: int,
    ) -> None:
        self.partner, self.number, self._key = partner, partner.number, key
        self.counts = Counter(dict.fromkeys(COUNTS, 0))
        self.slow: dict[int, int] = {}  # the last report of each slow field
        self.battery, self._empty = Battery(empty), empty
        self._boot = 0  # of the partner that was followed last
        self._timeout = round(timeout * SECOND)
        self._watchdog = round(watchdog * 1000)  # [ms]
        self._silence = self._watchdog * SECOND // 1000  # the same [ns]
        signed = key is not None
        self._reception = Reception(
            partner.rules, self._timeout, round(resolution * SECOND), signed, self.counts
        )
        self._echoes = Echoes(epoch, self._timeout, self._silence, signed, partner.refused)
        self._arming = ArmingMachine(partner.name, partner.latches)
        self.dropped = ""  # why it was disarmed last, in words, if nobody asked for that
        self._version = VERSION  # of frames of this partner that are refused for it
        self._sequence = 0
        self._now = 0
        self._still = 0  # how long time stood still before `_woke`
        self._woke = -1  # when time went on

    # What a kind of partner adds.

    @property
    def faults(self) -> list[str]:
        """Names of the faults that forbid motion."""
        return []

    @abstractmethod
    def _is_off(self, frame: T) -> bool:
        """Whether what must be off when disarmed is."""

    @abstractmethod
    def _end(self, why: str) -> None:
        """Nothing is in force any more."""

    @abstractmethod
    def _pass(self, now: int) -> None:
        """Let time pass for what is in force."""

    @abstractmethod
    def _learn(self, frame: T, echoed: int | None) -> None:
        """Learn how far what is in force has come from a frame that is believed."""

    def _patience(self) -> int:
        """The least silence after which the partner is lost [ns]."""
        return 0

    @property
    def arming(self) -> Arming:
        """What is wanted of the partner, and how far that has come."""
        return self._arming.state

    @property
    def released(self) -> bool:
        """Whether it has confirmed, since it was disarmed, that it is off."""
        return self._arming.released

    @property
    def armed(self) -> bool:
        """Whether it may act: this driver armed it, and it says so itself."""
        return self.arming is Arming.ARMED

    @property
    def settled(self) -> bool:
        """Whether what was asked last, to arm or to disarm, is done or has come to nothing."""
        return self.arming is not Arming.ARMING and not self._arming.releasing

    @property
    def lost(self) -> bool:
        """Whether nothing believable has come for the timeout, or ever."""
        return self._reception.lost

    @property
    def frame(self) -> T | None:
        """The last frame believed; None while the partner is lost."""
        track = self._reception.track
        return track.frame if track and not self.lost else None

    @property
    def round_trip(self) -> float:
        """Time under way, there and back, of the exchange that maps the clock [s], or NaN."""
        track = self._reception.track
        return track.clock.round_trip if track else nan

    def deviation(self, now: int) -> float:
        """Standard deviation of a stamp [s]; infinite before a round trip."""
        track = self._reception.track
        return track.clock.deviation(now) if track else inf

    @property
    def offset(self) -> float:
        """What to add to the partner's clock to have the host's [s]."""
        track = self._reception.track
        return 1e-9 * track.clock.offset(track.frame.clock) if track else nan

    @property
    def drift(self) -> float:
        """How much faster than the partner's the host's clock runs."""
        track = self._reception.track
        return track.clock.drift if track else nan

    def silence(self, now: int) -> float:
        """Time since a frame was last believed [s]; infinite if none ever was."""
        return 1e-9 * (now - self._reception.heard) if self.counts["believed"] else inf

    @property
    def absence(self) -> str:
        """For how long the partner was not heard, in words."""
        if self._version != VERSION:
            return self.dialect
        if (silence := self.silence(self._now)) == inf:
            return "not heard yet: is it on, and does no other driver talk to it?"
        return f"silent for {silence:.1f} s"

    @property
    def dialect(self) -> str:
        """That the partner speaks another version of the protocol, in words."""
        if self._version == VERSION:
            return ""
        what = "its firmware" if self._version < VERSION else "this computer's software"
        return (
            f"{self.partner.name} speaks version {self._version} of the protocol, expected "
            f"{VERSION}: {'flash' if self._version < VERSION else 'update'} {what}"
        )

    @property
    def rival(self) -> str:
        """That another driver commands the partner, in words; this one does not, then."""
        rival = self._echoes.rival(self._now)
        return f"another driver commands {self.partner.name}" if rival else ""

    @property
    def strain(self) -> str:
        """What makes it hard to command the partner, in words: delay, frames of somebody else."""
        if (way := self._echoes.delay) > self._timeout:
            most = 1e-9 * self._timeout
            return f"delay of {1e-9 * way:.2f} s there and back, at most {most:g} s"
        if self._echoes.crowded:
            return f"{self.partner.name} refuses frames of somebody else: another driver?"
        return ""

    @property
    def standstill(self) -> str:
        """That this process did nothing for longer than the watchdog time, in words."""
        return f"stood still for {1e-9 * self._still:.1f} s" if self._still else ""

    def obstacle(self, now: int) -> str:
        """Why the partner cannot be armed, in words; empty: it can."""
        self.tick(now)
        name, echoes = self.partner.name, self._echoes
        if self.rival:
            return self.rival
        if echoes.delay > self._timeout:
            return f"{name}: {self.strain}"
        if self.lost:
            return self.dialect or f"{name} is lost: {self.absence}"
        if echoes.answered < self._woke:
            return f"{name}: its driver {self.standstill} just now"
        return f"{name} has faults: {', '.join(self.faults)}" if self.faults else ""

    def arm(self, now: int) -> None:
        """Ask the partner to arm, also after a stop; `arming` says how far that has come.

        Raises:
            CommandError: there is an obstacle.
        """
        if obstacle := self.obstacle(now):
            raise CommandError(obstacle)
        self.dropped = ""
        # One that has yet to answer may wait for an earlier driver's watchdog.
        self._arming.arm(now, grace=0 if self._echoes.answered >= 0 else self._silence)

    def disarm(self) -> None:
        """Switch off what can act, also after a stop.

        `released` says whether the partner has, once all is `settled`; a lost one cannot confirm
        it.
        """
        self._end("disarmed")
        self.dropped = ""
        self._arming.disarm(self._now, self.lost)

    def stop(self) -> None:
        """Stop now, until armed anew or disarmed; what is off stays off."""
        self._end("stopped")
        self._arming.stop()

    def _drop(self, why: str) -> None:
        """Disarm without a person's request: a stop stays."""
        if self.arming in (Arming.ARMING, Arming.ARMED):
            self.dropped = why
        self._end(why)
        self._arming.drop()

    def require_armed(self) -> None:
        """Raise CommandError if it is not armed."""
        if not self.armed:
            name, how = self.partner.name, self.partner.armed_by
            raise CommandError(f"{name} is {self.arming.value}, not armed: {how} arms it")

    def tick(self, now: int) -> None:
        """Let time pass: loss, expiry, arming that came to nothing, a simulated clock set back.

        Time in which this was not called long enough for the partner to disarm itself, as the
        process was stopped or the computer slept, is time that nobody watched it.
        """
        if self._now and now - self._now > self._silence:
            self._still, self._woke = now - self._now, now
            self._drop(self.standstill)
        if now < self._now - CLOCK_CORRECTION:
            self._reception.forget(now)
            self._echoes.forget()
            self._woke = -1
            self._arming.forget()
            self._drop("the clock was set back")
        self._now = now
        if self._reception.tick(now, self._patience()):
            self._echoes.delay = 0
            self._drop(f"{self.partner.name} is lost")
        self._pass(now)
        self._arming.tick(now, self._echoes.delay, self.lost)

    def _flags(self, now: int) -> int:
        """Of the next command."""
        return self._arming.flags(self.frame, self._echoes.answered >= 0, now)

    def _head(self, flags: int, now: int) -> CommandHead:
        """The beginning of a command that is sent now."""
        self._sequence = (self._sequence + 1) & 0xFFFFFFFF
        self.counts["sent"] += 1
        frame = self.frame
        return CommandHead(
            link=self.number,
            flags=flags,
            boot=frame.boot if frame else 0,
            sequence=self._sequence,
            clock=self._echoes.stamp(now, latest=bool(flags & Order.STOP)),
            watchdog=self._watchdog,
        )

    def _by_its_clock(self, time: int) -> int:
        """A host time in the partner's clock [us]; 0: none, or not known."""
        track = self._reception.track
        return track.clock.to_link(time) if track and time else 0

    def _take(self, data: bytes, now: int) -> tuple[T, int] | None:
        """Take a datagram; the frame and when it was measured if it is to be believed [ns]."""
        self.tick(now)
        self.counts["received"] += 1
        if (frame := self._decode(data)) is None:
            return None
        lost, echoed = self.lost, self._echoes.sent_at(frame)
        stamp = self._reception.take(frame, echoed, now)
        if stamp is not None or lost:
            self._echoes.hear(frame, now)
        if stamp is None:
            return None
        if self.rival:
            self._drop(self.rival)
        if lost:  # nothing is wanted of a partner that was not followed until now
            self._drop(f"{self.partner.name} was lost")
        return frame, stamp

    def _follow(self, frame: T) -> None:
        """Learn from a frame that is believed: its slow values, arming, the last command."""
        if frame.boot != self._boot:
            self._boot, self.slow, self.battery = frame.boot, {}, Battery(self._empty)
        self.slow[frame.slow_id] = frame.slow_value
        if frame.slow_id == self.partner.battery:
            self.battery.take(0.1 * frame.slow_value, self._now)
        echoed = self._echoes.sent_at(frame)
        self._learn(frame, echoed)
        if why := self._arming.follow(frame, echoed, self._is_off(frame), self.faults):
            self._drop(why)

    def _decode(self, data: bytes) -> T | None:
        """The telemetry of this partner that these bytes are, or None, counted."""
        try:
            frame: Any = self.partner.decode(data, self._key)
        except FrameError as error:
            self.counts[error.reason.value] += 1
            if error.reason is Refusal.VERSION and self.lost:
                version, link = spoken(data)
                self._version = version if link == self.number else self._version
            return None
        if not isinstance(frame, self.partner.telemetry) or frame.link != self.number:
            self.counts["foreign"] += 1
            return None
        self._version = VERSION
        return frame
