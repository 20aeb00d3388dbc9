"""The sessions of all links and the simulated test bed, without ROS, as fast as time is stepped."""

from dataclasses import replace

from fss_arm_driver.protocol import Mode, State
from fss_arm_driver.session import LinkSession
from fss_arm_model.description import paper_arm
from fss_sim.noise import PRESETS
from fss_sim.testbed import FRAME, State as BedState, Testbed

SECOND = 1_000_000_000
EPOCH = 1_700_000_000 * SECOND  # of the sessions' clock at the test bed's first frame
PERIOD = SECOND // 5  # of the commands


class PathBed:
    """Links that a driver each talks to at 5 Hz.

    Args:
        n: links of the paper's arm.
        noise: preset of the test bed.
        seed: of all chances.
        key: that frames are signed under.
    """

    def __init__(self, n=4, noise="default", seed=1, key=None):
        arm = paper_arm()
        self.arm = replace(arm, links=arm.links[:n])
        q = (-0.7, 0.0, 0.0, *n * (0.0,))
        state = BedState(0, 1, 0, q, (3 + n) * (0.0,))
        keys = {i: key for i in range(1, n + 1) if key}
        self.bed = Testbed(self.arm, PRESETS[noise], seed, state, keys=keys)
        self.sessions = [
            LinkSession(i, link, key=key) for i, link in enumerate(self.arm.links, 1)
        ]
        self.seed, self.orders = seed, {}  # what is repeated each period, by link from 0
        self.samples = [None] * n

    @property
    def now(self):
        return EPOCH + self.bed.now

    def step(self):
        """One frame's time, 10 ms; the links' commands are sent at different times of a period."""
        for i, session in enumerate(self.sessions):
            if (self.bed.now // FRAME + 3 * i) % (PERIOD // FRAME) == 0:
                if i in self.orders:
                    self.order(i)
                self.send(i, session.command(self.now))
                self.send_path(i)
        for i, datagrams in enumerate(self.bed.step().telemetry):
            for datagram in datagrams:
                sample = self.sessions[i].feed(datagram.data, self.now)
                self.samples[i] = sample or self.samples[i]

    def send(self, i, data):
        self.bed.receive(i, data, peer=i)

    def send_path(self, i):
        for data in self.sessions[i].segments(self.now):
            self.send(i, data)

    def order(self, i):
        number, lives = self.orders[i]
        expiry = self.now + round(lives * SECOND)
        self.sessions[i].set(Mode.PATH, number, 0.0, 0.0, expiry, self.now)

    def run(self, seconds, watch=None):
        for _ in range(round(seconds * SECOND / FRAME)):
            self.step()
            if watch:
                watch(self)

    def until(self, holds, limit=20.0):
        """Run until `holds()` does."""
        for _ in range(round(limit * SECOND / FRAME)):
            if holds():
                return
            self.step()
        raise AssertionError(f"not within {limit} s")

    def armed(self, settle=3.0):
        self.run(settle)  # the clocks become known
        for session in self.sessions:
            session.arm(self.now)
        self.until(lambda: all(session.armed for session in self.sessions))
        return self

    def give(self, number, begin, time, positions, velocities):
        """A path of each link, which begins at `begin` by the sessions' clock [ns]."""
        for i, session in enumerate(self.sessions):
            session.give_path(number, begin, time, positions[i], velocities[i], self.now)
            self.send_path(i)

    def follow(self, number, lives=2.5):
        for i in range(len(self.sessions)):
            self.orders[i] = number, lives
            self.order(i)

    def fault(self, **faults):
        """Faults of all links' ways."""
        for i in range(1, len(self.sessions) + 1):
            for name, value in faults.items():
                self.bed.faults.set(f"link_{i}", name, value)

    def electronics(self, i=0):
        return self.bed.links[i].electronics

    def reading(self, i):
        """What the encoder reads now [rad]."""
        q = float(self.bed.plant.q[3 + i])
        return self.bed.links[i].instruments.encoder.reading(q)

    def flags(self, i=0):
        return State(0) if not self.samples[i] else self.samples[i].frame.flags
