"""What is tried on a link on the first day with hardware, one thing after the other.

By hand: direction and counts of a turn, zero and gain of the torque sensor. Then, at low current
and only after a person has agreed: the signs of current and torque, the stop and the watchdog.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import copysign, degrees, pi, radians
from statistics import mean, pstdev

from fss_arm_driver.faults import present
from fss_arm_driver.link import Arming, LinkSession, Sample
from fss_arm_driver.protocol import CURRENT_UNIT, Mode, Slow, State
from fss_arm_driver.scale import CommandError
from fss_arm_driver.transport import Transport
from fss_arm_model.description import Link

SECOND = 1_000_000_000  # [ns]
PASS, FAIL, NOT_TRIED = "pass", "fail", "not tried"

PERIOD = SECOND // 10  # of commands
ENOUGH = 0.03  # of a turn to see which way it goes [rad]
FAR = 0.35  # of a turn at most in a test [rad]
SLOW_TURN = 0.1  # velocity of the tests of stop and watchdog [rad/s]
STEPS = 5  # of current, until the joint turns
STILL = 0.01  # [rad/s]
WATCHDOG = 1.0  # tried with [s]

Ask = Callable[[str], str]


@dataclass(frozen=True)
class Finding:
    """One thing tried on one link."""

    link: int
    name: str
    verdict: str
    found: str


class Rig:
    """A link at the end of its transport; lets time pass while it talks to it."""

    def __init__(self, number: int, link: Link, transport: Transport, key: bytes | None) -> None:
        self.number, self.link, self.transport = number, link, transport
        self.session = LinkSession(number, link, timeout=1.0, watchdog=WATCHDOG, key=key)
        self.sample: Sample | None = None
        self.talking = True
        self._sent = 0

    def until(self, condition: Callable[[], object], timeout: float) -> bool:
        """Whether the condition comes true within a time [s]."""
        end = time.monotonic() + timeout
        while not condition():
            if time.monotonic() > end:
                return False
            self.turn()
        return True

    def turn(self) -> None:
        """Send a command when one is due; take what comes."""
        now = time.time_ns()
        if self.talking and now - self._sent > PERIOD:
            self.transport.send(self.session.command(now))
            self._sent = now
        if self.transport.wait(0.02):
            for data in self.transport.receive():
                self.sample = self.session.feed(data, time.time_ns()) or self.sample

    def listen(self, timeout: float) -> bool:
        """Whether the link is heard within a time [s]."""
        return self.until(lambda: self.sample, timeout)

    def samples(self, seconds: float) -> list[Sample]:
        """The samples that come within some time."""
        got = [self.now()]

        def keep() -> None:
            if self.sample and self.sample is not got[-1]:
                got.append(self.sample)

        self.until(keep, seconds)
        return got[1:]

    def now(self) -> Sample:
        """The last sample.

        Raises:
            CommandError: the link is lost.
        """
        if self.sample is None or self.session.lost:
            raise CommandError(f"link {self.number} is lost")
        return self.sample

    def arm(self) -> None:
        """Arm the link.

        Raises:
            CommandError: it does not arm.
        """
        self.session.arm(time.time_ns())
        self.until(lambda: self.session.arming is not Arming.ARMING, 3.0)
        if not self.session.armed:
            raise CommandError(f"link {self.number} does not arm")

    def set(self, mode: Mode, value: float, seconds: float) -> None:
        """Give a command that lasts so long."""
        now = time.time_ns()
        self.session.set(mode, value, 0.0, 0.0, now + round(seconds * SECOND), now)

    def rest(self) -> None:
        """Disarm, and wait until the joint rests."""
        self.talking = True
        self.session.disarm()
        self.until(lambda: self.sample and abs(self.sample.velocity) < STILL, 3.0)


def answers(rig: Rig) -> Finding:
    """What the link says about itself."""
    rig.until(lambda: len(rig.session.slow) >= len(Slow), 3.0)
    sample, session = rig.now(), rig.session
    version = session.slow.get(Slow.FIRMWARE, 0)
    words = [fault.name for fault in present(sample.frame.status, 0)]
    faults = session.faults
    found = (
        f"start {sample.frame.boot}, firmware "
        f"{version >> 16}.{version >> 8 & 255}.{version & 255}, round trip "
        f"{1e3 * session.round_trip:.1f} ms, "
        f"supply {0.1 * session.slow.get(Slow.SUPPLY, 0):.1f} V, "
        f"{'' if session.referenced else 'not '}referenced, drive: {', '.join(words) or 'nothing'}"
    )
    return Finding(rig.number, "answers", FAIL if faults else PASS, found)


def turn_by_hand(rig: Rig, ask: Ask) -> Finding:
    """Direction and counts of a turn, from a turn of known angle."""
    name = "direction and counts per turn"
    before = rig.now().frame.position
    text = ask(
        "Turn the joint by hand, counter-clockwise seen from above, by an angle that you know; "
        "then type the angle in degrees, or nothing to leave it out: "
    )
    if not (angle := radians(_number(text))):
        return Finding(rig.number, name, NOT_TRIED, "left out")
    rig.samples(1.0)
    counts = rig.now().frame.position - before
    drive = rig.link.drive
    expected = drive.direction * drive.counts_per_turn
    found = counts * 2.0 * pi / angle
    good = abs(found - expected) < 0.05 * abs(expected)
    told = f"{found:.0f} counts a turn, {expected} by the description"
    return Finding(rig.number, name, PASS if good else FAIL, told)


def torque_by_hand(rig: Rig, ask: Ask) -> Iterator[Finding]:
    """Zero and gain of the torque sensor, from a known torque."""
    sensor = rig.link.torque_sensor
    ask("Let the joint hang free of any torque, and press Enter: ")
    rest = [sample.frame.torque for sample in rig.samples(2.0)]
    zero, noise = mean(rest), pstdev(rest)
    off = sensor.gain * (zero - sensor.zero)
    told = f"{zero:.0f} +- {noise:.0f} counts, off by {off:+.4f} N m from the description's"
    yield Finding(rig.number, "torque zero", PASS if abs(off) < 0.05 else FAIL, told)
    text = ask(
        "Put a known torque on the joint, counter-clockwise positive, hold it, and type it in N m, "
        "or nothing to leave it out: "
    )
    if not (torque := _number(text)):
        yield Finding(rig.number, "torque gain", NOT_TRIED, "left out")
        return
    loaded = mean(sample.frame.torque for sample in rig.samples(2.0))
    if loaded == zero:
        yield Finding(rig.number, "torque gain", FAIL, "the sensor does not answer to the torque")
        return
    gain = torque / (loaded - zero)
    good = abs(gain - sensor.gain) < 0.1 * abs(sensor.gain)
    told = f"{gain:.4e} N m a count, {sensor.gain:.4e} by the description"
    yield Finding(rig.number, "torque gain", PASS if good else FAIL, told)


def signs(rig: Rig, current: float) -> Iterator[Finding]:
    """Whether a current turns the joint the way of its sign, and what the sensors say meanwhile."""
    rig.arm()
    start, seen = rig.now().position, []
    inwards = copysign(current, 0.5 * (rig.link.q_min + rig.link.q_max) - start)
    applied = 0.0
    for step in range(1, STEPS + 1):
        applied = step * inwards
        rig.set(Mode.CURRENT, applied, 1.0)
        rig.until(lambda: abs(rig.now().position - start) > ENOUGH, 1.0)
        seen.append(rig.now())
        if abs(rig.now().position - start) > ENOUGH:
            break
    turned = rig.now().position - start
    rig.rest()
    if abs(turned) < ENOUGH:
        told = f"does not turn with up to {applied:+.2f} A"
        yield Finding(rig.number, "current sign", FAIL, told)
        return
    told = f"{applied:+.2f} A turned it by {degrees(turned):+.1f} deg"
    yield Finding(rig.number, "current sign", PASS if turned * applied > 0.0 else FAIL, told)
    direction = rig.link.drive.direction
    measured = max((CURRENT_UNIT * direction * s.frame.current for s in seen), key=abs)
    good = copysign(1.0, measured) == copysign(1.0, turned) and measured != 0.0
    told = f"the drive measures {measured:+.2f} A"
    yield Finding(rig.number, "measured current", PASS if good else FAIL, told)
    torque = max((s.torque for s in seen), key=abs)
    if abs(torque) < 0.01:
        yield Finding(rig.number, "torque sign", NOT_TRIED, f"only {torque:+.4f} N m were measured")
        return
    told = f"{torque:+.3f} N m while it was accelerated by {turned:+.2f} rad"
    good = copysign(1.0, torque) == copysign(1.0, turned)
    yield Finding(rig.number, "torque sign", PASS if good else FAIL, told)


def stop(rig: Rig) -> Finding:
    """How soon a stop is obeyed."""
    _turn_slowly(rig)
    begun = time.monotonic()
    rig.session.stop()
    rig.transport.send(rig.session.command(time.time_ns()))
    stopped = rig.until(
        lambda: rig.now().frame.flags & State.STOPPED and abs(rig.now().velocity) < STILL, 3.0
    )
    told = f"at rest {time.monotonic() - begun:.2f} s after it" if stopped else "goes on"
    rig.session.arming = Arming.DISARMED  # so that it may be armed anew
    rig.rest()
    return Finding(rig.number, "stop", PASS if stopped else FAIL, told)


def watchdog(rig: Rig) -> Finding:
    """How soon the joint is at rest when the computer falls silent."""
    _turn_slowly(rig)
    rig.talking, begun = False, time.monotonic()
    stopped = rig.until(
        lambda: (
            rig.sample
            and rig.sample.frame.flags & State.WATCHDOG
            and abs(rig.sample.velocity) < STILL
        ),
        WATCHDOG + 2.0,
    )
    took = time.monotonic() - begun
    told = f"at rest {took:.2f} s after the last command, watchdog {WATCHDOG} s" if stopped else ""
    rig.rest()
    return Finding(rig.number, "watchdog", PASS if stopped else FAIL, told or "goes on")


def _turn_slowly(rig: Rig) -> None:
    """Turn towards the middle of the joint's range.

    Raises:
        CommandError: it does not.
    """
    rig.arm()
    way = 0.5 * (rig.link.q_min + rig.link.q_max) - rig.now().position
    rig.set(Mode.VELOCITY, copysign(SLOW_TURN, way), FAR / SLOW_TURN)
    if not rig.until(lambda: abs(rig.now().velocity) > 0.5 * SLOW_TURN, 2.0):
        rig.rest()
        raise CommandError("does not turn at a slow velocity")


def trials(rig: Rig, ask: Ask, current: float) -> Iterator[Finding]:
    """Try one link."""
    yield answers(rig)
    yield turn_by_hand(rig, ask)
    yield from torque_by_hand(rig, ask)
    active = ("current sign", "stop", "watchdog")
    question = (
        f"Link {rig.number} will turn by up to {degrees(FAR):.0f} deg with up to "
        f"{STEPS * current:.2f} A. Hold the base, stand clear, and type yes: "
    )
    if ask(question).strip().lower() != "yes":
        yield from (Finding(rig.number, name, NOT_TRIED, "left out") for name in active)
        return
    try:
        yield from signs(rig, current)
        yield stop(rig)
        yield watchdog(rig)
    except CommandError as error:
        yield Finding(rig.number, "motion", FAIL, str(error))
    finally:
        rig.rest()


def _number(text: str) -> float:
    """The number typed, or 0."""
    try:
        return float(text)
    except ValueError:
        return 0.0
