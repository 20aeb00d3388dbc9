"""A link's electronics, emulated: what it takes, what it refuses, how it stops by itself."""

from dataclasses import replace
from itertools import pairwise
from math import pi

import pytest

from fss_arm_driver.protocol import Command, Mode, Order, Slow, State, decode, encode
from fss_arm_model.description import Drive, Link, TorqueSensor
from fss_link.protocol import Refused
from fss_sim.link.electronics import LinkElectronics
from fss_sim.plant.plant import Motion

LINK = Link(
    a=0.38, theta_0=0.0, mass=2.88, inertia=0.034, b=0.19,
    drive=Drive(direction=-1), torque_sensor=TorqueSensor(gain=1e-6, zero=100.0),
)  # fmt: skip
REST = Motion(q=0.5, qd=0.0, current=0.25, torque=0.2)
BOOT, SECOND = 7, 1_000_000
QUIET = Command(
    link=2, flags=0, boot=BOOT, sequence=1, clock=5, expiry=0, mode=Mode.OFF, watchdog=2000,
    set_point=0, velocity=0, acceleration=0,
)  # fmt: skip
GO = replace(
    QUIET, flags=Order.ARM, sequence=2, expiry=3 * SECOND, mode=Mode.POSITION, set_point=-40_000,
    velocity=300_000, acceleration=3000,
)  # fmt: skip


def link(*commands, clock=SECOND):
    electronics = LinkElectronics(2, LINK, BOOT)
    for command in commands:
        assert electronics.receive(encode(command), clock)
    return electronics


def frame(electronics, clock=SECOND, motion=REST):
    return decode(electronics.telemetry(clock, motion))


def test_it_starts_disarmed_and_off():
    fresh = link()
    assert fresh.demand(SECOND, REST).mode == Mode.OFF
    assert not frame(fresh).flags & (State.ARMED | State.STOPPED | State.WATCHDOG)


def test_it_reports_counts_of_its_own_drive_and_torque_converter():
    got = frame(link(QUIET), clock=SECOND + 300)
    assert got.position == round(-0.5 * 240_000 / (2 * pi))
    assert got.current == -25
    assert got.torque == round(0.2 / 1e-6 + 100)
    assert (got.link, got.boot, got.sequence) == (2, BOOT, 0)
    assert (got.clock, got.echo, got.turnaround) == (SECOND + 300, 5, 300)


def test_it_tells_its_serial_number():
    electronics = LinkElectronics(2, replace(LINK, serial=23), BOOT)
    frames = [frame(electronics, t) for t in range(SECOND, 3 * SECOND, 200_000)]
    assert {f.slow_value for f in frames if f.slow_id == Slow.SERIAL} == {23}


def test_frames_come_at_their_rate_and_slow_fields_take_turns():
    electronics = link()
    times = [t for t in range(0, 3 * SECOND, 10_000) if electronics.telemetry(t, REST)]
    assert [b - a for a, b in pairwise(times)] == [200_000] * 14
    slow = [frame(electronics, t).slow_id for t in range(3 * SECOND, 5 * SECOND, 200_000)]
    assert set(slow) == set(Slow)


def test_an_armed_link_does_what_it_is_told():
    demand = link(QUIET, GO).demand(SECOND, REST)
    assert demand.mode == Mode.POSITION
    assert demand.set_point == pytest.approx(40_000 * 2 * pi / 240_000)
    assert demand.speed == pytest.approx(30_000 * 2 * pi / 240_000)
    assert demand.acceleration == pytest.approx(30_000 * 2 * pi / 240_000)


@pytest.mark.parametrize(
    ("command", "reason"),
    [
        (replace(GO, sequence=1), Refused.SEQUENCE),
        (replace(GO, sequence=2), Refused.SEQUENCE),
        (replace(GO, sequence=0xFFFFFFF0), Refused.SEQUENCE),
        (replace(GO, sequence=3, boot=BOOT + 1), Refused.BOOT),
        (replace(GO, sequence=3, expiry=SECOND - 1), Refused.EXPIRED),
        (replace(GO, sequence=3, link=3), Refused.OTHER),
    ],
)
def test_it_refuses_and_changes_nothing(command, reason):
    electronics = link(QUIET, replace(GO, sequence=2))
    before = electronics.demand(SECOND, REST)
    assert not electronics.receive(encode(command), SECOND)
    assert electronics.gate.refused == {reason: 1}
    assert electronics.demand(SECOND, REST) == before


@pytest.mark.parametrize("cut", [0, 1, 71])
def test_what_is_no_frame_is_refused(cut):
    electronics = link()
    assert not electronics.receive(encode(QUIET)[:cut], SECOND)
    assert not electronics.receive(electronics.telemetry(SECOND, REST), SECOND)
    assert electronics.gate.refused == {Refused.FRAME: 1, Refused.OTHER: 1}


def test_a_session_cannot_begin_armed():
    electronics = link()
    assert not electronics.receive(encode(GO), SECOND)
    assert not electronics.armed


def test_silence_trips_the_watchdog_and_only_a_disarming_frame_resets_it():
    electronics = link(QUIET, replace(GO, expiry=100 * SECOND))
    assert electronics.demand(3 * SECOND, REST).speed > 0.0
    held = electronics.demand(3 * SECOND + 1, replace_speed(REST, 0.3))
    assert (held.mode, held.speed) == (Mode.POSITION, 0.0)
    assert frame(electronics, 3 * SECOND + 1).flags & State.WATCHDOG
    late = replace(GO, sequence=3, expiry=100 * SECOND)
    assert not electronics.receive(encode(late), 4 * SECOND)
    assert electronics.receive(encode(replace(QUIET, sequence=4)), 4 * SECOND)
    assert electronics.receive(encode(replace(late, sequence=5)), 4 * SECOND)
    assert electronics.armed


def replace_speed(motion, qd):
    return motion._replace(qd=qd)


def test_whatever_stops_it_brakes_as_hard_as_the_drive_can():
    gentle = replace(GO, acceleration=50)
    electronics = link(QUIET, gentle)
    assert electronics.demand(SECOND, REST).acceleration < 0.02
    assert electronics.receive(encode(replace(QUIET, sequence=3, flags=Order.STOP)), SECOND)
    held = electronics.demand(SECOND, replace_speed(REST, 0.3))
    assert held.acceleration == LINK.drive.max_acceleration


def test_a_joint_that_does_not_come_to_rest_is_switched_off_in_bounded_time():
    electronics, pushed = link(QUIET, GO), replace_speed(REST, 0.3)
    electronics.demand(SECOND, pushed)
    for k in range(15):  # told again and again, which begins nothing anew
        clock = SECOND + 200_000 * k
        assert electronics.receive(encode(replace(QUIET, sequence=3 + k)), clock)
        assert electronics.demand(clock, pushed).mode == Mode.POSITION
    assert electronics.demand(4 * SECOND, pushed).mode == Mode.POSITION
    assert electronics.demand(4 * SECOND + 1, pushed).mode == Mode.OFF


def test_a_link_without_reference_finds_it_once_for_all_such_commands_in_a_row():
    electronics, home = link(QUIET), replace(GO, flags=Order.ARM | Order.HOME, set_point=0)
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


def test_a_homing_that_is_given_up_leaves_no_reference_and_begins_anew_when_told():
    home = replace(GO, flags=Order.ARM | Order.HOME, set_point=0)
    electronics = link(QUIET, home)
    electronics.demand(SECOND, REST)
    assert electronics.demand(3 * SECOND + 1, REST).speed == 0.0  # the order has expired
    assert electronics.demand(3 * SECOND + 1, REST._replace(q=-0.01)).speed == 0.0
    assert not frame(electronics, 3 * SECOND + 1).flags & State.REFERENCED
    again = replace(home, sequence=4, expiry=9 * SECOND)
    assert electronics.receive(encode(replace(QUIET, sequence=3)), 3 * SECOND)
    assert electronics.receive(encode(again), 3 * SECOND)
    assert electronics.demand(3 * SECOND, REST._replace(q=-0.01)).set_point == 0.2


def test_an_expired_set_point_is_held():
    electronics = link(QUIET, GO)
    assert electronics.demand(3 * SECOND, REST).speed > 0.0
    electronics.receive(encode(replace(GO, sequence=3, expiry=2 * SECOND)), 2 * SECOND)
    assert electronics.demand(2 * SECOND + 1, REST).speed == 0.0


def test_stop_latches_until_disarmed_and_armed_anew():
    electronics = link(QUIET, GO, replace(QUIET, sequence=3, flags=Order.STOP))
    again = replace(GO, sequence=4)
    assert electronics.receive(encode(again), SECOND)
    assert not electronics.armed
    assert frame(electronics).flags & State.STOPPED
    assert electronics.receive(encode(replace(QUIET, sequence=5)), SECOND)
    assert electronics.receive(encode(replace(again, sequence=6)), SECOND)
    assert electronics.armed


def test_a_stop_switches_nothing_on():
    stop = replace(QUIET, sequence=3, flags=Order.STOP)
    assert link(QUIET, GO, stop).demand(SECOND, REST).mode == Mode.POSITION
    for before in ([], [QUIET], [QUIET, GO, replace(QUIET, sequence=3)]):
        electronics = link(*before, stop)
        assert electronics.stopped
        assert electronics.demand(SECOND, REST).mode == Mode.OFF


def test_stop_is_obeyed_whatever_its_boot_and_sequence():
    electronics = link(QUIET, GO)
    stop = replace(QUIET, sequence=0, boot=BOOT + 5, flags=Order.STOP)
    assert electronics.receive(encode(stop), SECOND)
    assert not electronics.armed
    assert electronics.stopped


def test_disarming_brakes_and_switches_off_at_rest():
    electronics = link(QUIET, GO)
    electronics.demand(SECOND, REST)
    assert electronics.receive(encode(replace(QUIET, sequence=3)), SECOND)
    assert electronics.demand(SECOND, replace_speed(REST, 0.3)).mode == Mode.POSITION
    assert electronics.demand(SECOND, REST).mode == Mode.OFF


KEY = bytes(range(16))


def test_with_a_key_each_command_is_taken_once_and_only_if_signed():
    electronics = LinkElectronics(2, LINK, BOOT, key=KEY)
    go = replace(GO, clock=6)
    stop = replace(QUIET, sequence=3, clock=7, flags=Order.STOP)
    seen = []
    for command in (QUIET, go, stop):
        assert not electronics.receive(encode(command), SECOND)
        seen.append(encode(command, KEY))
        assert electronics.receive(seen[-1], SECOND)
        assert not any(electronics.receive(data, SECOND) for data in seen)
    assert electronics.gate.refused == {Refused.FRAME: 3, Refused.SEQUENCE: 6}
    assert decode(electronics.telemetry(SECOND, REST), KEY).flags & State.STOPPED


def test_with_a_key_silence_opens_no_way_for_replays():
    electronics = LinkElectronics(2, LINK, BOOT, key=KEY)
    assert electronics.receive(encode(replace(QUIET, boot=0), KEY), SECOND)
    assert electronics.receive(encode(replace(QUIET, sequence=2, clock=9), KEY), SECOND)
    assert not electronics.receive(encode(replace(QUIET, boot=0), KEY), 60 * SECOND)
    assert electronics.receive(encode(replace(QUIET, sequence=1, clock=10), KEY), 60 * SECOND)
