"""Trajectories as asked for, the paths made of them, and what is refused."""

from dataclasses import replace
from math import inf, nan

import numpy as np
import pytest
from builtin_interfaces.msg import Duration as DurationMessage
from builtin_interfaces.msg import Time
from control_msgs.action import FollowJointTrajectory
from control_msgs.msg import JointComponentTolerance, JointTolerance
from rclpy.duration import Duration
from scipy.interpolate import CubicHermiteSpline, CubicSpline
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint, MultiDOFJointTrajectoryPoint

from fss_arm_driver.arm.request import (
    MAX_MAGNITUDE,
    MAX_POINTS,
    Code,
    Request,
    TrajectoryError,
    parse_request,
    reject_unsupported_fields,
)
from fss_arm_driver.arm.state import LinkState
from fss_arm_driver.arm.tolerance import Tolerance, Tolerances
from fss_arm_driver.arm.trajectory import (
    MAX_SEGMENT,
    Trajectory,
    check_time,
    plan_trajectory,
    spline_velocities,
)
from fss_arm_driver.arm.trajectory_monitor import TrajectoryMonitor
from fss_arm_model.description import paper_arm
from fss_arm_model.units import SECOND
from fss_arm_ros import validation

ARM = paper_arm()
JOINTS = [f"joint_{i}" for i in range(1, 5)]
START_TIME = 1_000 * SECOND


def message(points, names=JOINTS):
    trajectory = JointTrajectory(joint_names=list(names))
    for time, q, *qd in points:
        point = JointTrajectoryPoint(positions=np.asarray(q, dtype=float).tolist())
        point.velocities = np.asarray(qd[0], dtype=float).tolist() if qd else []
        point.time_from_start = Duration(seconds=time).to_msg()
        trajectory.points.append(point)
    return trajectory


def at_rest(*q):
    return lambda _: (np.array(q or np.zeros(4)), np.zeros(4))


def wavy(m=8, seed=1):
    """Times, positions (m, 4) that the drives can follow."""
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.5, 2.0, m))
    return times, rng.uniform(-0.2, 0.2, (m, 4))


def test_the_codes_are_those_of_control_msgs():
    result = FollowJointTrajectory.Result
    assert {code.name: int(code) for code in Code} == {
        name: getattr(result, name) for name in Code.__members__
    }


def test_velocities_that_lack_are_those_of_the_spline_which_a_given_one_parts():
    times, q = wavy()
    qd = np.full_like(q, np.nan)
    qd[0], qd[3], qd[-1] = 0.1, 0.2, 0.0
    found = spline_velocities(times, q, qd)
    for rows in (slice(0, 4), slice(3, None)):
        ends = qd[rows][0], qd[rows][-1]
        spline = CubicSpline(times[rows], q[rows], bc_type=((1, ends[0]), (1, ends[1])))
        np.testing.assert_allclose(found[rows], spline(times[rows], 1), atol=1e-12)


def test_a_path_is_the_cubic_between_its_knots():
    times, q = wavy()
    rng = np.random.default_rng(3)
    path = Trajectory(START_TIME, times - times[0], q, rng.uniform(-0.2, 0.2, q.shape))
    other = CubicHermiteSpline(path.times, path.q, path.qd)
    for t in rng.uniform(0.0, path.times[-1], 50):
        at = START_TIME + round(t * SECOND)
        np.testing.assert_allclose(path.at(at)[0], other(t), atol=1e-8)
        np.testing.assert_allclose(path.at(at)[1], other(t, 1), atol=1e-7)
    np.testing.assert_array_equal(path.at(START_TIME - 1), [path.q[0], np.zeros(4)])
    np.testing.assert_array_equal(path.at(path.end), [path.q[-1], np.zeros(4)])


def test_names_come_in_any_order():
    times, q = wavy()
    points = [*list(zip(times, q, -q, strict=True))[:-1], (times[-1], q[-1])]
    straight = parse_request(ARM, message(points))
    turned = [(t, np.asarray(q)[::-1], *(np.asarray(v)[::-1] for v in qd)) for t, q, *qd in points]
    other = parse_request(ARM, message(turned, JOINTS[::-1]))
    np.testing.assert_array_equal(straight.q, other.q)
    np.testing.assert_array_equal(straight.qd, other.qd)
    assert np.isnan(straight.qd[-1]).all()


@pytest.mark.parametrize("n", [1, 9, 10, 12])
def test_an_arm_may_have_any_number_of_joints(n):
    """`joint_10` comes before `joint_2` in the order of letters."""
    arm = replace(ARM, links=(ARM.links * 3)[:n])
    names = [f"joint_{i}" for i in range(n, 0, -1)]
    asked = parse_request(arm, message([(1.0, np.arange(n, 0, -1))], names))
    assert asked.q[0].tolist() == list(range(1, n + 1))


def test_a_path_begins_where_the_arm_is_and_reaches_every_point():
    times, q = wavy()
    path = plan_trajectory(
        ARM, Request(0, times, q, np.full_like(q, np.nan)), START_TIME, at_rest()
    )
    assert path.begin == START_TIME
    np.testing.assert_array_equal(path.q[0], np.zeros(4))
    np.testing.assert_allclose(
        [path.at(START_TIME + round(t * SECOND))[0] for t in times], q, atol=1e-8
    )
    np.testing.assert_array_equal(path.qd[[0, -1]], np.zeros((2, 4)))


def test_one_that_says_itself_where_it_begins_must_begin_nearby():
    times, q = wavy()
    request = Request(0, times - times[0], q, np.full_like(q, np.nan))
    assert len(plan_trajectory(ARM, request, START_TIME, at_rest(*q[0] + 0.2)).times) == len(times)
    with pytest.raises(
        TrajectoryError, match=r"joint_1 starts 17.19 deg from its present position"
    ):
        plan_trajectory(ARM, request, START_TIME, at_rest(*q[0] + 0.3))


def test_of_a_trajectory_that_has_begun_the_rest_is_followed():
    times, q = wavy()
    request = Request(START_TIME, times, q, np.full_like(q, np.nan))
    now = START_TIME + round(times[3] * SECOND) + SECOND // 10
    path = plan_trajectory(ARM, request, now, at_rest(*q[3]))
    assert path.begin == now
    np.testing.assert_allclose(path.times[1:], times[4:] - times[3] - 0.1, atol=1e-9)
    np.testing.assert_array_equal(path.q[1:], q[4:])
    ended = START_TIME + round(times[-1] * SECOND)
    check_time(request, ended - SECOND)
    with pytest.raises(TrajectoryError, match="ends in the past") as error:
        check_time(request, ended)
    assert error.value.code is Code.OLD_HEADER_TIMESTAMP


def test_one_in_the_future_begins_when_it_says():
    times, q = wavy()
    request = Request(START_TIME + 5 * SECOND, times, q, np.full_like(q, np.nan))
    assert plan_trajectory(ARM, request, START_TIME, at_rest()).begin == START_TIME + 5 * SECOND
    with pytest.raises(TrajectoryError, match=r"starts 120.0 s ahead, expected at most 119"):
        check_time(request, START_TIME - 115 * SECOND)


def test_long_waits_are_divided_without_a_change():
    q = np.array([np.zeros(4), np.full(4, 0.5)])
    request = Request(0, np.array([0.0, 150.0]), q, np.zeros_like(q))
    path = plan_trajectory(ARM, request, START_TIME, at_rest())
    assert np.diff(path.times).max() <= MAX_SEGMENT
    whole = Trajectory(START_TIME, request.times, q, request.qd)
    for t in np.linspace(0.0, 150.0, 31):
        at = START_TIME + round(t * SECOND)
        np.testing.assert_allclose(path.at(at), whole.at(at), atol=1e-9)


FOUR = np.zeros(4)
REFUSED = {
    "has 'x', expected each of joint_1": (Code.INVALID_JOINTS, [(1.0, FOUR)], [*"xyz", ""]),
    "is joint_1, joint_2, joint_3, expected each of joint_1":
        (Code.INVALID_JOINTS, [(1.0, np.zeros(3))], JOINTS[:3]),
    "joint_names is 1000000 names": (Code.INVALID_JOINTS, [(1.0, FOUR)], JOINTS * 250_000),
    "joint_names is empty": (Code.INVALID_JOINTS, [(1.0, FOUR)], []),
    "points has 0 elements, expected 1 to 10000": (Code.INVALID_GOAL, [], JOINTS),
    "positions of point 0 has 3 numbers, expected 4":
        (Code.INVALID_GOAL, [(1.0, np.zeros(3))], JOINTS),
    "velocities of point 0 has 3 numbers, expected 4":
        (Code.INVALID_GOAL, [(1.0, FOUR, np.zeros(3))], JOINTS),
    "time_from_start of point 1 is 1 s, expected more than the 1 s of the point before":
        (Code.INVALID_GOAL, [(1.0, FOUR)] * 2, JOINTS),
    "last point are up to 1 rad/s, expected 0":
        (Code.INVALID_GOAL, [(1.0, FOUR, np.ones(4))], JOINTS),
}  # fmt: skip


@pytest.mark.parametrize("words", REFUSED)
def test_malformed_trajectories_are_refused(words):
    code, points, names = REFUSED[words]
    with pytest.raises(TrajectoryError, match=words) as error:
        parse_request(ARM, message(points, names))
    assert error.value.code is code
    assert len(str(error.value)) < 200


def test_rounding_errors_in_the_last_velocity_are_removed():
    request = parse_request(ARM, message([(1.0, np.zeros(4), [-9e-17, 1e-8, 0.0, 0.0])]))
    assert not request.qd[-1].any()
    assert np.isnan(parse_request(ARM, message([(1.0, np.zeros(4))])).qd[-1]).all()


def test_the_longest_trajectory_is_read_and_a_longer_one_is_not():
    times = 0.36 * np.arange(MAX_POINTS)
    points = [*zip(times, np.zeros((MAX_POINTS, 4)), strict=True)]
    whole = message(points)
    assert parse_request(ARM, whole).q.shape == (MAX_POINTS, 4)
    whole.points.append(whole.points[-1])
    with pytest.raises(TrajectoryError, match="points has 10001 elements, expected 1 to 10000"):
        parse_request(ARM, whole)


# --- every number of a goal ----------------------------------------------------------------------

TOLERANCES = [
    (field, name)
    for field in ("path_tolerance", "goal_tolerance")
    for name in ("position", "velocity", "acceleration")
]


def valid_goal():
    """Return a goal in which every field that may be filled is."""
    whole = FollowJointTrajectory.Goal()
    for field in (whole.path_tolerance, whole.goal_tolerance):
        field += [JointTolerance(name=name, position=0.1, velocity=0.1) for name in JOINTS]
    whole.trajectory = message([(1.0, np.zeros(4), np.zeros(4)), (2.0, np.zeros(4), np.zeros(4))])
    for point in whole.trajectory.points:
        point.accelerations = [0.0] * 4
    return whole


def refusal(goal):
    """Return why a goal is refused; empty: it is not."""
    try:
        reject_unsupported_fields(goal)
        DEFAULT.with_goal(goal)
        parse_request(ARM, goal.trajectory)
    except TrajectoryError as error:
        return str(error)
    return ""


def test_numbers_of_goals_are_bounded_as_those_of_topics():
    assert MAX_MAGNITUDE == validation.MAX_MAGNITUDE


def test_a_goal_with_every_field_filled_is_valid():
    assert refusal(valid_goal()) == ""


@pytest.mark.parametrize("value", [nan, -inf, 1e18])
@pytest.mark.parametrize("field", ["positions", "velocities", "accelerations"])
def test_numbers_of_points_are_bounded(field, value):
    goal = valid_goal()
    getattr(goal.trajectory.points[0], field)[2] = value
    expected = "finite numbers of at most 1e+12 in size"
    given = f"{field} of point 0 has {value:g} for joint_3"
    assert refusal(goal) == f"{given}, expected {expected}"


THOUSANDS = [0.0] * 100_000
TWICE = [JointTolerance(name="joint_1")] * 2
SIZES = [  # a field, its value, and why that is refused
    *((f"point.{field}", THOUSANDS, f"{field} of point 1 has 100000 numbers, expected 4")
      for field in ("positions", "velocities", "accelerations")),
    *(("point.effort", values, f"effort of point 1 has {len(values)} numbers, expected none")
      for values in ([0.0], [nan] * 4, THOUSANDS)),
    *((field, [JointComponentTolerance()], f"{field} has 1 elements, expected none")
      for field in ("component_path_tolerance", "component_goal_tolerance")),
    ("multi.points", [MultiDOFJointTrajectoryPoint()] * 100_000,
     "multi_dof_trajectory.points has 100000 elements, expected none"),
    ("multi.joint_names", ["base"],
     "multi_dof_trajectory.joint_names has 1 elements, expected none"),
    *((field, 50_000 * TWICE, f"{field} has 100000 elements, expected at most 4, one per joint")
      for field in ("path_tolerance", "goal_tolerance")),
    *((field, TWICE, f"{field} names 'joint_1', expected some of joint_1, joint_2")
      for field in ("path_tolerance", "goal_tolerance")),
    ("path_tolerance", [JointTolerance(name="elbow")], "path_tolerance names 'elbow'"),
]  # fmt: skip


@pytest.mark.parametrize(("field", "value", "words"), SIZES)
def test_each_field_has_as_many_elements_as_there_are_joints(field, value, words):
    goal = valid_goal()
    places = {"point": goal.trajectory.points[1], "multi": goal.multi_dof_trajectory, "": goal}
    place, _, name = field.rpartition(".")
    setattr(places[place], name, value)
    assert refusal(goal).startswith(words)


@pytest.mark.parametrize("value", [nan, inf, -1e18, -0.5, 5e-324])
@pytest.mark.parametrize(("field", "name"), TOLERANCES)
def test_tolerances_are_bounded(field, name, value):
    goal = valid_goal()
    setattr(getattr(goal, field)[1], name, value)
    unit = {"position": "rad", "velocity": "rad/s", "acceleration": "rad/s^2"}[name]
    given = f"{name} in {field} of joint_2 is {value:g} {unit}"
    assert refusal(goal) == f"{given}, expected -1, 0, or 1e-06 to 1e+12"


@pytest.mark.parametrize(
    ("sec", "nanosec"), [(2**31 - 1, 0), (10**6, 0), (3600, 1), (-1, 0), (1, 10**9), (0, 2**32 - 1)]
)
def test_times_are_within_an_hour(sec, nanosec):
    goal = valid_goal()
    goal.trajectory.points[1].time_from_start = DurationMessage(sec=sec, nanosec=nanosec)
    shown = f"{sec} s and {nanosec} ns" if nanosec else f"{sec} s"
    given = f"time_from_start of point 1 is {shown}"
    assert refusal(goal) == f"{given}, expected 0 to 3600 s"


@pytest.mark.parametrize(("sec", "nanosec"), [(2**31 - 1, 0), (3601, 0), (-2, 0), (-1, 1)])
def test_goal_time_tolerances_are_within_an_hour(sec, nanosec):
    goal = valid_goal()
    goal.goal_time_tolerance = DurationMessage(sec=sec, nanosec=nanosec)
    assert "goal_time_tolerance is" in refusal(goal)
    assert refusal(goal).endswith("s, expected -1, 0, or 1e-06 to 3600")


def test_nanoseconds_are_less_than_a_second():
    goal = valid_goal()
    goal.goal_time_tolerance.nanosec = 2**32 - 1
    assert refusal(goal) == "goal_time_tolerance has 4294967295 ns, expected less than 1000000000"
    for sec, nanosec in ((-1, 0), (1, 10**9)):
        goal = valid_goal()
        goal.trajectory.header.stamp = Time(sec=sec, nanosec=nanosec)
        assert refusal(goal).startswith(f"header.stamp is {sec} s")


def test_long_names_are_shown_in_part():
    goal = valid_goal()
    goal.trajectory.joint_names = ["x" * 1_000_000, *JOINTS[1:]]
    assert len(refusal(goal)) < 200
    goal = valid_goal()
    goal.path_tolerance = [JointTolerance(name="x" * 1_000_000)]
    assert len(refusal(goal)) < 200


# --- limits --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("q", "times", "words"),
    [
        ([1.55, 1.55], [3.0, 6.0], r"joint_2 would be at 9\d\.\d+ deg, expected -90 to 90 deg"),
        ([1.0], [1.0], r"joint_2 would turn at 85.94 deg/s, expected at most 57.3 deg/s"),
        ([0.1, 0.1], [1.0, 1.0005], r"points are 0.0005 s apart"),
    ],
)
def test_what_the_arm_cannot_do_is_refused(q, times, words):
    points = np.outer(q, [0.0, 1.0, 0.0, 0.0])
    request = Request(0, np.array(times), points, np.full_like(points, np.nan))
    with pytest.raises(TrajectoryError, match=words):
        plan_trajectory(ARM, request, START_TIME, at_rest())


def test_limits_are_checked_between_the_knots():
    """Against dense samples, on random paths about the limits."""
    rng = np.random.default_rng(7)
    outcomes = set()
    for _ in range(200):
        times = np.cumsum(rng.uniform(0.6, 2.0, 4))
        q = rng.uniform(-0.75, 0.75, (4, 4)) + rng.choice([-0.9, 0.0, 0.9])
        qd = rng.uniform(-0.9, 0.9, (4, 4))
        qd[-1] = 0.0
        try:
            path = plan_trajectory(ARM, Request(0, times - times[0], q, qd), 0, at_rest(*q[0]))
            good, path = True, CubicHermiteSpline(path.times, path.q, path.qd)
        except TrajectoryError:
            good, path = False, CubicHermiteSpline(times - times[0], q, qd)
        dense = np.linspace(0.0, times[-1] - times[0], 4000)
        most, fastest = np.abs(path(dense)).max() - np.pi / 2, np.abs(path(dense, 1)).max() - 1.1
        if min(abs(most), abs(fastest)) > 1e-4:
            assert good == (max(most, fastest) < 0.0)
            outcomes.add(good)
    assert outcomes == {True, False}


# --- tolerances ----------------------------------------------------------------------------------

DEFAULT = Tolerances((Tolerance(),) * 4, (Tolerance(0.005, 0.01),) * 4, 5.0)


def goal(path=(), end=(), time=0.0):
    given = FollowJointTrajectory.Goal(path_tolerance=list(path), goal_tolerance=list(end))
    given.goal_time_tolerance = Duration(seconds=time).to_msg()
    return given


def test_a_goal_changes_defaults_and_erases_them():
    path = [JointTolerance(name="joint_2", position=0.1)]
    end = [JointTolerance(name="joint_3", position=-1.0), JointTolerance(name="joint_1")]
    found = DEFAULT.with_goal(goal(path, end, 2.0))
    assert found.path[1] == Tolerance(0.1, 0.0)
    assert found.goal == (DEFAULT.goal[0], DEFAULT.goal[1], Tolerance(0.0, 0.01), DEFAULT.goal[3])
    assert (found.goal_time, DEFAULT.with_goal(goal()).goal_time) == (2.0, 5.0)
    assert DEFAULT.with_goal(goal(time=-1.0)).goal_time == 0.0


# --- following -----------------------------------------------------------------------------------

PATH = Trajectory(
    START_TIME, np.array([0.0, 4.0]), np.array([np.zeros(4), np.full(4, 0.4)]), np.zeros((2, 4))
)


def links(seconds, off=0.0, **changes):
    """States measured at a time since the start, joint 2 off the path."""
    at = START_TIME + round(seconds * SECOND)
    q, qd = PATH.at(at)
    error = off * np.array([0.0, 1.0, 0.0, 0.0])
    state = {"effort": 0.0, "armed": True, "referenced": True, "following": True, "path": 1}
    state |= {"broken": False, **changes}
    return {
        i: LinkState(at, at, float(q[i - 1] + error[i - 1]), float(qd[i - 1]), **state)
        for i in range(1, 5)
    }


def following(**tolerances):
    path, end = tolerances.get("path", 0.0), tolerances.get("end", 0.005)
    wanted = Tolerances(
        (Tolerance(path),) * 4, (Tolerance(end, 0.01),) * 4, tolerances.get("time", 1.0)
    )
    return TrajectoryMonitor(PATH, wanted, 1.0)


def test_errors_are_those_at_the_time_of_the_measurement():
    found = following().progress(links(1.3, off=0.02))
    off = found.actual[0] - found.desired[0]
    np.testing.assert_allclose(off, [0.0, 0.02, 0.0, 0.0], atol=1e-12)
    assert found.time == pytest.approx(1.3)


def test_it_is_over_when_all_are_there_and_at_rest():
    assert not following().is_goal_reached(links(3.9))
    assert following().is_goal_reached(links(4.1))
    assert not following().is_goal_reached(links(4.1, off=0.006))
    assert following(end=0.0).is_goal_reached(links(4.1, off=0.5))
    with pytest.raises(TrajectoryError, match=r"joint_2 is off by 0.006 rad, at most 0.005") as e:
        following().is_goal_reached(links(5.1, off=0.006))
    assert e.value.code is Code.GOAL_TOLERANCE_VIOLATED
    assert not following(time=0.0).is_goal_reached(links(1000.0, off=0.006))


def test_who_leaves_the_path_ends_it():
    assert not following(path=0.1).is_goal_reached(links(2.0, off=0.09))
    with pytest.raises(TrajectoryError, match=r"joint_2 is off by 0.11 rad") as error:
        following(path=0.1).is_goal_reached(links(2.0, off=0.11))
    assert error.value.code is Code.PATH_TOLERANCE_VIOLATED
    assert not following(path=0.1).is_goal_reached(links(-0.1, off=0.11))  # not begun yet


@pytest.mark.parametrize(("broken", "words"), [(True, "left its path"), (False, "does not follow")])
def test_a_link_that_does_not_follow_ends_it(broken, words):
    lost = {"following": False, "broken": broken}
    assert not following().is_goal_reached(links(0.9, **lost))  # it may not have heard of it
    assert not following().is_goal_reached(links(3.95, **lost))  # it may have arrived
    with pytest.raises(TrajectoryError, match=f"link 1 {words}"):
        following().is_goal_reached(links(1.1, **lost))
