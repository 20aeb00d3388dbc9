"""Bags that something is wrong with: each ends in a named error or in a verdict that says it."""

import re
from dataclasses import replace
from math import nan

import calib_float
import calib_rig
import numpy as np
import pytest
from calib_float import Float, postures
from calib_rig import ARM, Rig, at

from fss_arm_bags.reader import BagError
from fss_arm_calib.acceptance import FAIL, NOT_EVALUATED, PASS
from fss_arm_calib.dynamic.kind import DYNAMIC
from fss_arm_calib.experiment.design_command import main as design
from fss_arm_calib.experiment.postures import DEFAULT_POSTURES
from fss_arm_calib.from_bag import main as from_bag
from fss_arm_calib.from_bag import solve_bag
from fss_arm_calib.kinematic.kind import KINEMATIC
from fss_arm_calib.segments.rests import BASE, TIP
from fss_arm_model.description_file import save
from fss_arm_msgs.msg import LinkTelemetry
from fss_arm_ros.convert import SECOND, to_time

PRECISE = {"position_deviation": 0.0005, "heading_deviation": 0.001}


def rig(vector=None):
    return Float(postures(10, seed=3), vector, noise=(0.0005, 0.001))


@pytest.fixture(scope="module")
def rests():
    """Eight rests that nothing is wrong with."""
    return Rig(DEFAULT_POSTURES[:8], rest=3.2, rate=25.0).samples()


@pytest.fixture(scope="module")
def maneuvers():
    """Ten maneuvers that nothing is wrong with."""
    return rig().samples(rate=20)


def solve(bag, kind=KINEMATIC, arm=ARM, **settings):
    save(arm, bag.parent / "arm.yaml")
    return solve_bag(kind, bag, kind.settings(arm=str(bag.parent / "arm.yaml"), **settings))


def without(*streams):
    return lambda samples: [s for s in samples[:1000] if s.stream not in streams]


def with_value(stream, value, every=1):
    """The samples with a value in place of each n-th one, or of all of a stream."""
    return lambda samples: [
        s._replace(value=value) if s.stream == stream and k % every == 0 else s
        for k, s in enumerate(samples)
    ]


def set_back(*streams):
    """By 12 s, at 25 s: what comes after may hide a rest."""
    return lambda samples: [
        s._replace(t=s.t - 12 * SECOND) if s.stream in streams and at(25.0) < s.t else s
        for s in samples
    ]


def swapped(samples):
    """From the fifth posture's approach to the sixth's departure."""
    other = {BASE: TIP, TIP: BASE}
    return [
        s._replace(stream=other.get(s.stream, s.stream)) if at(20.0) < s.t < at(30.0) else s
        for s in samples
    ]


NONE = nan, 0.0, 0.0
BACK = r"clock of \w+ jumped back by 1[12]"


@pytest.mark.parametrize(
    ("change", "verdict", "reason", "rejected"),
    [
        (without(1, 2, 3, 4), NOT_EVALUATED, "nothing received from joint_1, joint_2, joint_", ()),
        (with_value(BASE, NONE, 10), PASS, "", ["fss occluded"]),
        (with_value(3, nan), NOT_EVALUATED, "rejected: {} joint_3 not finite", ()),
        (set_back(2), NOT_EVALUATED, BACK, ()),
        (swapped, FAIL, "base and end effector are swapped in observations 5",
         ["fss jump", "end_effector jump"]),
    ],
)  # fmt: skip
def test_what_is_wrong_with_samples_is_named(tmp_path, rests, change, verdict, reason, rejected):
    """{} is the number of samples changed; they arrive on time, whatever their stamps."""
    samples = change(rests)
    changed = sum(new is not old for new, old in zip(samples, rests, strict=False))
    late = {}
    if len(samples) == len(rests):
        late = {id(new): old.t - new.t for old, new in zip(rests, samples, strict=True)}
    bag = calib_rig.record(tmp_path / "bag", samples, late=lambda s: late.get(id(s), SECOND // 100))
    result = solve(bag)
    assert result.verdict == verdict, result.reason
    assert re.search(reason.replace("{}", str(changed)), result.reason)
    assert set(rejected) <= result.streams.rejected.keys()
    if rejected and verdict == PASS:
        assert result.streams.rejected == {rejected[0]: changed}


def truncated(data, share):
    return data[: int(share * len(data))]


def damaged(data, share):
    begin = int(share * len(data))
    return data[:begin] + bytes(4096) + data[begin + 4096 :]


@pytest.mark.parametrize(
    ("spoil", "share", "verdict", "lost"),
    [
        (truncated, 0.9, PASS, ""),
        (truncated, 0.4, NOT_EVALUATED, ""),
        (damaged, 0.34, None, r", [1-9]\d* bytes lost\)$"),
    ],
)
def test_of_a_spoilt_bag_whole_chunks_are_used(tmp_path, rests, spoil, share, verdict, lost):
    bag = calib_rig.record(tmp_path / "bag", rests)
    file = bag / "bag_0.mcap"
    file.write_bytes(spoil(file.read_bytes(), share))
    if spoil is truncated:
        (bag / "metadata.yaml").unlink()
    result = solve(bag)
    source = result.provenance.source
    assert re.search(r"^bag_0 [0-9a-f]{64} \(\d+ messages recovered" + lost, source)
    assert verdict in (None, result.verdict), result.reason
    assert verdict is None or (result.accepted >= 6) == (verdict == PASS)
    assert result.accepted < 8 or verdict is None


def test_a_misspelt_topic_is_named_with_the_right_one(tmp_path, rests):
    bag = calib_rig.record(tmp_path / "bag", rests[:50])
    with pytest.raises(BagError) as error:
        solve(bag, base_topic="vicon/fs/fss")
    words = "is it /vicon/fss/fss? Then add --base-topic /vicon/fss/fss"
    assert str(error.value) == f"no /vicon/fs/fss in {bag}; {words}"


def test_what_is_said_of_a_namespace_leads_to_a_pass(tmp_path, monkeypatch, capsys, rests):
    """The arm is of a vehicle `lab`, but motion capture has the usual names."""
    message = calib_rig.message

    def moved(sample):
        topic, content = message(sample)
        return topic.replace("joint_states", "lab/joint_states"), content

    monkeypatch.setattr("calib_rig.message", moved)
    types = {name.replace("joint_st", "lab/joint_st"): it for name, it in calib_rig.TYPES.items()}
    given = [str(calib_rig.record(tmp_path / "bag", rests, types=types))]
    for _ in range(4):
        if not (code := from_bag(given)):
            break
        options = re.findall(r"--[a-z-]+ [\w/]+", capsys.readouterr().err)
        assert options
        given += options[0].split()
    assert code == 0
    assert len(given) == 7  # three options


@pytest.mark.parametrize(
    ("kind", "missing"),
    [*((KINEMATIC, topic) for topic in calib_rig.TYPES), (DYNAMIC, "vicon/fss/fss")],
)
def test_a_missing_topic_is_named(tmp_path, rests, kind, missing):
    topics = [topic for topic in calib_rig.TYPES if topic != missing]
    bag = calib_rig.record(tmp_path / "bag", rests[:50], topics)
    with pytest.raises(BagError, match=f"no /{missing} in .*, which has "):
        solve(bag, kind)


@pytest.mark.parametrize(
    ("links", "words"),
    [(5, "nothing received from joint_5"), (3, "received joint_4, but 'paper' has 3 joints")],
)
def test_an_arm_of_other_joints_is_named(tmp_path, rests, links, words):
    arm = replace(ARM, links=(ARM.links * 2)[:links])
    result = solve(calib_rig.record(tmp_path / "bag", rests), arm=arm)
    assert result.verdict == NOT_EVALUATED
    cause = f"the data have 4 joints, description 'paper' has {links}: give the arm's"
    assert result.reason.startswith(cause)
    assert words in result.reason


@pytest.mark.parametrize("place", [0, 2000])
def test_a_stamp_of_another_year_is_rejected_by_itself(tmp_path, rests, place):
    """One of each stream, the first or not: the result is the same."""
    year_2038 = {s.stream: s._replace(t=2**31 * SECOND - 1) for s in rests[:500]}
    bad = [*rests[:place], *year_2038.values(), *rests[place:]]
    heard = {id(s): rests[place].t - s.t for s in year_2038.values()}
    bag = calib_rig.record(tmp_path / "bad", bad, late=lambda s: heard.get(id(s), 0))
    result, expected = solve(bag), solve(calib_rig.record(tmp_path / "good", rests))
    assert result.verdict == PASS
    assert result.values.tolist() == expected.values.tolist()
    rejected = result.streams.rejected
    assert len(rejected) == 6
    assert {why.split(" ", 1)[1] for why in rejected} == {"isolated in time"}


def calibrated(samples):
    """What is found in samples of maneuvers."""
    settings = DYNAMIC.settings(**PRECISE)
    finder = DYNAMIC.finder(ARM, settings, [])
    found = calib_float.feed(finder, samples)
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


def test_maneuvers_that_a_person_moved_are_left_out(maneuvers):
    """Link 2 is armed after the first."""
    settings = DYNAMIC.settings()
    finder = DYNAMIC.finder(ARM, settings, [])
    feeds = {one.topic: one.feed for one in DYNAMIC.inputs(settings, ARM.n)}
    for seconds, armed in ((0.0, False), (12.0, True)):
        message = LinkTelemetry(link=2, boot=3, homings=1, armed=armed)
        message.header.stamp = to_time(at(seconds))
        feeds["link_2/telemetry"](finder, message)
    found = calib_float.feed(finder, [s for s in maneuvers if s.t < at(34.0)])
    assert [m.reason for m in found] == ["joint_2 moved while disarmed", ""]


@pytest.mark.parametrize(
    ("gap", "why"), [(True, ": fss silent for 2.00 s"), (False, ", it has none")]
)
def test_design_says_that_no_maneuver_can_be_used(tmp_path, capsys, maneuvers, gap, why):
    """The base lost from the first look on, or a bag that ends before the arm moves."""
    end = at(20.0) if gap else at(4.0)
    lost = at(2.0) if gap else end
    some = [s for s in maneuvers if s.t < end and (s.stream != "base" or s.t <= lost)]
    bag = calib_float.record(tmp_path / "bags", some)
    assert design(["--bag", str(bag), "--count", "1"]) == 1
    assert capsys.readouterr().err == f"design: no maneuver of {bag} can be used{why}\n"


def test_what_is_no_pose_is_named(tmp_path, capsys, monkeypatch, rests):
    monkeypatch.setattr("calib_rig.serialize_message", lambda _: b"\0\1\0\0" + bytes(24))
    bag = calib_rig.record(tmp_path, [s for s in rests[:50] if isinstance(s.stream, str)])
    assert from_bag([str(bag)]) == 1
    assert "28 bytes is not a geometry_msgs/PoseStamped" in capsys.readouterr().err


def test_the_result_is_the_same_whatever_is_read_at_once(tmp_path, rests):
    bag = calib_rig.record(tmp_path / "bag", rests)
    once, bits = solve(bag, horizon=1e4), solve(bag, horizon=20.0)
    assert once.verdict == PASS
    assert once.accepted == 8
    assert not once.streams.rejected
    assert re.search(r"^bag_0 [0-9a-f]{64}$", once.provenance.source)
    assert np.array_equal(once.values, bits.values)
    assert once.provenance.data_hash == bits.provenance.data_hash
