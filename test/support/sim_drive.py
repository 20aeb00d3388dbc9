"""A simulated test bed with the driver of one of its links, in simulated time."""

from contextlib import suppress
from math import pi

from fss_arm_driver.protocol import Mode, Slow
from fss_arm_driver.scale import HOME
from fss_arm_driver.session import LinkSession
from fss_arm_model.description import paper_arm
from fss_arm_model.units import SECOND
from fss_link.session import Arming, CommandError
from fss_sim.noise import PRESETS
from fss_sim.testbed import State, Testbed

Q = (0.0, 0.0, 0.0, -0.4, -0.2, 0.3, 0.1)
BEGIN = State(frame=0, boots=1, rests=0, q=Q, qd=(0.0,) * 7, boot_offset=0)
EPOCH = 1_700_000_000 * SECOND
COUNT = 2.0 * pi / 240_000


class Bench:
    """Link 2 of a test bed, commanded every 50 ms, its telemetry 20 times a second."""

    def __init__(self, **options):
        arm = paper_arm()
        options = {"rate": 20.0, **options}
        self.bed = Testbed(arm, PRESETS["ideal"], 1, BEGIN, **options)
        self.session, self.frames = LinkSession(2, arm.links[1]), []
        self.target = None  # a goal of its moves
        self.faults = self.bed.faults
        self.run(1.0)

    @property
    def link(self):
        return self.bed.links[1]

    @property
    def now(self):
        return EPOCH + self.bed.now

    @property
    def q(self):
        return self.bed.plant.q[4]

    @property
    def frame(self):
        return self.frames[-1]

    @property
    def latched(self):
        return self.session.slow.get(Slow.FAULTS, 0)

    def run(self, seconds, until=lambda: False):
        """Let time pass; whether `until` came true."""
        for _ in range(round(100 * seconds)):
            if self.bed.frame % 5 == 0:
                with suppress(CommandError):
                    self.give()
                self.bed.receive(1, self.session.command(self.now), "driver")
            for datagram in self.bed.step().telemetry[1]:
                if sample := self.session.feed(datagram.data, self.now):
                    self.frames.append(sample.frame)
            if until():
                return True
        return until()

    def give(self):
        if self.target is not None and self.session.armed:
            mode, value = self.target
            self.session.set(mode, value, 0.0, 0.0, self.now + SECOND, self.now)

    def arm(self):
        """Arm; raises CommandError as the session does."""
        self.session.arm(self.now)
        return self.run(3.0, lambda: self.session.arming is not Arming.ARMING) and (
            self.session.armed
        )

    def disarm(self):
        self.target = None
        self.session.disarm()
        return self.run(5.0, lambda: self.session.released)

    def clear(self):
        """What `fss_arm.sh clear` does."""
        self.session.clear_faults(self.now)
        self.run(3.0)

    def home(self):
        """What `fss_arm.sh home` does."""
        assert self.arm()
        self.target = HOME, 0.0
        found = self.run(60.0, lambda: self.session.referenced)
        return found and self.disarm()

    def go(self, q):
        self.target = Mode.POSITION, q

    def power_cycle(self, seconds=1.5):
        self.faults.set("link_2", "dead", 1.0)
        self.run(seconds)
        self.faults.set("link_2", "dead", 0.0)
        return self.run(5.0, lambda: not self.session.lost)
