"""Invalid values in every field of the references, plans and goals of `control` and `guidance`."""

import re
from math import inf, nan

import numpy as np
import pytest
from builtin_interfaces.msg import Duration, Time
from geometry_msgs.msg import Quaternion
from rclpy.duration import Duration as Seconds
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from fss_arm_model.description import paper_arm
from fss_arm_ros.convert import SECOND, to_time
from fss_arm_ros.validation import check
from fss_gnc import messages
from fss_gnc.bounds import check_reference
from fss_gnc.guidance.activity import ActivityError, Craft, Observation
from fss_gnc.guidance.kinds import BASE
from fss_gnc.reference import Body, Path

DENORMAL = 5e-324
NOT_FINITE = (nan, inf, -inf)
HUGE = (1e9, -1e18)
MILLION = 1_000_000
STAMP = 1_700_000_000 * SECOND
HOLD, GO_TO, FOLLOW = BASE

# --- control ------------------------------------------------------------------------------------

PARTS = ("transforms[0].translation", "velocities[0].linear", "accelerations[0].linear")
VECTORS = (*PARTS, "velocities[0].angular", "accelerations[0].angular")
NUMBERS = [f"{vector}.{axis}" for vector in VECTORS for axis in "xyz"]
TURN = [f"transforms[0].rotation.{axis}" for axis in "xyzw"]
#: Fields of a point of a reference, with invalid values.
POINT = [
    *[(name, (*NOT_FINITE, *HUGE)) for name in NUMBERS],
    *[(name, (*NOT_FINITE, 1e18)) for name in TURN],
    *[(f"{PARTS[0]}.{axis}", (5.0, -2.1)) for axis in "xy"],
    *[(f"{part}.z", (0.002,)) for part in PARTS[1:]],
    *[(f"{vector}.{axis}", (0.002,)) for vector in VECTORS[3:] for axis in "xy"],
    ("transforms[0].rotation", (Quaternion(w=0.0), Quaternion(x=1.0, w=0.0))),
    ("time_from_start", [Duration(sec=sec) for sec in (-1, 86_401, 2**31 - 1)]),
    *[(part, ([],)) for part in ("transforms", "velocities", "accelerations")],
]
REFERENCE = [
    *[(f"points[{k}].{name}", values) for name, values in POINT for k in (0, 1)],
    ("header.stamp", (Time(sec=-1),)),
    ("header.frame_id", ("", "fss", 9000 * "x")),
    ("joint_names", ([], ["joint_1"], 2 * ["fss"], 9000 * ["fss"])),
]
#: Fields of a plan of the joints, with invalid values.
PLAN = [
    *[(f"points[{k}].velocities[{i}]", (*NOT_FINITE, *HUGE)) for k in (0, 1) for i in range(4)],
    *[(f"points[1].{name}", (4 * [nan],)) for name in ("positions", "accelerations", "effort")],
    ("points[1].velocities", ([], [0.0], 5 * [0.0], 9000 * [0.0])),
    ("points[0].time_from_start", [Duration(sec=sec) for sec in (-1, 1, 2**31 - 1)]),
    ("joint_names", ([], ["joint_1"], 9000 * ["joint_1"])),
    ("points", ([],)),
]


def resting():
    """Return a valid reference of two points: at rest at the origin."""
    return messages.trajectory(Path(np.arange(2.0), np.zeros((2, 3, 3))), 0.0, STAMP, 1.0, 1.0)


def plan():
    message = JointTrajectory(joint_names=[f"joint_{i}" for i in range(1, 5)])
    message.header.stamp = to_time(STAMP)
    message.points = [
        JointTrajectoryPoint(velocities=4 * [0.0], time_from_start=Seconds(seconds=k).to_msg())
        for k in range(2)
    ]
    return message


def set_field(message, name, value):
    """Set a field by its path, such as points[0].transforms[0].translation.x."""
    *path, last = re.findall(r"\w+", name)
    for part in path:
        message = message[int(part)] if part.isdigit() else getattr(message, part)
    if last.isdigit():
        message[int(last)] = value
    else:
        setattr(message, last, value)


def validated(message):
    """Return a message that the rule of its type allows."""
    if why := check(type(message))(message):
        raise ValueError(why)
    return message


def reference(message):
    """Return the reference in a message as `control` does: by rule, content and bounds."""
    path = messages.path(validated(message))
    check_reference(path, (4.0, 4.0))
    return path


def rates(message):
    return messages.planned_rates(validated(message), paper_arm())[2]


@pytest.mark.parametrize(
    ("read", "make", "invalid"), [(reference, resting, REFERENCE), (rates, plan, PLAN)]
)
def test_invalid_references_and_plans_are_rejected(read, make, invalid):
    read(make())
    for name, values in invalid:
        for value in values:
            message = make()
            set_field(message, name, value)
            with pytest.raises(ValueError):  # noqa: PT011
                pytest.fail(f"{name} = {str(value)[:40]} is not rejected: {read(message)}")


def test_denormal_numbers_in_a_reference_count_as_zero():
    message = resting()
    for name in NUMBERS + TURN[:3]:
        set_field(message.points[0], name, DENORMAL)
    np.testing.assert_allclose(reference(message).knots, 0.0, atol=1e-300)


# --- guidance -----------------------------------------------------------------------------------

DURATIONS = (*NOT_FINITE, 1e18, -1.0, -DENORMAL)
KNOTS = {"time": [0.0, 5.0], "pose": 6 * [0.0], "twist": 6 * [0.0]}


def with_one(numbers, i, value):
    changed = list(numbers)
    changed[i] = value
    return changed


#: Action, goal, and the field that the result names.
GOALS = [
    *[
        (kind, {"pose": with_one(3 * [0.0], i, value)}, f"pose[{i}]")
        for kind in (HOLD, GO_TO)
        for i in range(3)
        for value in (*NOT_FINITE, *HUGE)
    ],
    *[(kind, {"pose": [5.0, 0.0, 0.0]}, "pose[0]") for kind in (HOLD, GO_TO)],
    *[(HOLD, {"pose": count * [0.0]}, "pose has") for count in (2, MILLION)],
    *[(HOLD, {"pose": pose}, "pose is") for pose in ([0.5, 0.0, 0.0], [0.0, 0.0, 2.0])],
    *[(HOLD, {"duration": value}, "duration") for value in DURATIONS],
    *[
        (GO_TO, {"pose": [0.1, 0.0, 0.0], name: value}, name)
        for name in ("duration", "hold_duration")
        for value in DURATIONS
    ],
    (GO_TO, {"pose": [0.1, 0.0, 0.0], "duration": DENORMAL}, "duration"),
    *[
        (FOLLOW, KNOTS | {name: with_one(numbers, i, value)}, f"{name}[{i}]")
        for name, numbers in KNOTS.items()
        for i in (0, len(numbers) - 1)
        for value in (*NOT_FINITE, *HUGE)
    ],
    *[(FOLLOW, KNOTS | {"time": [0.0, step]}, "time[1]") for step in (0.0, DENORMAL, 1e-6, -1.0)],
    (FOLLOW, KNOTS | {"time": [DENORMAL, 5.0]}, "time[0]"),
    *[
        (FOLLOW, KNOTS | {name: count * [0.0]}, f"{name} has")
        for name in KNOTS
        for count in (1, MILLION)
    ],
    (FOLLOW, {}, "time has 0 knots"),
]
#: Goals with numbers that count as 0.
AS_ZERO = [
    (HOLD, {"pose": 3 * [DENORMAL], "duration": DENORMAL}),
    (GO_TO, {"pose": 3 * [-DENORMAL], "hold_duration": DENORMAL}),
    (GO_TO, {"pose": [0.0, 0.0, 100 * 2 * np.pi]}),
    (FOLLOW, {"time": [0.0, 1.0], "pose": 6 * [DENORMAL], "twist": 6 * [DENORMAL]}),
]

CRAFT = Craft(paper_arm())
AT_ORIGIN = Observation(
    0.0, Body(np.zeros(3), np.zeros(3)), None, np.array([1.5, -1.5, -1.5, 1.5]), np.zeros(4)
)


def test_invalid_goals_are_rejected_with_field_and_expected_value():
    for kind, goal, field in GOALS:
        with pytest.raises(ActivityError, match=r"expected") as error:
            kind.start(CRAFT, AT_ORIGIN, kind.action.Goal(**goal))
        assert field in str(error.value)
        assert len(str(error.value)) < 200


@pytest.mark.parametrize(("kind", "goal"), AS_ZERO)
def test_numbers_of_a_goal_that_count_as_zero_leave_the_base_where_it_is(kind, goal):
    motion = kind.start(CRAFT, AT_ORIGIN, kind.action.Goal(**goal))
    np.testing.assert_allclose(motion.path.knots, 0.0, atol=1e-6)
