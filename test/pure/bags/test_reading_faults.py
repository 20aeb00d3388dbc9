"""Errors of readings are found from the headings, and correct readings are never accused."""

from dataclasses import replace

import numpy as np
import pytest

from fss_arm_bags.doctor.reading_faults import find_reading_errors
from fss_arm_bags.doctor.stream_faults import find_faults
from fss_arm_bags.recorded import Recorded, Track
from fss_arm_model.units import SECOND

NAMES = ["joint_1", "joint_2", "joint_3"]
DURATION, PERIOD = 60.0, 0.05  # [s]
OFFSET = 0.4  # of the headings, of how subjects are defined [rad]


def recording(seed=0):
    """Return good data: rests and moves of all joints, headings with noise of 0.1 degrees."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, DURATION, PERIOD)
    leg = (t / 4.0).astype(int)
    postures = rng.uniform(-1.2, 1.2, (leg[-1] + 2, len(NAMES)))
    part = np.clip((t - 4.0 * leg) / 2.0, 0.0, 1.0)[:, None]
    q = postures[leg] + part * (postures[leg + 1] - postures[leg])
    stamps = np.round(t * SECOND).astype(np.int64) + 1_000_000_000_000
    qd = np.gradient(q, t, axis=0)
    joints = {
        name: Track(stamps, stamps + 5_000_000, np.column_stack([q[:, k], qd[:, k]]))
        for k, name in enumerate(NAMES)
    }
    base = 0.3 * np.sin(0.2 * t)
    poses = {}
    for name, heading in (("fss", base), ("tip", base + q.sum(axis=1) + OFFSET)):
        half = 0.5 * (heading + np.radians(0.1) * rng.standard_normal(len(t)))
        place = rng.standard_normal((len(t), 2))
        none = np.zeros(len(t))
        columns = [*place.T, none, none, none, np.sin(half), np.cos(half)]
        poses[name] = Track(stamps, stamps + 5_000_000, np.column_stack(columns))
    return Recorded(joints, poses)


def with_values(recorded, name, values):
    track = recorded.joints[name]._replace(values=values)
    return replace(recorded, joints={**recorded.joints, name: track})


def found(recorded):
    return list(find_reading_errors(recorded, NAMES, "fss", "tip"))


@pytest.mark.parametrize("seed", range(20))
def test_correct_readings_are_not_accused(seed):
    assert found(recording(seed)) == []
    assert not list(find_faults(recording(seed)))


@pytest.mark.parametrize("ratio", [4.0, 0.5, 1.1, -2.0])
def test_ratio_is_named_and_corrected(ratio):
    good = recording()
    values = good.joints["joint_2"].values
    (error, *_) = found(with_values(good, "joint_2", ratio * values))
    assert error.words == f"joint_2 turns {1 / ratio:.2g} times its reading?"
    corrected = error.corrected.joints["joint_2"].values
    np.testing.assert_allclose(corrected, values, rtol=0.002)  # headings have noise


def test_ratio_of_all_joints_is_one_error():
    wrong = recording().change(joints=lambda _, track: track._replace(values=1.25 * track.values))
    assert found(wrong)[0].words == "all joints turn 0.8 times their readings?"


def test_sign_is_left_to_its_own_test():
    values = recording().joints["joint_3"].values
    assert found(with_values(recording(), "joint_3", -values)) == []


def test_jump_is_offered_for_each_joint_and_corrected():
    good = recording()
    values = good.joints["joint_2"].values.copy()
    values[600:, 0] += 0.3
    errors = found(with_values(good, "joint_2", values))
    words = "reading of {} jumps by 17.2 deg, 30 s after the start?"
    assert [error.words for error in errors] == [words.format(name) for name in NAMES]
    corrected = errors[1].corrected.joints["joint_2"].values
    np.testing.assert_allclose(corrected, good.joints["joint_2"].values, atol=0.001)


def test_samples_without_a_reading_are_left_out():
    good = recording()
    values = 2.0 * good.joints["joint_2"].values
    values[::7] = np.nan
    (error, *_) = found(with_values(good, "joint_2", values))
    assert error.words == "joint_2 turns 0.5 times its reading?"


def test_frozen_reading_is_replaced_by_the_headings():
    good = recording()
    values = good.joints["joint_1"].values.copy()
    values[150:] = values[150, 0], 0.0  # since 120, in a rest
    (error,) = found(with_values(good, "joint_1", values))
    assert error.words == "reading of joint_1 frozen for 54 s?"
    corrected = error.corrected.joints["joint_1"].values[:, 0]
    np.testing.assert_allclose(corrected, good.joints["joint_1"].values[:, 0], atol=0.01)


@pytest.mark.parametrize(
    "lost",
    [
        Recorded({}, {}),
        replace(recording(), poses={"fss": recording().poses["fss"]}),
        recording().change(joints=lambda _, track: track.received_since(2**62)),
        recording().change(poses=lambda _, track: track._replace(t=track.t + 10**15)),
        recording().change(joints=lambda _, track: track._replace(values=np.nan * track.values)),
    ],
)
def test_without_common_data_nothing_is_found(lost):
    assert found(lost) == []


@pytest.mark.parametrize(
    ("rate", "words"),
    [
        (1.02, "clock of the joints runs 2 % fast"),
        (0.99, "clock of the joints runs 1 % slow"),
        (0.001, "clock of the joints runs 0.001 times as fast as that of the receiver"),
    ],
)
def test_clock_of_a_wrong_rate_is_named(rate, words):
    def run(_, track):
        since = rate * (track.t - track.t[0])
        return track._replace(t=track.t[0] + np.round(since).astype(np.int64))

    assert list(find_faults(recording().change(joints=run))) == [words]


def test_heading_that_never_changes_is_named():
    wrong = recording()
    wrong.poses["tip"].values[:, 3:] = 0.0, 0.0, 0.0, 1.0
    assert list(find_faults(wrong)) == ["heading of tip frozen for 60 s while joints moved"]
