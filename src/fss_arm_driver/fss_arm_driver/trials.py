"""Tests of a link on the first day with hardware, one after the other.

By hand: direction and counts per turn, zero and gain of the torque sensor. Then, at low current and
only after the operator has agreed: the signs of current and torque, the stop and the watchdog.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import copysign, degrees, isnan, pi, radians
from statistics import mean, pstdev

from fss_arm_driver.faults import active_faults
from fss_arm_driver.protocol import CURRENT_UNIT, Mode, Slow, State
from fss_arm_driver.session import LinkSession, Sample
from fss_arm_model.description import Link
from fss_arm_model.units import SECOND
from fss_link.session import RELEASE_TIMEOUT, Arming, CommandError
from fss_link.transport import Transport

PASS, FAIL, NOT_TRIED = "pass", "fail", "not tried"
COMPLETE = "complete"  # name of the last finding, of tests that ended early

PERIOD = SECOND // 10  # of commands
MIN_TURN = 0.03  # angle that shows the direction of motion [rad]
MAX_TURN = 0.35  # largest angle of a test [rad]
SLOW_TURN = 0.1  # velocity of the tests of stop and watchdog [rad/s]
STEPS = 5  # of current, until the joint turns
MOTION_THRESHOLD = 0.01  # [rad/s]
WATCHDOG = 1.0  # used in the test [s]
NO_TORQUE = "no samples of the torque sensor are received"

Prompt = Callable[[str], str]


@dataclass(frozen=True)
class Finding:
    """Result of one test of one link."""

    link: int
    name: str
    verdict: str
    found: str


class Rig:
    """Link under test, with its transport; waiting keeps the communication running."""

    def __init__(self, number: int, link: Link, transport: Transport, key: bytes | None) -> None:
        self.number, self.link, self.transport = number, link, transport
        epoch = time.time_ns() - time.monotonic_ns()
        self.session = LinkSession(
            number, link, timeout=1.0, watchdog=WATCHDOG, key=key, epoch=epoch
        )
        self.sample: Sample | None = None
        self.sending = True
        self._sent = 0

    def wait_until(self, condition: Callable[[], object], timeout: float) -> bool:
        """Return True if the condition becomes true within `timeout` [s]."""
        end = time.monotonic() + timeout
        while not condition():
            if time.monotonic() > end:
                return False
            self.step()
        return True

    def step(self) -> None:
        """Send a command when one is due; process received data."""
        if self.sending and time.monotonic_ns() - self._sent > PERIOD:
            self.send()
        if self.transport.wait(0.02):
            for data in self.transport.receive():
                self.sample = self.session.feed(data, time.monotonic_ns()) or self.sample

    def send(self) -> None:
        """Send a command now."""
        self._sent = time.monotonic_ns()
        self.transport.send(self.session.command(self._sent))

    def listen(self, timeout: float) -> bool:
        """Return True if a sample of the link is received within `timeout` [s]."""
        return self.wait_until(lambda: self.sample, timeout)

    def samples(self, seconds: float) -> list[Sample]:
        """Return the samples that are received within `seconds`.

        Raises:
            CommandError: the link is lost.
        """
        received = [self.now()]

        def append_new() -> None:
            if self.sample and self.sample is not received[-1]:
                received.append(self.sample)

        self.wait_until(append_new, seconds)
        self.now()
        return received[1:]

    def torques(self, seconds: float) -> list[int]:
        """Return the torque samples within `seconds` [counts]; empty without a sensor."""
        return [s.frame.torque for s in self.samples(seconds) if not isnan(s.torque)]

    def now(self) -> Sample:
        """Return the last sample.

        Raises:
            CommandError: the link is lost.
        """
        if self.sample is None or self.session.lost:
            raise CommandError(f"link {self.number} is lost")
        return self.sample

    @contextmanager
    def armed(self) -> Iterator[None]:
        """Arm the link for the block, and release the joint after it in any case.

        Raises:
            CommandError: it cannot be armed, or does not confirm the release.
        """
        self.step()  # the link counts as lost after the operator's answer
        self.wait_until(lambda: not self.session.obstacle(time.monotonic_ns()), 3.0)
        self.session.arm(time.monotonic_ns())
        try:
            self.wait_until(lambda: self.session.arming is not Arming.ARMING, 3.0)
            if not self.session.armed:
                raise CommandError(f"link {self.number} does not arm")
            yield
        finally:
            self.release()

    def set(self, mode: Mode, value: float, seconds: float) -> None:
        """Set a command that is valid for `seconds`."""
        now = time.monotonic_ns()
        self.session.set(mode, value, 0.0, 0.0, now + round(seconds * SECOND), now)

    def release(self) -> None:
        """Disarm, and wait until the link reports that its drive is off and the joint rests.

        Raises:
            CommandError: the link does not report this in time.
        """
        self.sending = True
        self.session.disarm()
        self.send()  # even if the joint rests already: it may be held there under power

        def released() -> bool:
            at_rest = self.sample and abs(self.sample.velocity) < MOTION_THRESHOLD
            return bool(self.session.released and at_rest)

        if not self.wait_until(released, 1e-9 * RELEASE_TIMEOUT):
            raise CommandError(f"link {self.number} does not confirm that it is off: cut its power")


def answers(rig: Rig) -> Finding:
    """Report the link's firmware, state and faults."""
    rig.wait_until(lambda: len(rig.session.slow) >= len(Slow), 3.0)
    sample, session = rig.now(), rig.session
    version, supply = session.slow.get(Slow.FIRMWARE, 0), session.slow.get(Slow.SUPPLY)
    words = [fault.name for fault in active_faults(sample.frame.status, 0)]
    faults = session.faults
    found = (
        f"start {sample.frame.boot}, firmware "
        f"{version >> 16}.{version >> 8 & 255}.{version & 255}, round trip "
        f"{1e3 * session.round_trip:.1f} ms, "
        f"supply {'not reported yet' if supply is None else f'{0.1 * supply:.1f} V'}, "
        f"{'' if session.referenced else 'not '}referenced, drive: {', '.join(words) or 'nothing'}"
    )
    return Finding(rig.number, "answers", FAIL if faults else PASS, found)


def turn_by_hand(rig: Rig, ask: Prompt) -> Finding:
    """Measure direction and counts per turn, from a turn by a known angle."""
    name = "direction and counts per turn"
    before = rig.now().frame.position
    text = ask(
        "Turn the joint by hand, counter-clockwise seen from above, by an angle that you know; "
        "then type the angle in degrees, or nothing to skip this test: "
    )
    if not (angle := radians(_number(text))):
        return Finding(rig.number, name, NOT_TRIED, "skipped")
    rig.samples(1.0)
    counts = rig.now().frame.position - before
    drive = rig.link.drive
    expected = drive.direction * drive.counts_per_turn
    found = counts * 2.0 * pi / angle
    good = abs(found - expected) < 0.05 * abs(expected)
    words = f"{found:.0f} counts a turn, {expected} by the description"
    return Finding(rig.number, name, PASS if good else FAIL, words)


def torque_by_hand(rig: Rig, ask: Prompt) -> Iterator[Finding]:
    """Measure zero and gain of the torque sensor, from a known torque."""
    sensor = rig.link.torque_sensor
    ask("Leave the joint free of any torque, and press Enter: ")
    if not (rest := rig.torques(2.0)):
        yield Finding(rig.number, "torque zero", FAIL, NO_TORQUE)
        yield Finding(rig.number, "torque gain", NOT_TRIED, NO_TORQUE)
        return
    zero, noise = mean(rest), pstdev(rest)
    off = sensor.gain * (zero - sensor.zero)
    words = f"{zero:.0f} +- {noise:.0f} counts, off by {off:+.4f} N m from the description's"
    yield Finding(rig.number, "torque zero", PASS if abs(off) < 0.05 else FAIL, words)
    text = ask(
        "Apply a known torque to the joint, counter-clockwise positive, hold it, and type it in "
        "N m, "
        "or nothing to skip this test: "
    )
    if not (torque := _number(text)):
        yield Finding(rig.number, "torque gain", NOT_TRIED, "skipped")
        return
    if not (held := rig.torques(2.0)):
        yield Finding(rig.number, "torque gain", FAIL, NO_TORQUE)
        return
    loaded = mean(held)
    if loaded == zero:
        yield Finding(rig.number, "torque gain", FAIL, "the sensor does not respond to the torque")
        return
    gain = torque / (loaded - zero)
    good = abs(gain - sensor.gain) < 0.1 * abs(sensor.gain)
    words = f"{gain:.4e} N m a count, {sensor.gain:.4e} by the description"
    yield Finding(rig.number, "torque gain", PASS if good else FAIL, words)


def signs(rig: Rig, current: float) -> Iterator[Finding]:
    """Test whether a current turns the joint in its direction, and the signs of the sensors."""
    with rig.armed():
        start, seen = rig.now().position, []
        inwards = copysign(current, 0.5 * (rig.link.q_min + rig.link.q_max) - start)
        applied = 0.0
        for step in range(1, STEPS + 1):
            applied = step * inwards
            rig.set(Mode.CURRENT, applied, 1.0)
            rig.wait_until(lambda: abs(rig.now().position - start) > MIN_TURN, 1.0)
            seen.append(rig.now())
            if abs(rig.now().position - start) > MIN_TURN:
                break
        turned = rig.now().position - start
    if abs(turned) < MIN_TURN:
        words = f"does not turn with up to {applied:+.2f} A"
        yield Finding(rig.number, "current sign", FAIL, words)
        return
    words = f"{applied:+.2f} A turned it by {degrees(turned):+.1f} deg"
    yield Finding(rig.number, "current sign", PASS if turned * applied > 0.0 else FAIL, words)
    direction = rig.link.drive.direction
    measured = max((CURRENT_UNIT * direction * s.frame.current for s in seen), key=abs)
    good = copysign(1.0, measured) == copysign(1.0, turned) and measured != 0.0
    words = f"the drive measures {measured:+.2f} A"
    yield Finding(rig.number, "measured current", PASS if good else FAIL, words)
    if not (torques := [s.torque for s in seen if not isnan(s.torque)]):
        yield Finding(rig.number, "torque sign", NOT_TRIED, NO_TORQUE)
        return
    torque = max(torques, key=abs)
    if abs(torque) < 0.01:
        yield Finding(rig.number, "torque sign", NOT_TRIED, f"only {torque:+.4f} N m were measured")
        return
    words = f"{torque:+.3f} N m while it was accelerated by {turned:+.2f} rad"
    good = copysign(1.0, torque) == copysign(1.0, turned)
    yield Finding(rig.number, "torque sign", PASS if good else FAIL, words)


def stop(rig: Rig) -> Finding:
    """Measure how soon the joint is at rest after a stop."""
    with rig.armed():
        _turn_slowly(rig)
        start = time.monotonic()
        rig.session.stop()
        rig.send()
        stopped = rig.wait_until(
            lambda: (
                rig.now().frame.flags & State.STOPPED and abs(rig.now().velocity) < MOTION_THRESHOLD
            ),
            3.0,
        )
        took = time.monotonic() - start
    words = f"at rest {took:.2f} s after it" if stopped else "still moves"
    return Finding(rig.number, "stop", PASS if stopped else FAIL, words)


def watchdog(rig: Rig) -> Finding:
    """Measure how soon the joint is at rest when the computer stops sending."""
    with rig.armed():
        _turn_slowly(rig)
        rig.sending, start = False, time.monotonic()
        stopped = rig.wait_until(
            lambda: (
                rig.sample
                and rig.sample.frame.flags & State.WATCHDOG
                and abs(rig.sample.velocity) < MOTION_THRESHOLD
            ),
            WATCHDOG + 2.0,
        )
        took = time.monotonic() - start
    words = f"at rest {took:.2f} s after the last command, watchdog {WATCHDOG} s" if stopped else ""
    return Finding(rig.number, "watchdog", PASS if stopped else FAIL, words or "still moves")


def _turn_slowly(rig: Rig) -> None:
    """Turn the joint towards the middle of its range.

    Raises:
        CommandError: the joint does not turn.
    """
    way = 0.5 * (rig.link.q_min + rig.link.q_max) - rig.now().position
    rig.set(Mode.VELOCITY, copysign(SLOW_TURN, way), MAX_TURN / SLOW_TURN)
    if not rig.wait_until(lambda: abs(rig.now().velocity) > 0.5 * SLOW_TURN, 2.0):
        raise CommandError("does not turn at a slow velocity")


def trials(rig: Rig, ask: Prompt, current: float) -> Iterator[Finding]:
    """Test one link; a failure that prevents further tests is the last finding."""
    try:
        yield answers(rig)
        yield turn_by_hand(rig, ask)
        yield from torque_by_hand(rig, ask)
        question = (
            f"Link {rig.number} will turn by up to {degrees(MAX_TURN):.0f} deg with up to "
            f"{STEPS * current:.2f} A. Hold the base, stand clear, and type yes: "
        )
        if ask(question).strip().lower() != "yes":
            yield from _skipped(rig, "skipped", "current sign", "stop", "watchdog")
            return
        sign, *others = signs(rig, current)
        yield from (sign, *others)
        if sign.verdict != PASS:  # the drive's velocity loop may run away
            yield from _skipped(rig, "the current sign has not passed", "stop", "watchdog")
            return
        yield stop(rig)
        yield watchdog(rig)
    except CommandError as error:
        yield Finding(rig.number, COMPLETE, FAIL, str(error))


def _skipped(rig: Rig, why: str, *names: str) -> Iterator[Finding]:
    return (Finding(rig.number, name, NOT_TRIED, why) for name in names)


def _number(text: str) -> float:
    """Return the number typed, or 0."""
    try:
        return float(text)
    except ValueError:
        return 0.0
