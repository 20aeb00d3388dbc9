"""Activities of the base alone: hold it, move it to a pose, move it along a path."""

from collections.abc import Iterator
from contextlib import contextmanager
from math import inf

import numpy as np
import numpy.typing as npt

from fss_arm_model.arrays import Floats
from fss_gnc import bounds
from fss_gnc.guidance.activity import (
    ActivityError,
    Commands,
    Craft,
    Observation,
    Outcome,
    tracking_problem,
)
from fss_gnc.guidance.free_space import FreeSpace
from fss_gnc.guidance.give_way import GiveWay
from fss_gnc.guidance.limits import braking, limit_use, min_duration
from fss_gnc.guidance.settings import GuidanceSettings
from fss_gnc.reference import Body, Path, Reference, pose_error

MAX_KNOTS = 10_000
MIN_STEP = 0.001  # between knots [s]
# Allowed decrease of a gap on a path that the base follows, whose checks use other times and other
# measurements than the first one [m].
PATH_TOLERANCE = 0.005


class PathMotion:
    """Activity that moves the base along a path and then holds its last pose for a while.

    It gives way to other vehicles, and then continues. It brakes, and then fails, if edge or target
    are in the way. If it is canceled on the path, it brakes before it ends. For a while it
    continues without joint states.

    Args:
        craft: whose base.
        phase: name of the phase during the motion.
        path: starts at time 0.
        hold: how long to hold at the end [s]; inf: until it is canceled.
        arrival_timeout: time after the path's end by which the base must be at rest there [s];
            None: it only has to stay near its reference.
    """

    def __init__(
        self, craft: Craft, phase: str, path: Path, hold: float, arrival_timeout: float | None
    ) -> None:
        self.settings, self.free_space = craft.settings, FreeSpace(craft)
        self.give_way = GiveWay(craft, self.free_space, path, may_detour=phase == "go_to")
        self.phase, self.path, self.hold, self.arrival_timeout = phase, path, hold, arrival_timeout
        self.arrival_time: float | None = None  # time at which the goal was reached [s]
        self.offset, self.largest_offset = np.zeros(3), np.zeros(3)  # from the reference
        self.remaining = inf  # [s]
        self.cancel_reason = ""  # why it brakes, or stops holding
        self.cancel_is_success = False  # True if a cancel request now is no failure

    def step(self, obs: Observation) -> Commands:
        """Return the commands until the next step."""
        joints_unknown = "" if obs.q is not None else "joints are unknown and assumed at rest"
        obs = obs.with_joints_at_rest()
        q, qd = obs.floating_state
        base = Body(q[:3], qd[:3])
        if not self.cancel_reason and self.arrival_timeout is not None:
            self._keep_clear(obs)
        if self.cancel_reason and not self.cancel_is_success and self.phase != "brake":
            self.phase, self.path = "brake", braking(self.settings, base, obs.t)
        self._measure(obs.t, base)
        waits = bool(self.give_way.waits_for) and not self.cancel_reason
        is_moving = obs.t < self.path.end_time or bool(self.cancel_reason)
        gives_way = self.give_way.reason if is_moving or waits else ""
        return Commands(
            "wait" if waits else self.phase if is_moving else "hold",
            self.path,
            keep_out=self.settings.keep_out,
            reason=self.cancel_reason or gives_way or joints_unknown,
            outcome=self._outcome(obs, base),
            plan=self.give_way.plan(self.path, obs.t) if waits else self.path,
        )

    def tolerates(self, obs: Observation) -> bool:
        """Return True if the base is known, and the joints were known a short time ago."""
        return obs.base is not None and abs(obs.joints_age) <= self.settings.joint_timeout

    def cancel(self, reason: str) -> None:
        """Stop holding, or brake."""
        if not self.cancel_reason:
            self.cancel_is_success = self.arrival_time is not None
        self.interrupt(reason)

    def interrupt(self, reason: str) -> None:
        """Brake, and fail."""
        self.cancel_reason = self.cancel_reason or reason

    def _keep_clear(self, obs: Observation) -> None:
        """Give way to other vehicles; brake if the rest of the path is not free otherwise."""
        try:
            if obs.t < self.path.end_time or self.give_way.waits_for:
                self.path = self.give_way.update(self.path, obs)
            if obs.t < self.path.end_time:
                self.free_space.check(self.path, obs.t, obs, tolerance=PATH_TOLERANCE)
        except ActivityError as error:
            self.interrupt(str(error))

    def _measure(self, t: float, base: Body) -> None:
        self.offset = pose_error(base.pose, self.path.at(t).pose)
        self.largest_offset = np.maximum(self.largest_offset, np.abs(self.offset))
        end = self.path.end_time if self.arrival_time is None else self.arrival_time
        self.remaining = inf if self.give_way.waits_for else max(0.0, end + self.hold - t)

    def _outcome(self, obs: Observation, base: Body) -> Outcome | None:
        s, t = self.settings, obs.t
        distance, turn = float(np.hypot(*self.offset[:2])), abs(float(self.offset[2]))
        if problem := tracking_problem(obs, self.offset, s):
            return Outcome(False, problem)
        if self.cancel_reason:
            if not (self.cancel_is_success or t >= self.path.end_time):
                return None
            return Outcome(True) if self.cancel_is_success else Outcome(False, self.cancel_reason)
        if self.give_way.waits_for:
            return None
        if (
            self.arrival_time is None
            and t >= self.path.end_time
            and self._is_at_goal(base, distance, turn)
        ):
            self.arrival_time = t
        if self.arrival_time is not None:
            return Outcome(True) if t >= self.arrival_time + self.hold else None
        if self.arrival_timeout is not None and t > self.path.end_time + self.arrival_timeout:
            return Outcome(
                False,
                f"the base is {distance:.3f} m and {np.degrees(turn):.1f} deg off its goal, or not "
                f"at rest, {self.arrival_timeout:g} s after the planned time",
            )
        return None

    def _is_at_goal(self, base: Body, distance: float, turn: float) -> bool:
        s = self.settings
        is_near = distance <= s.tolerance and turn <= s.heading_tolerance
        speed, turning = float(np.hypot(*base.twist[:2])), abs(float(base.twist[2]))
        return self.arrival_timeout is None or (
            is_near and speed <= s.rest_speed and turning <= s.rest_turn_rate
        )


def hold(craft: Craft, obs: Observation, pose: npt.ArrayLike, duration: float) -> PathMotion:
    """Hold the base at a pose near its present one, (3,), or where it comes to rest, ().

    Args:
        craft: whose base.
        obs: state at the start.
        pose: to hold [m, m, rad].
        duration: how long [s]; 0: until it is canceled.

    Raises:
        ActivityError: a value is invalid, the pose is too far, or the path to it is not free.
    """
    q, qd = obs.floating_state
    with _activity_errors():
        duration = bounds.check_duration("duration", duration) or inf
        goal = bounds.check_pose("pose", pose, craft.settings.table) if np.size(pose) else None
    if goal is None:
        return PathMotion(
            craft, "hold", braking(craft.settings, Body(q[:3], qd[:3])), duration, None
        )
    _check_distance(craft.settings, "pose", goal, q[:3], "; use base/go_to to move there")
    goal = q[:3] + pose_error(goal, q[:3])
    motion = PathMotion(craft, "hold", Path(np.zeros(1), goal.reshape(1, 1, 3)), duration, None)
    path = Path(np.array([0.0, 1.0]), np.array([[q[:3]], [goal]]))
    motion.free_space.check(path, 0.0, obs)
    return motion


def go_to(
    craft: Craft, obs: Observation, pose: npt.ArrayLike, duration: float, hold_duration: float
) -> PathMotion:
    """Move the base straight to a pose, (3,), and hold it there.

    Args:
        craft: whose base.
        obs: state at the start.
        pose: goal [m, m, rad]; the heading takes the shorter turn.
        duration: of the motion [s]; 0: as short as the limits allow.
        hold_duration: at the end [s].

    Raises:
        ActivityError: a value is invalid, the limits do not allow it, or the path is not free.
    """
    q, qd = obs.floating_state
    start = Reference(q[:3], qd[:3], np.zeros(3))
    with _activity_errors():
        goal = q[:3] + pose_error(bounds.check_pose("pose", pose, craft.settings.table), q[:3])
        duration = bounds.check_duration("duration", duration)
        hold_duration = bounds.check_duration("hold_duration", hold_duration)
    minimum = min_duration(craft.settings, start, goal)
    duration = duration or minimum
    if duration < minimum - 1e-6:
        raise ActivityError(
            f"duration is {duration:g} s, expected at least {minimum:.1f} s for the limits"
        )
    path = Path.between(start, goal, 0.0, duration)
    return _checked_motion(craft, obs, "go_to", path, hold_duration)


def follow(
    craft: Craft,
    obs: Observation,
    times: npt.ArrayLike,
    poses: npt.ArrayLike,
    twists: npt.ArrayLike,
) -> PathMotion:
    """Move the base along the knots of a path.

    Args:
        craft: whose base.
        obs: state at the start.
        times: (k,) increasing from 0 [s].
        poses: (3 k,) [m, m, rad]; the first near the base, headings take the shorter turn.
        twists: (3 k,) in the world; (): those of the cubic spline that rests at both ends.

    Raises:
        ActivityError: a value is invalid, the limits do not allow it, or the path is not free.
    """
    from scipy.interpolate import CubicSpline

    knots, numbers, rates = np.size(times), np.size(poses), np.size(twists)
    if not 2 <= knots <= MAX_KNOTS:
        raise ActivityError(f"time has {knots} knots, expected 2 to {MAX_KNOTS}")
    if numbers != 3 * knots:
        raise ActivityError(f"pose has {numbers} numbers, expected {3 * knots} for {knots} knots")
    if rates not in (0, numbers):
        raise ActivityError(f"twist has {rates} numbers, expected {numbers}, or none")
    with _activity_errors():
        t = bounds.check_knot_times("time", times, MIN_STEP)
        x = bounds.check_poses("pose", poses, craft.settings.table)
        v = bounds.check_twists("twist", twists)
    if t[0] != 0.0:
        raise ActivityError(f"time[0] is {t[0]:g} s, expected 0 s")
    x[:, 2] = np.unwrap(x[:, 2])
    v = v if len(v) else CubicSpline(t, x, bc_type="clamped")(t, 1)
    speed, turn_rate = craft.settings.rest_speed, craft.settings.rest_turn_rate
    if (np.abs(v[-1]) > (speed, speed, turn_rate)).any():
        last = v[-1].tolist()
        raise ActivityError(f"the last twist is {last} m/s, rad/s, expected 0: the base rests then")
    path = Path(t, np.stack([x, v], axis=1))
    _check_distance(craft.settings, "the first pose", x[0], obs.floating_state[0][:3])
    _check_limits(craft.settings, path)
    return _checked_motion(craft, obs, "follow", path, 0.0)


def _checked_motion(
    craft: Craft, obs: Observation, phase: str, path: Path, hold: float
) -> PathMotion:
    motion = PathMotion(craft, phase, path, hold, craft.settings.max_overrun)
    motion.free_space.check(path, 0.0, obs, every_segment=True)
    return motion


def _check_limits(settings: GuidanceSettings, path: Path) -> None:
    if not (worst := limit_use(settings, path)).share <= 1.0 + 1e-3:  # NaN, too
        raise ActivityError(worst.description)


def _check_distance(
    settings: GuidanceSettings, name: str, pose: Floats, present: Floats, hint: str = ""
) -> None:
    error = pose_error(pose, present)
    distance, turn = float(np.hypot(*error[:2])), abs(float(error[2]))
    if distance > settings.max_offset or turn > settings.max_turn:
        raise ActivityError(
            f"{name} is {distance:.3f} m and {np.degrees(turn):.1f} deg from the base, "
            f"expected at most {settings.max_offset:g} m and "
            f"{np.degrees(settings.max_turn):.0f} deg{hint}"
        )


@contextmanager
def _activity_errors() -> Iterator[None]:
    """Convert a ValueError about a goal's number to an ActivityError."""
    try:
        yield
    except ValueError as error:
        raise ActivityError(str(error)) from None
