"""Emulated electronics of a link: accepted and rejected commands, stops, homing."""

from dataclasses import replace
from itertools import pairwise
from math import pi

import driver_frames
import pytest
from driver_frames import BOOT, DISARM, SECOND

from fss_arm_driver.protocol import LinkCommandFlag, Mode, Slow, State, decode, encode
from fss_arm_model.description import Drive, Link, TorqueSensor
from fss_sim.link.electronics import LinkElectronics
from fss_sim.plant.vehicle import Motion
from fss_sim.settings import TestbedSettings

LINK = Link(
    a=0.38, theta_0=0.0, mass=2.88, inertia=0.034, b=0.19,
    drive=Drive(direction=-1), torque_sensor=TorqueSensor(gain=1e-6, zero=100.0),
)  # fmt: skip
REST = Motion(q=0.5, qd=0.0, current=0.25, torque=0.2)
MOVING = REST._replace(qd=0.3)
MOVE = replace(
    driver_frames.MOVE, expiry=3 * SECOND, set_point=-40_000, velocity=300_000, acceleration=3000
)


def link(*commands, clock=SECOND):
    electronics = LinkElectronics(2, LINK, BOOT)
    for command in commands:
        assert electronics.receive(encode(command), clock)
    return electronics


def frame(electronics, clock=SECOND, motion=REST):
    return decode(electronics.telemetry(clock, motion))


def test_it_starts_off_and_reports_counts_of_its_own_drive_and_torque_converter():
    electronics = link(DISARM)
    assert electronics.demand(SECOND, REST).mode == Mode.OFF
    got = frame(electronics, clock=SECOND + 300)
    assert not got.flags & (State.ARMED | State.STOPPED | State.WATCHDOG)
    assert got.position == round(-0.5 * 240_000 / (2 * pi))
    assert got.current == -25
    assert got.torque == round(0.2 / 1e-6 + 100)
    assert (got.link, got.boot, got.sequence) == (2, BOOT, 0)
    assert (got.clock, got.echo, got.turnaround) == (SECOND + 300, 5, 300)


def test_frames_have_their_rate_and_slow_fields_alternate():
    electronics = LinkElectronics(2, replace(LINK, serial=23), BOOT)
    times = [t for t in range(0, 3 * SECOND, 10_000) if electronics.telemetry(t, REST)]
    assert [b - a for a, b in pairwise(times)] == [200_000] * 14
    frames = [frame(electronics, t) for t in range(3 * SECOND, 5 * SECOND, 200_000)]
    slow = {f.slow_id: f.slow_value for f in frames}
    assert slow.keys() == set(Slow)
    assert slow[Slow.SERIAL] == 23


def test_links_of_a_test_bed_have_the_serial_numbers_given():
    arm = TestbedSettings(serials=(7, 9, 8, 23)).description()
    assert [link.serial for link in arm.links] == [7, 9, 8, 23]


def test_an_armed_link_obeys_commands():
    demand = link(DISARM, MOVE).demand(SECOND, REST)
    assert demand.mode == Mode.POSITION
    assert demand.set_point == pytest.approx(40_000 * 2 * pi / 240_000)
    assert demand.speed == pytest.approx(30_000 * 2 * pi / 240_000)
    assert demand.acceleration == pytest.approx(30_000 * 2 * pi / 240_000)


def test_missing_commands_trip_the_watchdog_and_only_disarming_resets_it():
    electronics = link(DISARM, replace(MOVE, expiry=100 * SECOND))
    assert electronics.demand(3 * SECOND, REST).speed > 0.0
    held = electronics.demand(3 * SECOND + 1, MOVING)
    assert (held.mode, held.speed) == (Mode.POSITION, 0.0)
    assert frame(electronics, 3 * SECOND + 1).flags & State.WATCHDOG
    late = replace(MOVE, sequence=3, expiry=100 * SECOND)
    assert not electronics.receive(encode(late), 4 * SECOND)
    assert electronics.receive(encode(replace(DISARM, sequence=4)), 4 * SECOND)
    assert electronics.receive(encode(replace(late, sequence=5)), 4 * SECOND)
    assert electronics.armed


def test_every_stop_uses_the_largest_deceleration():
    gentle = replace(MOVE, acceleration=50)
    electronics = link(DISARM, gentle)
    assert electronics.demand(SECOND, REST).acceleration < 0.02
    stop = replace(DISARM, sequence=3, flags=LinkCommandFlag.STOP)
    assert electronics.receive(encode(stop), SECOND)
    held = electronics.demand(SECOND, MOVING)
    assert held.acceleration == LINK.drive.max_acceleration


def test_a_joint_that_keeps_moving_is_switched_off_after_a_timeout():
    electronics = link(DISARM, MOVE)
    electronics.demand(SECOND, MOVING)
    for k in range(15):  # repeated commands do not restart the timeout
        clock = SECOND + 200_000 * k
        assert electronics.receive(encode(replace(DISARM, sequence=3 + k)), clock)
        assert electronics.demand(clock, MOVING).mode == Mode.POSITION
    assert electronics.demand(4 * SECOND, MOVING).mode == Mode.POSITION
    assert electronics.demand(4 * SECOND + 1, MOVING).mode == Mode.OFF


def test_repeated_home_commands_home_once():
    home = replace(MOVE, flags=LinkCommandFlag.ARM | LinkCommandFlag.HOME, set_point=0)
    electronics = link(DISARM)
    assert electronics.drive.referenced
    assert electronics.receive(encode(home), SECOND)
    assert not frame(electronics).flags & State.REFERENCED  # from the first that echoes it
    for k in range(3):
        assert electronics.receive(encode(replace(home, sequence=3 + k)), SECOND)
        demand = electronics.demand(SECOND, REST)  # at 0.5 rad, the flag covers it
        assert (demand.mode, demand.set_point) == (Mode.VELOCITY, -0.2)
    electronics.demand(SECOND, REST._replace(q=-1e-6))
    assert electronics.homings == 2
    assert electronics.demand(SECOND, REST._replace(q=-0.01)) == (Mode.POSITION, 0.0, 0.2, 1.0)
    after = frame(electronics, 2 * SECOND)
    assert after.flags & State.REFERENCED
    assert after.mode == Mode.POSITION


def test_an_aborted_homing_leaves_no_reference_and_can_be_repeated():
    home = replace(MOVE, flags=LinkCommandFlag.ARM | LinkCommandFlag.HOME, set_point=0)
    electronics = link(DISARM, home)
    electronics.demand(SECOND, REST)
    assert electronics.demand(3 * SECOND + 1, REST).speed == 0.0  # the command has expired
    assert electronics.demand(3 * SECOND + 1, REST._replace(q=-0.01)).speed == 0.0
    assert not frame(electronics, 3 * SECOND + 1).flags & State.REFERENCED
    again = replace(home, sequence=4, expiry=9 * SECOND)
    assert electronics.receive(encode(replace(DISARM, sequence=3)), 3 * SECOND)
    assert electronics.receive(encode(again), 3 * SECOND)
    assert electronics.demand(3 * SECOND, REST._replace(q=-0.01)).set_point == 0.2


def test_an_expired_set_point_is_held():
    electronics = link(DISARM, replace(MOVE, expiry=2 * SECOND))
    assert electronics.demand(2 * SECOND, REST).speed > 0.0
    assert electronics.demand(2 * SECOND + 1, REST).speed == 0.0


def test_a_stop_switches_nothing_on():
    stop = replace(DISARM, sequence=3, flags=LinkCommandFlag.STOP)
    assert link(DISARM, MOVE, stop).demand(SECOND, REST).mode == Mode.POSITION
    for before in ([], [DISARM], [DISARM, MOVE, replace(DISARM, sequence=3)]):
        electronics = link(*before, stop)
        assert electronics.stopped
        assert electronics.demand(SECOND, REST).mode == Mode.OFF
