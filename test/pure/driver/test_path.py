"""Paths in time: what a link keeps of them and how it follows, and what the computer sends."""

from array import array
from dataclasses import replace
from math import inf, nan

import numpy as np
import pytest
from driver_frames import path_segments
from driver_path import PathBed, path_at, spread
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from scipy.interpolate import CubicHermiteSpline

from fss_arm_driver.knots import knots
from fss_arm_driver.protocol import (
    LAST_SEGMENT,
    MAX_INDEX,
    Command,
    LinkCommandFlag,
    Mode,
    PathFollower,
    State,
    hermite,
)
from fss_arm_driver.scale import Scale
from fss_arm_driver.session import Status
from fss_arm_model.description import paper_arm
from fss_arm_model.units import SECOND
from fss_arm_msgs.msg import LinkPath
from fss_arm_ros.validation import RULES
from fss_link.protocol import Refused
from fss_link.session import CommandError

START_CLOCK = 50_000_000  # of the link's clock [us]
STEP = 20_000  # [us]
FASTEST = 40_000.0  # [counts/s]: the reach is 10000 counts
ORDER = Command(
    link=1, flags=LinkCommandFlag.ARM, boot=3, sequence=77, clock=1, expiry=1 << 60, mode=Mode.PATH,
    watchdog=2000, set_point=5, velocity=10 * int(FASTEST), acceleration=7639,
)  # fmt: skip
KNOTS = [(0, 0, 0), (1_000_000, 5000, 60_000), (2_000_000, 9000, -20_000), (3_000_000, 0, 0)]


def test_the_longest_path_passes_the_links_door():
    longest = array("d", bytes(8 * (MAX_INDEX + 2)))
    sent = serialize_message(LinkPath(path=1, time=longest, position=longest, velocity=longest))
    assert len(sent) <= RULES["fss_arm_msgs/LinkPath"].size


def path(number=5, begin=START_CLOCK + 1_000_000, told=KNOTS):
    """The segments of a path of knots (us since its start, counts, 0.1 counts/s)."""
    told = [(begin + t, p, v) for t, p, v in told]
    return path_segments(told, link=1, clock=1, path=number)


FIRST_SEGMENT, SECOND_SEGMENT, THIRD_SEGMENT = path()


class Joint:
    """A joint that turns as commanded, and rests without a command."""

    def __init__(self, follower, clock=START_CLOCK, position=0.0):
        self.follower, self.clock, self.position = follower, clock, position
        self.told = 0.0  # velocity [counts/s]; None: hold
        self.fastest_turn = 0.0

    def until(self, clock, order=ORDER):
        while self.clock < clock:
            speed = self.told or 0.0
            self.told = self.follower.follow(order, self.clock, self.position, speed)
            self.clock += STEP
            self.position += 1e-6 * STEP * (self.told or 0.0)
            self.fastest_turn = max(self.fastest_turn, abs(self.told or 0.0))
        return self


def follower(*segments, clock=START_CLOCK):
    paths = PathFollower()
    for segment in segments:
        assert paths.store(segment, clock) is None
    return paths


def following(*segments, at=START_CLOCK + 1_500_000):
    """A joint in the middle of path 5."""
    return Joint(follower(*(segments or path()))).until(at)


@pytest.mark.parametrize(
    ("duration", "p0", "v0", "p1", "v1"),
    [(2.0, 0.0, 0.0, 1.0, 0.0), (0.001, 5e8, -3e5, 5e8 + 40, 8e4), (60.0, -1e9, 1e6, 1e9, 0.0)],
)
def test_between_two_knots_a_path_is_their_cubic(duration, p0, v0, p1, v1):
    spline = CubicHermiteSpline([0.0, duration], [p0, p1], [v0, v1])
    for t in np.linspace(0.0, duration, 11):
        expected = float(spline(t)), float(spline(t, 1))
        assert hermite(t, duration, p0, v0, p1, v1) == pytest.approx(expected, rel=1e-9, abs=1e-6)


@pytest.mark.parametrize(
    ("segment", "why"),
    [
        (SECOND_SEGMENT, None),
        (FIRST_SEGMENT, None),  # again
        (replace(FIRST_SEGMENT, sequence=9, clock=9), None),
        (replace(FIRST_SEGMENT, position=1), Refused.CONTRADICTION),
        (replace(FIRST_SEGMENT, flags=LAST_SEGMENT, end_velocity=0), Refused.CONTRADICTION),
        (replace(FIRST_SEGMENT, begin=FIRST_SEGMENT.begin + 1), Refused.CONTRADICTION),
        (replace(FIRST_SEGMENT, duration=FIRST_SEGMENT.duration + 1), Refused.CONTRADICTION),
        (replace(SECOND_SEGMENT, position=5001), Refused.CONTRADICTION),
        (replace(SECOND_SEGMENT, velocity=60_001), Refused.CONTRADICTION),
        (replace(SECOND_SEGMENT, begin=SECOND_SEGMENT.begin + 1), Refused.CONTRADICTION),
        (replace(SECOND_SEGMENT, end_position=0), None),  # what comes after is not known
        (replace(SECOND_SEGMENT, index=31), None),
        (replace(SECOND_SEGMENT, index=32), Refused.INDEX),
        (replace(SECOND_SEGMENT, index=65534), Refused.INDEX),
        (replace(FIRST_SEGMENT, begin=START_CLOCK - 2_000_000, duration=2_000_000), Refused.TIME),
        (replace(SECOND_SEGMENT, begin=0), Refused.TIME),
        (replace(SECOND_SEGMENT, index=9, begin=START_CLOCK + 120_000_000), None),
        (replace(SECOND_SEGMENT, index=9, begin=START_CLOCK + 120_000_001), Refused.TIME),
        (replace(SECOND_SEGMENT, index=9, begin=(1 << 64) - 60_000_001), Refused.TIME),
        (replace(FIRST_SEGMENT, path=6), None),
        (replace(FIRST_SEGMENT, path=5 + 32767), None),
        (replace(FIRST_SEGMENT, path=5 + 32768), Refused.PATH),
        (replace(FIRST_SEGMENT, path=4), Refused.PATH),
        (replace(FIRST_SEGMENT, path=6, index=32), Refused.INDEX),
    ],
)  # fmt: skip
def test_a_segment_is_kept_or_refused_for_a_reason(segment, why):
    """The link keeps the first segment of path 5, and no command has come."""
    paths = follower(FIRST_SEGMENT)
    report = paths.report
    assert paths.store(segment, START_CLOCK) is why
    if why:
        assert paths.report == report
    joint = Joint(paths).until(
        START_CLOCK + 3_000_000, replace(ORDER, flags=LinkCommandFlag.ARM, set_point=9)
    )
    assert joint.position == 0.0


@pytest.mark.parametrize(
    ("segment", "why"),
    [
        (replace(FIRST_SEGMENT, begin=START_CLOCK, duration=5_000_000), Refused.INDEX),  # is over
        (SECOND_SEGMENT, None),
        (replace(SECOND_SEGMENT, index=32, begin=START_CLOCK + 9_000_000), None),
        (replace(SECOND_SEGMENT, index=33, begin=START_CLOCK + 9_000_000), Refused.INDEX),
        (replace(THIRD_SEGMENT, index=3, flags=0), Refused.CONTRADICTION),  # after the last
        (replace(FIRST_SEGMENT, path=4, begin=START_CLOCK + 9_000_000), Refused.PATH),
        (replace(FIRST_SEGMENT, path=6, begin=START_CLOCK + 9_000_000), None),
    ],
)
def test_what_fits_a_path_that_is_followed(segment, why):
    last = THIRD_SEGMENT if segment.index == 3 else replace(THIRD_SEGMENT, flags=0)
    joint = following(FIRST_SEGMENT, SECOND_SEGMENT, last, at=START_CLOCK + 2_500_000)
    assert joint.follower.store(segment, joint.clock) is why
    joint.until(START_CLOCK + 2_900_000)
    assert joint.follower.following


def test_a_last_segment_cannot_come_before_one_that_is_held():
    paths = follower(FIRST_SEGMENT, SECOND_SEGMENT)
    assert (
        paths.store(replace(FIRST_SEGMENT, flags=LAST_SEGMENT, end_velocity=0), START_CLOCK)
        is Refused.CONTRADICTION
    )


def test_segments_alone_move_nothing_and_a_command_without_them_holds():
    paths = PathFollower()
    joint = Joint(paths).until(START_CLOCK + 500_000)
    assert joint.told is None
    for segment in reversed(path()):
        assert paths.store(segment, joint.clock) is None
    joint.until(START_CLOCK + 900_000)
    assert (joint.told, joint.position, paths.following) == (None, 0.0, False)
    joint.until(START_CLOCK + 1_500_000)
    assert paths.following


def test_a_joint_follows_from_the_first_knot_to_the_last():
    joint = Joint(follower(*path()), position=30.0)
    spline = CubicHermiteSpline(
        [k[0] for k in KNOTS], [k[1] for k in KNOTS], [1e-7 * k[2] for k in KNOTS]
    )
    for t in range(0, 3_000_000, STEP):
        joint.until(START_CLOCK + 1_000_000 + t)
        assert joint.position == pytest.approx(float(spline(t)), abs=150.0)
    assert joint.follower.following
    joint.until(START_CLOCK + 6_000_000)
    assert not joint.follower.following
    assert not joint.follower.broken
    assert joint.follower.followed == 5
    assert joint.position == pytest.approx(0.0, abs=1.0)


def test_a_disturbed_joint_returns_to_its_path_within_the_most_velocity():
    joint = following()
    joint.position += 9000.0
    joint.until(START_CLOCK + 3_900_000)
    assert joint.follower.following
    assert joint.fastest_turn <= FASTEST
    assert abs(joint.position - 0.0) < 2000.0


@pytest.mark.parametrize(
    ("change", "clock"),
    [
        (lambda joint: setattr(joint, "position", joint.position + 11_000.0), 0),  # too far off
        (lambda joint: setattr(joint, "position", -11_000.0), 0),
        (lambda joint: None, 1_600_000),  # the third segment has not come
    ],
)
def test_a_path_breaks_off_for_good(change, clock):
    joint = following(FIRST_SEGMENT, SECOND_SEGMENT)
    change(joint)
    joint.until(joint.clock + clock + 2 * STEP)
    paths = joint.follower
    assert (joint.told, paths.following, paths.broken) == (None, False, True)
    for segment in path():
        assert paths.store(segment, joint.clock) in (Refused.PATH, Refused.TIME)
    where = joint.position
    joint.until(joint.clock + 200_000)
    assert (joint.position, paths.broken, paths.report) == (where, True, 0)
    begin = joint.clock + 100_000
    for segment in path(6, begin, [(t, p + round(where), v) for t, p, v in KNOTS]):
        assert paths.store(segment, joint.clock) is None
    joint.until(begin + 200_000, replace(ORDER, set_point=6))
    assert (paths.following, paths.broken) == (True, False)


def test_a_late_command_joins_a_path_that_has_begun():
    paths = follower(*path())
    joint = Joint(paths, clock=START_CLOCK + 2_200_000, position=5500.0).until(
        START_CLOCK + 3_000_000
    )
    assert paths.following
    assert joint.position == pytest.approx(9000.0, abs=100.0)


def test_the_next_path_takes_over_when_it_begins():
    joint = following()
    there = START_CLOCK + 2_000_000
    then = [(0, 5000, 60_000), (1_000_000, 8000, 0), (2_000_000, 8000, 0)]
    for segment in path(6, there, then):
        assert joint.follower.store(segment, joint.clock) is None
    assert joint.follower.report == 6 << 16 | 2
    order = replace(ORDER, set_point=6)
    joint.until(there - STEP, order)
    assert joint.follower.followed == 5
    joint.until(there + 3_000_000, order)
    assert joint.follower.followed == 6
    assert joint.position == pytest.approx(8000.0, abs=1.0)


def test_until_the_next_path_has_come_the_joint_goes_on():
    joint, order = following(), replace(ORDER, set_point=6)
    joint.until(START_CLOCK + 1_800_000, order)
    assert joint.follower.followed == 5
    for segment in path(6, START_CLOCK + 2_000_000, [(0, 5000, 60_000), (1_000_000, 8000, 0)]):
        assert joint.follower.store(segment, joint.clock) is None
    joint.until(START_CLOCK + 2_500_000, order)
    assert joint.follower.followed == 6
    joint.until(joint.clock + 100_000, replace(ORDER, set_point=4))  # long over
    assert (joint.told, joint.follower.report) == (None, 0)


def test_another_order_ends_the_followed_path_and_keeps_the_next():
    joint = following()
    for segment in path(6, START_CLOCK + 9_000_000):
        joint.follower.store(segment, joint.clock)
    joint.follower.abandon()
    assert joint.follower.followed == 0
    assert joint.follower.report >> 16 == 6
    assert joint.until(joint.clock + 100_000).told is None


def test_the_report_counts_what_came_without_a_gap():
    paths = follower(FIRST_SEGMENT)
    assert paths.report == 5 << 16 | 1
    assert paths.store(THIRD_SEGMENT, START_CLOCK) is None
    assert paths.report == 5 << 16 | 1
    assert paths.store(SECOND_SEGMENT, START_CLOCK) is None
    assert paths.report == 5 << 16 | 3
    assert follower(*path(0x8000)).report == (0x8000 << 16 | 3) - (1 << 32)


# --- the computer's side ---

SCALE = Scale(paper_arm().links[0])
TIMES = [0.0, 2.0, 4.0, 6.0, 8.0, 10.0]
POSITIONS = [0.0, 0.4, -0.3, 0.5, 0.2, 0.0]
VELOCITIES = [0.0, -0.1, 0.05, 0.1, -0.1, 0.0]


@pytest.mark.parametrize(
    ("time", "position", "velocity", "words"),
    [
        ([0.0], [0.0], [0.0], "have 1, 1 and 1 values, expected as many of each, 2 to 65536"),
        ([0.0, 1.0], [0.0, 0.1], [0.0], "have 2, 2 and 1 values"),
        ([0.1, 1.0], [0.0, 0.1], [0.0, 0.0], r"time\[0\] is 0.1 s, expected 0"),
        ([0.0, 0.0], [0.0, 0.1], [0.0, 0.0], r"time\[1\] is 0 s after the one before"),
        ([0.0, -1.0], [0.0, 0.1], [0.0, 0.0], r"time\[1\] is -1 s after the one before"),
        ([0.0, 61.0], [0.0, 0.1], [0.0, 0.0], "is 61 s after the one before, expected 0.002 to 59"),
        ([0.0, nan], [0.0, 0.1], [0.0, 0.0], r"time\[1\] is nan, expected a finite number"),
        ([0.0, 1.0], [0.0, inf], [0.0, 0.0], r"position\[1\] is inf"),
        ([0.0, 1.0], [0.0, 0.1], [-inf, 0.0], r"velocity\[0\] is -inf"),
        ([0.0, 1.0], [0.0, 0.1], [0.0, 0.1], "the last velocity is 0.1 rad/s, expected 0"),
        ([0.0, 9.0], [0.0, 1.7], [0.0, 0.0], "position is 1.7 rad between knots 0 and 1, expected"),
        ([0.0, 4.0, 8.0], [1.5, 1.5, 1.5], [0.0, -0.4, 0.0], "between knots 1 and 2|knots 0 and 1"),
        ([0.0, 1.0], [0.0, 0.8], [0.0, 0.0], "velocity is 1.2 rad/s between knots 0 and 1"),
        ([0.0, 1.0], [0.0, 0.5], [1.1, 0.0], "velocity is 1.1 rad/s between knots 0 and 1"),
    ],
)
def test_knots_that_make_no_path_are_named(time, position, velocity, words):
    with pytest.raises(CommandError, match=words):
        knots(SCALE, time, position, velocity)


@given(st.floats(0.1, 20.0), *(st.floats(-1.5, 1.5) for _ in range(2)),
       *(st.floats(-1.0, 1.0) for _ in range(2)))  # fmt: skip
def test_knots_are_refused_just_when_their_cubic_leaves_the_limits(t, q0, q1, qd0, qd1):
    fine = np.linspace(0.0, t, 2001)
    spline = CubicHermiteSpline([0.0, t], [q0, q1], [qd0, qd1])
    link = SCALE.link
    over = max(
        *(spline(fine) - link.q_max),
        *(link.q_min - spline(fine)),
        *(abs(spline(fine, 1)) - link.drive.max_velocity),
    )
    try:
        knots(SCALE, [0.0, t, t + 50.0], [q0, q1, q1], [qd0, qd1, 0.0])
        refused = ""
    except CommandError as error:
        refused = str(error)
    if "knots 1 and 2" not in refused and abs(over) > 1e-5:
        assert bool(refused) == (over > 0.0)


def test_all_links_follow_their_path_and_it_is_reached():
    bed = PathBed().armed()
    begin = bed.now + 2 * SECOND
    bed.give(1, begin, TIMES, 4 * [POSITIONS], 4 * [VELOCITIES])
    assert spread(bed) < 5.0
    bed.follow(1)
    off = []
    while (t := (bed.frame - begin) / SECOND) < 10.0:
        if t >= 0.0:
            wanted = path_at(t, TIMES, POSITIONS, VELOCITIES)
            off += [abs(bed.reading(i) - wanted) for i in range(4)]
        bed.step()
    assert max(off) < 0.003
    bed.until(bed.reached)
    assert all(session.armed and not session.breakage for session in bed.sessions)
    assert not any(bed.electronics(i).gate.refused for i in range(4))


@pytest.mark.parametrize("runs", [1, pytest.param(20, marks=pytest.mark.slow)])
def test_no_knot_is_missed_with_loss_jitter_and_an_outage(runs):
    for seed in range(runs):
        bed = PathBed(n=2, seed=seed)
        bed.fault(loss=0.2, delay=0.03, jitter=0.03)
        bed.armed(settle=10.0)
        begin = bed.now + 2 * SECOND
        bed.give(1, begin, TIMES, 2 * [POSITIONS], 2 * [VELOCITIES])
        bed.follow(1)
        bed.run(2.0 + bed.random.uniform(0.0, 8.0))
        bed.fault(loss=1.0)
        bed.run(1.0)
        bed.fault(loss=0.2)
        while bed.now < begin + 10 * SECOND:
            assert all(bed.electronics(i).paths.followed == 1 for i in range(2)), seed
            bed.step()
        bed.until(bed.reached)


def test_without_buffered_segments_the_path_breaks_off_and_says_so():
    bed = PathBed(n=1).armed()
    time = [0.1 * k for k in range(100)]
    bed.give(3, bed.now + SECOND, time, [[0.002 * k for k in range(100)]], [[*(99 * [0.02]), 0.0]])
    bed.follow(3, lives=8.0)
    bed.run(2.0)
    bed.sessions[0].segments = lambda now: []  # none is sent any longer
    bed.until(lambda: bed.electronics().paths.broken)
    bed.orders.clear()
    bed.until(lambda: bed.sessions[0].breakage)
    assert "path 3 of link 1 was aborted: no segment after" in bed.sessions[0].breakage
    assert bed.sessions[0].progress.status is Status.ABORTED
    with pytest.raises(CommandError, match="path 3 has ended, expected one newer than 3"):
        bed.order_path(0, 3)
    bed.run(1.0)
    assert abs(bed.bed.plant.qd[3]) < 1e-3


def test_a_dense_path_is_sent_as_the_link_has_room():
    bed = PathBed(n=1).armed()
    time = [0.1 * k for k in range(101)]
    velocities = [*(100 * [0.005]), 0.0]
    bed.give(1, bed.now + SECOND, time, [[0.0005 * k for k in range(101)]], [velocities])
    bed.follow(1)
    bed.run(12.0)
    assert bed.sessions[0].progress.status is Status.REACHED
    assert not bed.electronics().gate.refused
    assert bed.sessions[0].counts["segments"] < 450


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"number": 0}, "path is 0, expected 1 to 65535"),
        ({"number": 3}, "path 3 is older than path 4"),
        ({"number": 4, "time": [0.0, 2.5]}, "path 4 was given before with other knots"),
        ({"number": 4, "begin": 2}, "path 4 was given before with other knots"),
        ({"begin": 121}, "path 5 starts 121.0 s ahead, at most 120 s allowed"),
        ({"begin": -9}, "path 5 ended 7.000 s ago"),
    ],
)
def test_paths_that_cannot_be_followed_are_refused(change, words):
    bed = PathBed(n=1).armed()
    session, given = bed.sessions[0], {"number": 5, "begin": 1, "time": [0.0, 2.0]}
    for _ in range(2):  # again changes nothing
        given_path(bed, **(given | {"number": 4}))
    with pytest.raises(CommandError, match=words):
        given_path(bed, **(given | change))
    assert session.counts["commands_refused"] == 1


def given_path(bed, number, begin, time):
    knots = time, [0.0, 0.1], [0.0, 0.0]
    bed.sessions[0].give_path(number, bed.now + begin * SECOND, *knots, bed.now)


def test_a_path_needs_an_armed_link():
    bed = PathBed(n=1)
    bed.run(2.0)
    with pytest.raises(CommandError, match="link 1 is disarmed; to arm it"):
        given_path(bed, 1, 1, [0.0, 2.0])


@pytest.mark.parametrize("end", ["stop", "disarm", "expire", "velocity"])
def test_whatever_ends_a_path_leaves_none_to_go_on_with(end):
    bed = PathBed(n=1).armed()
    bed.give(1, bed.now + SECOND, TIMES, [POSITIONS], [VELOCITIES])
    bed.follow(1, lives=0.5)
    bed.run(3.0)
    assert bed.flags() & State.FOLLOWING
    bed.orders.clear()
    session = bed.sessions[0]
    if end == "velocity":
        session.set(Mode.VELOCITY, 0.0, 0.0, 0.0, bed.now + SECOND, bed.now)
    elif end != "expire":
        getattr(session, end)()
    bed.run(2.0)
    assert not bed.flags() & (State.FOLLOWING | State.BROKEN)
    assert bed.electronics().paths.report == 0
    assert not session.segments(bed.now)
    where = bed.reading(0)
    if not session.armed:
        bed.armed(settle=0.5)
    bed.run(1.0)
    assert bed.reading(0) == pytest.approx(where, abs=1e-3)


def test_frames_of_another_version_are_counted_and_named():
    bed = PathBed(n=1)
    data = bytearray(bed.electronics().telemetry(10_000_000, bed.bed._motions[0]))
    for version, what in ((1, "flash its firmware"), (3, "update this computer's software")):
        data[2] = version
        assert bed.sessions[0].feed(bytes(data), bed.now) is None
        words = f"link 1 uses version {version} of the protocol, expected 2: {what}"
        assert bed.sessions[0].obstacle(bed.now) == words
        assert bed.sessions[0].loss_reason == words
    assert bed.sessions[0].counts["version"] == 2
    bed.run(1.0)
    assert not bed.sessions[0].obstacle(bed.now)
