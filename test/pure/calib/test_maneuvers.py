"""Maneuvers out of streams: which, what of them, and the same however the streams arrive."""

import dataclasses

import numpy as np
import pytest
from calib_float import ARM, Float, postures, telemetry
from calib_rig import at, feed

from fss_arm_calib.segments.maneuvers import ManeuverFinder
from fss_arm_calib.segments.settings import ManeuverSettings
from fss_arm_model import base_motion, joint_path
from fss_arm_model.kinematics import tip_in_base
from fss_arm_model.planar import wrap
from fss_arm_model.units import SECOND

STATE = np.array([0.1, 0.2, 3.0, 0.2, -0.1, 0.03, 0.001, -0.0005])


@pytest.fixture(scope="module")
def rig():
    return Float(postures(3), state=STATE)


@pytest.fixture(scope="module")
def samples(rig):
    return rig.samples()


@pytest.fixture(scope="module")
def found(samples):
    return feed(ManeuverFinder(4), samples)


def shifted(samples, late):
    """Stamps of joints and gyro late against those of the base's poses."""
    shift = round(late * SECOND)
    return [s if s.stream == "base" else s._replace(t=s.t + shift) for s in samples]


def assert_alike(some, others, shift):
    for one, other in zip(some, others, strict=True):
        assert one.start == other.start + shift
        assert one.q == other.q
        assert np.array(one.marks) == pytest.approx(np.array(other.marks), abs=0.012)
        assert np.array(one.poses) == pytest.approx(np.array(other.poses), abs=0.003)


def test_each_motion_between_rests_is_a_maneuver(rig, found):
    assert len(found) == 3
    for maneuver, begin, end, way in zip(found, rig.begins, rig.ends, rig.ways, strict=True):
        assert maneuver.used
        assert maneuver.moved_joints == (1, 2, 3, 4)
        assert at(begin - 2.3) < maneuver.start < at(begin - 1.4)
        assert at(end + 2.0) < maneuver.end < at(end + 3.0)
        q = np.array([[q[0], q[-1]] for q in maneuver.q]).T
        assert q == pytest.approx(way[[0, -1]], abs=1.4e-5)
        assert len(maneuver.marks) == 8
        assert sum(maneuver.frames) == pytest.approx(400, abs=20)
        assert maneuver.seconds == pytest.approx([0.5] * 8, abs=0.06)


def test_path_and_poses_fit_each_other(rig, found):
    """With the true arm and the state at its start, a maneuver's poses are predicted."""
    for maneuver in found:
        start = (maneuver.start - at(0.0)) / SECOND
        before = rig.base(np.array([start, start + 1e-4, start + 2e-4]))
        marks = np.array([start, *(start + np.array(maneuver.marks))])
        true = rig.base(marks)[1:]
        turns = 2 * np.pi * np.round((np.array(maneuver.poses)[0, 2] - true[0, 2]) / (2 * np.pi))
        seen = np.array(maneuver.poses) - [0.0, 0.0, turns]
        assert seen == pytest.approx(true, abs=2e-5)
        momentum = STATE[3:6] + 21.52 * start * np.array([*STATE[6:], 0.0])
        mark = [0.0, *maneuver.marks]
        law, edges = joint_path.sampled(maneuver.times, maneuver.q, maneuver.qd)
        path = joint_path.path(law, edges, mark)
        poses = base_motion.base_poses(ARM.vector(), path, [*before[0], *momentum, *STATE[6:]])
        assert poses[1:] == pytest.approx(true, abs=3e-4)


def test_solving_amid_a_long_rest_ends_it_once(rig, samples, found):
    """In the rest before the second maneuver, once a full look at it has been told already."""
    finder = ManeuverFinder(4)
    assert feed(finder, [s for s in samples if s.t < at(rig.begins[1])], close=False) == found[:1]
    assert feed(finder, [s for s in samples if s.t >= at(rig.begins[1])]) == found[1:]
    for seconds in (3.0, 4.9):
        finder = ManeuverFinder(4)
        amid = at(rig.ends[0] + seconds)
        early = feed(finder, [s for s in samples if s.t < amid])
        late = feed(finder, [s for s in samples if s.t >= amid])
        assert [m.used for m in early + late] == [True] * 3
        assert [m.q for m in late[1:]] == [m.q for m in found[2:]]


def test_the_gyro_bridges_what_cameras_miss():
    """The base turns by more than half a turn unseen."""
    light = dataclasses.replace(ARM, base=dataclasses.replace(ARM.base, mass=3.0, inertia=0.03))
    sweep = np.array([[[-1.5] * 4, [1.5] * 4]])
    rig = Float(sweep, light.vector())
    hidden = [
        s
        for s in rig.samples()
        if s.stream != "base" or not at(rig.begins[0]) < s.t < at(rig.ends[0])
    ]
    (whole,) = feed(ManeuverFinder(4), rig.samples())
    (bridged,) = feed(ManeuverFinder(4), hidden)
    assert abs(whole.poses[-1][2] - whole.poses[0][2]) > np.pi
    assert np.array(bridged.poses) == pytest.approx(np.array(whole.poses), abs=1e-6)
    (lost,) = feed(ManeuverFinder(4), [s for s in hidden if s.stream != "gyro"])
    assert not lost.used
    assert lost.reason.startswith("fss silent for")
    assert lost.reason.endswith("without a gyro")


@pytest.mark.parametrize(
    ("stream", "gap", "joint_gap", "used", "reason"),
    [
        (2, ("begins", 1, 1.0, "begins", 1, 1.8), 0.5, [1, 0, 1], "joint_2 silent for"),
        # for a look, where `joint_gap` allows for it: nobody knows its reading then
        (2, ("ends", 0, 0.1, "ends", 0, 2.9), 4.0, [0, 1, 1], "joint_2 silent for 2."),
        ("base", ("ends", 1, 0.1, "begins", 2, 0.1), 0.5, [1, 0, 0], "fss silent for"),
    ],
)
def test_a_silent_stream_spoils_a_maneuver(rig, samples, stream, gap, joint_gap, used, reason):
    begin, end = (at(getattr(rig, name)[k] + t) for name, k, t in (gap[:3], gap[3:]))
    heard = [s for s in samples if s.stream != stream or not begin < s.t < end]
    found = feed(ManeuverFinder(4, ManeuverSettings(joint_gap=joint_gap)), heard)
    assert [m.used for m in found] == used
    assert found[used.index(0)].reason.startswith(reason)


def test_a_short_pause_is_part_of_the_motion():
    """To stay where it is takes a move 0.5 s."""
    a, b, c = postures(1)[0]
    (paused,) = feed(ManeuverFinder(4), Float([np.array([a, b, b, b, c])]).samples(20))
    assert paused.q[0][-1] == pytest.approx(c[0], abs=1.4e-5)
    rested = feed(ManeuverFinder(4), Float([np.array([a, b, b, b, b, b, c])], rest=2.0).samples(20))
    assert len(rested) == 2
    assert 0.5 < rested[0].times[0][0] < 0.8  # a shorter rest has shorter looks


def test_a_joint_that_stays_has_one_sample_and_may_be_disarmed():
    """A bump is no maneuver."""
    ways = np.array([[[0.3, -1.0, 0.2, 0.5], [0.3, 1.0, 0.2, 0.5]]])
    heard = telemetry(Float(ways).samples(20), lambda i, t: i == 2)
    (only,) = feed(ManeuverFinder(4), heard)
    assert only.used
    assert only.moved_joints == (2,)
    assert [len(t) for t in only.times] == [1, len(only.times[1]), 1, 1]
    assert only.q[3][0] == pytest.approx(0.5, abs=1.4e-5)
    bump = np.array([[[0.3, 0.0, 0.2, 0.5], [0.3, 0.03, 0.2, 0.5]]])
    assert feed(ManeuverFinder(4), Float(bump).samples(20)) == []


@pytest.mark.parametrize("stream", ["gyro", "tip"])
def test_a_wrong_clock_of_what_may_be_absent_spoils_nothing(rig, stream):
    """Stamps are five minutes ahead, all or from some moment on: as if it had ended then."""
    samples = rig.samples(rate=50, tip=True)
    for end in (at(0.0), at(3.0)):
        finder = ManeuverFinder(4, ManeuverSettings(horizon=20.0))
        ahead = [
            s._replace(t=s.t + 300 * SECOND) if s.stream == stream and s.t >= end else s
            for s in samples
        ]
        found = feed(finder, ahead)
        ended = [s for s in samples if s.stream != stream or s.t < end]
        assert [m.used for m in found] == [True] * 3
        assert found == feed(ManeuverFinder(4, ManeuverSettings(horizon=20.0)), ended)
        assert max(len(finder.sensors.gyro.t), len(finder.sensors.tip.t)) < 2000 + 1000


def test_a_motion_without_end_is_followed_no_longer_than_the_horizon():
    """Ten moves on end, and all the while no more is kept than twice that."""
    way = np.random.default_rng(0).uniform(-1.0, 1.0, (11, 4))
    rig = Float([way])
    finder = ManeuverFinder(4, ManeuverSettings(horizon=8.0))
    assert rig.ends[0] - rig.begins[0] > 16.0
    found = []
    for sample in rig.samples(tip=True):
        found += feed(finder, [sample], close=False)
        assert (
            len(finder.sensors.base.t) < 1700 + 1000
        )  # a look at what may go comes every 1000 samples
        assert len(finder.sensors.joints[0].t) < 250
    (long,) = found + finder.close()
    assert not long.used
    assert long.reason.endswith("(at most 8: see horizon)")
    assert "maneuver takes" in long.reason
    assert long.q == ((),) * 4


def test_what_a_disarmed_joint_does_is_no_maneuver(rig, samples, found):
    """Whether it is disarmed all the while, or in the midst of the motion."""
    amid = at(0.5 * (rig.begins[2] + rig.ends[2]))
    heard = telemetry(
        samples, lambda i, t: (i, t < at(rig.ends[0])) != (3, True) and (i, t > amid) != (2, True)
    )
    seen = feed(ManeuverFinder(4), heard)
    said = "joint_3 moved while disarmed", "", "joint_2 moved while disarmed"
    assert tuple(m.reason for m in seen) == said
    assert [m.used for m in seen] == [False, True, False]
    assert seen[1].q == found[1].q
    # Armed with the first move, disarmed after the last one; links 3 and 4 tell nothing.
    heard = telemetry(samples, lambda i, t: at(rig.begins[0]) < t < at(rig.ends[-1] + 0.2))
    heard = [s for s in heard if s.stream not in ("link_3", "link_4")]
    assert feed(ManeuverFinder(4), heard) == found


def test_a_joint_homed_amid_a_maneuver_spoils_it(rig, samples, found):
    """A start or a count that is told for the first time is none; nor is one told of a rest."""
    amid, rest = at(rig.begins[1] + 0.5), at(rig.begins[2] - 2.5)
    homings = [
        lambda i, t: (7, 1 + (i == 4 and t > amid)),
        lambda i, t: (7 + (i == 4 and t > amid), 1),
    ]
    for reference in homings:
        seen = feed(ManeuverFinder(4), telemetry(samples, reference=reference))
        assert [m.reason for m in seen] == ["", "joint_4 homed or restarted", ""]
    first = telemetry(samples, reference=lambda i, t: (7, int(t > amid)))
    assert feed(ManeuverFinder(4), first) == found
    between = telemetry(samples, reference=lambda i, t: (7, 1 + (t > rest)))
    assert [m.used for m in feed(ManeuverFinder(4), between)] == [True] * 3


@pytest.mark.parametrize("late", [-0.8, 1.5])
def test_an_offset_between_the_clocks_is_allowed_for(samples, found, late):
    finder = ManeuverFinder(4, ManeuverSettings(time_offset=late))
    allowed = feed(finder, shifted(samples, late))
    assert_alike(allowed, found, round(late * SECOND))
    assert allowed[0].time_offset == late


def test_an_offset_between_the_clocks_is_found():
    """From the first maneuver on, by the gyro, whatever the noise; with its deviation."""
    rig, finder = Float(postures(8, seed=3), state=STATE, noise=(0.001, 0.009)), ManeuverFinder(4)
    found = feed(finder, shifted(rig.samples(), -0.3))
    offset = finder.streams().offset
    assert abs(offset.value + 0.3) < 3.0 * offset.deviation < 0.02
    assert found[0].time_offset == 0.0
    assert np.array([m.time_offset for m in found[1:]]) == pytest.approx(-0.3, abs=0.02)


def test_an_offset_that_no_gyro_tells_stays_as_given(samples, found):
    finder = ManeuverFinder(4, ManeuverSettings(time_offset=0.05))
    (*_, last) = feed(finder, [s for s in shifted(samples, 0.05) if s.stream != "gyro"])
    assert last.time_offset == 0.05
    assert np.isnan(finder.streams().offset.value)
    without = feed(ManeuverFinder(4), [s for s in samples if s.stream != "gyro"])
    assert_alike(without, found, 0)  # nor is a gyro needed while the base is seen
    finder = ManeuverFinder(4)  # nor does one that turns the other way
    feed(finder, [s._replace(value=-s.value) if s.stream == "gyro" else s for s in samples])
    assert abs(np.nan_to_num(finder.streams().offset.value)) < 0.05


def test_the_end_effector_is_seen_before_each_maneuver(rig, found):
    seen = feed(ManeuverFinder(4), rig.samples(tip=True))
    for one in seen:
        posture = [readings[0] for readings in one.q]
        # Readings err by half a count each, 1.5 m from the end effector at most.
        x, y, heading = tip_in_base(ARM.vector(), posture)
        assert one.tip == pytest.approx((x, y, wrap(heading)), abs=8e-5)
    assert [dataclasses.replace(one, tip=()) for one in seen] == found


def test_an_end_effector_that_falls_silent_is_not_waited_for_long(rig):
    """Half the horizon: nothing is held up until the end."""
    samples = [s for s in rig.samples(tip=True) if s.stream != "tip" or s.t < at(2.0)]
    finder = ManeuverFinder(4, ManeuverSettings(horizon=20.0))
    first, *_ = feed(finder, samples, close=False)
    assert first.used
    assert not first.tip
