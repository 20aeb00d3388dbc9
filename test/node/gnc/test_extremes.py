"""Invalid values in every field of the goals and commands of `control` and `guidance`."""

from math import inf, nan
from operator import attrgetter

import control_bench
import guidance_bench
import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from builtin_interfaces.msg import Duration, Time
from control_bench import at
from geometry_msgs.msg import Quaternion, Transform, Twist, Vector3
from rclpy.duration import Duration as Seconds
from trajectory_msgs.msg import (
    JointTrajectory,
    JointTrajectoryPoint,
    MultiDOFJointTrajectory,
    MultiDOFJointTrajectoryPoint,
)

from fss_arm_ros.convert import SECOND, to_time
from fss_arm_ros.validation import refusals
from fss_gnc.guidance.kinds import BASE, MISSIONS

DENORMAL = 5e-324
NOT_FINITE = (nan, inf, -inf)
HUGE = (1e9, -1e9, 1e18, -1e18)
MILLION = 1_000_000
MIN_WRENCH = 1e-6  # a smaller wrench opens no valve [N, N m]

# --- control ------------------------------------------------------------------------------------

PLACE = [f"transforms.translation.{axis}" for axis in "xyz"]
TURN = [f"transforms.rotation.{axis}" for axis in "xyzw"]
MOTION = [
    f"{part}.{kind}.{axis}"
    for part in ("velocities", "accelerations")
    for kind in ("linear", "angular")
    for axis in "xyz"
]
#: Field of a point, and value.
NUMBERS = [
    *[(name, value) for name in PLACE + MOTION for value in NOT_FINITE + HUGE],
    *[(name, value) for name in TURN for value in (*NOT_FINITE, 1e18)],
    *[(name, value) for name in PLACE[:2] for value in (5.0, -2.1)],
    *[(name, 0.002) for name in MOTION if name.endswith(("linear.z", "angular.x", "angular.y"))],
    ("transforms.rotation", Quaternion(x=0.0, y=0.0, z=0.0, w=0.0)),
    ("transforms.rotation", Quaternion(x=1.0, y=0.0, z=0.0, w=0.0)),
    *[("time_from_start", Duration(sec=sec)) for sec in (-1, 86_401, 2**31 - 1)],
    *[(part, []) for part in ("transforms", "velocities", "accelerations")],
]
#: Field of the message itself, and value.
MESSAGE_FIELDS = [
    *[("header.stamp", Time(sec=sec)) for sec in (0, -1, 1, 2**31 - 1)],
    *[("header.frame_id", frame) for frame in ("", "fss", 9000 * "x")],
    *[("joint_names", names) for names in ([], ["joint_1"], 2 * ["fss"], 9000 * ["fss"])],
]  # fmt: skip
#: Each number of a plan of the joints, and its other fields.
PLANS = [
    *[("velocities", i, value) for i in range(4) for value in NOT_FINITE + HUGE],
    *[(name, 0, nan) for name in ("positions", "accelerations", "effort")],
]


@pytest.fixture
def control(spin):
    return control_bench.Bench(spin)


def through(bench, times, x, speed=(), acceleration=()):
    """Return a reference along x through two points [s, m], with derivatives or without."""
    message = MultiDOFJointTrajectory(joint_names=["fss"])
    message.header.stamp, message.header.frame_id = to_time(bench.now()), "world"
    for k in range(2):
        message.points.append(
            MultiDOFJointTrajectoryPoint(
                transforms=[Transform(translation=Vector3(x=float(x[k])))],
                velocities=[Twist(linear=Vector3(x=float(v))) for v in speed[k : k + 1]],
                accelerations=[Twist(linear=Vector3(x=float(a))) for a in acceleration[k : k + 1]],
                time_from_start=Seconds(seconds=times[k]).to_msg(),
            )
        )
    return message


def resting(bench):
    """Return a valid reference: to rest where the base is."""
    return through(bench, [0, 1], [0, 0], [0, 0], [0, 0])


def set_field(message, name, value):
    """Set a field, of the message or of a message in it."""
    path, _, last = name.rpartition(".")
    setattr(attrgetter(path)(message) if path else message, last, value)


def set_point_field(point, name, value):
    part, _, rest = name.partition(".")
    if rest:
        set_field(getattr(point, part)[0], rest, value)
    else:
        set_field(point, name, value)


def check_rejected(bench, publisher, message, what):
    """Check that a published message is rejected and counted, and opens no valve."""
    key = f"refused on {publisher.topic_name.lstrip('/')}"
    before = refusals(bench.control).get(key, 0)
    publisher.publish(message)
    try:
        bench.until(lambda: refusals(bench.control).get(key, 0) > before, 2.0)
    except pytest.fail.Exception:
        pytest.fail(f"{what} is not rejected")
    assert refusals(bench.control)[key] == before + 1, what
    assert np.abs(bench.wrenches or [0.0]).max() < MIN_WRENCH, what


def still_follows(bench):
    """Check that a valid reference is followed."""
    bench.path = at(0.05, 0.0, 0.0)
    bench.silent -= {"base/trajectory"}
    bench.until(lambda: bench.wrenches and bench.wrenches[-1][0] > 0.01)


def test_invalid_references_are_rejected(control):
    for name, value in NUMBERS:
        for k in (0, 1):
            message = resting(control)
            set_point_field(message.points[k], name, value)
            check_rejected(control, control.trajectory, message, f"points[{k}].{name} = {value}")
    for name, value in MESSAGE_FIELDS:
        message = resting(control)
        set_field(message, name, value)
        check_rejected(control, control.trajectory, message, f"{name} = {str(value)[:40]}")
    late, early = resting(control), resting(control)
    late.header.stamp = to_time(control.now() - 5 * SECOND)
    early.header.stamp = to_time(control.now() + 5 * SECOND)
    long = resting(control)
    long.points = 20_000 * long.points[:1]
    twice = resting(control)
    twice.points[1].time_from_start = Duration()
    for what, message in {
        "old": late, "of the future": early, "a megabyte": long, "not rising": twice,
        "across the table in 0.1 s": through(control, [0.0, 0.1], x=[0.0, 1.9]),
        "off the table between points": through(control, [0, 60], x=[0, 0], speed=[0.9, -0.9]),
    }.items():  # fmt: skip
        check_rejected(control, control.trajectory, message, what)
    assert not control.wrenches
    still_follows(control)


def follow(bench, message):
    """Publish a reference, and wait until it has become wrenches."""
    before, received = len(bench.wrenches), bench.now()
    bench.trajectory.publish(message)
    bench.until(lambda: (bench.control.controller.trajectory.stamp or 0) >= received)
    bench.until(lambda: len(bench.wrenches) > before + 1)


def test_denormal_numbers_in_a_reference_count_as_zero(control):
    for name in PLACE + TURN[:3] + MOTION:
        message = resting(control)
        set_point_field(message.points[0], name, DENORMAL)
        follow(control, message)
    assert np.abs(control.wrenches).max() < MIN_WRENCH
    assert not refusals(control.control)
    still_follows(control)


def plan(bench, **fields):
    message = JointTrajectory(joint_names=[f"joint_{i}" for i in range(1, 5)])
    message.header.stamp = to_time(bench.now())
    message.points = [
        JointTrajectoryPoint(velocities=4 * [0.0], time_from_start=Seconds(seconds=k).to_msg())
        for k in range(2)
    ]
    for name, value in fields.items():
        setattr(message, name, value)
    return message


def test_invalid_joint_plans_are_rejected(control):
    control.path = at(0.0, 0.0, 0.0)
    control.acts()
    for name, i, value in PLANS:
        for k in (0, 1):
            message = plan(control)
            numbers = 4 * [0.0]
            numbers[i] = value
            setattr(message.points[k], name, numbers)
            check_rejected(control, control.planned, message, f"points[{k}].{name}[{i}] = {value}")
    for velocities in ([], [0.0], 5 * [0.0], 9000 * [0.0]):
        message = plan(control)
        message.points[1].velocities = velocities
        check_rejected(control, control.planned, message, f"{len(velocities)} velocities")
    for sec in (-1, 0, 2**31 - 1):
        message = plan(control)
        message.points[0].time_from_start = Duration(sec=sec)
        message.points[1].time_from_start = Duration(sec=0)
        check_rejected(control, control.planned, message, f"points[0].time_from_start = {sec} s")
    for names in ([], ["joint_1"], 9000 * ["joint_1"]):
        check_rejected(control, control.planned, plan(control, joint_names=names), f"{names[:2]}")
    check_rejected(control, control.planned, plan(control, points=[]), "no points")
    denormal = plan(control)
    denormal.points[1].velocities = 4 * [DENORMAL]
    control.planned.publish(denormal)
    control.acts(10)
    assert np.abs(control.wrenches).max() < MIN_WRENCH
    still_follows(control)


# --- guidance -----------------------------------------------------------------------------------

HOLD, GO_TO, FOLLOW = BASE
ABORT = MISSIONS[-1]
DURATIONS = (*NOT_FINITE, 1e18, 1e300, -1.0, -DENORMAL)
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
        for value in (*NOT_FINITE, *HUGE, 1e300)
    ],
    *[(kind, {"pose": [5.0, 0.0, 0.0]}, "pose[0]") for kind in (HOLD, GO_TO)],
    *[(HOLD, {"pose": count * [0.0]}, "pose has") for count in (1, 2, 4, MILLION)],
    (HOLD, {"pose": [0.0, 0.0, 2.0]}, "pose is"),
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
        for value in (*NOT_FINITE, *HUGE, 1e300)
    ],
    *[(FOLLOW, KNOTS | {"time": [0.0, step]}, "time[1]") for step in (0.0, DENORMAL, 1e-6, -1.0)],
    (FOLLOW, KNOTS | {"time": [DENORMAL, 5.0]}, "time[0]"),
    *[
        (FOLLOW, KNOTS | {name: count * [0.0]}, f"{field} has")
        for name, field, count in (
            ("time", "time", 1), ("time", "pose", 7), ("time", "time", MILLION),
            ("pose", "pose", 1), ("pose", "pose", 7), ("pose", "pose", MILLION),
            ("twist", "twist", 1), ("twist", "twist", 7), ("twist", "twist", MILLION),
        )
    ],
    (FOLLOW, {}, "time has 0 knots"),
    (FOLLOW, KNOTS | {"pose": []}, "pose has 0 numbers"),
]  # fmt: skip
#: Goals with numbers that count as 0.
AS_ZERO = [
    (HOLD, {"pose": 3 * [DENORMAL], "duration": DENORMAL}),
    (GO_TO, {"pose": 3 * [-DENORMAL], "hold_duration": DENORMAL}),
    (GO_TO, {"pose": [0.0, 0.0, 100 * 2 * np.pi]}),
    (FOLLOW, {"time": [0.0, 1.0], "pose": 6 * [DENORMAL], "twist": 6 * [DENORMAL]}),
]


@pytest.fixture
def guidance(spin):
    return guidance_bench.Bench(spin, max_age=3.0)  # of a busy computer


def test_invalid_goals_are_rejected_with_field_and_expected_value(guidance):
    for kind, goal, field in GOALS:
        ended = guidance.does(kind, **goal)
        what = f"{kind.name} {str(goal)[:80]}: {ended.result.message[:200]}"
        assert ended.status == GoalStatus.STATUS_ABORTED, what
        assert field in ended.result.message, what
        assert "expected" in ended.result.message, what
        assert len(ended.result.message) < 200, what
    assert not any(guidance.paths)
    for kind, goal in AS_ZERO:
        ended = guidance.does(kind, **goal)
        assert ended.status == GoalStatus.STATUS_SUCCEEDED, ended.result.message
        assert np.abs(guidance.pose).max() < 1e-6
    ended = guidance.does(GO_TO, pose=[0.01, 0.0, 0.0])
    assert ended.status == GoalStatus.STATUS_SUCCEEDED, ended.result.message


@pytest.mark.parametrize(
    ("reason", "shown"),
    [("", "requested by the operator"), ("lost\nit", "lost it"), (MILLION * "x", 200 * "x")],
)
def test_abort_accepts_any_reason(guidance, reason, shown):
    guidance.begin(ABORT, reason=reason)
    guidance.until(lambda: guidance.states[-1].phase == "abort")
    assert guidance.states[-1].reason == shown
