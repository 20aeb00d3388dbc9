"""A link's electronics in a few lines, for the driver's tests: it turns as fast as it is told."""

import time
from collections import Counter, deque
from dataclasses import replace
from threading import Condition

from fss_arm_driver.faults import IN_MOTION
from fss_arm_driver.protocol import (
    VELOCITY_UNIT,
    Command,
    LinkCommandFlag,
    Mode,
    PathFollower,
    Segment,
    Slow,
    State,
    Telemetry,
    decode,
    encode,
)
from fss_arm_driver.session import LinkSession
from fss_arm_model.description import paper_arm
from fss_arm_model.units import SECOND
from fss_link.protocol import newer
from fss_link.session import Arming

MILLISECOND = 1_000_000
RATE = 20.0  # of telemetry [1/s]: faster than a real link, for short tests
SAMPLE = Telemetry(
    link=1, flags=0, boot=1, sequence=0, clock=0, echo=0, turnaround=0, position=0, velocity=0,
    current=0, mode=Mode.OFF, slow_id=Slow.SUPPLY, status=0, torque=0, torque_age=0,
    slow_value=240,
)  # fmt: skip


class FakeLink:
    """Telemetry of a link whose clock began at host time `born` [ns]."""

    def __init__(
        self, number: int = 1, boot: int = 1, born: int = 0, sequence: int = 0, key=None
    ) -> None:
        self.key = key
        self.frame = replace(SAMPLE, link=number, boot=boot, sequence=sequence)
        self.born = born
        self.taken: Command | None = None
        self.arrived = 0
        self.flags, self.referenced = 0, True
        self.position = self.target = 0
        self.speed = 0.0  # [counts/s]
        self.paths, self.turning = PathFollower(), 0.0  # as a path says [counts/s]
        self.measured = 0

    def clock(self, now: int) -> int:
        return (now - self.born) // 1000

    def take(self, data: bytes, now: int) -> None:
        command = decode(data, self.key)
        if isinstance(command, Segment):
            assert self.paths.store(command, self.clock(now)) is None
            return
        assert isinstance(command, Command)
        assert command.boot in (0, self.frame.boot)
        assert self.taken is None or newer(command.sequence, self.taken.sequence)
        assert command.expiry == 0 or self.clock(now) <= command.expiry
        self.taken, self.arrived = command, now
        latches = self.flags & (State.STOPPED | State.WATCHDOG)
        if command.flags & LinkCommandFlag.STOP:
            self.flags = State.STOPPED
        elif not command.flags & LinkCommandFlag.ARM:
            self.flags, self.speed = 0, 0.0
        elif not latches:
            self.flags = State.ARMED
            self.referenced |= bool(command.flags & LinkCommandFlag.HOME)
            if command.flags & LinkCommandFlag.HOME:
                self.speed = 0.0
            elif command.mode == Mode.POSITION:
                self.target, self.speed = command.set_point, VELOCITY_UNIT * command.velocity
            else:
                self.speed = 0.0

    def turn(self, now):
        """Follow the path that is commanded, or hold."""
        last = self.turning
        self.position += round(1e-9 * (now - self.measured) * last)
        self.turning = self.paths.follow(self.taken, self.clock(now), self.position, last) or 0.0

    def telemetry(self, now: int, **changes: int) -> bytes:
        """The next frame, measured at host time `now`."""
        taken = self.taken
        armed = self.flags & State.ARMED
        if armed and taken and taken.mode == Mode.PATH:
            self.turn(now)
        elif not armed:
            self.paths = PathFollower()
        way = self.target - self.position if self.speed and armed else 0
        most = round(self.speed * 1e-9 * (now - self.measured))
        self.measured, turned = now, max(-most, min(way, most))
        self.position += turned
        self.frame = replace(
            self.frame,
            flags=self.flags
            | State.REFERENCED * self.referenced
            | State.FOLLOWING * self.paths.following
            | State.BROKEN * self.paths.broken,
            sequence=(self.frame.sequence + 1) & 0xFFFFFFFF,
            clock=self.clock(now),
            echo=taken.clock & 0xFFFFFFFF if taken else 0,
            turnaround=self.clock(now) - self.clock(self.arrived) if taken else 0,
            position=self.position,
            velocity=round((self.speed if turned else self.turning) / VELOCITY_UNIT),
            status=IN_MOTION if turned or self.paths.following else 0,
            mode=Mode.POSITION if self.speed else Mode.OFF,
        )
        if self.paths.report or self.paths.broken:
            changes = {"slow_id": Slow.PATH, "slow_value": self.paths.report, **changes}
        return encode(replace(self.frame, **changes), self.key)


class FakeLine:
    """A transport with electronics at the other end, which talk and hear as long as they shall."""

    def __init__(self, clock):
        self.counts, self.problem = Counter(), ""
        self.clock = clock
        self.talks = self.hears = True
        self.last = 0
        self.datagrams, self.arrival = deque(), Condition()

    def put(self, data):
        with self.arrival:
            self.datagrams.append(data)
            self.arrival.notify()

    def receive(self):
        with self.arrival:
            got = list(self.datagrams)
            self.datagrams.clear()
        return got

    def wait(self, timeout):
        with self.arrival:
            # Not as long as it may, so that whoever waits here is soon seen to be closed.
            return self.arrival.wait_for(lambda: self.datagrams, min(timeout, 0.02))

    def close(self):
        pass


class FakeTransport(FakeLine):
    """A link at the other end that measures once for each command frame, at its steady rate."""

    def __init__(self, number=1, clock=time.time_ns, key=None):
        super().__init__(clock)
        self.link = FakeLink(number, boot=5, born=clock() - 100 * SECOND, key=key)

    def send(self, data):
        now = self.clock()
        expiry = getattr(decode(data, self.link.key), "expiry", 0)
        late = expiry and self.link.clock(now) > expiry  # sent in time, by a busy computer
        if self.hears and not late:
            self.link.take(data, now)
        if self.talks and now - self.last > 0.8 * SECOND / RATE:
            self.last = now
            self.put(self.link.telemetry(now))


class SessionBench:
    """A session with link 1 and that link, with time."""

    PERIOD = SECOND // 5
    TURN = 50 * MILLISECOND  # from the command to the measurement
    DELAY = 2 * MILLISECOND

    def __init__(self, description=None, **options):
        self.session = LinkSession(1, description or paper_arm().links[0], **options)
        self.now = 1_700_000_000 * SECOND
        self.restart(boot=7)

    def restart(self, boot, **options):
        self.link = FakeLink(boot=boot, born=self.now - SECOND, **options)

    def step(self, up=True, down=True, **changes):
        """One period: a command down, telemetry up; the sample, if any."""
        self.now += self.PERIOD - self.TURN - self.DELAY
        data = self.session.command(self.now)
        if down:
            self.link.take(data, self.now + self.DELAY)
        frame = self.link.telemetry(self.now + self.TURN, **changes)
        return self.feed(frame if up else b"", self.TURN + self.DELAY)

    def feed(self, data, later=0):
        self.now += later
        return self.session.feed(data, self.now)

    def connected(self):
        while self.step() is None:
            pass
        return self

    def arm(self):
        self.session.arm(self.now)
        while self.session.arming is Arming.ARMING:
            self.step()

    def last_command(self):
        return decode(self.session.command(self.now))

    def set(self, mode, value=0.0, velocity=0.0, acceleration=0.0, time_to_live=1.0):
        expiry = self.now + round(time_to_live * SECOND)
        self.session.set(mode, value, velocity, acceleration, expiry, self.now)
