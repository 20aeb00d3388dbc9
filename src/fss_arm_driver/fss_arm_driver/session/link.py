"""The driver's side of one link: what it measures in SI units, set points and paths for it."""

from collections.abc import Sequence
from dataclasses import replace
from math import nan
from typing import NamedTuple

from fss_arm_driver.faults import blocking
from fss_arm_driver.knots import Knot, knots
from fss_arm_driver.protocol import (
    MAX_PATH,
    NO_TORQUE,
    Command,
    Mode,
    Order,
    Segment,
    Slow,
    State,
    Telemetry,
    decode,
    encode,
)
from fss_arm_driver.scale import CommandError, Scale, SetPoint
from fss_arm_driver.session.clock import MICROSECOND, SECOND
from fss_arm_driver.session.orders import NO_SET_POINT, Orders
from fss_arm_driver.session.paths import Paths, SentPath
from fss_arm_driver.session.progress import Progress, Status
from fss_arm_driver.session.session import COUNTS as SHARED_COUNTS
from fss_arm_driver.session.session import Partner, Session
from fss_arm_model.description import Link

FARTHEST = 120 * SECOND  # that a path may begin ahead
PATIENCE = 2  # with a link that follows a path by itself [its watchdog times]
COUNTS = (*SHARED_COUNTS, "segments", "commands_clamped")


class Sample(NamedTuple):
    """A telemetry frame that is believed, in host time and SI units."""

    frame: Telemetry
    stamp: int  # host time of the measurement [ns]
    position: float  # [rad]
    velocity: float  # [rad/s]
    torque: float  # [N m]; NaN: none of the last 254 ms

    @property
    def referenced(self) -> bool:
        """Whether the encoder's zero is known, so that the position means something."""
        return bool(self.frame.flags & State.REFERENCED)


class Reports:
    """What a link's telemetry can say: what its joint can do.

    Args:
        scale: the link's units and limits.
    """

    def __init__(self, scale: Scale) -> None:
        self._scale = scale

    def possible(self, frame: Telemetry) -> bool:
        """Whether the joint can be there, turn so fast and take so much current."""
        return self._scale.possible(frame)

    def reachable(self, before: Telemetry, frame: Telemetry) -> bool:
        """Whether the joint can have come there."""
        homed = frame.flags & ~before.flags & State.REFERENCED  # from now it counts anew
        turned, period = frame.position - before.position, frame.clock - before.clock
        return bool(homed) or self._scale.reachable(turned, period)


class LinkSession(Session[Telemetry]):
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
        file: of the arm's description, to name where another serial number is expected.
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
        file: str = "",
    ) -> None:
        self.serial, self._file = description.serial, file
        self.scale = Scale(description)
        partner = Partner(
            f"link {number}",
            number,
            Telemetry,
            decode,
            Reports(self.scale),
            State.STOPPED | State.WATCHDOG,
            Slow.BATTERY,
            Slow.REFUSED,
            "scripts/fss_arm.sh arm",
        )
        super().__init__(partner, timeout, watchdog, resolution, key, empty, epoch)
        self.counts.update(dict.fromkeys(COUNTS, 0))
        self._orders = Orders(self.scale, self._timeout)
        self._paths = Paths()
        self.breakage = ""  # how the last path broke off, in words; until another is followed

    @property
    def progress(self) -> Progress | None:
        """How far the last command has come."""
        return self._orders.progress

    @property
    def follows(self) -> bool:
        """Whether the link is to follow a path."""
        return bool(self._orders.path)

    @property
    def path(self) -> int:
        """What the link reports of its paths; if it holds none, the number of the last * 65536."""
        return self.slow.get(Slow.PATH, 0) & 0xFFFFFFFF or self._paths.last << 16

    @property
    def faults(self) -> list[str]:
        """Names of the faults that forbid motion."""
        latched = self.slow.get(Slow.FAULTS, 0) & 0xFFFFFFFF
        names = blocking(self.frame.status, latched) if self.frame else []
        told = self.slow.get(Slow.SERIAL)
        if self.frame and self.serial and told and told != self.serial:
            names.append(
                f"serial number {told} came where {self.serial} is expected: mount that link here "
                f"or change the links in {self._file or 'the description of the arm'}"
            )
        return names

    @property
    def nameless(self) -> str:
        """That a serial number is expected and the link has told none, in words."""
        if not self.serial or self.slow.get(Slow.SERIAL):
            return ""
        how = "has no" if Slow.SERIAL in self.slow else "has not yet told its"
        return f"link {self.number} {how} serial number, expected {self.serial}"

    def obstacle(self, now: int) -> str:
        """Why the link cannot be armed, in words; empty: it can."""
        obstacle = super().obstacle(now)
        return obstacle or ("" if Slow.SERIAL in self.slow else self.nameless)

    @property
    def referenced(self) -> bool:
        """Whether the encoder's zero is known, so that positions mean something."""
        return bool(self.frame and self.frame.flags & State.REFERENCED)

    def clear_faults(self, now: int) -> None:
        """Disarm, and have the drive forget its latched faults."""
        self.disarm()
        self._arming.clear_faults(now)

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
            self.require_armed()
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
            self.require_armed()
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

    def _patience(self) -> int:
        """A link that follows a path does so by itself, and its own watchdog looks after it."""
        return PATIENCE * self._silence if self.follows else 0

    def _pass(self, now: int) -> None:
        """Let time pass for set point and paths."""
        self._orders.tick(now)
        if track := self._reception.track:
            self._paths.tick(self._orders.path, track.clock.to_link(now))

    def command(self, now: int) -> bytes:
        """The frame to send now."""
        self.tick(now)
        flags, expiry, set_point = self._wanted(now)
        return encode(
            Command(
                **self._head(flags, now),
                expiry=self._by_its_clock(expiry),
                mode=set_point.mode,
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
        return replace(segment, sequence=self._sequence, clock=self._echoes.last_stamp())

    def _wanted(self, now: int) -> tuple[int, int, SetPoint]:
        """Flags, host time of expiry and set point of the next command."""
        frame, flags = self.frame, self._flags(now)
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
        lost = self.lost
        if (taken := self._take(data, now)) is None:
            return None
        if lost:  # another may have taken its place
            self.slow.pop(Slow.SERIAL, None)
        (frame, stamp), scale = taken, self.scale
        return Sample(
            frame=frame,
            stamp=stamp,
            position=scale.position(frame.position),
            velocity=scale.velocity(frame.velocity),
            torque=scale.torque(frame.torque) if frame.torque_age < NO_TORQUE else nan,
        )

    def follow(self, sample: Sample) -> None:
        """Learn from a sample what the link does."""
        self._follow(sample.frame)

    def _is_off(self, frame: Telemetry) -> bool:
        """Whether the drive is."""
        return frame.mode == Mode.OFF

    def _learn(self, frame: Telemetry, echoed: int | None) -> None:
        """Learn how far the last command and the paths have come."""
        self._paths.follow(frame, echoed)
        self._orders.follow(frame, echoed, self._now, self._paths.find(self._orders.path))
        if self.progress and self.progress.broken:
            self.breakage = self.progress.reason
        elif frame.flags & State.FOLLOWING:
            self.breakage = ""
