"""Driver side of one link: measurements in SI units, set points and paths."""

from collections.abc import Sequence
from dataclasses import replace
from math import nan
from typing import NamedTuple

from fss_arm_driver.faults import blocking_faults
from fss_arm_driver.knots import Knot, knots
from fss_arm_driver.protocol import (
    MAX_PATH,
    NO_TORQUE,
    Command,
    LinkCommandFlag,
    Mode,
    Segment,
    Slow,
    State,
    Telemetry,
    decode,
    encode,
)
from fss_arm_driver.scale import Scale, SetPoint
from fss_arm_driver.session.active_command import NO_SET_POINT, ActiveCommand
from fss_arm_driver.session.paths import Paths, SentPath
from fss_arm_driver.session.progress import Progress, Status
from fss_arm_model.description import Link
from fss_arm_model.units import SECOND
from fss_link.session import CommandError
from fss_link.session.clock import MICROSECOND
from fss_link.session.session import COUNTS as SHARED_COUNTS
from fss_link.session.session import Partner, Session

MAX_PATH_LEAD = 120 * SECOND  # longest time ahead at which a path may start
LATCHED_WORDS: dict[int, str] = {
    State.STOPPED: "the link is stopped",
    State.WATCHDOG: "its watchdog tripped",
    State.BROKEN: "its last path was aborted",
}
PATH_TIMEOUT_FACTOR = 2  # timeout of a link that follows a path [watchdog times]
COUNTS = (*SHARED_COUNTS, "segments", "commands_clamped")


class Sample(NamedTuple):
    """Telemetry frame that was accepted, in host time and SI units."""

    frame: Telemetry
    stamp: int  # host time of the measurement [ns]
    position: float  # [rad]
    velocity: float  # [rad/s]
    torque: float  # [N m]; NaN: no sample in the last 254 ms

    @property
    def referenced(self) -> bool:
        """True if the encoder's zero is known, so that the position is valid."""
        return bool(self.frame.flags & State.REFERENCED)


class LinkRules:
    """Validity rules for telemetry frames, from the joint's limits.

    Args:
        scale: the link's units and limits.
    """

    def __init__(self, scale: Scale) -> None:
        self._scale = scale

    def is_plausible(self, frame: Telemetry) -> bool:
        """Return True if position, velocity and current are within the link's bounds."""
        return self._scale.is_plausible(frame)

    def is_reachable(self, before: Telemetry, frame: Telemetry) -> bool:
        """Return True if the joint can have moved there since the frame `before`."""
        homed = frame.flags & ~before.flags & State.REFERENCED  # homing resets the position
        turned, period = frame.position - before.position, frame.clock - before.clock
        return bool(homed) or self._scale.is_reachable(turned, period)


class LinkSession(Session[Telemetry]):
    """Session with one link: its state, and the commands for it.

    Args:
        number: of the link, as in its frames.
        description: its units and limits.
        timeout: silence after which the link is lost [s].
        watchdog: silence after which the link must disarm itself [s].
        resolution: step of the clock that the caller reads [s].
        key: key that signs the frames; None: they are not signed.
        empty: voltage of the link's battery at which it must be switched off [V].
        epoch: time of day minus the caller's clock [ns]. Commands are stamped with the time of
            day, so that they are later than those of an earlier session.
        file: of the arm's description, named if the serial number is not the expected one.
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
            name=f"link {number}",
            label=f"link_{number}",
            number=number,
            telemetry=Telemetry,
            decode=decode,
            rules=LinkRules(self.scale),
            latches=State.STOPPED | State.WATCHDOG,
            battery=Slow.BATTERY,
            refused=Slow.REFUSED,
            armed_by="scripts/fss_arm.sh arm",
            unconfirmed="does not confirm that it is off",
            threat="move the link",
            flag_words=LATCHED_WORDS,
        )
        super().__init__(partner, timeout, watchdog, resolution, key, empty, epoch)
        self.counts.update(dict.fromkeys(COUNTS, 0))
        self._active = ActiveCommand(self.scale, self.timeout)
        self._paths = Paths()
        self.breakage = ""  # why the last path was aborted; until another is followed

    @property
    def progress(self) -> Progress | None:
        """Progress of the last command."""
        return self._active.progress

    @property
    def follows(self) -> bool:
        """True if the link is commanded to follow a path."""
        return bool(self._active.path)

    @property
    def path(self) -> int:
        """Slow field PATH of the link; if it holds no path, the number of the last * 65536."""
        return self.slow.get(Slow.PATH, 0) & 0xFFFFFFFF or self._paths.last << 16

    @property
    def faults(self) -> list[str]:
        """Names of the faults that forbid motion."""
        latched = self.slow.get(Slow.FAULTS, 0) & 0xFFFFFFFF
        names = blocking_faults(self.frame.status, latched) if self.frame else []
        reported = self.slow.get(Slow.SERIAL)
        if self.frame and self.serial and reported and reported != self.serial:
            names.append(
                f"serial number is {reported}, expected {self.serial}: mount that link here or "
                f"change the links in {self._file or 'the description of the arm'}"
            )
        return names

    @property
    def problems(self) -> dict[str, str]:
        """Problems to warn of, by kind."""
        return {**super().problems, "path": self.breakage}

    @property
    def remarks(self) -> list[str]:
        """Remark that positions are not valid, if so."""
        return ["not referenced"] if self.frame and not self.referenced else []

    @property
    def serial_problem(self) -> str:
        """Message if a serial number is expected and the link has reported none, else empty."""
        if not self.serial or self.slow.get(Slow.SERIAL):
            return ""
        flag = "has no" if Slow.SERIAL in self.slow else "has not yet reported its"
        return f"link {self.number} {flag} serial number, expected {self.serial}"

    def obstacle(self, now: int) -> str:
        """Return why the link cannot be armed, in words; empty if it can."""
        obstacle = super().obstacle(now)
        return obstacle or ("" if Slow.SERIAL in self.slow else self.serial_problem)

    @property
    def referenced(self) -> bool:
        """True if the encoder's zero is known, so that positions are valid."""
        return bool(self.frame and self.frame.flags & State.REFERENCED)

    def clear_faults(self, now: int) -> None:
        """Disarm, and request that the drive clears its latched faults."""
        self.disarm()
        self.arming_machine.clear_faults(now)

    def cancel_command(self, why: str) -> None:
        """Cancel the active command and all paths."""
        self._active.end(Status.ABORTED, why)
        self._paths = Paths()

    def set(
        self, mode: int, value: float, velocity: float, acceleration: float, expiry: int, now: int
    ) -> None:
        """Accept a command in SI units, active until host time `expiry`.

        Raises:
            CommandError: it cannot be executed; the active command stays active.
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
        self._active.activate(set_point, expiry, now)
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
        """Accept a timed path to send to the link; a command of mode PATH starts it.

        Args:
            number: of the path, 1 to 65535, newer than those of earlier paths.
            begin: host time at which it starts.
            time: (n) of the knots, since the start of the path [s].
            position: (n) [rad].
            velocity: (n) [rad/s].
            now: host time.

        Raises:
            CommandError: it cannot be executed; the paths accepted before stay.
        """
        self.tick(now)
        try:
            self.require_armed()
            self._require_reference()
            self._paths.add(self._path(number, begin, knots(self.scale, time, position, velocity)))
        except CommandError:
            self.counts["commands_refused"] += 1
            raise

    def _path(self, number: int, begin: int, knots: Sequence[Knot]) -> SentPath:
        """Convert a path to the link's clock, by the present clock estimate."""
        track, now = self.reception.track, self.now
        if not 1 <= number <= MAX_PATH:
            raise CommandError(f"path is {number}, expected 1 to {MAX_PATH}")
        if begin > now + MAX_PATH_LEAD:
            ahead = 1e-9 * (begin - now)
            raise CommandError(f"path {number} starts {ahead:.1f} s ahead, at most 120 s allowed")
        if (ago := now - begin - knots[-1].time * MICROSECOND) >= 0:
            raise CommandError(f"path {number} ended {1e-9 * ago:.3f} s ago")
        if track is None or track.clock.half_width(now) > self.timeout:
            raise CommandError(f"the clock of link {self.number} is not known yet")
        boot, clock = track.frame.boot, track.clock
        begins, rate = clock.to_link(begin), 1.0 / (1.0 + clock.drift)
        return SentPath(self.number, boot, number, begins, rate, knots, now)

    def min_timeout(self) -> int:
        """Return a longer timeout on a path, which the link follows under its own watchdog."""
        return PATH_TIMEOUT_FACTOR * self.watchdog_time if self.follows else 0

    def advance_command(self, now: int) -> None:
        """Advance set point and paths to time `now`."""
        self._active.tick(now)
        if track := self.reception.track:
            self._paths.tick(self._active.path, track.clock.to_link(now))

    def command(self, now: int) -> bytes:
        """Encode the command frame to send now."""
        self.tick(now)
        flags, expiry, set_point = self._next_command(now)
        return encode(
            Command(
                **self.command_header(flags, now),
                expiry=self.to_partner_clock(expiry),
                mode=set_point.mode,
                set_point=set_point.value,
                velocity=set_point.velocity,
                acceleration=set_point.acceleration,
            ),
            self.key,
        )

    def segments(self, now: int) -> list[bytes]:
        """Encode the path segments to send now, after a command."""
        track = self.reception.track
        if not (self.armed and track):
            return []
        due = self._paths.due(track.clock.to_link(now))
        self.counts["segments"] += len(due)
        return [encode(segment, self.key) for segment in map(self._stamped, due)]

    def _stamped(self, segment: Segment) -> Segment:
        self.sequence = (self.sequence + 1) & 0xFFFFFFFF
        return replace(segment, sequence=self.sequence, clock=self.echoes.last_stamp())

    def _next_command(self, now: int) -> tuple[int, int, SetPoint]:
        """Return flags, host time of expiry and set point of the next command."""
        frame, flags = self.frame, self.command_flags(now)
        if frame is None or flags != LinkCommandFlag.ARM:
            return flags, 0, NO_SET_POINT
        flag, expiry, set_point = self._active.next_command(frame.position, now)
        return flags | flag, expiry, set_point

    def feed(self, data: bytes, now: int) -> Sample | None:
        """Process a datagram; return its sample if it is accepted."""
        if sample := self.measure(data, now):
            self.follow(sample)
        return sample

    def measure(self, data: bytes, now: int) -> Sample | None:
        """Decode a datagram as `feed` does, but leave the update of the session to `follow`.

        The caller can publish the measurement before that update.
        """
        lost = self.lost
        if (accepted := self.accept(data, now)) is None:
            return None
        if lost:  # the link may have been replaced
            self.slow.pop(Slow.SERIAL, None)
        (frame, stamp), scale = accepted, self.scale
        return Sample(
            frame=frame,
            stamp=stamp,
            position=scale.position(frame.position),
            velocity=scale.velocity(frame.velocity),
            torque=scale.torque(frame.torque) if frame.torque_age < NO_TORQUE else nan,
        )

    def follow(self, sample: Sample) -> None:
        """Update the session from a sample."""
        self.update_state(sample.frame)

    def is_off(self, frame: Telemetry) -> bool:
        """Return True if the drive is off."""
        return frame.mode == Mode.OFF

    def update_progress(self, frame: Telemetry, echoed: int | None) -> None:
        """Update the progress of the last command and of the paths."""
        self._paths.update(frame, echoed)
        self._active.update(frame, echoed, self.now, self._paths.find(self._active.path))
        if self.progress and self.progress.broken:
            self.breakage = self.progress.reason
        elif frame.flags & State.FOLLOWING:
            self.breakage = ""
