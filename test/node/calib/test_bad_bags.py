"""Bags that something is wrong with: each ends in a named error or in a verdict that says it."""

import re
from dataclasses import replace

import numpy as np
import pytest
from calib_float import ARM, Float, postures
from calib_kinds import PRECISE
from calib_rig import Sample, at, feed, record, resting
from geometry_msgs.msg import PoseStamped
from rclpy.serialization import serialize_message

from fss_arm_bags.reader import BagError
from fss_arm_calib.acceptance import FAIL, NOT_EVALUATED, PASS
from fss_arm_calib.dynamic.kind import DYNAMIC
from fss_arm_calib.experiment.design_command import main as design
from fss_arm_calib.from_bag import main as from_bag
from fss_arm_calib.from_bag import solve_bag
from fss_arm_calib.kinematic.kind import KINEMATIC
from fss_arm_model.description_file import save
from fss_arm_ros.convert import SECOND


def rig(vector=None):
    return Float(postures(10, seed=3), vector, noise=(0.0005, 0.001))


@pytest.fixture(scope="module")
def rests():
    """Eight rests that nothing is wrong with."""
    return resting()


@pytest.fixture(scope="module")
def maneuvers():
    """Ten maneuvers that nothing is wrong with."""
    return rig().samples(rate=20)


def solve(bag, arm=ARM, **settings):
    save(arm, bag.parent / "arm.yaml")
    settings = KINEMATIC.settings(arm=str(bag.parent / "arm.yaml"), **settings)
    return solve_bag(KINEMATIC, bag, settings)


def test_a_clock_set_back_is_seen_in_the_order_of_receipt(tmp_path, rests):
    """By 12 s, at 25 s: what comes after may hide a rest."""
    samples, late = [], {}
    for s in rests:
        back = 12 * SECOND * (s.stream == 2 and s.t > at(25.0))
        samples.append(s._replace(t=s.t - back))
        late[id(samples[-1])] = back
    result = solve(record(tmp_path / "bag", samples, lambda s: late[id(s)]))
    assert result.verdict == NOT_EVALUATED
    assert re.search(r"clock of joint_2 jumped back by 1[12]", result.reason)


def test_of_a_spoilt_bag_whole_chunks_are_used(tmp_path, rests):
    """Zeros amid it, then an end that is missing."""
    bag = record(tmp_path / "bag", rests)
    file = bag / "bag_0.mcap"
    data = file.read_bytes()
    begin = int(0.34 * len(data))
    file.write_bytes(data[:begin] + bytes(4096) + data[begin + 4096 :])
    source = solve(bag).provenance.source
    assert re.search(r"^bag_0 \w{64} \(\d+ messages recovered, [1-9]\d* bytes lost\)$", source)
    file.write_bytes(data[: int(0.9 * len(data))])
    (bag / "metadata.yaml").unlink()
    result = solve(bag)
    assert (result.verdict, result.accepted) == (PASS, 7), result.reason
    assert "messages recovered" in result.provenance.source


def test_a_misspelt_topic_is_named_with_the_right_one(tmp_path, rests):
    bag = record(tmp_path / "bag", rests[:50])
    with pytest.raises(BagError) as error:
        solve(bag, base_topic="vicon/fs/fss")
    words = "is it /vicon/fss/fss? Then add --base-topic /vicon/fss/fss"
    assert str(error.value) == f"no /vicon/fs/fss in {bag}; {words}"


def test_what_is_said_of_a_namespace_leads_to_a_pass(tmp_path, capsys, rests):
    """The arm is of a vehicle `lab`, but motion capture has the usual names."""
    moved = record(tmp_path, rests, renamed=lambda s: s.replace("joint_s", "lab/joint_s"))
    given = [str(moved)]
    for _ in range(4):
        if not (code := from_bag(given)):
            break
        options = re.findall(r"--[a-z-]+ [\w/]+", capsys.readouterr().err)
        assert options
        given += options[0].split()
    assert code == 0
    assert len(given) == 7  # three options


@pytest.mark.parametrize(
    ("links", "words"),
    [(5, "nothing received from joint_5"), (3, "received joint_4, but 'paper' has 3 joints")],
)
def test_an_arm_of_other_joints_is_named(tmp_path, rests, links, words):
    arm = replace(ARM, links=(ARM.links * 2)[:links])
    result = solve(record(tmp_path / "bag", rests), arm=arm)
    assert result.verdict == NOT_EVALUATED
    cause = f"the data have 4 joints, description 'paper' has {links}: give the arm's"
    assert result.reason.startswith(cause)
    assert words in result.reason


def calibrated(samples):
    """What is found in samples of maneuvers."""
    settings = DYNAMIC.settings(**PRECISE)
    finder = DYNAMIC.finder(ARM, settings, [])
    found = feed(finder, samples)
    return DYNAMIC.calibrate(found, ARM, settings, finder.streams(), "live")


def test_another_arm_of_nearly_the_same_lengths_is_named_by_its_end_effector():
    """Motion alone fits: half an inch more of each link hides in the centres of mass."""
    lengths, angles = ([k.a + 0.0127 for k in ARM.links], [k.theta_0 for k in ARM.links[1:]])
    longer = ARM.with_kinematics([*lengths, *angles, *ARM.base.mount])
    samples = rig(longer.vector()).samples(rate=20, tip=True)
    assert calibrated([s for s in samples if s.stream != "tip"]).verdict == PASS
    result = calibrated(samples)
    assert result.verdict == FAIL
    assert re.search(r"^another arm's data, .*end effector 0\.0\d+ m from", result.reason)


@pytest.mark.slow
def test_poses_of_the_end_effector_under_the_base_s_name_are_named(maneuvers):
    seen = [s for s in maneuvers if s.stream == "base"]
    t, poses = [(s.t - at(0.0)) / SECOND for s in seen], np.array([s.value for s in seen])
    tips = iter(rig().tip(t, poses).tolist())
    result = calibrated(
        [s._replace(value=tuple(next(tips))) if s.stream == "base" else s for s in maneuvers]
    )
    assert result.verdict == FAIL
    assert "the poses of the base are those of the end effector" in result.reason


def test_maneuvers_that_a_person_moved_are_left_out(tmp_path, maneuvers):
    """Link 2 is armed after the first."""
    told = [Sample(at(t), "link_2", (t > 0.0, 3, 1)) for t in (0.0, 12.0)]
    some = sorted([*told, *(s for s in maneuvers if s.t < at(34.0))], key=lambda s: s.t)
    found = solve_bag(DYNAMIC, record(tmp_path / "bag", some)).data
    assert [m.reason for m in found] == ["joint_2 moved while disarmed", ""]


@pytest.mark.parametrize(
    ("gap", "why"), [(True, ": fss silent for 2.00 s"), (False, ", it has none")]
)
def test_design_says_that_no_maneuver_can_be_used(tmp_path, capsys, maneuvers, gap, why):
    """The base lost from the first look on, or a bag that ends before the arm moves."""
    end = at(20.0) if gap else at(4.0)
    lost = at(2.0) if gap else end
    some = [s for s in maneuvers if s.t < end and (s.stream != "base" or s.t <= lost)]
    bag = record(tmp_path / "bags", some)
    assert design(["--bag", str(bag), "--count", "1"]) == 1
    assert capsys.readouterr().err == f"design: no maneuver of {bag} can be used{why}\n"


def test_what_is_no_pose_is_named(tmp_path, capsys, monkeypatch, rests):
    def cut(content):
        return serialize_message(content)[: 28 if isinstance(content, PoseStamped) else None]

    monkeypatch.setattr("calib_rig.serialize_message", cut)
    assert from_bag([str(record(tmp_path, rests[:50]))]) == 1
    assert "28 bytes is not a geometry_msgs/PoseStamped" in capsys.readouterr().err


def test_the_result_is_the_same_whatever_is_read_at_once(tmp_path, rests):
    bag = record(tmp_path / "bag", rests)
    once, bits = solve(bag, horizon=1e4), solve(bag, horizon=20.0)
    assert once.verdict == PASS
    assert once.accepted == 8
    assert not once.streams.rejected
    assert re.search(r"^bag_0 [0-9a-f]{64}$", once.provenance.source)
    assert np.array_equal(once.values, bits.values)
    assert once.provenance.data_hash == bits.provenance.data_hash
