"""Activities of the base alone: hold it, move it to a pose, move it along a path."""

from collections.abc import Iterator
from contextlib import contextmanager
from math import inf
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fss_gnc import bounds
from fss_gnc.guidance.activity import ActivityError, Craft, Ended, Floats, Orders, Seen
from fss_gnc.guidance.free_space import FreeSpace
from fss_gnc.guidance.settings import GuidanceSettings
from fss_gnc.reference import Body, Path, Reference, off

MAX_KNOTS = 10_000
MIN_STEP = 0.001  # between knots [s]
MIN_DURATION = 1.0  # of a motion [s]


class AlongPath:
    """Activity that moves the base along a path and then holds its last pose for a while.

    It brakes, and then fails, if the rest of the path is no longer free. If it is cancelled on the
    path, it brakes before it ends.

    Args:
        craft: whose base.
        phase: name of the phase during the motion.
        path: starts at time 0.
        hold: how long to hold at the end [s]; inf: until it is cancelled.
        patience: time after the path's end by which the base must be at rest there [s]; None: it
            only has to stay near its reference.
    """

    blind = False

    def __init__(
        self, craft: Craft, phase: str, path: Path, hold: float, patience: float | None
    ) -> None:
        self.settings, self.free_space = craft.settings, FreeSpace(craft)
        self.phase, self.path, self.hold, self.patience = phase, path, hold, patience
        self.reached: float | None = None  # time at which the goal was reached [s]
        self.offset, self.largest_offset = np.zeros(3), np.zeros(3)  # from the reference
        self.remaining = inf  # [s]
        self.cancelled = ""  # why it brakes, or stops holding
        self.well = False  # True if a cancel request now is no failure

    def step(self, seen: Seen) -> Orders:
        """Return the orders for now."""
        q, qd = seen.floating
        base = Body(q[:3], qd[:3])
        self._measure(seen.t, base)
        if seen.t < self.path.end and not self.cancelled and self.patience is not None:
            try:
                self.free_space.check(self.path, seen.t, seen)
            except ActivityError as error:
                self.cancel(str(error))
        if self.cancelled and not self.well and self.phase != "brake":
            self.phase, self.path = "brake", braking(self.settings, base, seen.t)
        return Orders(
            self.phase if seen.t < self.path.end or self.cancelled else "hold", self.path,
            keep_out=self.settings.keep_out, reason=self.cancelled, ended=self._end(seen.t, base),
        )  # fmt: skip

    def cancel(self, reason: str) -> None:
        """Stop holding, or brake."""
        self.cancelled = self.cancelled or reason
        self.well = self.well or self.reached is not None

    def _measure(self, t: float, base: Body) -> None:
        self.offset = off(base.pose, self.path.at(t).pose)
        self.largest_offset = np.maximum(self.largest_offset, np.abs(self.offset))
        end = self.path.end if self.reached is None else self.reached
        self.remaining = max(0.0, end + self.hold - t)

    def _end(self, t: float, base: Body) -> Ended | None:
        s = self.settings
        distance, turn = float(np.hypot(*self.offset[:2])), abs(float(self.offset[2]))
        if distance > s.max_offset or turn > s.max_turn:
            return Ended(
                False,
                f"the base is {distance:.3f} m and {np.degrees(turn):.1f} deg off its reference, "
                f"expected at most {s.max_offset:g} m and {np.degrees(s.max_turn):.0f} deg",
            )
        if self.cancelled:
            over = self.well or t >= self.path.end
            return Ended(self.well, "" if self.well else self.cancelled) if over else None
        if self.reached is None and t >= self.path.end and self._is_there(base, distance, turn):
            self.reached = t
        if self.reached is not None:
            return Ended(True) if t >= self.reached + self.hold else None
        if self.patience is not None and t > self.path.end + self.patience:
            return Ended(
                False,
                f"the base is {distance:.3f} m and {np.degrees(turn):.1f} deg off its goal, or not "
                f"at rest, {self.patience:g} s after the planned time",
            )
        return None

    def _is_there(self, base: Body, distance: float, turn: float) -> bool:
        s = self.settings
        near = distance <= s.tolerance and turn <= s.heading_tolerance
        speed, turning = float(np.hypot(*base.twist[:2])), abs(float(base.twist[2]))
        return self.patience is None or (near and speed <= s.still and turning <= s.turning_still)


def hold(craft: Craft, seen: Seen, pose: npt.ArrayLike, duration: float) -> AlongPath:
    """Hold the base at a pose near its present one, (3,), or where it comes to rest, ().

    Args:
        craft: whose base.
        seen: state at the start.
        pose: to hold [m, m, rad].
        duration: how long [s]; 0: until it is cancelled.

    Raises:
        ActivityError: a value is invalid, the pose is too far, or the path to it is not free.
    """
    q, qd = seen.floating
    with _activity_errors():
        lasts = bounds.duration("duration", duration) or inf
        goal = bounds.pose("pose", pose, craft.settings.table) if np.size(pose) else None
    if goal is None:
        return AlongPath(craft, "hold", braking(craft.settings, Body(q[:3], qd[:3])), lasts, None)
    _check_near(craft.settings, "pose", goal, q[:3], "; base/go_to goes there")
    goal = q[:3] + off(goal, q[:3])
    found = AlongPath(craft, "hold", Path(np.zeros(1), goal.reshape(1, 1, 3)), lasts, None)
    way = Path(np.array([0.0, 1.0]), np.array([[q[:3]], [goal]]))
    found.free_space.check(way, 0.0, seen)
    return found


def go_to(
    craft: Craft, seen: Seen, pose: npt.ArrayLike, duration: float, hold_duration: float
) -> AlongPath:
    """Move the base straight to a pose, (3,), and hold it there.

    Args:
        craft: whose base.
        seen: state at the start.
        pose: goal [m, m, rad]; the heading takes the shorter turn.
        duration: of the motion [s]; 0: as short as the limits allow.
        hold_duration: at the end [s].

    Raises:
        ActivityError: a value is invalid, the limits do not allow it, or the path is not free.
    """
    q, qd = seen.floating
    begin = Reference(q[:3], qd[:3], np.zeros(3))
    with _activity_errors():
        goal = q[:3] + off(bounds.pose("pose", pose, craft.settings.table), q[:3])
        duration = bounds.duration("duration", duration)
        hold_duration = bounds.duration("hold_duration", hold_duration)
    shortest = least_duration(craft.settings, begin, goal)
    lasts = duration or shortest
    if lasts < shortest - 1e-6:
        raise ActivityError(
            f"duration is {lasts:g} s, expected at least {shortest:.1f} s for the limits"
        )
    path = Path.between(begin, goal, 0.0, lasts)
    return _along(craft, seen, "go_to", path, hold_duration)


def follow(
    craft: Craft, seen: Seen, times: npt.ArrayLike, poses: npt.ArrayLike, twists: npt.ArrayLike
) -> AlongPath:
    """Move the base along the knots of a path.

    Args:
        craft: whose base.
        seen: state at the start.
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
        t = bounds.knot_times("time", times, MIN_STEP)
        x = bounds.poses("pose", poses, craft.settings.table)
        v = bounds.twists("twist", twists)
    if t[0] != 0.0:
        raise ActivityError(f"time[0] is {t[0]:g} s, expected 0 s")
    x[:, 2] = np.unwrap(x[:, 2])
    v = v if len(v) else CubicSpline(t, x, bc_type="clamped")(t, 1)
    path = Path(t, np.stack([x, v], axis=1))
    _check_near(craft.settings, "the first pose", x[0], seen.floating[0][:3])
    _check_limits(craft.settings, path)
    return _along(craft, seen, "follow", path, 0.0)


def _along(craft: Craft, seen: Seen, phase: str, path: Path, hold: float) -> AlongPath:
    found = AlongPath(craft, phase, path, hold, craft.settings.max_overrun)
    found.free_space.check(path, 0.0, seen, whole=True)
    return found


def braking(settings: GuidanceSettings, base: Body, start: float = 0.0) -> Path:
    """Return a path that brings the base to rest within the limits, from the time `start` [s]."""
    v, omega = float(np.hypot(*base.twist[:2])), abs(float(base.twist[2]))
    lasts = 1.5 * max(v / settings.acceleration, omega / settings.turn_acceleration)
    lasts = max(MIN_DURATION, lasts)
    begin = Reference(base.pose, base.twist, np.zeros(3))
    return Path.between(begin, base.pose + 0.5 * lasts * base.twist, start, lasts)


class Peak(NamedTuple):
    """Largest share of a limit that a path takes, and its description."""

    share: float
    words: str


def peak(settings: GuidanceSettings, path: Path, slack: Floats | None = None) -> Peak:
    """Return the largest share of a limit that a path takes.

    Args:
        settings: the limits.
        path: of the base.
        slack: (3,) twist that is allowed regardless of the limits, as the base already has it.
    """
    s, t = settings, np.zeros(3) if slack is None else slack
    times, found = path.resolved(float(path.times[0]))
    speed, gain = np.hypot(*found[:, 1, :2].T), np.hypot(*found[:, 2, :2].T)
    turning, spin_up = np.abs(found[:, 1:, 2]).T
    rows = (
        ("moves with", "m/s", speed, max(s.speed, 1.05 * float(np.hypot(*t[:2])))),
        ("turns with", "rad/s", turning, max(s.turn_rate, 1.05 * abs(float(t[2])))),
        ("accelerates with", "m/s^2", gain, s.acceleration),
        ("accelerates with", "rad/s^2", spin_up, s.turn_acceleration),
    )
    shares = [float(values.max()) / most for _, _, values, most in rows]
    verb, unit, values, most = rows[int(np.argmax(shares))]
    k = int(values.argmax())
    words = f"{verb} {values[k]:.4f} {unit} after {times[k]:.1f} s, expected at most {most:g}"
    return Peak(max(shares), f"the path {words}")


def least_duration(settings: GuidanceSettings, begin: Reference, goal: Floats) -> float:
    """Return the least time within the limits from a state to a pose at rest [s]."""

    def allowed(lasts: float) -> bool:
        path = Path.between(begin, goal, 0.0, lasts)
        return peak(settings, path, begin.twist).share <= 1.0

    long = MIN_DURATION
    while not allowed(long):
        long *= 2.0
    short = MIN_DURATION if long == MIN_DURATION else 0.5 * long
    while long - short > 0.01 * long:
        middle = 0.5 * (short + long)
        short, long = (short, middle) if allowed(middle) else (middle, long)
    return long


def _check_limits(settings: GuidanceSettings, path: Path) -> None:
    if not (most := peak(settings, path)).share <= 1.0 + 1e-3:  # NaN, too
        raise ActivityError(most.words)


def _check_near(
    settings: GuidanceSettings, what: str, pose: Floats, here: Floats, hint: str = ""
) -> None:
    apart = off(pose, here)
    distance, turn = float(np.hypot(*apart[:2])), abs(float(apart[2]))
    if distance > settings.max_offset or turn > settings.max_turn:
        raise ActivityError(
            f"{what} is {distance:.3f} m and {np.degrees(turn):.1f} deg from where the base is, "
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
