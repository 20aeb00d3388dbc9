"""Arm motions that do not change the base's heading: zero-reaction maneuvers.

Without momentum the base turns at the rate

    omega = G(q) q',    G the base's angular rate per joint rate (the angular coupling)

so that joint rates in the null space of G, n - 1 of them, do not turn it (Yoshida, Hashizume and
Abiko 2001; the paper's [24]). Along a desired direction u the joints follow its projection,

    dq/dl = P u / |P u|,   P = 1 - G^T G / |G|^2

as far as limits allow. The constraint G q' = 0 is not integrable for three joints or more: the
postures that such motions reach depend on their path. For a goal, the motion with the least turn
of the base is searched for, with additional time for a detour. The search starts from the straight
motion, and does not always find an existing solution.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fss_arm_model.arrays import Floats
from fss_arm_model.kernels import helper, kernel
from fss_arm_model.kinematics import write_chain
from fss_arm_model.momentum import write_floating_jacobian
from fss_arm_model.settings import FINITE, NOT_NEGATIVE, POSITIVE, SettingError, Settings, setting
from fss_arm_model.units import in_degrees
from fss_arm_motion.plan import Plan, PlanError, Start, finished
from fss_arm_motion.point_to_point import PointToPoint, point_to_point
from fss_arm_motion.timing import knots, run_through, shortest

STEP = 5e-3  # of the Runge-Kutta method of 4th order [rad]
MIN_SHARE = 1e-3  # smallest share of a direction that is not neglected

MIN_PATH = 1e-3  # longest path that counts as none [rad]
EXTRA_TIMES = (2.5, 8.0)  # times beyond the fastest motion, tried one after the other [s]

LIMIT, NOTHING_LEFT, LENGTH = range(3)


@dataclass(frozen=True)
class ZeroReaction(Settings):
    """A motion that does not turn the base: along a direction, or to a goal.

    Raises:
        SettingError: neither a direction nor a goal is given, or both.
    """

    direction: tuple[float, ...] = setting(
        (), "joint rates whose direction is wished", unit="rad/s", check=FINITE
    )
    goal: tuple[float, ...] = setting((), "joint readings to arrive at", unit="rad", check=FINITE)
    length: float = setting(
        0.0,
        "length along the direction, in joint space; 0: as far as it goes",
        unit="rad",
        check=NOT_NEGATIVE,
    )
    duration: float = setting(
        0.0, "time to take; 0: as short as limits allow", unit="s", check=NOT_NEGATIVE
    )
    tolerance: float = setting(
        math.radians(0.1), "turn of the base that counts as none", unit="rad", check=POSITIVE
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if bool(self.direction) == bool(self.goal):
            given = "both" if self.goal else "neither"
            raise SettingError(f"direction and goal: {given} given, expected one of them")


@helper
def _slope(p, u, q, d, e, J, x):  # type: ignore[no-untyped-def]
    """Write the part of u that does not turn the base, normalized; return its former length."""
    write_chain(p, q, d, e)
    write_floating_jacobian(p, d, e, J)
    along = size = 0.0
    for k in range(u.size):
        G = J[2, k] - 1.0
        along += G * u[k]
        size += G * G
    length = 0.0
    for k in range(u.size):
        x[k] = u[k] - (J[2, k] - 1.0) * along / size
        length += x[k] * x[k]
    length = math.sqrt(length)
    for k in range(u.size):
        x[k] /= max(length, 1e-12)
    return length


@kernel("(p),(n,b),(n),(n),(),(m)->(m,n),(m,n),(m)")
def _null_path(p, bounds, q0, u0, length, _m, q, slope, report):  # type: ignore[no-untyped-def]
    p, n = p.copy(), q0.size
    d, e = np.empty((2, n + 1), np.complex128)
    J, state, x, u = np.empty((3, n)), np.zeros(3 + n), np.empty((4, n)), u0.copy()
    size = 0.0
    for k in range(n):
        size += u[k] * u[k]
    for k in range(n):
        u[k] /= math.sqrt(size)
    q[:], slope[:], report[:] = math.nan, math.nan, 0.0
    here, done, count = q0.copy(), 0.0, 0
    report[1] = 2.0
    while True:
        state[3:] = here
        left = _slope(p, u, state, d, e, J, x[0])
        if count < q.shape[0] and left > MIN_SHARE:
            q[count], slope[count] = here, x[0]
            count += 1
        if not left > MIN_SHARE:
            report[1] = 1.0
            break
        h = min(STEP, length[0] - done)
        if h < 1e-9 or count >= q.shape[0]:
            break
        for stage in range(1, 4):
            state[3:] = here + (h if stage == 3 else 0.5 * h) * x[stage - 1]
            _slope(p, u, state, d, e, J, x[stage])
        share = 1.0
        for k in range(n):
            move = h / 6.0 * (x[0, k] + 2.0 * x[1, k] + 2.0 * x[2, k] + x[3, k])
            beyond = bounds[k, 1] - here[k] if move > 0.0 else bounds[k, 0] - here[k]
            if abs(move) > abs(beyond) and abs(beyond / move) < share:
                share = abs(beyond / move)
                report[1], report[2] = 0.0, k + 1.0
            state[3 + k] = move
        if share < 1.0:
            break
        here += state[3:]
        done += h
    report[0] = count


def null_path(
    start: Start, direction: npt.ArrayLike, length: float
) -> tuple[Floats, Floats, Floats, str]:
    """Return the motion that follows joint rates as closely as it can without turning the base.

    Args:
        start: initial posture, and limits.
        direction: joint rates u, (n,); only their direction counts.
        length: of the path in the space of the joints [rad].

    Returns:
        Lengths (m,) [rad], postures (m, n), their derivatives by the length (m, n), and the reason
        for an early end (empty if the path has the full length).

    Raises:
        PlanError: the direction is not valid.
    """
    u = np.asarray(direction, dtype=float)
    if u.shape != start.q.shape or not (np.isfinite(u).all() and np.linalg.norm(u) > 0.0):
        raise PlanError(f"direction is {u.tolist()}, expected {start.arm.n} numbers, not all 0")
    room = np.empty(2 + int(length / STEP) + 4)
    q, slope, report = _null_path(start.bodies, start.limits.bounds, start.q, u, length, room)
    count = int(report[0])
    why = ""
    if report[1] == LIMIT:
        i = int(report[2]) - 1
        limit = start.limits.bounds[i, int(slope[count - 1, i] > 0.0)]
        why = f"joint {i + 1} is at its limit of {in_degrees([limit])}"
    elif report[1] == NOTHING_LEFT:
        why = "of the wished direction nothing is left that does not turn the base"
    lengths = np.minimum(np.arange(count) * STEP, length)
    return lengths, q[:count], slope[:count], why


def zero_reaction(start: Start, request: ZeroReaction) -> Plan:
    """Plan the motion, with the time that limits need.

    Raises:
        PlanError: no motion is possible, limits cannot be kept, or a goal is not reached without
            turning the base.
    """
    return _to_goal(start, request) if request.goal else _along(start, request)


def _along(start: Start, request: ZeroReaction) -> Plan:
    from scipy.interpolate import CubicHermiteSpline

    length = request.length or 2.0 * float(np.ptp(start.limits.bounds, axis=1).sum())
    lengths, q, slope, why = null_path(start, request.direction, length)
    if not len(lengths) or lengths[-1] < MIN_PATH:
        raise PlanError(f"no motion along {list(request.direction)}: {why}")
    whole = lengths[-1]
    spline = CubicHermiteSpline(lengths / whole, q, whole * slope)
    least = shortest(start, lambda s: (spline(s), spline(s, 1), spline(s, 2)))
    if request.duration and request.duration < least:
        raise PlanError(f"duration is {request.duration:g} s, expected {least:.3f} s or more")
    lasts = request.duration or least

    def law(t: Floats) -> tuple[Floats, Floats]:
        s, speed, _ = run_through(np.clip(t / lasts, 0.0, 1.0))
        return spline(s), spline(s, 1) * speed[:, None] / lasts

    times, at, rate, deviation = knots(law, lasts)
    arguments = {
        "direction": list(request.direction),
        "length": request.length,
        "duration": request.duration,
    }
    notes = {"travel": float(whole), "deviation": deviation}
    return finished(start, "zero_reaction", arguments, times, at, rate, notes, why)


def _to_goal(start: Start, request: ZeroReaction) -> Plan:
    goal = start.posture("goal", request.goal)
    fastest = point_to_point(start, PointToPoint(tuple(goal)))
    durations = (
        [request.duration]
        if request.duration
        else [fastest.duration + more for more in EXTRA_TIMES]
    )
    arguments = {
        "goal": goal.tolist(),
        "duration": request.duration,
        "tolerance": request.tolerance,
    }
    turns = []
    for duration in durations:
        plan = point_to_point(start, PointToPoint(tuple(goal), duration, least_rotation=True))
        turns.append(plan.prediction.excursion)
        if turns[-1] <= request.tolerance:
            notes = {"fastest_turn": fastest.prediction.excursion}
            return Plan(
                "zero_reaction",
                arguments,
                plan.times,
                plan.q,
                plan.qd,
                plan.prediction,
                plan.used,
                notes,
            )
    raise PlanError(
        f"goal {in_degrees(goal)}: no motion found that turns the base by less than "
        f"{np.degrees(min(turns)):.2f} deg, expected {np.degrees(request.tolerance):.2f} deg; "
        f"a duration above {max(durations):.1f} s may help"
    )
