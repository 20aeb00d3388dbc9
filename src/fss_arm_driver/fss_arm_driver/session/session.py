"""The driver's side of one link: datagrams in and out, no I/O and no clock.

What is sent when a link is lost, adopted, armed, commanded or stopped is as in
docs/reference/protocol.md. All times are the caller's, in integer nanoseconds.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from math import inf, nan

from fss_arm_driver.faults import blocking
from fss_arm_driver.knots import Knot, knots
from fss_arm_driver.protocol import (
    MAX_PATH,
    VERSION,
    Command,
    FrameError,
    Mode,
    Order,
    Refusal,
    Segment,
    Slow,
    State,
    Telemetry,
    decode,
    encode,
    spoken,
)
from fss_arm_driver.scale import CommandError, Scale, SetPoint
from fss_arm_driver.session.arming import Arming, ArmingMachine
from fss_arm_driver.session.battery import Battery
from fss_arm_driver.session.clock import MICROSECOND, SECOND
from fss_arm_driver.session.dialogue import Dialogue
from fss_arm_driver.session.orders import NO_SET_POINT, Orders
from fss_arm_driver.session.paths import Paths, SentPath
from fss_arm_driver.session.progress import Progress, Status
from fss_arm_driver.session.reception import Reception, Sample
from fss_arm_model.description import Link

FARTHEST = 120 * SECOND  # that a path may begin ahead
PATIENCE = 2  # with a link that follows a path by itself [its watchdog times]
CLOCK_CORRECTION = SECOND // 10  # a simulated clock that is set back by less is being corrected

#: What may happen to a telemetry frame but to be believed.
TROUBLES = (
    *(reason.value for reason in Refusal),
    *("foreign", "impossible", "unproven"),
    *("stale", "repeated", "reordered", "candidates", "missed"),
)
COUNTS = (
    *("received", "believed", *TROUBLES, "adopted", "lost"),
    *("sent", "segments", "commands_clamped", "commands_refused"),
)


class LinkSession:
    """What the driver knows and wants of one link.

    Args:
        number: of the link, as in its frames.
        description: its units and limits.
        timeout: silence after which the link is lost [s].
        watchdog: silence after which the link shall disarm itself [s].
        resolution: step of the clock that the caller reads [s].
        key: that frames are signed under; None: they are not signed.
        empty: voltage of the link's battery at which it must be switched off [V].
        epoch: what to add to the caller's clock to have the time of day [ns]: commands are
            stamped with that, once, so that they come after those of an earlier session.
    """

    def __init__(
        self,
        number: int,
        description: Link,
        timeout: float = 1.0,
        watchdog: float = 2.0,
        resolution: float = 0.0,
        key: bytes | None = None,
        empty: float = 12.0,
        epoch: int = 0,
    ) -> None:
        self.number, self._key = number, key
        self.scale = Scale(description)
        self.counts = Counter(dict.fromkeys(COUNTS, 0))
        self.slow: dict[int, int] = {}  # the last report of each field, by Slow
        self.battery, self._empty = Battery(empty), empty
        self._boot = 0  # of the link that was followed last
        self._timeout = round(timeout * SECOND)
        self._watchdog = round(watchdog * 1000)  # [ms]
        self._silence = self._watchdog * SECOND // 1000  # the same [ns]
        signed = key is not None
        self._reception = Reception(
            self.scale, self._timeout, round(resolution * SECOND), signed, self.counts
        )
        self._dialogue = Dialogue(epoch, self._timeout, self._silence, signed)
        self._arming = ArmingMachine()
        self._orders = Orders(self.scale, self._timeout)
        self._paths = Paths()
        self.breakage = ""  # how the last path broke off, in words; until another is followed
        self._version = VERSION  # of frames of this link that are refused for it
        self._sequence = 0
        self._now = 0
        self._still = 0  # how long time stood still before `_woke`
        self._woke = -1  # when time went on

    @property
    def arming(self) -> Arming:
        """What is wanted of the link, and how far that has come."""
        return self._arming.state

    @property
    def released(self) -> bool:
        """Whether the link has confirmed, since it was disarmed, that its drive is off."""
        return self._arming.released

    @property
    def progress(self) -> Progress | None:
        """How far the last command has come."""
        return self._orders.progress

    @property
    def armed(self) -> bool:
        """Whether the link may move: this driver armed it, and it says so itself."""
        return self.arming is Arming.ARMED

    @property
    def settled(self) -> bool:
        """Whether what was asked last, to arm or to disarm, is done or has come to nothing."""
        return self.arming is not Arming.ARMING and not self._arming.releasing

    @property
    def follows(self) -> bool:
        """Whether the link is to follow a path."""
        return bool(self._orders.path)

    @property
    def path(self) -> int:
        """What the link reports of its paths; if it holds none, the number of the last * 65536."""
        return self.slow.get(Slow.PATH, 0) & 0xFFFFFFFF or self._paths.last << 16

    @property
    def lost(self) -> bool:
        """Whether nothing believable has come for the timeout, or ever."""
        return self._reception.lost

    @property
    def frame(self) -> Telemetry | None:
        """The last frame believed; None while the link is lost."""
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
        """What to add to the link's clock to have the host's [s]."""
        track = self._reception.track
        return 1e-9 * track.clock.offset(track.frame.clock) if track else nan

    @property
    def drift(self) -> float:
        """How much faster than the link's the host's clock runs."""
        track = self._reception.track
        return track.clock.drift if track else nan

    def silence(self, now: int) -> float:
        """Time since a frame was last believed [s]; infinite if none ever was."""
        return 1e-9 * (now - self._reception.heard) if self.counts["believed"] else inf

    @property
    def faults(self) -> list[str]:
        """Names of the faults that forbid motion."""
        latched = self.slow.get(Slow.FAULTS, 0) & 0xFFFFFFFF
        return blocking(self.frame.status, latched) if self.frame else []

    @property
    def referenced(self) -> bool:
        """Whether the encoder's zero is known, so that positions mean something."""
        return bool(self.frame and self.frame.flags & State.REFERENCED)

    @property
    def absence(self) -> str:
        """For how long the link was not heard, in words."""
        if self._version != VERSION:
            return self.dialect
        if (silence := self.silence(self._now)) == inf:
            return "not heard yet: is it on, and does no other driver talk to it?"
        return f"silent for {silence:.1f} s"

    @property
    def dialect(self) -> str:
        """That the link speaks another version of the protocol, in words."""
        if self._version == VERSION:
            return ""
        what = "its firmware" if self._version < VERSION else "this computer's software"
        return (
            f"link {self.number} speaks version {self._version} of the protocol, expected "
            f"{VERSION}: {'flash' if self._version < VERSION else 'update'} {what}"
        )

    @property
    def rival(self) -> str:
        """That another driver commands the link, in words; this one does not, then."""
        rival = self._dialogue.rival(self._now)
        return f"another driver commands link {self.number}" if rival else ""

    @property
    def strain(self) -> str:
        """What makes it hard to command the link, in words: delay, frames of somebody else."""
        if (way := self._dialogue.delay) > self._timeout:
            most = 1e-9 * self._timeout
            return f"delay of {1e-9 * way:.2f} s there and back, at most {most:g} s"
        if self._dialogue.crowded:
            return f"link {self.number} refuses frames of somebody else: another driver?"
        return ""

    @property
    def standstill(self) -> str:
        """That this process did nothing for longer than the watchdog time, in words."""
        return f"stood still for {1e-9 * self._still:.1f} s" if self._still else ""

    def obstacle(self, now: int) -> str:
        """Why the link cannot be armed, in words; empty: it can."""
        self.tick(now)
        link, dialogue = f"link {self.number}", self._dialogue
        if self.rival:
            return self.rival
        if dialogue.delay > self._timeout:
            return f"{link}: {self.strain}"
        if self.lost:
            return self.dialect or f"{link} is lost: {self.absence}"
        if dialogue.answered < self._woke:
            return f"{link}: its driver {self.standstill} just now"
        return f"{link} has faults: {', '.join(self.faults)}" if self.faults else ""

    def arm(self, now: int) -> None:
        """Ask the link to arm, also after a stop; `arming` says how far that has come.

        Raises:
            CommandError: there is an obstacle.
        """
        if obstacle := self.obstacle(now):
            raise CommandError(obstacle)
        # A link that has yet to answer may wait for an earlier driver's watchdog.
        self._arming.arm(now, grace=0 if self._dialogue.answered >= 0 else self._silence)

    def clear_faults(self, now: int) -> None:
        """Disarm, and have the drive forget its latched faults."""
        self.disarm()
        self._arming.clear_faults(now)

    def disarm(self) -> None:
        """Let the joint come to rest and switch the drive off, also after a stop.

        `released` says whether the link has, once all is `settled`; a lost one cannot confirm it.
        """
        self._end("disarmed")
        self._arming.disarm(self._now, self.lost)

    def stop(self) -> None:
        """Stop now and hold that place until armed anew or disarmed; what is off stays off."""
        self._end("stopped")
        self._arming.stop()

    def _drop(self, why: str) -> None:
        """Disarm without a person's request: a stop stays."""
        self._end(why)
        self._arming.drop()

    def _end(self, why: str) -> None:
        """Nothing is in force any more, and the link forgets its paths."""
        self._orders.end(Status.ABORTED, why)
        self._paths = Paths()

    def set(
        self, mode: int, value: float, velocity: float, acceleration: float, expiry: int, now: int
    ) -> None:
        """Take a command in SI units, in force until host time `expiry`.

        Raises:
            CommandError: it cannot be followed; what was in force stays.
        """
        self.tick(now)
        try:
            self._require_armed()
            if expiry <= now:
                raise CommandError(f"the command expired {1e-9 * (now - expiry):.3f} s ago")
            if faults := self.faults:
                raise CommandError(f"link {self.number} has faults: {', '.join(faults)}")
            set_point = self.scale.set_point(mode, value, velocity, acceleration)
            if mode in (Mode.POSITION, Mode.PATH):
                self._require_reference()
            if mode == Mode.PATH:
                self._paths.check(set_point.value)
        except CommandError:
            self.counts["commands_refused"] += 1
            raise
        self._orders.give(set_point, expiry, now)
        self.counts["commands_clamped"] += set_point.clamped

    def _require_armed(self) -> None:
        if not self.armed:
            raise CommandError(f"link {self.number} is {self.arming.value}, not armed")

    def _require_reference(self) -> None:
        if not self.referenced:
            raise CommandError(f"link {self.number} is not referenced: home it first")

    def give_path(
        self,
        number: int,
        begin: int,
        time: Sequence[float],
        position: Sequence[float],
        velocity: Sequence[float],
        now: int,
    ) -> None:
        """Take a path in time for the link to keep; a command of mode PATH makes it follow.

        Args:
            number: of the path, 1 to 65535, newer than those before it.
            begin: host time at which it begins.
            time: (n) of the knots, since the path's beginning [s].
            position: (n) [rad].
            velocity: (n) [rad/s].
            now: host time.

        Raises:
            CommandError: it cannot be followed; what was given before stays.
        """
        self.tick(now)
        try:
            self._require_armed()
            self._require_reference()
            self._paths.give(self._path(number, begin, knots(self.scale, time, position, velocity)))
        except CommandError:
            self.counts["commands_refused"] += 1
            raise

    def _path(self, number: int, begin: int, knots: Sequence[Knot]) -> SentPath:
        """A path by the link's clock, as that is known now."""
        track, now = self._reception.track, self._now
        if not 1 <= number <= MAX_PATH:
            raise CommandError(f"path is {number}, expected 1 to {MAX_PATH}")
        if begin > now + FARTHEST:
            ahead = 1e-9 * (begin - now)
            raise CommandError(f"path {number} begins {ahead:.1f} s ahead, at most 120 s allowed")
        if (ago := now - begin - knots[-1].time * MICROSECOND) >= 0:
            raise CommandError(f"path {number} ended {1e-9 * ago:.3f} s ago")
        if track is None or track.clock.half_width(now) > self._timeout:
            raise CommandError(f"the clock of link {self.number} is not known yet")
        boot, clock = track.frame.boot, track.clock
        begins, rate = clock.to_link(begin), 1.0 / (1.0 + clock.drift)
        return SentPath(self.number, boot, number, begins, rate, knots, now)

    def tick(self, now: int) -> None:
        """Let time pass: loss, expiry, arming that came to nothing, a simulated clock set back.

        Time in which this was not called long enough for the link to disarm itself, as the
        process was stopped or the computer slept, is time that nobody watched the link.
        """
        if self._now and now - self._now > self._silence:
            self._still, self._woke = now - self._now, now
            self._drop(self.standstill)
        if now < self._now - CLOCK_CORRECTION:
            self._reception.forget(now)
            self._dialogue.forget()
            self._woke = -1
            self._arming.forget()
            self._drop("the clock was set back")
        self._now = now
        # A link that follows a path does so by itself, and its own watchdog looks after it.
        if self._reception.tick(now, PATIENCE * self._silence if self.follows else 0):
            self._dialogue.delay = 0
            self._drop("the link is lost")
        self._orders.tick(now)
        if track := self._reception.track:
            self._paths.tick(self._orders.path, track.clock.to_link(now))
        self._arming.tick(now, self._dialogue.delay, self.lost)

    def command(self, now: int) -> bytes:
        """The frame to send now."""
        self.tick(now)
        self._sequence = (self._sequence + 1) & 0xFFFFFFFF
        self.counts["sent"] += 1
        flags, expiry, set_point = self._wanted(now)
        frame, track = self.frame, self._reception.track
        return encode(
            Command(
                link=self.number,
                flags=flags,
                boot=frame.boot if frame else 0,
                sequence=self._sequence,
                clock=self._dialogue.stamp(now),
                expiry=track.clock.to_link(expiry) if track and expiry else 0,
                mode=set_point.mode,
                watchdog=self._watchdog,
                set_point=set_point.value,
                velocity=set_point.velocity,
                acceleration=set_point.acceleration,
            ),
            self._key,
        )

    def segments(self, now: int) -> list[bytes]:
        """The frames of the paths to send now, after a command."""
        track = self._reception.track
        if not (self.armed and track):
            return []
        due = self._paths.due(track.clock.to_link(now))
        self.counts["segments"] += len(due)
        return [encode(segment, self._key) for segment in map(self._stamped, due)]

    def _stamped(self, segment: Segment) -> Segment:
        self._sequence = (self._sequence + 1) & 0xFFFFFFFF
        return replace(segment, sequence=self._sequence, clock=self._dialogue.last_stamp())

    def _wanted(self, now: int) -> tuple[int, int, SetPoint]:
        """Flags, host time of expiry and set point of the next command."""
        frame = self.frame
        flags = self._arming.flags(frame, self._dialogue.answered >= 0, now)
        if frame is None or flags != Order.ARM:
            return flags, 0, NO_SET_POINT
        how, expiry, set_point = self._orders.wanted(frame.position, now)
        return flags | how, expiry, set_point

    def feed(self, data: bytes, now: int) -> Sample | None:
        """Take a datagram; return what it says if it is to be believed."""
        if sample := self.measure(data, now):
            self.follow(sample)
        return sample

    def measure(self, data: bytes, now: int) -> Sample | None:
        """Take a datagram, as `feed` does, but leave its consequences to `follow`.

        Whoever waits for the measurement need not wait for them.
        """
        self.tick(now)
        self.counts["received"] += 1
        if (frame := self._decode(data)) is None:
            return None
        lost, echoed = self.lost, self._dialogue.sent_at(frame)
        sample = self._reception.take(frame, echoed, now)
        if sample or lost:
            self._dialogue.hear(frame, now)
        if sample and self.rival:
            self._drop(self.rival)
        if sample and lost:  # nothing is wanted of a link that was not followed until now
            self._drop("the link was lost")
        return sample

    def follow(self, sample: Sample) -> None:
        """Learn from a sample what the link does: its slow values, arming, the last command."""
        frame = sample.frame
        if frame.boot != self._boot:
            self._boot, self.slow, self.battery = frame.boot, {}, Battery(self._empty)
        self.slow[frame.slow_id] = frame.slow_value
        if frame.slow_id == Slow.BATTERY:
            self.battery.take(0.1 * frame.slow_value, self._now)
        echoed = self._dialogue.sent_at(frame)
        self._paths.follow(frame, echoed)
        self._orders.follow(frame, echoed, self._now, self._paths.find(self._orders.path))
        if self.progress and self.progress.broken:
            self.breakage = self.progress.reason
        elif frame.flags & State.FOLLOWING:
            self.breakage = ""
        if why := self._arming.follow(frame, echoed, self.faults):
            self._drop(why)

    def _decode(self, data: bytes) -> Telemetry | None:
        """The telemetry of this link that these bytes are, or None, counted."""
        try:
            frame = decode(data, self._key)
        except FrameError as error:
            self.counts[error.reason.value] += 1
            if error.reason is Refusal.VERSION and self.lost:
                version, link = spoken(data)
                self._version = version if link == self.number else self._version
            return None
        if not isinstance(frame, Telemetry) or frame.link != self.number:
            self.counts["foreign"] += 1
            return None
        self._version = VERSION
        return frame
