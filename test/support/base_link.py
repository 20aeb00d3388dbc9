"""The base's board behind a fake transport: its own table of states, and a gyro that turns."""

import time

from driver_link import FakeLine

from fss_arm_model.units import SECOND
from fss_base_driver.protocol import BaseSlow, BoardState, Measured, board_gate, decode, encode

RATE = 20.0  # of telemetry [1/s]
GYRO_RATE = 100  # samples a second
SLOW = {
    BaseSlow.TANK: 19_500, BaseSlow.SUPPLY: 7000, BaseSlow.BATTERY: 240,
    BaseSlow.TEMPERATURE: 198, BaseSlow.FIRMWARE: 0x010203, BaseSlow.FAULTS: 0,
}  # fmt: skip


class FakeBoard:
    """A board whose clock began at host time `born` [ns]."""

    def __init__(self, boot=1, born=0, key=None, limits=None):
        self.state = BoardState(board_gate(boot, key), limits)
        self.born, self.key, self.sequence = born, key, 0
        self.slow = dict(SLOW)
        self.counts = 0.0  # of the gyro, of each sample
        self.sum = self.samples = 0
        self.holds, self.dead = False, False
        self.taken = []

    def clock(self, now):
        return (now - self.born) // 1000

    def take(self, data, now):
        if self.state.receive(data, self.clock(now)):
            self.taken.append(decode(data, self.key))

    def telemetry(self, now):
        """The next frame, measured at host time `now`."""
        clock = self.clock(now)
        while not self.dead and self.samples < clock * GYRO_RATE // 1_000_000:
            self.samples += 1
            self.sum += round(self.counts)
        measured = Measured(self.sum, self.samples, False, self.holds, self.slow)
        self.sequence += 1
        return encode(self.state.telemetry(clock, self.sequence, measured), self.key)

    def valves(self, now):
        self.state.tick(self.clock(now))
        return self.state.valves()


class FakeBoardTransport(FakeLine):
    """A board at the other end that measures at its rate, as commands come."""

    def __init__(self, clock=time.time_ns, key=None, **options):
        super().__init__(clock)
        self.board = FakeBoard(boot=5, born=clock() - 100 * SECOND, key=key, **options)

    def send(self, data):
        now = self.clock()
        if self.hears:
            self.board.take(data, now)
        if self.talks and now - self.last > 0.8 * SECOND / RATE:
            self.last = now
            self.put(self.board.telemetry(now))
