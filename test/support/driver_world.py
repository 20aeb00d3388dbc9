"""Drivers and one link that talk over a network, in virtual time."""

import heapq
from functools import partial

from fss_arm_driver.protocol import Mode
from fss_arm_driver.session import LinkSession
from fss_arm_model.description import paper_arm
from fss_arm_model.units import SECOND
from fss_link.session import Arming
from fss_sim.link.electronics import LinkElectronics
from fss_sim.plant.vehicle import Motion

PERIOD, TICK = SECOND // 5, SECOND // 200
DATE = 1_700_000_000 * SECOND  # the time of day when the tests' clock is 0
WATCHDOG = 2.0
LINK = paper_arm().links[0]
REST = Motion(q=0.1, qd=0.0, current=0.0, torque=0.0)


class World:
    """Drivers that talk to one link, in virtual time; all hear what it says.

    Args:
        key: that frames are signed under.
        delay: of each datagram [s].
    """

    def __init__(self, key=None, delay=0.002):
        self.key, self.delay = key, delay
        self.now, self.ways, self.sent = 100 * SECOND, [], 0
        self.drivers, self.commands, self.heard = [], [], []
        self.link = LinkElectronics(1, LINK, boot=5, key=key)

    def driver(self, step=0.0):
        """Another driver, on a computer whose time of day is off by `step` [s]."""
        epoch = DATE + round(step * SECOND)
        session = LinkSession(1, LINK, watchdog=WATCHDOG, key=self.key, epoch=epoch)
        self.drivers.append([session, self.now])
        return session

    def kill(self, session):
        self.drivers = [driver for driver in self.drivers if driver[0] is not session]

    def clock(self):
        return (self.now - 90 * SECOND) // 1000

    def send(self, session):
        self.commands.append(session.command(self.now))
        self.post(partial(self.to_link, self.commands[-1]))

    def post(self, what):
        self.sent += 1
        heapq.heappush(self.ways, (self.now + round(self.delay * SECOND), self.sent, what))

    def to_link(self, data):
        self.link.receive(data, self.clock())

    def to_drivers(self, data):
        self.heard.append(data)
        for session, _ in self.drivers:
            session.feed(data, self.now)

    def step(self):
        self.now += TICK
        while self.ways and self.ways[0][0] <= self.now:
            heapq.heappop(self.ways)[2]()
        for number, driver in enumerate(self.drivers):
            if self.now >= driver[1] + number * PERIOD // 3:  # each at a time of its own
                driver[1] += PERIOD
                self.send(driver[0])
        self.link.demand(self.clock(), REST)
        if data := self.link.telemetry(self.clock(), REST):
            self.post(partial(self.to_drivers, data))

    def run(self, seconds, until=lambda: False):
        """Let time pass until the condition holds; how long it took [s], or fail."""
        begun, end = self.now, self.now + round(seconds * SECOND)
        while not until():
            if self.now >= end:
                return seconds
            self.step()
        return (self.now - begun) / SECOND

    def can_arm(self, session):
        return not session.obstacle(self.now)

    def arm(self, session):
        session.arm(self.now)
        self.send(session)
        self.run(4.0, lambda: session.arming is not Arming.ARMING)
        assert session.armed
        return session

    def turn(self, session, seconds=60.0):
        expiry = self.now + round(seconds * SECOND)
        session.set(Mode.VELOCITY, 0.1, 0.0, 0.0, expiry, self.now)
        self.run(0.4)
        assert self.turns()

    def turns(self):
        return self.link.demand(self.clock(), REST).mode == Mode.VELOCITY
