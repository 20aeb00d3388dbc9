"""Driver side of one link, or of the base's board: datagrams in and out, no I/O, no clock.

docs/reference/protocol.md defines what is sent when the partner is lost, adopted, armed, commanded
or stopped. All times are the caller's, in integer nanoseconds.
"""

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable
from math import inf, nan
from typing import Any, Generic, NamedTuple, TypedDict, TypeVar

from fss_link.protocol import (
    VERSION,
    CommandFlag,
    FrameError,
    Head,
    Refusal,
    TelemetryHead,
    version_and_link,
)
from fss_link.session.arming import Arming, ArmingMachine
from fss_link.session.battery import Battery
from fss_link.session.clock import SECOND
from fss_link.session.echoes import Echoes
from fss_link.session.reception import Reception, Rules

CLOCK_CORRECTION = SECOND // 10  # a simulated clock set back by less is only corrected

#: Outcomes of telemetry frames other than acceptance.
FRAME_PROBLEMS = (
    *(reason.value for reason in Refusal),
    *("foreign", "impossible", "unproven"),
    *("stale", "repeated", "reordered", "candidates", "missed"),
)
COUNTS = ("received", "accepted", *FRAME_PROBLEMS, "adopted", "lost", "sent", "commands_refused")

T = TypeVar("T", bound=TelemetryHead)


class CommandError(ValueError):
    """Error of a command that is not allowed; the message gives the reason."""


class Partner(NamedTuple, Generic[T]):
    """Partner of a session: a link or the base's board."""

    name: str  # in words
    number: int  # in its frames
    telemetry: type[T]
    decode: Callable[[bytes, bytes | None], Head]
    rules: Rules[T]  # of its telemetry
    latches: int  # telemetry flags that prevent arming until it is disarmed
    battery: int  # slow field of its battery's voltage [0.1 V]
    refused: int  # slow field of the number of datagrams that it refused
    armed_by: str  # the operator's command that arms it


class HeaderFields(TypedDict):
    """Header of all commands."""

    link: int
    flags: int
    boot: int
    sequence: int
    clock: int
    watchdog: int


class Session(ABC, Generic[T]):
    """Session with a partner. A subclass for each kind of partner adds the commands.

    Args:
        partner: the link or board.
        timeout: silence after which it is lost [s].
        watchdog: silence after which it must disarm itself [s].
        resolution: step of the clock that the caller reads [s].
        key: key that signs the frames; None: they are not signed.
        empty: voltage of its battery at which it must be switched off [V].
        epoch: time of day minus the caller's clock [ns]. Commands are stamped with the time of
            day, so that they are later than those of an earlier session.
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
        self._boot = 0  # of the last accepted partner
        self._timeout = round(timeout * SECOND)
        self._watchdog = round(watchdog * 1000)  # [ms]
        self._silence = self._watchdog * SECOND // 1000  # the same [ns]
        signed = key is not None
        self._reception = Reception(
            partner.rules, self._timeout, round(resolution * SECOND), signed, self.counts
        )
        self._echoes = Echoes(epoch, self._timeout, self._silence, signed, partner.refused)
        self._arming = ArmingMachine(partner.name, partner.latches)
        self.disarm_reason = ""  # why it was last disarmed, unless the operator requested it
        self._version = VERSION  # of this partner's frames, if it is not ours
        self._sequence = 0
        self._now = 0
        self._stall_time = 0  # how long this process was stalled before `_resumed`
        self._resumed = -1  # when this process resumed

    # Overridden for each kind of partner.

    @property
    def faults(self) -> list[str]:
        """Names of the faults that forbid motion."""
        return []

    @abstractmethod
    def _is_off(self, frame: T) -> bool:
        """Return True if everything that must be off when disarmed is off."""

    @abstractmethod
    def _cancel_command(self, why: str) -> None:
        """Cancel the active command."""

    @abstractmethod
    def _advance_command(self, now: int) -> None:
        """Advance the active command to time `now`."""

    @abstractmethod
    def _update_progress(self, frame: T, echoed: int | None) -> None:
        """Update the progress of the active command from an accepted frame."""

    def _min_timeout(self) -> int:
        """Return the shortest silence after which the partner is lost [ns]."""
        return 0

    @property
    def arming(self) -> Arming:
        """State requested of the partner, with the progress of arming."""
        return self._arming.state

    @property
    def released(self) -> bool:
        """True if the partner has confirmed that it is off since it was disarmed."""
        return self._arming.released

    @property
    def armed(self) -> bool:
        """True if this driver armed the partner and the partner confirmed it."""
        return self.arming is Arming.ARMED

    @property
    def settled(self) -> bool:
        """True if the last request to arm or disarm has succeeded or failed."""
        return self.arming is not Arming.ARMING and not self._arming.releasing

    @property
    def lost(self) -> bool:
        """True if no frame was accepted within the timeout, or ever."""
        return self._reception.lost

    @property
    def frame(self) -> T | None:
        """Last accepted frame; None while the partner is lost."""
        track = self._reception.track
        return track.frame if track and not self.lost else None

    @property
    def round_trip(self) -> float:
        """Round trip of the exchange that the clock estimate is based on [s], or NaN."""
        track = self._reception.track
        return track.clock.round_trip if track else nan

    def deviation(self, now: int) -> float:
        """Return the standard deviation of a stamp [s]; infinite before a round trip."""
        track = self._reception.track
        return track.clock.deviation(now) if track else inf

    @property
    def offset(self) -> float:
        """Host's clock minus the partner's [s]."""
        track = self._reception.track
        return 1e-9 * track.clock.offset(track.frame.clock) if track else nan

    @property
    def drift(self) -> float:
        """Relative rate by which the host's clock is faster than the partner's."""
        track = self._reception.track
        return track.clock.drift if track else nan

    def silence(self, now: int) -> float:
        """Return the time since a frame was last accepted [s]; infinite if none ever was."""
        return 1e-9 * (now - self._reception.accepted_at) if self.counts["accepted"] else inf

    @property
    def loss_reason(self) -> str:
        """Message about why the partner is lost, or how long it has been silent."""
        if self._version != VERSION:
            return self.version_problem
        if (silence := self.silence(self._now)) == inf:
            return "nothing received yet: is it switched on, and does no other driver use it?"
        return f"silent for {silence:.1f} s"

    @property
    def version_problem(self) -> str:
        """Message if the partner uses another version of the protocol, else empty."""
        if self._version == VERSION:
            return ""
        what = "its firmware" if self._version < VERSION else "this computer's software"
        return (
            f"{self.partner.name} uses version {self._version} of the protocol, expected "
            f"{VERSION}: {'flash' if self._version < VERSION else 'update'} {what}"
        )

    @property
    def other_driver(self) -> str:
        """Message if another driver commands the partner, else empty; this driver then disarms."""
        other = self._echoes.has_other_driver(self._now)
        return f"another driver commands {self.partner.name}" if other else ""

    @property
    def link_problem(self) -> str:
        """Message about a communication problem, else empty: delay, or another sender's frames."""
        if (delay := self._echoes.delay) > self._timeout:
            limit = 1e-9 * self._timeout
            return f"round trip of {1e-9 * delay:.2f} s, at most {limit:g} s allowed"
        if self._echoes.crowded:
            return (
                f"{self.partner.name} refuses frames of another sender: does a second driver run?"
            )
        return ""

    @property
    def stall(self) -> str:
        """Message if this process was last stalled beyond the watchdog time, else empty."""
        return f"was stalled for {1e-9 * self._stall_time:.1f} s" if self._stall_time else ""

    def obstacle(self, now: int) -> str:
        """Return why the partner cannot be armed, in words; empty if it can."""
        self.tick(now)
        name, echoes = self.partner.name, self._echoes
        if self.other_driver:
            return self.other_driver
        if echoes.delay > self._timeout:
            return f"{name}: {self.link_problem}"
        if self.lost:
            return self.version_problem or f"{name} is lost: {self.loss_reason}"
        if echoes.answered < self._resumed:
            return f"{name}: its driver {self.stall} just now"
        return f"{name} has faults: {', '.join(self.faults)}" if self.faults else ""

    def arm(self, now: int) -> None:
        """Request that the partner arms, also after a stop; `arming` shows the progress.

        Raises:
            CommandError: there is an obstacle.
        """
        if obstacle := self.obstacle(now):
            raise CommandError(obstacle)
        self.disarm_reason = ""
        # A partner that has not yet answered may wait for an earlier driver's watchdog.
        self._arming.arm(now, grace=0 if self._echoes.answered >= 0 else self._silence)

    def disarm(self) -> None:
        """Switch the actuators off, also after a stop.

        Once `settled`, `released` is True if the partner has confirmed it; a lost partner cannot.
        """
        self._cancel_command("disarmed")
        self.disarm_reason = ""
        self._arming.disarm(self._now, self.lost)

    def stop(self) -> None:
        """Stop now, until armed again or disarmed; actuators that are off stay off."""
        self._cancel_command("stopped")
        self._arming.stop()

    def _drop(self, why: str) -> None:
        """Disarm without the operator's request; a stop stays in effect."""
        if self.arming in (Arming.ARMING, Arming.ARMED):
            self.disarm_reason = why
        self._cancel_command(why)
        self._arming.drop()

    def require_armed(self) -> None:
        """Raise CommandError if the partner is not armed."""
        if not self.armed:
            name, how = self.partner.name, self.partner.armed_by
            raise CommandError(f"{name} is {self.arming.value}, not armed: {how} arms it")

    def tick(self, now: int) -> None:
        """Advance to time `now`: handle loss, expiry, arming timeouts, a simulated clock set back.

        If this was not called for longer than the watchdog time, the process was stalled or the
        computer slept. The partner was not monitored meanwhile, so it is disarmed.
        """
        if self._now and now - self._now > self._silence:
            self._stall_time, self._resumed = now - self._now, now
            self._drop(self.stall)
        if now < self._now - CLOCK_CORRECTION:
            self._reception.reset(now)
            self._echoes.reset()
            self._resumed = -1
            self._arming.reset()
            self._drop("the clock was set back")
        self._now = now
        if self._reception.tick(now, self._min_timeout()):
            self._echoes.delay = 0
            self._drop(f"{self.partner.name} is lost")
        self._advance_command(now)
        self._arming.tick(now, self._echoes.delay, self.lost)

    def _flags(self, now: int) -> int:
        """Return the flags of the next command."""
        return self._arming.flags(self.frame, self._echoes.answered >= 0, now)

    def _header(self, flags: int, now: int) -> HeaderFields:
        """Return the header of a command that is sent now."""
        self._sequence = (self._sequence + 1) & 0xFFFFFFFF
        self.counts["sent"] += 1
        frame = self.frame
        return HeaderFields(
            link=self.number,
            flags=flags,
            boot=frame.boot if frame else 0,
            sequence=self._sequence,
            clock=self._echoes.stamp(now, latest=bool(flags & CommandFlag.STOP)),
            watchdog=self._watchdog,
        )

    def _to_partner_clock(self, time: int) -> int:
        """Convert a host time to the partner's clock [us]; 0: no time, or clock not known."""
        track = self._reception.track
        return track.clock.to_link(time) if track and time else 0

    def _accept(self, data: bytes, now: int) -> tuple[T, int] | None:
        """Process a datagram; return the frame and its measurement time [ns] if it is accepted."""
        self.tick(now)
        self.counts["received"] += 1
        if (frame := self._decode(data)) is None:
            return None
        lost, echoed = self.lost, self._echoes.sent_at(frame)
        stamp = self._reception.accept(frame, echoed, now)
        if stamp is not None or lost:
            self._echoes.update(frame, now)
        if stamp is None:
            return None
        if self.other_driver:
            self._drop(self.other_driver)
        if lost:  # a partner that was lost until now must be armed again
            self._drop(f"{self.partner.name} was lost")
        return frame, stamp

    def _update_state(self, frame: T) -> None:
        """Update slow values, arming and the last command from an accepted frame."""
        if frame.boot != self._boot:
            self._boot, self.slow, self.battery = frame.boot, {}, Battery(self._empty)
        self.slow[frame.slow_id] = frame.slow_value
        if frame.slow_id == self.partner.battery:
            self.battery.add(0.1 * frame.slow_value, self._now)
        echoed = self._echoes.sent_at(frame)
        self._update_progress(frame, echoed)
        if why := self._arming.follow(frame, echoed, self._is_off(frame), self.faults):
            self._drop(why)

    def _decode(self, data: bytes) -> T | None:
        """Decode this partner's telemetry; count other data and return None."""
        try:
            frame: Any = self.partner.decode(data, self._key)
        except FrameError as error:
            self.counts[error.reason.value] += 1
            if error.reason is Refusal.VERSION and self.lost:
                version, link = version_and_link(data)
                self._version = version if link == self.number else self._version
            return None
        if not isinstance(frame, self.partner.telemetry) or frame.link != self.number:
            self.counts["foreign"] += 1
            return None
        self._version = VERSION
        return frame
