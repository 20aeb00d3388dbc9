"""The drive's fault table, progress and reports of commands, homing, and the battery."""

from dataclasses import replace
from math import inf, isnan
from pathlib import Path

import pytest
from driver_link import SAMPLE, SessionBench

from fss_arm_driver.faults import (
    FAULTS,
    IN_MOTION,
    Word,
    active_faults,
    as_markdown,
    blocking_faults,
)
from fss_arm_driver.protocol import LinkCommandFlag, Mode, Slow, State
from fss_arm_driver.scale import HOME, Scale, SetPoint
from fss_arm_driver.session import CommandReports, Report
from fss_arm_driver.session.progress import STALL_TIME, START_TIMEOUT, Progress, Status
from fss_arm_model.description import Drive, paper_arm
from fss_arm_model.units import SECOND
from fss_link.session import Arming, CommandError
from fss_link.session.battery import Battery

LINK = paper_arm().links[0]
SCALE = Scale(LINK)
HALF = round(0.5 * 240_000 / 6.283185307179586)  # [counts]


def test_the_documentation_is_the_table():
    text = Path(__file__, "../../../../docs/reference/faults.md").resolve().read_text()
    assert text == as_markdown()


def test_each_bit_stands_once_and_what_blocks_has_a_remedy():
    places = [(fault.word, fault.bit) for fault in FAULTS]
    assert len(set(places)) == len(places)
    assert all(bool(fault.remedy) == fault.blocks for fault in FAULTS)
    assert all(fault.blocks for fault in FAULTS if fault.word is Word.FAULTS)


@pytest.mark.parametrize(
    ("status", "faults", "names"),
    [
        (0, 0, []),
        (1 << 27 | 1 << 12 | 1 << 20 | 1 << 9, 0, []),
        (1 << 0, 0, ["short circuit"]),
        (1 << 22, 0, ["latched fault"]),
        (1 << 22, 1 << 9, ["tracking error"]),
        (1 << 18 | 1 << 22, 1 << 9, ["tracking error"]),
        (0, 1 << 31 | 1 << 5, ["supply too high", "latched fault 31"]),
    ],
)
def test_what_blocks_is_named_once(status, faults, names):
    assert blocking_faults(status, faults) == names


def test_words_for_what_does_not_block():
    assert [fault.name for fault in active_faults(1 << 27 | 1 << 20, 0)] == [
        "was reset",
        "in motion",
    ]


def armed(description=LINK):
    bench = SessionBench(description).connected()
    bench.arm()
    return bench


@pytest.fixture
def bench():
    return armed()


def test_a_fault_disarms_and_forbids_arming_until_it_is_gone(bench):
    bench.set(Mode.POSITION, 0.5)
    bench.step(status=1 << 3)
    assert bench.session.arming is Arming.DISARMED
    assert bench.session.progress.status is Status.ABORTED
    assert bench.session.progress.reason == "supply too low"
    with pytest.raises(CommandError, match="link 1 has faults: supply too low"):
        bench.session.arm(bench.now)
    bench.step()
    bench.arm()
    assert bench.session.armed


def test_a_measured_fault_forbids_commands_before_it_disarms(bench):
    bench.now += bench.PERIOD
    sample = bench.session.measure(bench.link.telemetry(bench.now, status=1 << 3), bench.now)
    assert bench.session.armed
    with pytest.raises(CommandError, match="link 1 has faults: supply too low"):
        bench.set(Mode.POSITION, 0.5)
    bench.session.follow(sample)
    assert not bench.session.armed


def test_latched_faults_are_cleared_by_frames_that_do_not_arm(bench):
    bench.step(slow_id=Slow.FAULTS, slow_value=1 << 9)
    assert bench.session.faults == ["tracking error"]
    bench.session.clear_faults(bench.now)
    assert bench.last_command().flags == LinkCommandFlag.CLEAR_FAULTS
    bench.step(slow_id=Slow.FAULTS, slow_value=0)
    bench.arm()
    assert not bench.last_command().flags & LinkCommandFlag.CLEAR_FAULTS


def test_a_link_without_reference_is_commanded_no_position_until_homed(bench):
    bench.link.referenced = False
    assert not bench.step().referenced
    with pytest.raises(CommandError, match="link 1 is not referenced: home it first"):
        bench.set(Mode.POSITION, 0.1)
    bench.set(Mode.VELOCITY, 0.1)
    assert bench.last_command().mode == Mode.VELOCITY
    bench.set(HOME)
    told = bench.last_command()
    assert (told.flags, told.mode, told.set_point) == (
        LinkCommandFlag.ARM | LinkCommandFlag.HOME,
        Mode.POSITION,
        0,
    )
    bench.step()
    assert bench.step().referenced
    assert bench.session.progress.status is Status.REACHED
    bench.set(Mode.POSITION, 0.1)


def test_a_current_that_makes_too_much_torque_is_clamped():
    drive = Drive(torque_constant=0.8, max_torque=0.4, max_current=2.25)
    bench = armed(replace(LINK, drive=drive))
    bench.set(Mode.CURRENT, 2.0)
    assert bench.last_command().set_point == 50
    assert bench.session.counts["commands_clamped"] == 1


def test_a_command_is_accepted_moving_and_reached(bench):
    stations = []
    for _ in range(20):
        bench.set(Mode.POSITION, 0.5)
        stations.append(bench.session.progress.status)
        bench.step()
    assert stations == sorted(stations)
    assert set(stations) == {Status.ACCEPTED, Status.MOVING, Status.REACHED}


@pytest.mark.parametrize(
    ("end", "status", "reason"),
    [
        (lambda b: b.session.stop(), Status.ABORTED, "stopped"),
        (lambda b: b.session.disarm(), Status.ABORTED, "disarmed"),
        (lambda b: b.set(Mode.VELOCITY, 0.1), Status.ABORTED, "replaced by another command"),
        (lambda b: b.session.tick(b.now + 2 * SECOND), Status.ABORTED, "link 1 is lost"),
        (lambda b: [b.step() for _ in range(4)], Status.TIMED_OUT, "its time to live expired"),
        (
            lambda b: (
                b.link.take(b.session.command(b.now), b.now)
                or setattr(b.link, "flags", State.WATCHDOG)
                or b.step(down=False)
            ),
            Status.ABORTED,
            "the link has disarmed itself",
        ),
    ],
)
def test_a_command_may_end_otherwise(bench, end, status, reason):
    bench.set(Mode.POSITION, 1.2, time_to_live=0.5)
    progress = bench.session.progress
    bench.step()
    end(bench)
    assert (progress.status, progress.reason) == (status, reason)


ARMED = replace(SAMPLE, flags=State.ARMED | State.REFERENCED, mode=Mode.POSITION)


def follow(frames, mode=Mode.POSITION, value=0.5):
    progress = Progress(SCALE.set_point(mode, value), 0, SCALE)
    for now, taken, changes in frames:
        progress.update(replace(ARMED, **changes), taken, now)
    return progress.status, progress.reason


MOVING = {"status": IN_MOTION, "velocity": 100, "position": HALF // 2}


@pytest.mark.parametrize(
    ("frames", "status", "reason"),
    [
        ([(1, False, MOVING)], Status.ACCEPTED, ""),
        ([(START_TIMEOUT + 1, False, {})], Status.TIMED_OUT, "the link has not accepted it"),
        ([(1, True, {})], Status.ACCEPTED, ""),
        ([(START_TIMEOUT + 1, True, {})], Status.TIMED_OUT, "the joint did not start to move"),
        ([(1, True, MOVING)], Status.MOVING, ""),
        ([(1, True, MOVING), (2, True, {"position": HALF // 2})], Status.MOVING, ""),
        (
            [(1, True, MOVING), (STALL_TIME + 2, True, {"position": HALF // 2})],
            Status.ABORTED,
            "the joint stopped before its goal",
        ),
        ([(1, True, {**MOVING, "position": HALF})], Status.MOVING, ""),
        ([(1, True, {"position": HALF + 100})], Status.REACHED, ""),
        ([(1, True, {"position": HALF + 200})], Status.ACCEPTED, ""),
        ([(1, True, {"position": HALF, "mode": Mode.VELOCITY})], Status.ACCEPTED, ""),
    ],
)
def test_the_status_words_tell_the_progress(frames, status, reason):
    assert follow(frames) == (status, reason)


def test_velocity_and_current_are_reached_when_they_are_measured():
    velocity = {"status": IN_MOTION, "mode": Mode.VELOCITY, "velocity": 190_000}
    assert follow([(1, True, velocity)], Mode.VELOCITY)[0] is Status.REACHED
    assert follow([(1, True, {**velocity, "velocity": 90_000})], Mode.VELOCITY)[0] is Status.MOVING
    current = {"mode": Mode.CURRENT, "current": 50}
    assert follow([(1, True, current)], Mode.CURRENT)[0] is Status.REACHED


def test_a_battery_tells_how_long_it_lasts_though_the_clock_was_set_back():
    battery = Battery(empty=12.0)
    assert isnan(battery.time_left())
    for second in range(9000, 9600, 2):
        battery.add(14.8 - 1e-12 * second, second * SECOND)  # constant but for rounding
    assert battery.time_left() == inf
    for second in range(900):
        battery.add(round(16.0 - 0.001 * second, 1), second * SECOND)
    assert battery.time_left() == pytest.approx((15.1 - 12.0) / 0.001, rel=0.1)


# --- reports -------------------------------------------------------------------------------------

SET_POINT = SetPoint(Mode.POSITION, 0, 0, 0, clamped=False)


def test_each_change_is_reported_once():
    reports, progress = CommandReports(), Progress(SET_POINT, 5, SCALE)
    assert not reports.pending
    assert reports.take_changes(100) == []
    reports.add(None)
    reports.add(progress)
    assert reports.pending
    assert reports.take_changes(100) == [Report(Status.ACCEPTED, "", 105)]
    reports.add(progress)  # given again
    assert not reports.pending
    assert reports.take_changes(100) == []
    progress.end(Status.ABORTED, "disarmed")
    assert reports.pending
    assert reports.take_changes(200) == [Report(Status.ABORTED, "disarmed", 105)]


def test_the_end_of_a_replaced_command_precedes_the_next_one():
    reports = CommandReports()
    first, second, third = (Progress(SET_POINT, given, SCALE) for given in (5, 6, 6))
    reports.add(first)
    reports.take_changes(0)
    first.end(Status.ABORTED, "replaced")
    reports.add(second)
    second.end(Status.ABORTED, "replaced")
    reports.add(third)
    assert reports.take_changes(10) == [
        Report(Status.ABORTED, "replaced", 5),
        Report(Status.ABORTED, "replaced", 16),
        Report(Status.ACCEPTED, "", 16),
    ]
    assert not reports.pending
