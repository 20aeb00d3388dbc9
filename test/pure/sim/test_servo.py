"""The servo drive in the test bed: each line of the faults page, homing, what its supply does."""

from dataclasses import dataclass, field, fields

import numpy as np
import pytest
from sim_drive import COUNT, Bench, Mode

from fss_arm_driver.faults import FAULTS, Word, blocking
from fss_arm_driver.protocol import State
from fss_link.session import Arming, CommandError
from fss_sim.faults import DriveFaults, LinkFaults
from fss_sim.link import servo

STUCK = {"blocked": 1.0}


@dataclass(frozen=True)
class Case:
    """How a line of the page comes about: faults of the drive, and where the joint is to go."""

    status: int | None = None  # bit
    latched: int | None = None  # bit
    faults: dict = field(default_factory=dict)
    to: float | None = None
    power: bool = False  # which alone ends it
    homed: bool = True  # the reference is kept


CASES = {
    "short circuit": Case(0, 2, {"short_circuit": 1.0}),
    "drive too hot": Case(1, 3, {"drive_heat": 50.0}),
    "supply too high": Case(2, 5, {"supply": 40.0}),
    "supply too low": Case(3, 6, {"supply": -6.0}),
    "motor too hot": Case(4, 4, {"motor_heat": 80.0}),
    "feedback error": Case(5, 7, {"encoder": 1.0}, homed=False),
    "phasing error": Case(6, 8, {"phasing": 1.0}),
    "tracking error": Case(18, 9, STUCK, 1.0),
    "current too high": Case(None, 10, {"overcurrent": 1.0}),
    "command input lost": Case(None, 12, {"command_input": 1.0}),
    "flash memory damaged": Case(None, 0, {"flash": 1.0}, power=True),
    "internal error": Case(None, 1, {"internal": 1.0}, power=True),
    "logic failure": Case(None, 11, {"logic": 1.0}, power=True),
    "enable input inactive": Case(11, None, {"enable": 1.0}),
    "latched fault": Case(22, 2, {"short_circuit": 1.0}),
}
SEEN = {  # of those that do not block: the same, and the bit
    "current limited": (7, STUCK, 1.0),
    "voltage limited": (8, {"voltage_limit": 1.0}, None),
    "positive limit switch": (9, {"positive_limit": 1.0}, None),
    "negative limit switch": (10, {"negative_limit": 1.0}, None),
    "disabled by software": (12, {}, None),
    "stopping": (13, {}, "stop"),
    "brake on": (14, {}, None),
    "outputs disabled": (15, {}, None),
    "positive soft limit": (16, {}, "up"),
    "negative soft limit": (17, {}, "down"),
    "tracking warning": (19, STUCK, 1.0),
    "was reset": (20, {"supply": -24.0}, None),
    "position wrapped": (21, {"wrapped": 1.0}, None),
    "home switch": (26, {}, 0.3),
    "in motion": (27, {}, 0.3),
}


def test_each_line_of_the_page_is_rehearsed_and_names_faults_that_there_are():
    rehearsed = {(Word.STATUS, c.status) for c in CASES.values()}
    rehearsed |= {(Word.FAULTS, c.latched) for c in CASES.values()}
    rehearsed |= {(Word.STATUS, bit) for bit, *_ in SEEN.values()}
    assert {(f.word, f.bit) for f in FAULTS} <= rehearsed
    known = {f.name for f in fields(DriveFaults)}
    for fault in FAULTS:
        names = fault.rehearsal.split("`")[1::2]
        assert all(n in known or n == "link_<i>.resistance" for n in names), names
        case = CASES.get(fault.name)
        assert not case or case.status == 22 or set(case.faults) & set(names)


def test_the_emulated_drive_blocks_by_the_bits_of_the_page():
    for bit in range(32):
        assert bool(blocking(1 << bit, 0)) == bool(servo.BLOCKING >> bit & 1)


def afflicted(faults, to=None):
    bench = Bench()
    assert bench.arm()
    bench.go(bench.q if to is None else to)
    bench.run(0.2)
    for name, value in faults.items():
        bench.faults.set("drive_2", name, value)
    return bench


def has(bench, status=None, latched=None):
    return (status is None or bench.frame.status >> status & 1) and (
        latched is None or bench.latched >> latched & 1
    )


@pytest.mark.parametrize(("name", "case"), CASES.items(), ids=list(CASES))
def test_a_fault_is_reported_lets_go_and_ends_as_the_page_says(name, case):
    bench = afflicted(case.faults, case.to)
    assert bench.run(10.0, lambda: has(bench, case.status, case.latched))
    assert bench.run(4.0, lambda: bench.frame.mode == Mode.OFF)
    bench.target = None
    assert bench.session.arming is Arming.DISARMED
    assert not bench.frame.flags & State.ARMED
    cause = "short circuit" if name == "latched fault" else name
    with pytest.raises(CommandError, match=cause):
        bench.arm()
    if case.latched is not None:
        bench.clear()
        still = case.faults != STUCK  # a joint that is let go lags behind nothing
        assert bool(has(bench, latched=case.latched)) == still
    for fault in case.faults:
        bench.faults.set("drive_2", fault, 0.0)
    bench.run(3.0)
    if case.latched is not None and case.faults != STUCK:
        with pytest.raises(CommandError, match=cause):
            bench.arm()
        bench.clear()
        assert bool(bench.latched) == case.power
    if case.power:
        assert bench.power_cycle()
        bench.run(2.0)
    assert bench.session.referenced == (case.homed and not case.power)
    assert bench.session.referenced or bench.home()
    assert bench.arm()
    bench.go(0.2)
    assert bench.run(8.0, lambda: abs(bench.q - 0.2) < 1e-3)


@pytest.mark.parametrize(("bit", "faults", "to"), SEEN.values(), ids=list(SEEN))
def test_what_does_not_block_is_reported(bit, faults, to):
    bench = Bench()
    assert to is None or bench.arm()
    if isinstance(to, str):
        bench.target = Mode.VELOCITY, -0.5 if to == "down" else 0.5
        bench.run(6.0 if to != "stop" else 0.5)
    elif to is not None:
        bench.go(to)
    if to == "stop":
        bench.session.stop()
    for name, value in faults.items():
        bench.faults.set("drive_2", name, value)
    if bit == 20:
        bench.run(0.5)
        bench.faults.set("drive_2", "supply", 0.0)
    assert bench.run(4.0, lambda: has(bench, bit))


def test_a_joint_at_full_current_for_minutes_becomes_too_hot_and_cools():
    bench = afflicted(STUCK)
    bench.target = Mode.CURRENT, 2.25
    assert bench.run(300.0, lambda: has(bench, 4, 4))
    hot = bench.bed.now * 1e-9
    assert 180.0 < hot < 240.0  # 75 K of the 148 that it would come to: 300 s ln 2
    bench.target = None
    bench.clear()
    assert has(bench, 4, 4)
    assert bench.run(60.0, lambda: not has(bench, 4))
    bench.clear()
    assert not bench.latched
    assert bench.arm()


def test_a_bad_contact_of_the_battery_is_a_supply_too_low_under_load_alone():
    bench = afflicted(STUCK)
    bench.faults.set("link_2", "resistance", 5.0)
    bench.run(3.0)
    assert bench.session.armed
    bench.target = Mode.CURRENT, 2.25
    assert bench.run(5.0, lambda: has(bench, latched=6))
    assert bench.session.referenced  # its logic went on
    bench.faults.set("link_2", "resistance", 0.0)
    bench.target = None
    bench.clear()
    assert bench.arm()


def test_a_joint_that_is_blocked_in_time_for_a_warning_goes_on():
    bench = afflicted(STUCK, 1.0)
    assert bench.run(5.0, lambda: has(bench, 19))
    bench.faults.set("drive_2", "blocked", 0.0)
    assert bench.run(10.0, lambda: abs(bench.q - 1.0) < 1e-3)
    assert bench.session.armed


def test_a_blocked_joint_stays_where_it_is():
    bench = afflicted(STUCK, 1.0)
    bench.run(0.1)
    begin = bench.q
    bench.run(1.0)
    assert abs(bench.q - begin) < 1e-3
    assert np.abs(bench.bed.plant.imbalance).max() < 1e-9


def test_a_limit_switch_lets_the_joint_go_back_only():
    bench = afflicted({"positive_limit": 1.0}, 0.5)
    bench.run(3.0)
    assert bench.q < 0.0
    bench.go(-0.5)
    assert bench.run(5.0, lambda: abs(bench.q + 0.5) < 1e-3)


def test_the_reference_goes_with_the_power_and_homing_takes_time_and_moves():
    bench = Bench()
    begin = bench.q
    assert bench.power_cycle()
    bench.run(1.0)
    assert not bench.session.referenced
    assert bench.frame.status >> 20 & 1
    assert abs(bench.frame.position) <= 1  # it counts from where it is
    assert bench.arm()
    with pytest.raises(CommandError, match="not referenced"):
        bench.session.set(Mode.POSITION, 0.1, 0.0, 0.0, bench.now + 10**9, bench.now)
    bench.disarm()
    since, homings = bench.bed.now, bench.link.electronics.homings
    assert bench.home()
    took = (bench.bed.now - since) * 1e-9
    assert abs(begin) / servo.HOMING_SPEED < took < 10.0
    assert bench.link.electronics.homings == homings + 1
    assert abs(bench.frame.position * COUNT - bench.q) <= COUNT
    assert abs(bench.q) < 0.05  # it went there


@pytest.mark.parametrize("fault", ["dead", "reset"])
def test_a_link_restarts_disarmed_with_its_drive_off_at_rest(fault):
    bench = Bench()
    assert bench.arm()
    bench.target = Mode.VELOCITY, 0.2
    bench.run(1.0)
    bench.target = None
    bench.faults.set("link_2", fault, 1.0)
    bench.run(0.5)
    goes_on = abs(bench.bed.plant.qd[4] - 0.2) < 0.01
    assert goes_on == (fault == "reset")  # nobody told the drive to stop
    bench.run(1.0)
    bench.faults.set("link_2", fault, 0.0)
    assert bench.run(5.0, lambda: not bench.session.lost)
    assert bench.session.arming is Arming.DISARMED
    assert bench.run(4.0, lambda: bench.frame.mode == Mode.OFF)
    assert bench.session.referenced == (fault == "reset")


def test_a_drive_without_supply_leaves_its_link_silent():
    bench = Bench()
    bench.faults.set("drive_2", "supply", -24.0)
    assert bench.run(3.0, lambda: bench.session.lost)
    assert bench.link.running
    boot = bench.frame.boot
    bench.faults.set("drive_2", "supply", 0.0)
    assert bench.run(5.0, lambda: not bench.session.lost)
    assert bench.frame.boot == boot
    assert not bench.session.referenced


def test_a_brown_out_is_a_restart():
    bench = Bench()
    boot = bench.frame.boot
    bench.faults.set("link_2", "resistance", 60.0)
    assert bench.run(3.0, lambda: bench.session.lost)
    assert not bench.link.running
    bench.faults.set("link_2", "resistance", 0.0)
    assert bench.run(5.0, lambda: not bench.session.lost)
    assert bench.frame.boot == boot + 1
    assert not bench.session.referenced


def test_a_hand_turns_a_free_joint_and_loads_the_torque_sensor():
    bench = Bench()
    begin = bench.q
    bench.faults.set("drive_2", "hand", 0.5)
    bench.run(0.5)
    assert bench.q > begin + 0.01
    bench.run(20.0)  # against the stop
    assert bench.frame.current == 0
    torque = bench.session.scale.torque(bench.frame.torque)
    assert torque == pytest.approx(0.5, abs=0.02)


def test_faults_of_the_way_and_of_the_power_are_apart():
    assert {f.name for f in fields(LinkFaults)} & {f.name for f in fields(DriveFaults)} == set()
