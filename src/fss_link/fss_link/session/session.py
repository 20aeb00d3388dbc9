"""Driver side of one link, or of the base's board: datagrams in and out, no I/O, no clock.

docs/reference/protocol.md defines what is sent when the partner is lost, adopted, armed, commanded
or stopped. All times are the caller's, in integer nanoseconds.
"""

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Mapping
from math import inf, nan
from typing import Any, Generic, NamedTuple, TypedDict, TypeVar

from fss_arm_model.units import SECOND
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

    name: str  # in the log and in errors
    label: str  # in answers and diagnostics
    number: int  # in its frames
    telemetry: type[T]
    decode: Callable[[bytes, bytes | None], Head]
    rules: Rules[T]  # of its telemetry
    latches: int  # telemetry flags that prevent arming until it is disarmed
    battery: int  # slow field of its battery's voltage [0.1 V]
    refused: int  # slow field of the number of datagrams that it refused
    armed_by: str  # the operator's command that arms it
    unconfirmed: str  # words for one that does not confirm disarming
    threat: str  # what an attacker can do to one whose frames are not signed, in words
    flag_words: Mapping[int, str]  # meaning of the telemetry flags to report


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
        self.partner, self.number, self.key = partner, partner.number, key
        self.counts = Counter(dict.fromkeys(COUNTS, 0))
        self.slow: dict[int, int] = {}  # the last report of each slow field
        self.battery, self._empty = Battery(empty), empty
        self._boot = 0  # of the last accepted partner
        self.timeout = round(timeout * SECOND)  # [ns]
        self._watchdog = round(watchdog * 1000)  # [ms]
        self.watchdog_time = self._watchdog * SECOND // 1000  # the same [ns]
        signed = key is not None
        self.reception = Reception(
            partner.rules, self.timeout, round(resolution * SECOND), signed, self.counts
        )
        self.echoes = Echoes(epoch, self.timeout, self.watchdog_time, signed, partner.refused)
        self.arming_machine = ArmingMachine(partner.name, partner.latches)
        self.disarm_reason = ""  # why it was last disarmed, unless the operator requested it
        self._version = VERSION  # of this partner's frames, if it is not ours
        self.sequence = 0
        self.now = 0  # time of the last call [ns]
        self._stall_time = 0  # how long this process was stalled before `_resumed`
        self._resumed = -1  # when this process resumed

    # Overridden for each kind of partner.

    @property
    def faults(self) -> list[str]:
        """Names of the faults that forbid motion."""
        return []

    @property
    def remarks(self) -> list[str]:
        """Further words about the partner's state."""
        return []

    @abstractmethod
    def command(self, now: int) -> bytes:
        """Return the command frame to send now."""

    @abstractmethod
    def is_off(self, frame: T) -> bool:
        """Return True if everything that must be off when disarmed is off."""

    @abstractmethod
    def cancel_command(self, why: str) -> None:
        """Cancel the active command."""

    @abstractmethod
    def advance_command(self, now: int) -> None:
        """Advance the active command to time `now`."""

    @abstractmethod
    def update_progress(self, frame: T, echoed: int | None) -> None:
        """Update the progress of the active command from an accepted frame."""

    def min_timeout(self) -> int:
        """Return the shortest silence after which the partner is lost [ns]."""
        return 0

    @property
    def arming(self) -> Arming:
        """State requested of the partner, with the progress of arming."""
        return self.arming_machine.state

    @property
    def released(self) -> bool:
        """True if the partner has confirmed that it is off since it was disarmed."""
        return self.arming_machine.released

    @property
    def armed(self) -> bool:
        """True if this driver armed the partner and the partner confirmed it."""
        return self.arming is Arming.ARMED

    @property
    def settled(self) -> bool:
        """True if the last request to arm or disarm has succeeded or failed."""
        return self.arming is not Arming.ARMING and not self.arming_machine.releasing

    def describe_state(self) -> str:
        """Return the partner's state in words."""
        flags = self.frame.flags if self.frame else 0
        words = [text for flag, text in self.partner.flag_words.items() if flags & flag]
        words += [*self.faults, *self.remarks]
        state = f"{self.partner.label} is {self.arming.value}"
        return f"{state}: {', '.join(words)}" if words else state

    def describe_outcome(self, arm: bool) -> tuple[bool, str]:
        """Return whether the request to arm or disarm has succeeded, and the state in words."""
        done = self.armed if arm else self.released
        if done or arm or self.arming is not Arming.DISARMED:
            words = [self.describe_state()]
            if not done:
                reasons = self.disarm_reason, self.link_problem
                words += [reason for reason in reasons if reason and reason not in words[0]]
                if arm and self.arming is Arming.DISARMED and not any(reasons):
                    words += ["it did not confirm in time, try again"]
            return done, "; ".join(words)
        how = "is lost" if self.lost else self.partner.unconfirmed
        return False, f"{self.partner.label} {how}: disarming requested, not confirmed"

    @property
    def lost(self) -> bool:
        """True if no frame was accepted within the timeout, or ever."""
        return self.reception.lost

    @property
    def frame(self) -> T | None:
        """Last accepted frame; None while the partner is lost."""
        track = self.reception.track
        return track.frame if track and not self.lost else None

    @property
    def round_trip(self) -> float:
        """Round trip of the exchange that the clock estimate is based on [s], or NaN."""
        track = self.reception.track
        return track.clock.round_trip if track else nan

    def deviation(self, now: int) -> float:
        """Return the standard deviation of a stamp [s]; infinite before a round trip."""
        track = self.reception.track
        return track.clock.deviation(now) if track else inf

    @property
    def offset(self) -> float:
        """Host's clock minus the partner's [s]."""
        track = self.reception.track
        return 1e-9 * track.clock.offset(track.frame.clock) if track else nan

    @property
    def drift(self) -> float:
        """Relative rate by which the host's clock is faster than the partner's."""
        track = self.reception.track
        return track.clock.drift if track else nan

    def silence(self, now: int) -> float:
        """Return the time since a frame was last accepted [s]; infinite if none ever was."""
        return 1e-9 * (now - self.reception.accepted_at) if self.counts["accepted"] else inf

    @property
    def loss_reason(self) -> str:
        """Message about why the partner is lost, or how long it has been silent."""
        if self._version != VERSION:
            return self.version_problem
        if (silence := self.silence(self.now)) == inf:
            if unsigned := self.counts["signature"]:
                return f"{unsigned} frames without a valid signature: is its key in the key file?"
            return "nothing received yet: is it switched on? Does another driver use it?"
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
        other = self.echoes.has_other_driver(self.now)
        return f"another driver commands {self.partner.name}" if other else ""

    @property
    def link_problem(self) -> str:
        """Message about a communication problem, else empty: delay, or another sender's frames."""
        if (delay := self.echoes.delay) > self.timeout:
            limit = 1e-9 * self.timeout
            return (
                f"round trip of {1e-9 * delay:.2f} s, at most {limit:g} s allowed: is the computer "
                "or the network overloaded?"
            )
        if self.echoes.crowded:
            return (
                f"{self.partner.name} refuses frames of another sender: does a second driver run, "
                "or is the computer overloaded?"
            )
        return ""

    @property
    def problems(self) -> dict[str, str]:
        """Problems to warn of when they start, by kind; an empty one is none."""
        return {"other driver": self.other_driver, "link": self.link_problem}

    @property
    def stall(self) -> str:
        """Message if this process was last stalled beyond the watchdog time, else empty."""
        return f"was stalled for {1e-9 * self._stall_time:.1f} s" if self._stall_time else ""

    def obstacle(self, now: int) -> str:
        """Return why the partner cannot be armed, in words; empty if it can."""
        self.tick(now)
        name, echoes = self.partner.name, self.echoes
        if self.other_driver:
            return self.other_driver
        if echoes.delay > self.timeout:
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
        self.arming_machine.arm(now, grace=0 if self.echoes.answered >= 0 else self.watchdog_time)

    def disarm(self) -> None:
        """Switch the actuators off, also after a stop.

        Once `settled`, `released` is True if the partner has confirmed it; a lost partner cannot.
        """
        self.cancel_command("disarmed")
        self.disarm_reason = ""
        self.arming_machine.disarm(self.now, self.lost)

    def stop(self) -> None:
        """Stop now, until armed again or disarmed; actuators that are off stay off."""
        self.cancel_command("stopped")
        self.arming_machine.stop()

    def _drop(self, why: str) -> None:
        """Disarm without the operator's request; a stop stays in effect."""
        if self.arming in (Arming.ARMING, Arming.ARMED):
            self.disarm_reason = why
        self.cancel_command(why)
        self.arming_machine.drop()

    def require_armed(self) -> None:
        """Raise CommandError if the partner is not armed."""
        if not self.armed:
            name, how = self.partner.name, self.partner.armed_by
            if self.arming is Arming.ARMING:
                raise CommandError(f"{name} is still arming: wait until it is armed")
            raise CommandError(f"{name} is {self.arming.value}; to arm it: {how}")

    def tick(self, now: int) -> None:
        """Advance to time `now`: handle loss, expiry, arming timeouts, a simulated clock set back.

        If this was not called for longer than the watchdog time, the process was stalled or the
        computer slept. The partner was not monitored meanwhile, so it is disarmed.
        """
        if self.now and now - self.now > self.watchdog_time:
            self._stall_time, self._resumed = now - self.now, now
            self._drop(self.stall)
        if now < self.now - CLOCK_CORRECTION:
            self.reception.reset(now)
            self.echoes.reset()
            self._resumed = -1
            self.arming_machine.reset()
            self._drop("the clock was set back")
        self.now = now
        if self.reception.tick(now, self.min_timeout()):
            self.echoes.delay = 0
            self._drop(f"{self.partner.name} is lost")
        self.advance_command(now)
        self.arming_machine.tick(now, self.echoes.delay, self.lost)

    def command_flags(self, now: int) -> int:
        """Return the flags of the next command."""
        return self.arming_machine.flags(self.frame, self.echoes.answered >= 0, now)

    def command_header(self, flags: int, now: int) -> HeaderFields:
        """Return the header of a command that is sent now."""
        self.sequence = (self.sequence + 1) & 0xFFFFFFFF
        self.counts["sent"] += 1
        frame = self.frame
        return HeaderFields(
            link=self.number,
            flags=flags,
            boot=frame.boot if frame else 0,
            sequence=self.sequence,
            clock=self.echoes.stamp(now, latest=bool(flags & CommandFlag.STOP)),
            watchdog=self._watchdog,
        )

    def to_partner_clock(self, time: int) -> int:
        """Convert a host time to the partner's clock [us]; 0: no time, or clock not known."""
        track = self.reception.track
        return track.clock.to_link(time) if track and time else 0

    def accept(self, data: bytes, now: int) -> tuple[T, int] | None:
        """Process a datagram; return the frame and its measurement time [ns] if it is accepted."""
        self.tick(now)
        self.counts["received"] += 1
        if (frame := self._decode(data)) is None:
            return None
        lost, echoed = self.lost, self.echoes.sent_at(frame)
        stamp = self.reception.accept(frame, echoed, now)
        if stamp is not None or lost:
            self.echoes.update(frame, now)
        if stamp is None:
            return None
        if self.other_driver:
            self._drop(self.other_driver)
        if lost:  # a partner that was lost until now must be armed again
            self._drop(f"{self.partner.name} was lost")
        return frame, stamp

    def update_state(self, frame: T) -> None:
        """Update slow values, arming and the last command from an accepted frame."""
        if frame.boot != self._boot:
            self._boot, self.slow, self.battery = frame.boot, {}, Battery(self._empty)
        self.slow[frame.slow_id] = frame.slow_value
        if frame.slow_id == self.partner.battery:
            self.battery.add(0.1 * frame.slow_value, self.now)
        echoed = self.echoes.sent_at(frame)
        self.update_progress(frame, echoed)
        if why := self.arming_machine.follow(frame, echoed, self.is_off(frame), self.faults):
            self._drop(why)

    def _decode(self, data: bytes) -> T | None:
        """Decode this partner's telemetry; count other data and return None."""
        try:
            frame: Any = self.partner.decode(data, self.key)
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
