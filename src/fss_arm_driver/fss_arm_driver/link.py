"""The driver's side of one link as a state machine: datagrams in and out, no I/O and no clock.

What a link is told when it is lost, adopted, armed, commanded or stopped is as docs/protocol.md
says. All times are the caller's, in integer nanoseconds.
"""

from collections import Counter
from enum import Enum
from math import inf, nan
from typing import NamedTuple

from fss_arm_driver.battery import Battery
from fss_arm_driver.dialogue import Dialogue
from fss_arm_driver.faults import blocking
from fss_arm_driver.progress import Progress, Status
from fss_arm_driver.protocol import (
    Command,
    FrameError,
    Mode,
    Order,
    Refusal,
    Slow,
    State,
    Telemetry,
    decode,
    encode,
)
from fss_arm_driver.reception import SECOND, Reception
from fss_arm_driver.scale import CommandError, Scale, SetPoint
from fss_arm_model.description import Link

CORRECTION = SECOND // 10  # a simulated clock that is set back by less is being corrected
PATIENCE = 2 * SECOND  # a link that has not armed by then is left disarmed
RELEASE = 4 * SECOND  # a link that is disarmed has switched off by then, its joint at rest or not
NO_TORQUE = 255  # as the age of a torque sample: old, or there is none [ms]


class Arming(Enum):
    """What the driver wants of the link, and how far that has come."""

    DISARMED = "disarmed"
    ARMING = "arming"
    ARMED = "armed"
    STOPPED = "stopped"


#: What may happen to a telemetry frame but to be believed.
TROUBLES = (
    *(reason.value for reason in Refusal),
    *("foreign", "impossible", "unproven"),
    *("stale", "repeated", "reordered", "candidates", "missed"),
)
COUNTS = (
    *("received", "believed", *TROUBLES, "adopted", "lost"),
    *("sent", "commands_clamped", "commands_refused"),
)


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
        self.battery, self._empty = Battery(empty), empty
        self.scale = Scale(description)
        self.counts = Counter(dict.fromkeys(COUNTS, 0))
        self.arming = Arming.DISARMED
        self._timeout = round(timeout * SECOND)
        self._watchdog = round(watchdog * 1000)  # [ms]
        self._reception = Reception(
            self.scale, self._timeout, round(resolution * SECOND), key is not None, self.counts
        )
        self._silence = self._watchdog * SECOND // 1000  # the same [ns]
        self._dialogue = Dialogue(epoch, self._timeout, self._silence, key is not None)
        self._now = 0
        self._still = 0  # how long time stood still before `_woke`
        self._woke = -1  # when time went on
        self._boot = 0  # of the link that was followed last
        self.slow: dict[int, int] = {}  # the last report of each field, by Slow
        self._stamp = 0  # of the last sample
        self._order: SetPoint | None = None
        self._expiry = 0  # of the order
        self.progress: Progress | None = None  # of the last order
        self._clear_asked = -PATIENCE  # when
        self._arm_asked = 0  # when
        self._patience = PATIENCE  # with it
        self._disarm_asked = 0  # when
        self.released = False  # the link has said that it is off, as it was told to be
        self._releasing = False  # it has yet to
        self._sequence = 0

    @property
    def armed(self) -> bool:
        """Whether the link may move: this driver armed it, and it says so itself."""
        return self.arming is Arming.ARMED

    @property
    def settled(self) -> bool:
        """Whether what was asked last, to arm or to disarm, is done or has come to nothing."""
        return self.arming is not Arming.ARMING and not self._releasing

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
        return blocking(self.frame.status, self._latched()) if self.frame else []

    @property
    def referenced(self) -> bool:
        """Whether the encoder's zero is known, so that positions mean something."""
        return bool(self.frame and self.frame.flags & State.REFERENCED)

    def _latched(self) -> int:
        return self.slow.get(Slow.FAULTS, 0) & 0xFFFFFFFF

    @property
    def absence(self) -> str:
        """For how long the link was not heard, in words."""
        if (silence := self.silence(self._now)) == inf:
            return "not heard yet: is it on, and does no other driver talk to it?"
        return f"silent for {silence:.1f} s"

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
            return f"{link} is lost: {self.absence}"
        if dialogue.answered < self._woke:
            return f"{link}: its driver {self.standstill} just now"
        return f"{link} has faults: {', '.join(self.faults)}" if self.faults else ""

    def arm(self, now: int) -> None:
        """Ask the link to arm, also after a stop; `arming` tells how far that has come.

        Raises:
            CommandError: there is an obstacle.
        """
        if obstacle := self.obstacle(now):
            raise CommandError(obstacle)
        self.released = self._releasing = False
        if self.arming is not Arming.ARMED:
            self.arming, self._arm_asked = Arming.ARMING, now
            first = self._dialogue.answered < 0  # it may wait for an earlier driver's watchdog
            self._patience = PATIENCE + first * self._silence

    def _check_faults(self) -> None:
        if faults := self.faults:
            raise CommandError(f"link {self.number} has faults: {', '.join(faults)}")

    def clear_faults(self, now: int) -> None:
        """Disarm, and have the drive forget its latched faults."""
        self.disarm()
        self._clear_asked = now

    def disarm(self) -> None:
        """Let the joint come to rest and switch the drive off, also after a stop.

        `released` tells whether the link has, once all is `settled`; a lost one cannot tell.
        """
        self._drop_order(Status.ABORTED, "disarmed")
        self.arming, self._disarm_asked = Arming.DISARMED, self._now
        self.released, self._releasing = False, not self.lost

    def _disarm(self, why: str) -> None:
        """Disarm without having been told to: a stop stays."""
        self._drop_order(Status.ABORTED, why)
        if self.arming is not Arming.STOPPED:
            self.arming = Arming.DISARMED

    def stop(self) -> None:
        """Stop now and hold that place until armed anew or disarmed; what is off stays off."""
        self._drop_order(Status.ABORTED, "stopped")
        self.arming = Arming.STOPPED

    def _drop_order(self, status: Status, why: str) -> None:
        if self._order and self.progress:
            self.progress.end(status, why)
        self._order = None

    def set(
        self,
        mode: int,
        value: float,
        velocity: float,
        acceleration: float,
        expiry: int,
        now: int,
    ) -> None:
        """Take a command in SI units, in force until host time `expiry`.

        Raises:
            CommandError: it cannot be followed; what was in force stays.
        """
        self.tick(now)
        try:
            if not self.armed:
                raise CommandError(f"link {self.number} is {self.arming.value}, not armed")
            if expiry <= now:
                raise CommandError(f"the command expired {1e-9 * (now - expiry):.3f} s ago")
            self._check_faults()
            order = self.scale.set_point(mode, value, velocity, acceleration)
            if mode == Mode.POSITION and not self.referenced:
                raise CommandError(f"link {self.number} is not referenced: home it first")
        except CommandError:
            self.counts["commands_refused"] += 1
            raise
        if order != self._order:  # not a repetition that prolongs it
            self._drop_order(Status.ABORTED, "another command took its place")
            self.progress = Progress(order, now, self.scale)
        self._order, self._expiry = order, expiry
        self.counts["commands_clamped"] += order.clamped

    def tick(self, now: int) -> None:
        """Let time pass: loss, expiry, arming that came to nothing, a simulated clock set back.

        Time in which this was not called long enough for the link to disarm itself, as the
        process was stopped or the computer slept, is time that nobody watched the link.
        """
        if self._now and now - self._now > self._silence:
            self._still, self._woke = now - self._now, now
            self._disarm(self.standstill)
        if now < self._now - CORRECTION:
            self._reception.forget(now)
            self._dialogue.forget()
            self._woke = -1
            self._stamp = 0
            self._clear_asked = now - PATIENCE
            self._disarm("the clock was set back")
        self._now = now
        if self._reception.tick(now):
            self._dialogue.delay = 0
            self._disarm("the link is lost")
        if self._order and now > self._expiry:
            self._drop_order(Status.TIMED_OUT, "its time to live ended")
        patience = self._patience + 2 * self._dialogue.delay  # a latch is cleared first
        if self.arming is Arming.ARMING and now - self._arm_asked > patience:
            self.arming = Arming.DISARMED
        if self.lost or now - self._disarm_asked > RELEASE:
            self._releasing = False

    def command(self, now: int) -> bytes:
        """The frame to send now."""
        self.tick(now)
        self._sequence = (self._sequence + 1) & 0xFFFFFFFF
        self.counts["sent"] += 1
        flags, expiry, order = self._wanted(now)
        frame, track = self.frame, self._reception.track
        return encode(
            Command(
                link=self.number,
                flags=flags,
                boot=frame.boot if frame else 0,
                sequence=self._sequence,
                clock=self._dialogue.stamp(now),
                expiry=track.clock.to_link(expiry) if track and expiry else 0,
                mode=order.mode if order else Mode.OFF,
                watchdog=self._watchdog,
                set_point=order.value if order else 0,
                velocity=order.velocity if order else 0,
                acceleration=order.acceleration if order else 0,
            ),
            self._key,
        )

    def _wanted(self, now: int) -> tuple[int, int, SetPoint | None]:
        """Flags, host time of expiry and set point of the next command."""
        frame = self.frame
        if self.arming is Arming.STOPPED:
            return Order.STOP, 0, None
        if frame is None or self.arming is Arming.DISARMED:
            clear = now - self._clear_asked < PATIENCE
            return Order.CLEAR_FAULTS if clear else 0, 0, None
        latched = frame.flags & (State.STOPPED | State.WATCHDOG)
        if self.arming is Arming.ARMING and (latched or self._dialogue.answered < 0):
            return 0, 0, None  # a frame that does not arm clears latches, and begins a session
        if self._order is None or self.scale.outward(self._order, frame.position):
            return Order.ARM | Order.HOLD, now + self._timeout, None
        home = Order.HOME if self._order.home else 0
        return Order.ARM | home, self._expiry, self._order

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
        believed = self._reception.take(frame, self._dialogue.way(frame, now), now)
        if believed or lost:
            self._dialogue.hear(frame, now)
        if not believed:
            return None
        if self.rival:
            self._disarm(self.rival)
        if lost:  # nothing is wanted of a link that was not followed until now
            self._disarm("the link was lost")
        return self._sample(frame, echoed, now)

    def follow(self, sample: Sample) -> None:
        """Learn from a sample what the link does: its slow values, arming, the last command."""
        frame = sample.frame
        if frame.boot != self._boot:
            self._boot, self.slow, self.battery = frame.boot, {}, Battery(self._empty)
        self.slow[frame.slow_id] = frame.slow_value
        if frame.slow_id == Slow.BATTERY:
            self.battery.take(0.1 * frame.slow_value, self._now)
        self._follow_arming(frame, self._dialogue.sent_at(frame))

    def _decode(self, data: bytes) -> Telemetry | None:
        """The telemetry of this link that these bytes are, or None, counted."""
        try:
            frame = decode(data, self._key)
        except FrameError as error:
            self.counts[error.reason.value] += 1
            return None
        if not isinstance(frame, Telemetry) or frame.link != self.number:
            self.counts["foreign"] += 1
            return None
        return frame

    def _follow_arming(self, frame: Telemetry, echoed: int | None) -> None:
        """Arming and disarming are done when the link says so in answer to what was sent since."""
        armed = bool(frame.flags & State.ARMED)
        if self._order and self.progress:
            taken = echoed is not None and echoed >= self.progress.given
            self.progress.follow(frame, taken, self._now)
        if self.arming is Arming.ARMED and not armed:
            self._disarm("the link has disarmed itself")
        elif self.arming is not Arming.DISARMED and (faults := self.faults):
            self._disarm(", ".join(faults))
        elif self.arming is Arming.ARMING and armed and echoed and echoed >= self._arm_asked:
            self.arming = Arming.ARMED
        off = not armed and frame.mode == Mode.OFF
        if self._releasing and off and echoed and echoed > self._disarm_asked:
            self._releasing, self.released = False, True

    def _sample(self, frame: Telemetry, echoed: int | None, now: int) -> Sample:
        assert self._reception.track
        clock, scale = self._reception.track.clock, self.scale
        if echoed is None:
            clock.one_way(frame.clock, now)
        else:
            clock.exchange(echoed, frame.turnaround, frame.clock, now)
        # A better estimate of the clock never turns the stamps back.
        self._stamp = max(clock.to_host(frame.clock), self._stamp + 1)
        return Sample(
            frame=frame,
            stamp=self._stamp,
            position=scale.position(frame.position),
            velocity=scale.velocity(frame.velocity),
            torque=scale.torque(frame.torque) if frame.torque_age < NO_TORQUE else nan,
        )
