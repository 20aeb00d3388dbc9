"""The sessions of all links and the simulated test bed, without ROS, as fast as time is stepped."""

from bisect import bisect_right
from dataclasses import replace
from random import Random

from fss_arm_driver.protocol import Mode, State, hermite
from fss_arm_driver.session import LinkSession, Status
from fss_arm_model.description import paper_arm
from fss_arm_model.units import SECOND
from fss_link.session import Arming
from fss_sim.noise import PRESETS
from fss_sim.testbed import FRAME, Testbed
from fss_sim.testbed import State as BedState

MILLISECOND = 1_000_000
EPOCH = 1_700_000_000 * SECOND  # of the sessions' clock at the test bed's first frame
BEAT = SECOND // 10  # half the period of the commands, as in the link node


class PathBed:
    """Links that a driver each talks to at 5 Hz, over a way of 1 to 4 ms there and 1 to 6 ms back.

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
        self.sessions = [LinkSession(i, link, key=key) for i, link in enumerate(self.arm.links, 1)]
        self.random, self.orders = Random(seed), {}  # what is repeated each period, by link from 0
        self.samples = [None] * n

    @property
    def now(self):
        """The sessions' clock [ns]: a little before the test bed's frame."""
        return self.frame - 4 * MILLISECOND

    @property
    def frame(self):
        """The same at the test bed's frame, whose state it shows."""
        return EPOCH + self.bed.now

    def step(self):
        """One frame's time, 10 ms; the links' commands are sent at different times of a period."""
        frame = self.frame
        for i, session in enumerate(self.sessions):
            beat, rest = divmod(self.bed.now // FRAME + 3 * i, BEAT // FRAME)
            if rest == 0 and beat % 2 == 0 and i in self.orders:
                self.order_path(i, *self.orders[i])
            if rest == 0 and (beat % 2 == 0 or session.follows):
                self.send(i, session.command(frame - self.way(4)))
                self.send_path(i)
        frame += FRAME
        for i, datagrams in enumerate(self.bed.step().telemetry):
            for datagram in datagrams:
                sample = self.sessions[i].feed(datagram.data, frame + self.way(6))
                self.samples[i] = sample or self.samples[i]

    def way(self, most):
        """How long a datagram is under way [ns], without what faults add."""
        return round(MILLISECOND * self.random.uniform(1.0, most))

    def send(self, i, data):
        self.bed.receive(i, data, peer=i)

    def send_path(self, i):
        for data in self.sessions[i].segments(self.now):
            self.send(i, data)

    def order_path(self, i, number, lives=2.0):
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
        self.until(self.arms)
        return self

    def arms(self):
        """Whether all links are armed; asks those again whose answer did not come."""
        for session in self.sessions:
            waits = session.arming in (Arming.ARMING, Arming.ARMED)
            if not waits and not session.obstacle(self.now):
                session.arm(self.now)
        return all(session.armed for session in self.sessions)

    def give(self, number, begin, time, positions, velocities):
        """A path of each link, which begins at `begin` by the sessions' clock [ns]."""
        for i, session in enumerate(self.sessions):
            session.give_path(number, begin, time, positions[i], velocities[i], self.now)
            self.send_path(i)

    def follow(self, number, lives=2.0):
        """Order it, again and again with each command."""
        for i in range(len(self.sessions)):
            self.orders[i] = number, lives
            self.order_path(i, number, lives)

    def reached(self):
        """Whether all links have come to the end of their path."""
        return all(session.progress.status is Status.REACHED for session in self.sessions)

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


def path_at(t, time, positions, velocities):
    """Where a joint shall be at t [s] of a path of cubics [rad]."""
    k = max(1, min(bisect_right(time, t), len(time) - 1))
    ends = positions[k - 1], velocities[k - 1], positions[k], velocities[k]
    return hermite(min(t, time[-1]) - time[k - 1], time[k] - time[k - 1], *ends)[0]


def spread(bed):
    """From the first link's beginning of its path to the last one's, in true time [ms]."""
    begins = []
    for session, link in zip(bed.sessions, bed.bed.links, strict=True):
        path = session._paths.next or session._paths.followed
        now, later = link.clock(bed.bed.now), link.clock(bed.bed.now + SECOND)
        begins.append((path.start - now) / (later - now))
    return 1e3 * (max(begins) - min(begins))
