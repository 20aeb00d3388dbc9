"""Servo drive of the test bed: each fault of docs/reference/faults.md, homing and supply."""

from dataclasses import dataclass, field, fields

import pytest
from sim_drive import COUNT, Bench, Mode

from fss_arm_driver.faults import FAULTS, Word, blocking_faults
from fss_arm_driver.protocol import State
from fss_link.session import Arming, CommandError
from fss_sim.faults import DriveFaults, LinkFaults
from fss_sim.link import servo

BLOCKED = {"blocked": 1.0}


@dataclass(frozen=True)
class Case:
    """Conditions that cause a fault of the page: injected faults, and the goal of the joint."""

    status: int | None = None  # bit
    latched: int | None = None  # bit
    faults: dict = field(default_factory=dict)
    to: float | None = None
    power: bool = False  # True if only switching the power off ends it
    homed: bool = True  # the reference is kept


CASES = {
    "short circuit": Case(0, 2, {"short_circuit": 1.0}),
    "drive too hot": Case(1, 3, {"drive_heat": 50.0}),
    "supply too high": Case(2, 5, {"supply": 40.0}),
    "supply too low": Case(3, 6, {"supply": -6.0}),
    "motor too hot": Case(4, 4, {"motor_heat": 80.0}),
    "feedback error": Case(5, 7, {"encoder": 1.0}, homed=False),
    "phasing error": Case(6, 8, {"phasing": 1.0}),
    "tracking error": Case(18, 9, BLOCKED, 1.0),
    "current too high": Case(None, 10, {"overcurrent": 1.0}),
    "command input lost": Case(None, 12, {"command_input": 1.0}),
    "flash memory damaged": Case(None, 0, {"flash": 1.0}, power=True),
    "internal error": Case(None, 1, {"internal": 1.0}, power=True),
    "logic failure": Case(None, 11, {"logic": 1.0}, power=True),
    "enable input inactive": Case(11, None, {"enable_open": 1.0}),
    "latched fault": Case(22, 2, {"short_circuit": 1.0}),
}
NOT_BLOCKING = {  # for status bits that do not block: the bit, faults, goal
    "current limited": (7, BLOCKED, 1.0),
    "voltage limited": (8, {"voltage_limit": 1.0}, None),
    "positive limit switch": (9, {"positive_limit": 1.0}, None),
    "negative limit switch": (10, {"negative_limit": 1.0}, None),
    "disabled by software": (12, {}, None),
    "stopping": (13, {}, "stop"),
    "brake on": (14, {}, None),
    "outputs disabled": (15, {}, None),
    "positive soft limit": (16, {}, "up"),
    "negative soft limit": (17, {}, "down"),
    "tracking warning": (19, BLOCKED, 1.0),
    "was reset": (20, {"supply": -24.0}, None),
    "position wrapped": (21, {"wrapped": 1.0}, None),
    "home switch": (26, {}, 0.3),
    "in motion": (27, {}, 0.3),
}


def test_each_fault_of_the_page_has_a_case_and_names_existing_faults():
    rehearsed = {(Word.STATUS, c.status) for c in CASES.values()}
    rehearsed |= {(Word.FAULTS, c.latched) for c in CASES.values()}
    rehearsed |= {(Word.STATUS, bit) for bit, *_ in NOT_BLOCKING.values()}
    assert {(f.word, f.bit) for f in FAULTS} <= rehearsed
    known = {f.name for f in fields(DriveFaults)}
    assert not known & {f.name for f in fields(LinkFaults)}
    for fault in FAULTS:
        names = fault.rehearsal.split("`")[1::2]
        assert all(n in known or n == "link_<i>.resistance" for n in names), names
        case = CASES.get(fault.name)
        assert not case or case.status == 22 or set(case.faults) & set(names)


def test_the_emulated_drive_blocks_by_the_bits_of_the_page():
    for bit in range(32):
        assert bool(blocking_faults(1 << bit, 0)) == bool(servo.BLOCKING >> bit & 1)


def bench_with_faults(faults, to=None):
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
def test_a_fault_is_reported_stops_the_joint_and_is_cleared_as_documented(name, case):
    bench = bench_with_faults(case.faults, case.to)
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
        still = case.faults != BLOCKED  # a released joint has no lag
        assert bool(has(bench, latched=case.latched)) == still
    for fault in case.faults:
        bench.faults.set("drive_2", fault, 0.0)
    bench.run(3.0)
    if case.latched is not None and case.faults != BLOCKED:
        with pytest.raises(CommandError, match=cause):
            bench.arm()
        bench.clear()
        assert bool(bench.latched) == case.power
    if case.power:
        assert bench.power_cycle()
        bench.run(2.0)
    assert bench.session.referenced == (case.homed and not case.power)
    if not bench.session.referenced:
        assert bench.arm()
        with pytest.raises(CommandError, match="not referenced"):
            bench.session.set(Mode.POSITION, 0.1, 0.0, 0.0, bench.now + 10**9, bench.now)
        assert bench.disarm()
        assert bench.home()
        assert abs(bench.frame.position * COUNT - bench.q) <= COUNT
    assert bench.arm()
    bench.go(0.2)
    assert bench.run(8.0, lambda: abs(bench.q - 0.2) < 1e-3)


@pytest.mark.parametrize(("bit", "faults", "to"), NOT_BLOCKING.values(), ids=list(NOT_BLOCKING))
def test_bits_that_do_not_block_are_reported(bit, faults, to):
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


def test_a_joint_at_full_current_overheats_and_cools():
    bench = bench_with_faults({"motor_heat": 50.0, **BLOCKED})
    bench.target = Mode.CURRENT, 2.25
    assert bench.run(120.0, lambda: has(bench, 4, 4))
    hot = bench.bed.now * 1e-9
    assert 45.0 < hot < 70.0  # 25 K of the 148 that it would come to: 300 s ln(148 / 123)
    bench.target = None
    bench.clear()
    assert has(bench, 4, 4)
    bench.faults.set("drive_2", "motor_heat", 0.0)
    bench.clear()
    assert not has(bench, 4)
    assert not bench.latched
    assert bench.arm()


def test_a_limit_switch_allows_motion_only_away_from_it():
    bench = bench_with_faults({"positive_limit": 1.0}, 0.5)
    bench.run(3.0)
    assert bench.q < 0.0
    bench.go(-0.5)
    assert bench.run(5.0, lambda: abs(bench.q + 0.5) < 1e-3)


@pytest.mark.parametrize("fault", ["dead", "reset"])
def test_a_link_restarts_disarmed_with_its_drive_off_at_rest(fault):
    bench = Bench()
    assert bench.arm()
    bench.target = Mode.VELOCITY, 0.2
    bench.run(1.0)
    bench.target = None
    bench.faults.set("link_2", fault, 1.0)
    bench.run(0.5)
    keeps_moving = abs(bench.bed.plant.qd[4] - 0.2) < 0.01
    assert keeps_moving == (fault == "reset")  # after a reset the drive continues
    bench.run(1.0)
    bench.faults.set("link_2", fault, 0.0)
    assert bench.run(5.0, lambda: not bench.session.lost)
    assert bench.session.arming is Arming.DISARMED
    assert bench.run(4.0, lambda: bench.frame.mode == Mode.OFF)
    assert bench.session.referenced == (fault == "reset")


@pytest.mark.parametrize(
    ("part", "fault", "value", "restarts"),
    [("drive_2", "supply", -24.0, False), ("link_2", "resistance", 60.0, True)],
)
def test_without_supply_a_link_is_silent_and_in_a_brown_out_it_restarts(
    part, fault, value, restarts
):
    bench = Bench()
    boot = bench.frame.boot
    bench.faults.set(part, fault, value)
    assert bench.run(3.0, lambda: bench.session.lost)
    assert bench.link.running != restarts
    bench.faults.set(part, fault, 0.0)
    assert bench.run(5.0, lambda: not bench.session.lost)
    assert bench.frame.boot == boot + restarts
    assert not bench.session.referenced


def test_a_hand_turns_a_free_joint_and_loads_the_torque_sensor():
    bench = Bench()
    start = bench.q
    bench.faults.set("drive_2", "hand", 0.5)
    bench.run(0.5)
    assert bench.q > start + 0.01
    bench.run(20.0)  # until the end stop
    assert bench.frame.current == 0
    torque = bench.session.scale.torque(bench.frame.torque)
    assert torque == pytest.approx(0.5, abs=0.02)
