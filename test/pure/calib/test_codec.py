"""Data of all kinds to messages and back, and the rules for messages of data."""

from math import nan

import pytest

from fss_arm_calib.acceptance import Check
from fss_arm_calib.codec import decode, encode
from fss_arm_calib.joint.kind import JOINT
from fss_arm_calib.kinds import DRIFT, DRIVES, DYNAMIC, JOINT_SOURCES, KINEMATIC
from fss_arm_calib.segments.drifts import Drift
from fss_arm_calib.segments.excitations import Excitation, Frames
from fss_arm_calib.segments.maneuvers import Maneuver
from fss_arm_calib.segments.rests import Observation
from fss_arm_msgs import msg
from fss_arm_ros.convert import SECOND, stamp_ns
from fss_arm_ros.rules import RESULT
from fss_arm_ros.validation import check

START, END = 5 * SECOND + 1, 7 * SECOND + 2
TWO_POSES = ((0.1, 0.2, 0.3), (0.4, 0.5, 7.0))
DATA = [
    (
        KINEMATIC,
        Observation(
            START, END, (0.1, 0.2), (0.3, 0.4, 0.5), (0.6, 0.7, 0.8), 9, 10, 0.01, (1, 2), (3, 4),
            used=False, reason="a gap",
        ),
        {"q": [0.1, 0.2], "scatter": [0.6, 0.7, 0.8], "vicon_frames": 10, "homings": [3, 4]},
    ),
    (
        DYNAMIC,
        Maneuver(
            START, END, ((0.0,), (0.0, 1.0, 2.0)), ((1.0,), (2.0, 3.0, 4.0)),
            ((5.0,), (6.0, 7.0, 8.0)), (0.5, 1.5), TWO_POSES, (5, 6), (0.1, 0.2), (1.0, 2.0, 3.0),
            0.01,
        ),
        {"samples": [1, 3], "q": [1.0, 2.0, 3.0, 4.0], "poses": [0.1, 0.2, 0.3, 0.4, 0.5, 7.0]},
    ),
    (
        DRIFT,
        Drift(START, END, (0.1, 0.2), (0.0, 0.5), TWO_POSES, (5, 6), (0.1, 0.2)),
        {"poses": [0.1, 0.2, 0.3, 0.4, 0.5, 7.0], "frames": [5, 6], "used": True},
    ),
    (
        DRIVES,
        Excitation(START, END, 2 * (Frames(3, 1, (START, END), *5 * ((7.0, 8.0),)),)),
        {"links": 2 * [msg.LinkFrames(boot=3, homings=1, stamps=[START, END],
                       position=[7, 8], velocity=[7, 8], current=[7, 8], torque=[7, 8],
                       torque_age=[7, 8])]},
    ),
]  # fmt: skip


@pytest.mark.parametrize(("kind", "datum", "fields"), DATA)
def test_a_datum_is_a_message_and_comes_back(kind, datum, fields):
    message = kind.data.to_message([datum, datum], "fss")
    assert (message.header.frame_id, stamp_ns(message.header.stamp)) == ("fss", END)
    one = getattr(message, f"{kind.data.noun}s")[1]
    assert (stamp_ns(one.start), stamp_ns(one.end)) == (START, END)
    for name, value in fields.items():
        found = getattr(one, name)
        assert (list(found) if isinstance(value, list) else found) == value
    assert kind.data.from_message(message) == [datum, datum]
    assert check(kind.data.message, kind.data.rule)(message) == ""


def test_a_dataclass_may_have_fields_that_its_message_lacks():
    message = encode(Check("fit", "pass", 1, 2.0, "good", needed=False), msg.Check)
    assert message == msg.Check(name="fit", verdict="pass", value=1.0, threshold=2.0, reason="good")


def test_rows_of_another_length_are_refused():
    with pytest.raises(ValueError, match="cannot reshape"):
        decode(msg.Drift(poses=[0.0, 0.0]), Drift)


def rests(tip, used=True):
    one = msg.KinematicObservation(q=[0.0], tip=tip, used=used)
    return msg.KinematicObservations(observations=[one])


def maneuvers(**fields):
    one = {"samples": [1, 1], "times": [0.0, 0.0], "q": [0.0, 0.1], "qd": [nan, nan], "used": True}
    return msg.Maneuvers(maneuvers=[msg.Maneuver(), msg.Maneuver(**{**one, **fields})])


def drifts(**fields):
    one = {"times": [0.0], "poses": [0.0, 0.0, 0.0], "frames": [5], "seconds": [0.5]}
    return msg.Drifts(drifts=[msg.Drift(**{**one, **fields})])


@pytest.mark.parametrize(
    ("kind", "message", "why"),
    [
        (KINEMATIC, rests([nan, nan, nan], used=False), ""),
        (KINEMATIC, rests([nan, nan, nan]), "tip is not finite, but is to be used"),
        (KINEMATIC, rests([0.0, 1e13, 0.0]), "tip is 1e+13, expected at most 1e+12 in size"),
        (DYNAMIC, maneuvers(samples=[1, 2]), "times has 2 elements, expected 3"),
        (DYNAMIC, maneuvers(qd=[nan]), "qd has 1 elements, expected 2"),
        (DYNAMIC, maneuvers(marks=[0.5]), "frames has 0 elements, expected 1"),
        (DYNAMIC, maneuvers(q=[0.0, nan]), "q is not finite, but is to be used"),
        (DYNAMIC, maneuvers(q=[0.0, nan], used=False), ""),
        (DRIFT, drifts(poses=[0.0, 0.0]), "poses has 2 elements, expected 3"),
        (DRIFT, drifts(q=[nan], used=True), "q is not finite, but is to be used"),
    ],
)
def test_the_rule_for_data_refuses_what_a_solver_cannot_use(kind, message, why):
    assert check(kind.data.message, kind.data.rule)(message) == why


def test_the_joint_estimate_gives_the_rules_of_what_it_receives():
    given = {one.topic: one.rule for one in JOINT.inputs(JOINT.settings(), 4)}
    kinds = JOINT_SOURCES.values()
    assert given == {kind.data.topic: kind.data.rule for kind in kinds} | {
        kind.topic: RESULT for kind in kinds
    }
