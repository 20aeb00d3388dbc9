"""A driver and a link over a bad network, in virtual time: what is stamped, published, executed.

20% of the datagrams are lost, the others take 50 +- 40 ms, some come twice, some 0.3 s late, so
that later ones overtake them; for half a minute nothing comes at all.
"""

import heapq
from math import sin, sqrt
from random import Random

import pytest
from driver_network import SECOND, Network

from fss_arm_driver.protocol import LinkCommandFlag, Mode
from fss_arm_driver.session import LinkSession
from fss_arm_model.description import paper_arm
from fss_link.session import CommandError
from fss_sim.link.electronics import LinkElectronics
from fss_sim.plant.plant import Motion

START = 1_700_000_000 * SECOND
PERIOD = SECOND // 5
STEP = SECOND // 500  # of the link's clock
LINK = paper_arm().links[0]
TIMEOUT = SECOND
KEY = bytes(range(16))


class World:
    """Virtual time, a session and a link 40 ppm fast, and all that happened."""

    def __init__(self, seed, key=None):
        self.network = Network(rng=Random(seed))
        self.session = LinkSession(1, LINK, key=key)
        self.link = LinkElectronics(1, LINK, boot=5, key=key)
        self.now, self.events = START, []
        self.measured = []  # times of the link's frames [ns]
        self.samples, self.taken, self.late = [], [], []
        self.at(START, self.talk)
        self.at(START + PERIOD // 3, self.measure)

    def at(self, when, what, *values):
        heapq.heappush(
            self.events, (when, len(self.events), self.network.rng.random(), what, values)
        )

    def clock(self):
        return round((self.now - START + 7 * SECOND) * (1.0 + 40e-6)) // 1000

    def motion(self):
        t = (self.now - START) / SECOND
        return Motion(q=sin(0.5 * t), qd=0.5, current=0.1, torque=0.0)

    def run(self, seconds):
        end = self.now + round(seconds * SECOND)
        while self.events[0][0] <= end:
            self.now, *_, what, values = heapq.heappop(self.events)
            what(*values)
        self.now = end

    def talk(self):
        """The driver's timer."""
        self.at(self.now + PERIOD, self.talk)
        data = self.session.command(self.now)
        for arrival in self.network.arrivals(self.now):
            self.at(arrival, self.to_link, data)

    def measure(self):
        """The link's loop."""
        self.at(self.now + STEP, self.measure)
        self.link.demand(self.clock(), self.motion())
        if data := self.link.telemetry(self.clock(), self.motion()):
            self.measured.append((self.now, self.motion().q))
            for arrival in self.network.arrivals(self.now):
                self.at(arrival, self.to_driver, data)

    def to_link(self, data):
        if self.link.receive(data, self.clock()):
            command = self.link.gate.command
            self.taken.append((self.clock(), command))

    def to_driver(self, data):
        if sample := self.session.feed(data, self.now):
            self.samples.append((self.now, sample))


@pytest.mark.parametrize("key", [None, KEY])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_bad_network(seed, key):
    world = World(seed, key)
    session = world.session
    world.run(10)
    session.arm(world.now)
    world.run(2)
    for k in range(250):
        try:
            session.set(
                Mode.POSITION, 0.2 + 0.001 * k, 0.0, 0.0, world.now + SECOND // 2, world.now
            )
        except CommandError:
            session.arm(world.now)  # disarmed by a second of silence: armed again
        world.run(0.2)
    before = len(world.samples)
    world.network.down = True
    world.run(30)
    world.network.down = False
    assert session.lost
    assert not world.link.armed
    back = world.now
    world.run(30)

    assert world.samples[before][0] - back < SECOND
    assert not session.armed
    sequences = [sample.frame.sequence for _, sample in world.samples]
    assert sequences == sorted(set(sequences))
    assert len(sequences) > 0.7 * 5 * 92
    errors = []
    for heard, sample in world.samples:
        when, q = world.measured[sample.frame.sequence]
        assert sample.position == pytest.approx(q, abs=1e-4)
        assert heard - when <= TIMEOUT
        errors.append((sample.stamp - when) / SECOND)
    assert sqrt(sum(error**2 for error in errors) / len(errors)) < 5e-3
    stamps = [sample.stamp for _, sample in world.samples]
    assert stamps == sorted(set(stamps))

    executed = [
        (clock, command) for clock, command in world.taken if command.flags & LinkCommandFlag.ARM
    ]
    assert len(executed) > 100
    assert all(clock <= command.expiry for clock, command in executed)
    order = [command.sequence for _, command in world.taken]
    assert order == sorted(set(order))
