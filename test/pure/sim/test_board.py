"""The base's board in the test bed, driven by a session."""

from dataclasses import replace

import numpy as np
import pytest

from fss_arm_model.description import paper_arm
from fss_arm_model.thrusters import thruster_wrenches
from fss_base_driver.gyro import GyroSums
from fss_base_driver.protocol import BaseSlow, Gripper
from fss_base_driver.session import BoardSession
from fss_link.session import Arming
from fss_sim.board.board import GYRO_SCALE
from fss_sim.noise import PRESETS
from fss_sim.sensors import RATE
from fss_sim.testbed import FRAME, State, Testbed

VALVES = thruster_wrenches(0.16, 0.11)
START = State(frame=0, boots=3, rests=0, q=(0.0,) * 7, qd=(0.0,) * 7, boot_offset=0)
KEY = bytes(range(16))


class Flight:
    """A test bed with a board, and the session that drives it, in simulated time."""

    def __init__(self, preset="ideal", state=START, key=None):
        keys = {0: key} if key else {}
        noise = replace(PRESETS[preset], clock_drift=5e-5)
        self.bed = Testbed(paper_arm(), noise, 1, state, keys=keys, board_rate=20.0)
        self.session, self.received = BoardSession(key=key, epoch=10**18), []
        self.sending = True

    @property
    def now(self):
        return self.bed.now + 10**9

    def frames(self, count):
        for _ in range(count):
            if self.bed.frame % 5 == 0:
                self.send()
            for datagram in self.bed.step().board:
                if datagram.peer and (received := self.session.feed(datagram.data, self.now)):
                    self.received.append(received)
        return self

    def send(self):
        data = self.session.command(self.now)
        if self.sending:
            self.bed.receive_base(data, "driver")

    def armed(self):
        self.frames(40)
        self.session.arm(self.now)
        self.frames(40)
        assert self.session.armed
        return self

    def open(self, **on_times):
        times = [on_times.get(f"v{i}", 0.0) for i in range(1, 9)]
        self.session.thrust(times, self.now, self.now)
        self.send()

    @property
    def impulse(self):
        return self.bed.plant.audit.impulse[:2]


@pytest.mark.parametrize("key", [None, KEY])
def test_a_pulse_gives_the_base_its_impulse(key):
    flight = Flight(key=key).armed()
    flight.open(v1=0.2, v7=0.2)  # both push back along x
    flight.frames(60)
    plant = flight.bed.plant
    np.testing.assert_allclose(flight.impulse, [-2 * 0.16 * 0.2, 0.0], atol=1e-3)
    mass = paper_arm().base.mass + sum(link.mass for link in paper_arm().links)
    assert plant.audit.momentum[0] / mass == pytest.approx(-2 * 0.16 * 0.2 / mass, rel=1e-3)
    assert flight.bed.board.state.opened == [200_000, 0, 0, 0, 0, 0, 200_000, 0]
    assert not any(plant.valves)


def test_the_gyro_sums_give_the_rotation_of_the_base():
    flight = Flight().armed()
    flight.open(v2=1.0, v3=1.0, v6=1.0, v7=1.0)  # two couples
    before, start = flight.bed.plant.q[2], len(flight.received)
    flight.frames(300)
    sums, angle = GyroSums(), 0.0
    for received in flight.received[start - 1 :]:
        if turn := sums.add(*received):
            angle += GYRO_SCALE * turn.counts * turn.samples / RATE
    last = flight.received[-1].stamp - 10**9
    turned = flight.bed.plant.q[2] - before
    turned -= flight.bed.plant.qd[2] * (flight.bed.now - last) / 1e9
    assert abs(turned) > 0.02
    assert angle == pytest.approx(turned, rel=0.02)


def test_a_dead_board_closes_and_restarts_disarmed():
    flight = Flight().armed()
    flight.open(v3=1.0)
    flight.frames(10)
    boot = flight.session.frame.boot
    flight.bed.faults.set("board", "dead", 1.0)
    flight.frames(3)
    assert not any(flight.bed.plant.valves)
    flight.frames(120)
    assert flight.session.lost
    flight.bed.faults.set("board", "dead", 0.0)
    flight.frames(100)
    assert not flight.session.lost
    assert flight.session.arming is Arming.DISARMED
    assert flight.session.frame.boot == boot + 1
    assert not any(flight.bed.plant.valves)


def test_a_valve_that_sticks_open_pushes_and_one_that_sticks_closed_does_not():
    flight = Flight().armed()
    flight.bed.faults.set("valve_3", "stuck_closed", 1.0)
    flight.open(v3=0.3, v4=0.3)
    flight.frames(60)
    expected = 0.3 * VALVES[3, :2]
    np.testing.assert_allclose(flight.impulse, expected, atol=0.002)
    flight.frames(100)
    assert flight.session.slow[BaseSlow.FAULTS] == 0b100
    flight.bed.faults.set("valve_7", "stuck_open", 1.0)
    used = flight.bed.plant.thrusters.propellant_used
    flight.frames(100)
    assert flight.bed.plant.valves == [False] * 6 + [True, False]
    assert flight.bed.plant.thrusters.propellant_used - used == pytest.approx(
        0.16 / 34.0 / 9.80665, rel=1e-3
    )
    flight.bed.faults.set("valve_7", "stuck_open", 0.0)
    flight.frames(1)
    assert not any(flight.bed.plant.valves)


def test_telemetry_has_its_rate_and_all_slow_fields_and_a_dead_gyro_adds_no_samples():
    flight = Flight("default").armed()
    flight.received.clear()
    flight.frames(200)
    assert len(flight.received) == pytest.approx(200 * FRAME * 20e-9, abs=1)
    slow = flight.session.slow
    assert slow.keys() == set(BaseSlow)
    assert (slow[BaseSlow.TANK], slow[BaseSlow.SUPPLY]) == (20_000, 7000)
    assert slow[BaseSlow.TEMPERATURE] == pytest.approx(198, abs=1)
    flight.bed.faults.set("fog", "dropout", 1.0)
    flight.frames(20)
    samples = flight.session.frame.gyro_samples
    flight.frames(100)
    assert flight.session.frame.gyro_samples == samples


def test_the_gripper_obeys_commands_and_keeps_its_state_without_power():
    flight = Flight().armed()
    flight.session.grip(True, flight.now)
    flight.frames(10)
    assert flight.bed.plant.closed
    assert flight.bed.board.state.gripper is Gripper.CLOSE
    flight.bed.faults.set("board", "dead", 1.0)
    flight.frames(50)
    flight.bed.faults.set("board", "dead", 0.0)
    flight.frames(50)
    assert flight.bed.plant.closed
