"""The finder on synthetic streams: any interleaving, gaps, occlusions, repeats, motion."""

from dataclasses import replace

import numpy as np
import pytest
from calib_rig import ARM, COUNT, POSTURES, START, Rig, at, feed, frozen, without

from fss_arm_calib.experiment.postures import DEFAULT_POSTURES
from fss_arm_calib.segments.rests import (
    BASE,
    TIP,
    Observation,
    RestFinder,
    rejected_without_repeat,
)
from fss_arm_calib.segments.settings import RestSettings
from fss_arm_calib.segments.streams import keep_newest
from fss_arm_calib.segments.telemetry import keep_since_homing, rehomed_joints
from fss_arm_model.kinematics import tip_in_base
from fss_arm_ros.convert import SECOND

NAMES = {i: f"joint_{i}" for i in range(1, 5)}


def find(samples, close=True, finder=None, **known):
    return feed(finder or RestFinder(4, RestSettings(**known)), samples, close)


def postures_of(found):
    return np.array([o.q for o in found if o.used])


@pytest.mark.parametrize("lag", [0, 1, 5_000_000])
def test_each_rest_becomes_one_observation(lag):
    """Subjects have stamps of their own, and the base drifts: unpaired poses are 25 um off."""
    found = find(Rig().samples(lag))
    assert len(found) == 3
    assert np.abs(postures_of(found) - POSTURES).max() <= COUNT / 2
    for observation, posture in zip(found, POSTURES, strict=True):
        assert observation.used
        assert observation.end - observation.start == 2 * SECOND
        assert observation.joint_samples >= 10
        assert observation.vicon_frames in (200, 201)
        assert observation.tip == pytest.approx(tip_in_base(ARM.vector(), posture), abs=1e-9)


def test_headings_across_the_cut_are_averaged_on_the_circle():
    posture = np.array([[np.pi - ARM.vector()[6], 0.0, 0.0, 0.0]])
    (observation,) = find(Rig(posture, noise=0.03).samples())
    truth = tip_in_base(ARM.vector(), posture[0])[2]
    assert abs(np.angle(np.exp(1j * (observation.tip[2] - truth)))) < 0.01
    assert observation.scatter[2] == pytest.approx(0.03, rel=0.2)


def test_an_observation_knows_how_often_its_links_were_homed():
    finder = RestFinder(4)
    finder.add_telemetry(2, at(0.5), True, 7, 0)  # not told yet
    finder.add_telemetry(2, at(1.0), True, 7, 1)
    finder.add_telemetry(2, at(5.0), True, 7, 2)
    finder.add_telemetry(2, at(4.0), True, 7, 3)  # late: the newer one stands
    finder.add_telemetry(2, at(11.0), True, 8, 1)
    finder.add_telemetry(5, at(0.0), True, 7, 1)  # another arm's
    found = find(Rig().samples(), finder=finder)
    assert [o.boots for o in found] == [(0, 7, 0, 0), (0, 7, 0, 0), (0, 8, 0, 0)]
    assert [o.homings for o in found] == [(0, 1, 0, 0), (0, 2, 0, 0), (0, 1, 0, 0)]
    assert [rehomed_joints(o, finder.streams()) for o in found] == [[2], [2], []]
    assert keep_since_homing(found) == found[2:]
    assert [replace(o, boots=(), homings=()) for o in found] == [
        replace(o, boots=(), homings=()) for o in find(Rig().samples())
    ]


def test_a_short_rest_is_averaged_over_what_there_is_but_a_passing_stop_is_none():
    found = find(Rig(rest=1.6).samples())
    assert len(found) == 3
    assert all(0.5 * SECOND <= o.end - o.start < 2 * SECOND for o in found[:2])
    assert np.abs(postures_of(found) - POSTURES).max() <= COUNT / 2
    assert len(find(Rig(rest=0.8).samples())) <= 1  # the last one rests on to the end of the data


def test_slow_motion_is_no_rest():
    """A joint creeping at 0.003 rad/s stays within the tolerance for a third of a second only."""
    samples = [
        s._replace(value=s.value + 0.003 * (s.t - START) / SECOND) if s.stream == 3 else s
        for s in Rig(POSTURES[:1], rest=20.0).samples()
    ]
    assert find(samples) == []


@pytest.mark.parametrize("streams", [(TIP,), (BASE, TIP), (2,)])
@pytest.mark.parametrize(("begin", "end"), [(12.7, 14.2), (4.2, 5.8)])
def test_a_gap_in_motion_or_that_leaves_enough_of_a_rest_does_no_harm(streams, begin, end):
    """Posture 2 rests from 12 to 18 s, after a motion from 10 s on."""
    found = find(without(Rig().samples(), streams, begin, end))
    assert [o.used for o in found] == [True] * 3
    assert end < 12.0 or found[2].start >= at(14.19 if TIP in streams else 12.5)


@pytest.mark.parametrize("streams", [(TIP,), (BASE,), (2,), (1, 2, 3, 4)])
def test_a_rest_that_vicon_missed_or_a_silent_joint_cut_off_is_reported(streams):
    """Posture 1 rests from 6 to 10 s; at the end it is observed again, and nothing is lost."""
    begin, end = (6.9, 11.0) if 2 in streams else (5.0, 10.5)
    rig = Rig(np.array([*POSTURES, POSTURES[1] + 0.01]))
    found = find(without(rig.samples(), streams, begin, end))
    assert [o.used for o in found] == [True, False, True, True]
    assert "silent for" in found[1].reason
    assert any(NAMES.get(name, name) in found[1].reason for name in streams)
    assert np.abs(np.array(found[1].q) - POSTURES[1]).max() <= 1e-3
    assert np.isnan(found[1].tip).all()
    assert rejected_without_repeat(found[:3], 0.02) == [found[1]]
    assert rejected_without_repeat(found, np.radians(1.0)) == []
    assert len(rejected_without_repeat(found, np.radians(0.1))) == 1


def test_streams_that_begin_late_or_end_early():
    samples = Rig().samples()
    late = [s for s in samples if s.stream != TIP or s.t > at(7.5)]
    assert [o.used for o in find(late)] == [True, True]
    early = [s for s in samples if s.stream != TIP or s.t < at(8.0)]
    assert [o.used for o in find(early)] == [True, True, False]
    assert find(early, close=False) == find(early)[:1]
    assert find([s for s in samples if s.stream != TIP]) == []


def test_closing_takes_the_last_rest_once():
    samples = Rig().samples()
    finder = RestFinder(4)
    assert find([s for s in samples if s.t < at(0.9)], finder=finder) == []  # too early
    some = [s for s in samples if at(0.9) <= s.t < at(13.4)]
    found = find(some, close=False, finder=finder)
    assert len(found) == 2
    (last,) = finder.close()
    assert last.used
    assert 0.5 * SECOND <= last.end - last.start <= 1.0 * SECOND
    assert finder.close() == []
    assert find([s for s in samples if s.t >= at(13.4)], finder=finder) == []


class SlippingRig(Rig):
    """A rig whose first joint jumps by `slip` [rad] in the middle of the first rest, and back."""

    def __init__(self, slip, back=np.inf):
        super().__init__(rest=6.0)
        self.slip, self.back = slip, back

    def q(self, t):
        q = super().q(t)
        q[..., 0] += self.slip * ((np.asarray(t) > 3.0) & (np.asarray(t) < self.back))
        return q


def test_a_rest_split_by_a_slip_is_one_observation():
    """Motion capture's lasting errors are the same in both parts."""
    samples = SlippingRig(slip=0.003).samples()
    found = find(samples)
    assert len(found) == 3
    assert found[0].end <= at(3.0)
    dark = without(samples, {BASE}, 0.2, 3.1)
    late = find(dark)
    assert [o.used for o in late] == [False, True, True, True]
    assert at(3.0) < late[1].start < late[1].end <= at(6.1)


def test_a_joint_that_returns_after_a_degree_rests_again():
    assert len(find(SlippingRig(slip=0.03, back=3.4).samples())) == 4
    assert len(find(SlippingRig(slip=0.003, back=3.4).samples())) == 3


def test_after_a_restart_the_present_rest_is_not_observed_again():
    samples = [s for s in Rig().samples() if s.t > at(8.0)]
    resumed = find(samples, finder=RestFinder(4, resting_at=POSTURES[1]))
    assert np.abs(postures_of(resumed) - POSTURES[2:]).max() <= COUNT
    elsewhere = find(samples, finder=RestFinder(4, resting_at=POSTURES[0]))
    assert np.abs(postures_of(elsewhere) - POSTURES[1:]).max() <= COUNT


@pytest.mark.parametrize("lost", [(TIP,), (TIP, BASE)])
def test_rests_of_a_lost_subject_are_told_and_forgotten(lost):
    """Twenty rests, nothing seen from the second on: they are told before anything returns."""
    rig = Rig(np.resize(POSTURES, (20, 4)), rest=3.0)
    finder, found = RestFinder(4, RestSettings(horizon=10.0)), []
    for sample in without(rig.samples(), lost, 4.0, 700.0):
        found += find([sample], close=False, finder=finder)
        assert len(finder.pending) <= 3
        assert all(len(poses.t) < 2200 + 1000 for poses in finder.sensors.subjects.values())
    assert [o.used for o in found] == [True] + [False] * 17
    assert len(finder.sensors.joints[0].t) < 500
    assert all("silent for" in o.reason for o in found[1:])
    assert np.abs(np.array([o.q for o in found]) - rig.postures[:18]).max() <= 1e-3


def test_what_a_lost_subject_leaves_is_the_same_however_streams_lag():
    """Lost just before a rest ends, for longer than what is waited for."""
    samples = Rig(DEFAULT_POSTURES[:9], rest=3.0).samples()
    samples = without(without(samples, {TIP}, 13.05, 31.3), {BASE}, 0.0, 0.4)
    expected = find(samples, horizon=10.0)
    assert 3 <= sum(not o.used for o in expected) <= 5
    for streams in ((TIP,), (BASE, TIP), (1, 2, 3, 4), (2, TIP)):  # nearly as late as waited for
        late = sorted(samples, key=lambda s, of=streams: s.t + 9.5 * SECOND * (s.stream in of))
        assert find(late, horizon=10.0) == expected, streams


def test_a_subject_that_flickers_makes_no_work():
    """Never seen for as long as it takes, it is looked at once for each time that it went."""
    samples = Rig(rest=40.0).samples()
    for begin in np.arange(0.8, 40.0, 1.5):
        samples = without(samples, {TIP}, begin, begin + 0.4)
    finder, looks = RestFinder(4), []
    look = finder.observe
    finder.observe = lambda *rest: looks.append(rest) or look(*rest)
    found = find(samples, finder=finder)
    assert [o.used for o in found] == [True] * 3
    assert SECOND < found[0].end - found[0].start < 1.2 * SECOND
    assert len(looks) < 40


def test_the_newest_are_kept_whatever_was_spoiled_since():
    def rests(words):
        return [Observation(k, k, (), used=word == "u") for k, word in enumerate(words)]

    def kept(words, most):
        return "".join("u" if o.used else "-" for o in keep_newest(rests(words), most))

    assert kept("-u-u", 3) == "-u-u"
    assert kept("u-uu-uuu", 3) == "uuu"
    assert kept("uu-u-u-", 3) == "u-u-u-"
    assert kept("uuu" + 10 * "-", 3) == "uuu---"
    assert kept(10 * "-", 3) == "---"


def jumped(sample, x=1.0, heading=0.0):
    a, b, c = sample.value
    return sample._replace(value=(a + x, b, c + heading))


@pytest.mark.parametrize("off", [{"x": 0.5}, {"x": 0.0, "heading": np.pi}])
def test_poses_that_jump_are_refused_and_counted(off):
    """Every hundredth pose of either subject is elsewhere, or the other way round."""
    samples = Rig().samples()
    subjects = [k for k, s in enumerate(samples) if isinstance(s.stream, str)]
    for k in subjects[50::100]:
        samples[k] = jumped(samples[k], **off)
    finder = RestFinder(4)
    found = find(samples, finder=finder)
    assert np.abs(postures_of(found) - POSTURES).max() <= COUNT / 2
    for observation, posture in zip(found, POSTURES, strict=True):
        assert observation.tip == pytest.approx(tip_in_base(ARM.vector(), posture), abs=1e-9)
    rejected = finder.streams().rejected
    assert sum(rejected.values()) == len(subjects[50::100])
    assert all(kind.endswith(" jump") for kind in rejected)


def test_a_subject_that_is_elsewhere_for_long_spoils_the_rest():
    """From 7.2 to 9.4 s, amid the rest from 6 to 10 s: no true interval is long enough."""
    samples = [
        jumped(s) if s.stream == TIP and at(7.2) < s.t < at(9.4) else s for s in Rig().samples()
    ]
    finder = RestFinder(4)
    found = find(samples, finder=finder)
    assert finder.streams().rejected["end_effector jump"] > 10
    for observation, posture in zip(found, POSTURES, strict=True):
        near = np.abs(np.subtract(observation.tip, tip_in_base(ARM.vector(), posture))).max() < 0.01
        assert near or not observation.used


def test_a_pose_frozen_since_before_the_last_move_is_refused_and_counted():
    """Frozen from within the first move (4 to 6 s) until the end of the rest from 6 to 10 s."""
    finder = RestFinder(4)
    found = find(frozen(Rig().samples(), TIP, 5.0, 10.1), finder=finder)
    assert [o.used for o in found] == [True, False, True]
    assert f"{TIP} frozen for" in found[1].reason
    assert finder.streams().rejected[f"{TIP} frozen"] > 300
