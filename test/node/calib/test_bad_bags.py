"""Bags that something is wrong with: each ends in a named error or in a verdict that says it."""

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from math import nan
from typing import Any, NamedTuple

import calib_float
import calib_rig
import numpy as np
import pytest
from calib_float import Float, postures
from calib_rig import ARM, Rig, at

from fss_arm_bags.reader import BagError
from fss_arm_calib.acceptance import FAIL, NOT_EVALUATED, PASS
from fss_arm_calib.calibration import Calibration
from fss_arm_calib.dynamic.kind import DYNAMIC
from fss_arm_calib.experiment.design_command import main as design
from fss_arm_calib.experiment.postures import DEFAULT_POSTURES
from fss_arm_calib.from_bag import main as from_bag
from fss_arm_calib.from_bag import solve_bag
from fss_arm_calib.kinematic.kind import KINEMATIC
from fss_arm_calib.kinematic.problem import OFFSETS
from fss_arm_calib.segments.rests import BASE, TIP
from fss_arm_model.description_file import save
from fss_arm_ros.convert import SECOND

JOINTS = (1, 2, 3, 4)
PRECISE = {"position_deviation": 0.0005, "heading_deviation": 0.001, "max_relative": 2.0}


def rig(vector=None):
    return Float(postures(10, seed=3), vector, noise=(0.0005, 0.001))


class Lab(NamedTuple):
    """Samples of a kind that nothing is wrong with, and how they become a bag and a result."""

    kind: Calibration[Any, Any]
    make: Callable[[], list[Any]]
    record: Callable[..., Any]
    topics: tuple[str, ...]  # needed ones
    given: dict[str, float]  # settings
    data: int  # found in the samples

    def solve(self, bag, arm=ARM, **settings):
        save(arm, bag.parent / "arm.yaml")
        given = {"arm": str(bag.parent / "arm.yaml"), **self.given, **settings}
        return solve_bag(self.kind, bag, self.kind.settings(**given))

    def solve_samples(self, folder, samples, arm=ARM, **settings):
        """The result from a bag of samples that arrive on time, whatever their stamps."""
        good, late = self.samples, {}
        if len(samples) == len(good):
            late = {id(new): old.t - new.t for old, new in zip(good, samples, strict=True)}
        bag = self.record(folder / "bags", samples, late=lambda s: late.get(id(s), SECOND // 100))
        return self.solve(bag, arm, **settings)

    @property
    def samples(self):
        return good_samples(self.kind.name)


LABS = {
    "kinematic": Lab(
        KINEMATIC,
        lambda: Rig(DEFAULT_POSTURES[:8], rest=3.2, rate=25.0).samples(),
        calib_rig.record, tuple(calib_rig.TYPES), {}, 8,
    ),
    "dynamic": Lab(
        DYNAMIC, lambda: rig().samples(rate=20), calib_float.record,
        ("joint_states", "vicon/fss/fss"), PRECISE, 10,
    ),
}  # fmt: skip
SLOW = pytest.mark.slow


@cache
def good_samples(kind):
    return LABS[kind].make()


@pytest.fixture(params=LABS)
def lab(request):
    return LABS[request.param]


def without(*streams):
    return lambda samples: [s for s in samples[:1000] if s.stream not in streams]


def with_value(stream, value, every=1):
    """The samples with a value in place of each n-th one, or of all of a stream."""
    return lambda samples: [
        s._replace(value=value) if s.stream == stream and k % every == 0 else s
        for k, s in enumerate(samples)
    ]


def set_back(*streams):
    """By 12 s, at 25 s: what comes after may hide a rest or a maneuver."""
    return lambda samples: [
        s._replace(t=s.t - 12 * SECOND) if s.stream in streams and at(25.0) < s.t else s
        for s in samples
    ]


def swapped(begin=0.0, end=1e4):
    other = {BASE: TIP, TIP: BASE}
    return lambda samples: [
        s._replace(stream=other.get(s.stream, s.stream)) if at(begin) < s.t < at(end) else s
        for s in samples
    ]


def of_the_tip(begin=0.0, end=1e4):
    """The end effector under the base's name, for a while."""

    def seen(sample):
        t = (sample.t - at(0.0)) / SECOND
        if sample.stream != "base" or not begin < t < end:
            return sample
        (tip,) = rig().tip([t], np.array([sample.value])).tolist()
        return sample._replace(value=tuple(tip))

    return lambda samples: [seen(sample) for sample in samples]


def case(kind, change, verdict, reason="", rejected=(), slow=False):
    marks = [SLOW] if slow else []
    return pytest.param(LABS[kind], change, verdict, reason, rejected, marks=marks)


NONE = nan, 0.0, 0.0
EVERY_JOINT = "nothing received from joint_1, joint_2, joint_3, joint_4"
BACK = r"clock of \w+ jumped back by 1[12]"

#: Kind, change of the samples, verdict, reason ({} is the number of samples changed) and rejected
#: samples by stream and reason.
CASES = [
    case("kinematic", without(*JOINTS), NOT_EVALUATED, EVERY_JOINT),
    case("kinematic", without(BASE), NOT_EVALUATED, f"nothing received from {BASE}"),
    case("kinematic", without(TIP), NOT_EVALUATED, f"nothing received from {TIP}"),
    case("dynamic", without(*JOINTS, "gyro"), NOT_EVALUATED, EVERY_JOINT),
    case("dynamic", without("base"), NOT_EVALUATED, f"nothing received from {BASE}"),
    # One in ten does no harm; all leave nothing to calibrate from.
    case("kinematic", with_value(3, nan, 10), PASS, "", ["joint_3 not finite"]),
    case("kinematic", with_value(BASE, NONE, 10), PASS, "", ["fss occluded"]),
    case("kinematic", with_value(3, nan), NOT_EVALUATED, "rejected: {} joint_3 not finite"),
    case("kinematic", with_value(BASE, NONE), NOT_EVALUATED, "rejected: {} fss occluded"),
    case("dynamic", with_value(3, (nan, nan), 10), PASS, slow=True),
    case("dynamic", with_value("base", NONE, 10), PASS),
    case("dynamic", with_value("gyro", nan, 10), PASS, slow=True),
    case("dynamic", with_value(3, (nan, nan)), NOT_EVALUATED, "rejected: {} joint_3 not finite",
         slow=True),
    case("dynamic", with_value("base", NONE), NOT_EVALUATED, "rejected: {} fss occluded"),
    case("dynamic", with_value("gyro", nan), PASS, slow=True),
    case("kinematic", set_back(2), NOT_EVALUATED, BACK),
    case("kinematic", set_back(BASE, TIP), NOT_EVALUATED, BACK),
    case("dynamic", set_back(2), NOT_EVALUATED, BACK, slow=True),
    case("dynamic", set_back("base"), NOT_EVALUATED, BACK),
    case("kinematic", swapped(), FAIL, "base and end effector are swapped"),
    # from the fifth posture's approach to the sixth's departure
    case("kinematic", swapped(20.0, 30.0), FAIL,
         "base and end effector are swapped in observations 5", ["fss jump", "end_effector jump"]),
    case("dynamic", of_the_tip(), FAIL, "the poses of the base are those of the end effector",
         slow=True),
    # amid two maneuvers
    case("dynamic", of_the_tip(27.0, 39.0), FAIL, r"maneuvers? [2-5]\b.* off", ["fss jump"],
         slow=True),
]  # fmt: skip


@pytest.mark.parametrize(("lab", "change", "verdict", "reason", "rejected"), CASES)
def test_what_is_wrong_with_samples_is_named(tmp_path, lab, change, verdict, reason, rejected):
    samples = change(lab.samples)
    changed = sum(new is not old for new, old in zip(samples, lab.samples, strict=False))
    result = lab.solve_samples(tmp_path, samples)
    assert result.verdict == verdict, result.reason
    assert re.search(reason.replace("{}", str(changed)), result.reason)
    assert set(rejected) <= result.streams.rejected.keys()
    if rejected and verdict == PASS:
        assert result.streams.rejected == {rejected[0]: changed}


def test_nothing_is_wrong_with_this_one(lab, tmp_path):
    result = lab.solve_samples(tmp_path, lab.samples)
    assert result.verdict == PASS, result.reason
    assert result.accepted == lab.data
    assert re.search(r"^bag_0 [0-9a-f]{64}$", result.provenance.source)
    assert not result.streams.rejected


@pytest.mark.parametrize(
    ("lab", "share", "verdict"),
    [
        (LABS["kinematic"], 0.9, PASS),
        (LABS["kinematic"], 0.4, NOT_EVALUATED),
        (LABS["dynamic"], 0.9, PASS),
        pytest.param(LABS["dynamic"], 0.4, NOT_EVALUATED, marks=SLOW),
    ],
)
def test_of_a_truncated_bag_whole_chunks_are_used(tmp_path, lab, share, verdict):
    bag = lab.record(tmp_path / "bags", lab.samples)
    (bag / "metadata.yaml").unlink()
    file = bag / "bag_0.mcap"
    file.write_bytes(file.read_bytes()[: int(share * file.stat().st_size)])
    result = lab.solve(bag)
    assert result.verdict == verdict, result.reason
    assert re.search(r"^bag_0 [0-9a-f]{64} \(\d+ messages recovered", result.provenance.source)
    assert (result.accepted >= 6) == (verdict == PASS)
    assert result.accepted < lab.data


def test_a_damaged_chunk_is_left_out_and_told(lab, tmp_path):
    bag = lab.record(tmp_path / "bags", lab.samples)
    data = bytearray((bag / "bag_0.mcap").read_bytes())
    middle = len(data) // 3
    data[middle : middle + 4096] = bytes(4096)
    (bag / "bag_0.mcap").write_bytes(data)
    source = lab.solve(bag).provenance.source
    assert re.search(
        r"^bag_0 [0-9a-f]{64} \(\d+ messages recovered, [1-9]\d* bytes lost\)$", source
    )


def test_a_missing_topic_is_named(lab, tmp_path):
    for missing in lab.topics:
        topics = [topic for topic in lab.topics if topic != missing]
        bag = lab.record(tmp_path / missing.replace("/", "_"), lab.samples[:1000], topics)
        with pytest.raises(BagError, match=f"no /{missing} in .*(, which has |; is it )"):
            lab.solve(bag)


def test_a_misspelt_topic_is_named_with_the_right_one(lab, tmp_path):
    bag = lab.record(tmp_path / "bags", lab.samples[:1000])
    with pytest.raises(BagError) as error:
        lab.solve(bag, base_topic="vicon/fs/fss")
    assert str(error.value) == f"no /vicon/fs/fss in {bag}; is it /vicon/fss/fss?"


@pytest.mark.parametrize(
    ("links", "words"),
    [(5, "nothing received from joint_5"), (3, "received joint_4, but 'paper' has 3 joints")],
)
def test_an_arm_of_other_joints_is_named(lab, tmp_path, links, words):
    arm = replace(ARM, links=(ARM.links * 2)[:links])
    result = lab.solve_samples(tmp_path, lab.samples, arm)
    assert result.verdict == NOT_EVALUATED
    assert words in result.reason


def test_an_arm_of_other_lengths_is_named(tmp_path):
    """Estimated freely, its lengths fit."""
    lab, links = LABS["kinematic"], tuple(replace(link, a=link.a + 0.06) for link in ARM.links)
    result = lab.solve_samples(tmp_path, lab.samples, replace(ARM, links=links))
    assert result.verdict == FAIL
    assert re.match(r"another arm's data: a_\d is 0.3\d+ m, 0.\d+ m in", result.reason)
    assert not any("residuals are larger" in reason for reason in result.reasons)


def test_an_arm_of_other_lengths_does_not_fit(tmp_path):
    lab = LABS["kinematic"]
    longer = ARM.with_kinematics([0.45, *ARM.vector()[[14, 20, 26]], 0, 0, 0, 0.2, 0.0, 0.3])
    result = lab.solve_samples(tmp_path, lab.samples, longer, parametrization=OFFSETS)
    assert result.verdict == FAIL
    assert "residuals are larger than the assumed deviations allow" in result.reason


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
    samples = rig(arm.vector()).samples(rate=20)
    result = LABS["dynamic"].solve(calib_float.record(tmp_path / "bags", samples))
    assert result.verdict == FAIL
    assert re.search(r"at the bound of .*: b_1.*; another arm's data, or wrong", result.reason)


def test_another_arm_of_nearly_the_same_lengths_is_named_by_its_end_effector(tmp_path):
    """Motion alone fits: half an inch more of each link hides in the centres of mass."""
    lab, record = LABS["dynamic"], calib_float.record
    angles = (link.theta_0 for link in ARM.links[1:])
    lengths = [link.a + 0.0127 for link in ARM.links]
    arm = ARM.with_kinematics([*lengths, *angles, *ARM.base.mount])
    samples = rig(arm.vector()).samples(rate=20, tip=True)
    topics = ["joint_states", "vicon/fss/fss", "fog/imu"]
    unseen = record(tmp_path / "unseen", [s for s in samples if s.stream != "tip"], topics)
    assert lab.solve(unseen).verdict == PASS
    result = lab.solve(record(tmp_path / "seen", samples))
    assert result.verdict == FAIL
    assert re.search(r"^another arm's data, .*end effector 0\.0\d+ m from", result.reason)
    assert lab.solve(record(tmp_path / "own", samples), arm).verdict == PASS


@pytest.mark.parametrize(
    ("gap", "why"), [(True, ": fss silent for 2.00 s"), (False, ", it has none")]
)
def test_design_says_that_no_maneuver_can_be_used(tmp_path, capsys, gap, why):
    """The base lost from the first look on, or a bag that ends before the arm moves."""
    end = at(20.0) if gap else at(4.0)
    some = [
        s
        for s in good_samples("dynamic")
        if s.t < end and not (gap and s.stream == "base" and s.t > at(2.0))
    ]
    bag = calib_float.record(tmp_path / "bags", some)
    assert design(["--bag", str(bag), "--count", "1"]) == 1
    assert capsys.readouterr().err == f"design: no maneuver of {bag} can be used{why}\n"


@pytest.mark.slow
def test_no_gyro_is_needed(tmp_path):
    lab = LABS["dynamic"]
    result = lab.solve(lab.record(tmp_path / "bags", lab.samples, lab.topics))
    assert result.verdict == PASS, result.reason


@pytest.mark.parametrize("place", [0, 2000])
def test_a_stamp_of_another_year_is_rejected_by_itself(tmp_path, place):
    """One of each stream, the first or not: the result is the same."""
    lab, samples = LABS["kinematic"], good_samples("kinematic")
    year_2038 = {s.stream: s._replace(t=2**31 * SECOND - 1) for s in samples[:500]}
    bad = [*samples[:place], *year_2038.values(), *samples[place:]]
    heard = {id(s): samples[place].t - s.t for s in year_2038.values()}
    bag = lab.record(tmp_path / "bad", bad, late=lambda s: heard.get(id(s), 0))
    result, expected = lab.solve(bag), lab.solve_samples(tmp_path, samples)
    assert result.verdict == PASS
    assert result.values.tolist() == expected.values.tolist()
    rejected = result.streams.rejected
    assert len(rejected) == 6
    assert {why.split(" ", 1)[1] for why in rejected} == {"isolated in time"}


def test_what_is_no_pose_is_named(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("calib_rig.serialize_message", lambda _: b"\0\1\0\0" + bytes(24))
    samples = good_samples("kinematic")[:50]
    bag = calib_rig.record(tmp_path, [s for s in samples if isinstance(s.stream, str)])
    assert from_bag([str(bag)]) == 1
    assert "28 bytes is not a geometry_msgs/PoseStamped" in capsys.readouterr().err


def test_the_result_is_the_same_whatever_is_read_at_once(tmp_path):
    lab = LABS["kinematic"]
    bag = lab.record(tmp_path / "bags", lab.samples)
    once, bits = lab.solve(bag, horizon=1e4), lab.solve(bag, horizon=20.0)
    assert np.array_equal(once.values, bits.values)
    assert once.provenance.data_hash == bits.provenance.data_hash
