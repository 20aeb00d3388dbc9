"""Bags that something is wrong with: each ends in a named error or in a verdict that says it."""

import re
from dataclasses import replace
from math import nan

import numpy as np
import pytest
from calib_rig import ARM, TOPICS, TYPES, Rig, at, record

from fss_arm_bags.reader import BagError
from fss_arm_calib.acceptance import FAIL, NOT_EVALUATED, PASS
from fss_arm_calib.experiment.postures import DEFAULT_POSTURES
from fss_arm_calib.from_bag import main as from_bag
from fss_arm_calib.from_bag import solve_bag
from fss_arm_calib.kinematic.kind import KINEMATIC
from fss_arm_calib.kinematic.problem import OFFSETS
from fss_arm_calib.kinematic.settings import KinematicSettings
from fss_arm_calib.segments.rests import BASE, TIP
from fss_arm_model.description_file import save
from fss_arm_ros.convert import SECOND


@pytest.fixture(scope="module")
def samples():
    """Eight postures, VICON at 25 Hz."""
    return Rig(DEFAULT_POSTURES[:8], rest=3.2, rate=25.0).samples()


def arm_file(folder, arm):
    save(arm, folder / "arm.yaml")
    return KinematicSettings(arm=str(folder / "arm.yaml"))


def with_links(count):
    return type(ARM)(ARM.name, ARM.base, (ARM.links * 2)[:count])


def swapped(sample):
    if not isinstance(sample.stream, str):
        return sample
    return sample._replace(stream=BASE if sample.stream == TIP else TIP)


def test_nothing_is_wrong_with_this_one(samples, tmp_path):
    calibration = solve_bag(KINEMATIC, record(tmp_path, samples))
    assert calibration.verdict == PASS
    assert calibration.provenance.source.startswith("bag_0 ")
    assert len(calibration.provenance.source) == len("bag_0 ") + 64
    assert not calibration.streams.rejected


@pytest.mark.parametrize(("share", "verdict"), [(0.9, PASS), (0.4, NOT_EVALUATED)])
def test_of_a_truncated_bag_whole_chunks_are_used(samples, tmp_path, share, verdict):
    bag = record(tmp_path, samples)
    (bag / "metadata.yaml").unlink()
    file = bag / "bag_0.mcap"
    file.write_bytes(file.read_bytes()[: int(share * file.stat().st_size)])
    calibration = solve_bag(KINEMATIC, bag)
    assert calibration.verdict == verdict
    assert re.search(r"^bag_0 [0-9a-f]{64} \(\d+ messages recovered", calibration.provenance.source)
    assert (calibration.accepted >= 6) == (verdict == PASS)


def test_a_damaged_chunk_is_left_out_and_told(samples, tmp_path):
    bag = record(tmp_path, samples)
    data = bytearray((bag / "bag_0.mcap").read_bytes())
    middle = len(data) // 3
    data[middle : middle + 4096] = bytes(4096)
    (bag / "bag_0.mcap").write_bytes(data)
    source = solve_bag(KINEMATIC, bag).provenance.source
    assert re.search(
        r"^bag_0 [0-9a-f]{64} \(\d+ messages recovered, [1-9]\d* bytes lost\)$", source
    )


@pytest.mark.parametrize("missing", TYPES)
def test_a_missing_topic_is_named(samples, tmp_path, missing):
    bag = record(tmp_path, samples[:1000], [topic for topic in TYPES if topic != missing])
    with pytest.raises(BagError, match=f"no /{missing} in .*, which has "):
        solve_bag(KINEMATIC, bag)


@pytest.mark.parametrize("missing", TYPES)
def test_a_topic_without_messages_is_named(samples, tmp_path, missing):
    kept = [s for s in samples[:1000] if TOPICS.get(s.stream, "joint_states") != missing]
    calibration = solve_bag(KINEMATIC, record(tmp_path, kept))
    assert calibration.verdict == NOT_EVALUATED
    name = {v: k for k, v in TOPICS.items()}.get(missing, "joint_1, joint_2, joint_3, joint_4")
    assert f"nothing received from {name}" in calibration.reason


@pytest.mark.parametrize(
    ("links", "words"),
    [(5, "nothing received from joint_5"), (3, "received joint_4, but 'paper' has 3 joints")],
)
def test_an_arm_of_other_joints_is_named(samples, tmp_path, links, words):
    settings = arm_file(tmp_path, with_links(links))
    calibration = solve_bag(KINEMATIC, record(tmp_path / "bag", samples), settings)
    assert calibration.verdict == NOT_EVALUATED
    assert words in calibration.reason


def test_an_arm_of_other_lengths_is_named(samples, tmp_path):
    """Estimated freely, its lengths fit."""
    links = tuple(replace(link, a=link.a + 0.06) for link in ARM.links)
    calibration = solve_bag(
        KINEMATIC, record(tmp_path / "bag", samples), arm_file(tmp_path, replace(ARM, links=links))
    )
    assert calibration.verdict == FAIL
    assert re.match(r"another arm's data: a_\d is 0.3\d+ m, 0.\d+ m in", calibration.reason)
    assert not any("residuals are larger" in reason for reason in calibration.reasons)


def test_an_arm_of_other_lengths_does_not_fit(samples, tmp_path):
    longer = ARM.with_kinematics([0.45, *ARM.vector()[[14, 20, 26]], 0, 0, 0, 0.2, 0.0, 0.3])
    settings = arm_file(tmp_path, longer)
    settings = KinematicSettings(arm=settings.arm, parametrization=OFFSETS)
    calibration = solve_bag(KINEMATIC, record(tmp_path / "bag", samples), settings)
    assert calibration.verdict == FAIL
    assert "residuals are larger than the assumed deviations allow" in calibration.reason


@pytest.mark.parametrize("stream", [3, BASE])
def test_numbers_that_are_none_are_refused(samples, tmp_path, stream):
    """One in ten does no harm; all leave nothing to calibrate from."""
    value = (nan, 0.0, 0.0) if isinstance(stream, str) else nan
    some = [s._replace(value=value) if s.stream == stream and k % 10 == 0 else s
            for k, s in enumerate(samples)]  # fmt: skip
    why = f"{BASE} occluded" if stream == BASE else "joint_3 not finite"
    harmed = sum(s.value is value for s in some)
    calibration = solve_bag(KINEMATIC, record(tmp_path / "some", some))
    assert calibration.verdict == PASS
    assert calibration.streams.rejected == {why: harmed}
    every = [s._replace(value=value) if s.stream == stream else s for s in samples]
    calibration = solve_bag(KINEMATIC, record(tmp_path / "every", every))
    assert calibration.verdict == NOT_EVALUATED
    assert f"samples rejected: {sum(s.value is value for s in every)} {why}" in calibration.reason


@pytest.mark.parametrize("place", [0, 2000])
def test_a_stamp_of_another_year_is_rejected_by_itself(samples, tmp_path, place):
    """One of each stream, the first or not: the result is the same."""
    year_2038 = {s.stream: s._replace(t=2**31 * SECOND - 1) for s in samples[:500]}
    bad = [*samples[:place], *year_2038.values(), *samples[place:]]
    heard = {id(s): samples[place].t - s.t for s in year_2038.values()}
    bag = record(tmp_path / "bad", bad, late=lambda s: heard.get(id(s), 0))
    calibration = solve_bag(KINEMATIC, bag)
    expected = solve_bag(KINEMATIC, record(tmp_path / "bag", samples))
    assert calibration.verdict == PASS
    assert calibration.values.tolist() == expected.values.tolist()
    rejected = calibration.streams.rejected
    assert len(rejected) == 6
    assert {why.split(" ", 1)[1] for why in rejected} == {"isolated in time"}


@pytest.mark.parametrize("streams", [{2}, {BASE, TIP}])
def test_a_clock_that_runs_back_is_named(samples, tmp_path, streams):
    """By 12 s, at 25 s: what comes after may hide a rest."""

    def is_back(sample):
        return sample.stream in streams and at(25.0) < sample.t

    back = [s._replace(t=s.t - 12 * SECOND) if is_back(s) else s for s in samples]
    heard = {id(b): s.t - b.t for s, b in zip(samples, back, strict=True)}
    calibration = solve_bag(
        KINEMATIC, record(tmp_path, back, late=lambda sample: heard[id(sample)])
    )
    assert calibration.verdict == NOT_EVALUATED
    assert re.search(r"clock of \w+ jumped back by 1[12]", calibration.reason)


def test_swapped_subjects_are_named(samples, tmp_path):
    calibration = solve_bag(KINEMATIC, record(tmp_path / "all", map(swapped, samples)))
    assert calibration.verdict == FAIL
    assert "base and end effector are swapped" in calibration.reason

    # from the fifth posture's approach to the sixth's departure
    some = [swapped(s) if at(20.0) < s.t < at(30.0) else s for s in samples]
    calibration = solve_bag(KINEMATIC, record(tmp_path / "some", some))
    rejected = calibration.streams.rejected
    assert rejected[f"{BASE} jump"] > 0
    assert rejected[f"{TIP} jump"] > 0
    assert calibration.verdict == FAIL
    assert "base and end effector are swapped in observations 5" in calibration.reason


def test_what_is_no_pose_is_named(samples, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("calib_rig.serialize_message", lambda _: b"\0\1\0\0" + bytes(24))
    bag = record(tmp_path, [s for s in samples[:50] if isinstance(s.stream, str)])
    assert from_bag([str(bag)]) == 1
    assert "28 bytes is not a geometry_msgs/PoseStamped" in capsys.readouterr().err


def test_the_result_is_the_same_whatever_is_read_at_once(samples, tmp_path):
    bag = record(tmp_path, samples)
    once = solve_bag(KINEMATIC, bag, KinematicSettings(horizon=1e4))
    bits = solve_bag(KINEMATIC, bag, KinematicSettings(horizon=20.0))
    assert np.array_equal(once.values, bits.values)
    assert once.provenance.data_hash == bits.provenance.data_hash
