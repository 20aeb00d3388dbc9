"""What streams show by themselves when nothing is found in them, live and from a bag alike."""

import numpy as np
import pytest
from calib_rig import feed, resting

from fss_arm_calib.acceptance import NOT_EVALUATED, PASS
from fss_arm_calib.kinematic.calibrate import calibrate
from fss_arm_calib.kinematic.settings import KinematicSettings
from fss_arm_calib.segments.rests import BASE, TIP, RestFinder
from fss_arm_calib.segments.streams import Streams
from fss_arm_model.description import paper_arm
from fss_arm_model.units import SECOND

JOINTS = "joint_1, joint_2, joint_3, joint_4"


@pytest.fixture(scope="module")
def samples():
    return resting()


def found(samples):
    finder = RestFinder(4, KinematicSettings())
    return calibrate(feed(finder, samples), paper_arm(), streams=finder.streams())


@pytest.mark.parametrize(
    ("by", "words"),
    [
        (-7200 * SECOND, r"7200 s (2 hours) behind"),
        (-1_699_990_000 * SECOND, r"53.9 years (does it count from its start?) behind"),
    ],
)
def test_clocks_far_apart_are_named(samples, by, words):
    late = [s if isinstance(s.stream, str) else s._replace(t=s.t + by) for s in samples]
    outcome = found(late)
    assert outcome.verdict == NOT_EVALUATED
    assert outcome.reasons[0] == f"clock of {JOINTS} is {words} that of fss"


def test_a_subject_on_another_clock_is_not_only_silent(samples):
    late = [s._replace(t=s.t + 500 * SECOND) if s.stream == TIP else s for s in samples]
    outcome = found(late)
    assert outcome.verdict == NOT_EVALUATED
    assert "clock of end_effector is 500 s ahead of that of fss" in outcome.reasons


def test_a_subject_that_fell_silent_is_not_on_another_clock(samples):
    lost = [s for s in samples if s.stream != BASE or s.t < samples[0].t + 9 * SECOND]
    assert not any("clock" in doubt for doubt in found(lost).streams.problems)
    good = found(samples)
    assert good.verdict == PASS
    assert good.streams.problems == ()


def test_joints_read_too_rarely_are_named(samples):
    joints = [s for s in samples if not isinstance(s.stream, str)]
    rare = {id(s) for i in range(1, 5) for s in [s for s in joints if s.stream == i][::10]}
    outcome = found([s for s in samples if isinstance(s.stream, str) or id(s) in rare])
    assert outcome.verdict == NOT_EVALUATED
    assert outcome.reasons[0].startswith(f"{JOINTS} sampled only every 2")
    assert outcome.reasons[0].endswith("s: joint_gap (1 s) is less")


def test_a_joint_that_is_never_still_is_named(samples):
    rng = np.random.default_rng(1)
    noisy = [
        s._replace(value=s.value + 0.01 * rng.standard_normal()) if s.stream == 2 else s
        for s in samples
    ]
    outcome = found(noisy)
    assert outcome.verdict == NOT_EVALUATED
    words = "joint_2 never at rest for 1 s with a motion_threshold of 0.001 rad"
    assert outcome.reasons[0] == words


def test_samples_that_are_rejected_are_counted(samples):
    outcome = found([s._replace(value=np.nan) if s.stream == 3 else s for s in samples])
    assert outcome.verdict == NOT_EVALUATED
    count = sum(s.stream == 3 for s in samples)
    assert f"samples rejected: {count} joint_3 not finite" in outcome.reason


def test_names_heard_are_told_beside_those_that_are_not():
    streams = Streams(silent=("joint_1", "joint_2"), other_names=("q1", "q2"))
    outcome = calibrate([], paper_arm(), streams=streams)
    words = "nothing received from joint_1, joint_2, but from q1, q2: wrong names?"
    assert outcome.reasons[0] == words
