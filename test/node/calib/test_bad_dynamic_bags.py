"""Bags of maneuvers that something is wrong with: a named error, or a verdict that says it."""

import re
from dataclasses import replace
from math import nan

import numpy as np
import pytest
from calib_float import ARM, TYPES, Float, at, postures, record

from fss_arm_bags.reader import BagError
from fss_arm_calib.acceptance import FAIL, NOT_EVALUATED, PASS
from fss_arm_calib.dynamic.kind import DYNAMIC
from fss_arm_calib.dynamic.settings import DynamicSettings
from fss_arm_calib.experiment.design_command import main as design
from fss_arm_calib.from_bag import EXIT_CODES, solve_bag
from fss_arm_calib.from_bag import main as from_bag
from fss_arm_model.description_file import save
from fss_arm_ros.convert import SECOND

PRECISE = {"position_deviation": 0.0005, "heading_deviation": 0.001, "max_relative": 2.0}


def rig(vector=None):
    return Float(postures(10, seed=3), vector, noise=(0.0005, 0.001))


@pytest.fixture(scope="module")
def samples():
    """Ten maneuvers, the base at 20 Hz."""
    return rig().samples(rate=20)


def solved(bag, arm=ARM):
    save(arm, bag.parent / "arm.yaml")
    settings = DynamicSettings(arm=str(bag.parent / "arm.yaml"), **PRECISE)
    return solve_bag(DYNAMIC, bag, settings)


def test_nothing_is_wrong_with_this_one(samples, tmp_path):
    calibration = solved(record(tmp_path / "bags", samples))
    assert calibration.verdict == PASS, calibration.reason
    assert calibration.accepted == 10
    assert not calibration.streams.rejected


@pytest.mark.parametrize(
    ("share", "verdict"), [(0.9, PASS), pytest.param(0.4, NOT_EVALUATED, marks=pytest.mark.slow)]
)
def test_of_a_truncated_bag_whole_chunks_are_used(samples, tmp_path, share, verdict):
    bag = record(tmp_path / "bags", samples)
    (bag / "metadata.yaml").unlink()
    file = bag / "bag_0.mcap"
    file.write_bytes(file.read_bytes()[: int(share * file.stat().st_size)])
    calibration = solved(bag)
    assert calibration.verdict == verdict, calibration.reason
    assert re.search(r"^bag_0 [0-9a-f]{64} \(\d+ messages recovered", calibration.provenance.source)
    assert 3 <= calibration.accepted < 10


def test_a_damaged_chunk_is_left_out_and_said(samples, tmp_path, capsys):
    bag = record(tmp_path / "bags", samples)
    data = bytearray((bag / "bag_0.mcap").read_bytes())
    middle = len(data) // 3
    data[middle : middle + 4096] = bytes(4096)
    (bag / "bag_0.mcap").write_bytes(data)
    assert from_bag(["--dynamic", str(bag)]) in EXIT_CODES.values()
    assert re.search(r"messages\s+recovered, \d+ bytes lost", capsys.readouterr().out)


@pytest.mark.parametrize("missing", ["joint_states", "vicon/fss/fss"])
def test_a_missing_topic_is_named(samples, tmp_path, missing):
    topics = [topic for topic in TYPES if topic != missing]
    bag = record(tmp_path / "bags", samples[:1000], topics)
    with pytest.raises(BagError, match=f"no /{missing} in .*, which has "):
        solved(bag)


@pytest.mark.parametrize(
    ("gap", "why"), [(True, ": fss silent for 2.00 s"), (False, ", it has none")]
)
def test_design_says_that_no_maneuver_can_be_used(samples, tmp_path, capsys, gap, why):
    """The base lost from the first look on, or a bag that ends before the arm moves."""
    end = at(20.0) if gap else at(4.0)
    some = [s for s in samples if s.t < end and not (gap and s.stream == "base" and s.t > at(2.0))]
    bag = record(tmp_path / "bags", some)
    assert design(["--bag", str(bag), "--count", "1"]) == 1
    assert capsys.readouterr().err == f"design: no maneuver of {bag} can be used{why}\n"


@pytest.mark.slow
def test_no_gyro_is_needed(samples, tmp_path):
    calibration = solved(record(tmp_path / "bags", samples, list(TYPES)[:2]))
    assert calibration.verdict == PASS, calibration.reason


@pytest.mark.parametrize(
    ("stream", "name"), [("base", "fss"), (None, "joint_1, joint_2, joint_3, joint_4")]
)
def test_a_topic_without_messages_is_named(samples, tmp_path, stream, name):
    kept = [s for s in samples[:1000] if (s.stream != stream if stream else s.stream == "base")]
    calibration = solved(record(tmp_path / "bags", kept))
    assert calibration.verdict == NOT_EVALUATED
    assert f"nothing received from {name}" in calibration.reason


@pytest.mark.parametrize(
    ("links", "words"),
    [(5, "nothing received from joint_5"), (3, "received joint_4, but 'paper' has 3 joints")],
)
def test_an_arm_of_other_joints_is_named(samples, tmp_path, links, words):
    bag = record(tmp_path / "bags", samples)
    calibration = solved(bag, replace(ARM, links=(ARM.links * 2)[:links]))
    assert calibration.verdict == NOT_EVALUATED
    assert words in calibration.reason


@pytest.mark.slow
@pytest.mark.parametrize("other", ["lengths", "base"])
def test_another_arm_of_as_many_joints_is_named(tmp_path, other):
    """Longer links hide in centres of mass, until these would lie beyond their links."""
    if other == "base":
        arm = replace(ARM, base=replace(ARM.base, mass=16.0, inertia=0.5))
    else:
        arm = ARM.with_kinematics(
            [0.5, 0.5, 0.5, 0.4, *(link.theta_0 for link in ARM.links[1:]), *ARM.base.mount]
        )
    calibration = solved(record(tmp_path / "bags", rig(arm.vector()).samples(rate=20)))
    assert calibration.verdict == FAIL
    assert re.search(r"at the bound of .*: b_1.*; another arm's data, or wrong", calibration.reason)


def test_another_arm_of_nearly_the_same_lengths_is_named_by_its_end_effector(tmp_path):
    """Motion alone fits: half an inch more of each link hides in the centres of mass."""
    angles = (link.theta_0 for link in ARM.links[1:])
    lengths = [link.a + 0.0127 for link in ARM.links]
    arm = ARM.with_kinematics([*lengths, *angles, *ARM.base.mount])
    samples = rig(arm.vector()).samples(rate=20, tip=True)
    unseen = record(tmp_path / "unseen", [s for s in samples if s.stream != "tip"], list(TYPES)[:3])
    assert solved(unseen).verdict == PASS
    calibration = solved(record(tmp_path / "seen", samples))
    assert calibration.verdict == FAIL
    assert re.search(r"^another arm's data, .*end effector 0\.0\d+ m from", calibration.reason)
    assert solved(record(tmp_path / "own", samples), arm).verdict == PASS


@pytest.mark.parametrize(
    "stream",
    [pytest.param(3, marks=pytest.mark.slow), "base", pytest.param("gyro", marks=pytest.mark.slow)],
)
def test_numbers_that_are_none_are_refused(samples, tmp_path, stream):
    """One in ten does no harm; all leave nothing to calibrate from."""
    value = {3: (nan, nan), "base": (nan, 0.0, 0.0), "gyro": nan}[stream]
    some = [s._replace(value=value) if s.stream == stream and k % 10 == 0 else s
            for k, s in enumerate(samples)]  # fmt: skip
    calibration = solved(record(tmp_path / "some", some))
    assert calibration.verdict == PASS, calibration.reason
    every = [s._replace(value=value) if s.stream == stream else s for s in samples]
    calibration = solved(record(tmp_path / "every", every))
    if stream == "gyro":
        assert calibration.verdict == PASS
        return
    why = "fss occluded" if stream == "base" else "joint_3 not finite"
    assert calibration.verdict == NOT_EVALUATED
    assert f"samples rejected: {sum(s.value is value for s in every)} {why}" in calibration.reason


@pytest.mark.parametrize("stream", [pytest.param(2, marks=pytest.mark.slow), "base"])
def test_a_clock_that_runs_back_is_named(samples, tmp_path, stream):
    """By 12 s, at 25 s: what comes after may hide a maneuver."""

    def is_back(sample):
        return sample.stream == stream and at(25.0) < sample.t

    back = [s._replace(t=s.t - 12 * SECOND) if is_back(s) else s for s in samples]
    heard = {id(b): s.t - b.t for s, b in zip(samples, back, strict=True)}
    bag = record(tmp_path / "bags", back, late=lambda sample: heard[id(sample)])
    calibration = solved(bag)
    assert calibration.verdict == NOT_EVALUATED
    assert re.search(r"clock of \w+ jumped back by 1[12]", calibration.reason)


def of_the_tip(samples, rig, begin=0.0, end=np.inf):
    """The end effector under the base's name, for a while."""

    def seen(sample):
        t = (sample.t - at(0.0)) / SECOND
        if sample.stream != "base" or not begin < t < end:
            return sample
        (tip,) = rig.tip([t], np.array([sample.value])).tolist()
        return sample._replace(value=tuple(tip))

    return [seen(sample) for sample in samples]


@pytest.mark.slow
def test_a_swapped_subject_is_named(samples, tmp_path):
    calibration = solved(record(tmp_path / "all", of_the_tip(samples, rig())))
    assert calibration.verdict == FAIL
    assert "the poses of the base are those of the end effector" in calibration.reason

    # in the midst of two maneuvers
    calibration = solved(record(tmp_path / "some", of_the_tip(samples, rig(), 27.0, 39.0)))
    rejected = calibration.streams.rejected
    assert rejected["fss jump"] > 0
    assert calibration.verdict == FAIL
    assert re.search(r"maneuvers? [2-5]\b.* off", calibration.reason)
