"""Motion of the end effector along a line or through poses, in the world or the base frame.

In the world the base floats, with momentum (P, L) or without. The tip's twist is

    v = J* q' + v_m,    J* the generalized Jacobian (Umetani and Yoshida 1989)

v_m is the tip's twist due to the momentum alone, with the arm fixed in its current posture. With
the desired twist v_w, the tip's error e and a bump b(t) that is 1 where the motion starts and ends,

    q' = W (z + J*^T (J* W J*^T + mu 1)^-1 (v_w + (1 - b) (e / tau - v_m) - J* W z))

so that the arm starts and ends at rest on a base that drifts, and in between the tip follows its
path. z pulls joints away from their limits along the self-motions (Liegeois 1977), and the diagonal
W slows joints that approach a limit (Chan and Dubey 1995); mu is 0 except near a singularity
(Nakamura and Hanafusa 1986). In the base's frame J* is the tip's Jacobian with the base held, and
v_m is 0.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fss_arm_model.arrays import Floats
from fss_arm_model.dynamics import join_bodies
from fss_arm_model.kernels import helper, kernel
from fss_arm_model.kinematics import dot, tip_in_base, tip_pose, write_chain
from fss_arm_model.settings import (
    FINITE,
    NOT_NEGATIVE,
    POSITIVE,
    SettingError,
    Settings,
    one_of,
    setting,
)
from fss_arm_model.units import in_degrees
from fss_arm_motion.plan import Plan, PlanError, Start, finished
from fss_arm_motion.timing import knots, run_through

WORLD, BASE = "world", "base"
STEPS = 400  # of the Runge-Kutta method of 4th order
RAMP_SHARE = 0.15  # share of the time in which the bump falls, and rises again
SETTLING_SHARE = 0.1  # tau, share of the time
SINGULAR = 0.01  # det(J* J*^T) over (trace / r)^r, below which damping starts
DAMPING = 0.01  # mu at a singularity, over trace / r
LIMIT_PULL = 3.0  # rate that pulls a joint at a limit away from it, per length of the path [rad/m]
SLOWING_DISTANCE = (
    0.3  # distance from a limit below which a joint that approaches it is slowed [rad]
)
LIMIT_DISTANCE = 0.05  # distance from a limit that explains why a path ends [rad]
FULL, JOINT, LOST = range(3)  # reasons for the end of a path


@dataclass(frozen=True)
class TipPath(Settings):
    """A path of the end effector along a line or through poses.

    Raises:
        SettingError: neither a line nor places are given, or both, or headings do not fit.
    """

    by: tuple[float, ...] = setting((), "straight line to follow: x, y", unit="m", check=FINITE)
    through: tuple[float, ...] = setting(
        (), "places to go through: x, y, x, y, ..", unit="m", check=FINITE
    )
    headings: tuple[float, ...] = setting(
        (), "headings of the end effector at the places; none: any", unit="rad", check=FINITE
    )
    frame: str = setting(WORLD, "frame of the line or the points", check=one_of(WORLD, BASE))
    duration: float = setting(
        0.0, "time to take; 0: as short as limits allow", unit="s", check=NOT_NEGATIVE
    )
    tolerance: float = setting(
        0.005,
        "distance from the way at which the end effector counts as lost",
        unit="m",
        check=POSITIVE,
    )
    partial: bool = setting(False, "accept the part of the path that limits allow")

    def __post_init__(self) -> None:
        super().__post_init__()
        if bool(self.by) == bool(self.through):
            given = "both" if self.by else "neither"
            raise SettingError(f"by and through: {given} given, expected one of them")
        if self.by and len(self.by) != 2:
            raise SettingError(f"by has {len(self.by)} numbers, expected 2")
        if len(self.through) % 2:
            raise SettingError(f"through has {len(self.through)} numbers, expected x, y, x, y, ..")
        places = 1 if self.by else len(self.through) // 2
        if self.headings and len(self.headings) != places:
            raise SettingError(f"headings has {len(self.headings)} angles, expected {places}")


@helper
def _solve(C, y, rows):  # type: ignore[no-untyped-def]
    """Solve C y' = y in place by Gaussian elimination, C (rows, rows) symmetric and positive."""
    for i in range(rows):
        for r in range(i + 1, rows):
            share = C[r, i] / C[i, i]
            for c in range(i, rows):
                C[r, c] -= share * C[i, c]
            y[r] -= share * y[i]
    for i in range(rows - 1, -1, -1):
        for c in range(i + 1, rows):
            y[i] -= C[i, c] * y[c]
        y[i] /= C[i, i]


@helper
def _motions(p, floating, momentum, d, e, second, base, tip):  # type: ignore[no-untyped-def]
    """Write twists of base and tip (3, n + 1) by each joint's rate, and last by the momentum."""
    n = d.size - 1
    M, S, K, reach = 0.0, 0j, 0.0, 0j
    for k in range(n, -1, -1):
        M, S, K = join_bodies(p, k, d, e, M, S, K)
        second[0, k], second[1, k] = S, complex(K, 0.0)
        reach += d[k]
    com = S / M
    moment, r = K - dot(com, S), 0j
    for k in range(n + 1):
        if k < n:
            r += d[k]
            omega = -(second[1, k + 1].real + dot(r - com, second[0, k + 1])) / moment
            v, turn = -1j * (omega * com + second[0, k + 1] / M), 1.0
        else:
            omega = momentum[2] / moment
            v, turn = complex(momentum[0], momentum[1]) / M - 1j * omega * com, 0.0
        if floating == 0.0:
            omega, v = 0.0, 0j
        u = v + 1j * omega * reach + turn * 1j * (reach - r)
        base[0, k], base[1, k], base[2, k] = v.real, v.imag, omega
        tip[0, k], tip[1, k], tip[2, k] = u.real, u.imag, omega + turn


class FollowOptions(NamedTuple):
    """Options of the kernel that follows a path."""

    rows: float  # 2: heading free; 3: heading given
    floating: float  # 0: the base is fixed
    settling_time: float  # in which an error decays [s]
    step: float  # [s]
    tolerance: float  # distance from the way at which the tip counts as lost [m]


@helper
def _law(  # type: ignore[no-untyped-def]
    p, bounds, momentum, options, wish, x, d, e, second, base, tip, C, y, b, z, w, rate
):
    """Write the rates (3 + n,) of base and joints at a state x; return the tip's error [m]."""
    n, rows, settle = bounds.shape[0], int(options.rows), options.settling_time
    heading = write_chain(p, x, d, e)
    _motions(p, options.floating, momentum, d, e, second, base, tip)
    place = complex(x[0], x[1])
    for k in range(n + 1):
        place += d[k]
    off = complex(wish[0], wish[1]) - place
    speed, free = math.hypot(wish[3], wish[4]), 1.0 - wish[6]
    for k in range(n):
        half = 0.5 * (bounds[k, 1] - bounds[k, 0])
        z[k] = -LIMIT_PULL * speed * (x[3 + k] - 0.5 * (bounds[k, 0] + bounds[k, 1])) / half
    y[0] = wish[3] + free * (off.real / settle - tip[0, n])
    y[1] = wish[4] + free * (off.imag / settle - tip[1, n])
    y[2] = wish[5] + free * ((wish[2] - heading) / settle - tip[2, n])
    w[:] = 1.0
    for turn in range(2):
        for i in range(rows):
            b[i] = y[i]
            for j in range(rows):
                C[i, j] = 0.0
                for k in range(n):
                    C[i, j] += w[k] * tip[i, k] * tip[j, k]
            for k in range(n):
                b[i] -= tip[i, k] * w[k] * z[k]
        size = C[0, 0] * C[1, 1] - C[0, 1] * C[1, 0]
        if rows == 3:
            size = C[2, 2] * size - C[0, 2] * (C[0, 2] * C[1, 1] - C[0, 1] * C[1, 2])
            size -= C[1, 2] * (C[1, 2] * C[0, 0] - C[0, 1] * C[0, 2])
        part = 0.0
        for i in range(rows):
            part += C[i, i] / rows
        size /= part**rows
        if size < SINGULAR:
            for i in range(rows):
                C[i, i] += DAMPING * part * (1.0 - max(size, 0.0) / SINGULAR) ** 2
        _solve(C, b, rows)
        for k in range(n):
            rate[3 + k] = z[k]
            for i in range(rows):
                rate[3 + k] += tip[i, k] * b[i]
            rate[3 + k] *= w[k]
        if turn == 0:
            for k in range(n):
                room = bounds[k, 1] - x[3 + k] if rate[3 + k] > 0.0 else x[3 + k] - bounds[k, 0]
                w[k] = min(1.0, max(room, 0.0) / SLOWING_DISTANCE)
    for i in range(3):
        rate[i] = base[i, n]
    for k in range(n):
        for i in range(3):
            rate[i] += base[i, k] * rate[3 + k]
    return abs(off)


@kernel("(p),(n,b),(x),(t),(o),(w,v),(m)->(m,x),(m,x),(t)")
def _follow_path(p_, bounds_, start, momentum_, o, way_, _m, states, rates, report):  # type: ignore[no-untyped-def]
    p, bounds, momentum, way = p_.copy(), bounds_.copy(), momentum_.copy(), way_.copy()
    options, n = FollowOptions(o[0], o[1], o[2], o[3], o[4]), bounds_.shape[0]
    d, e = np.empty((2, n + 1), np.complex128)
    second = np.empty((2, n + 1), np.complex128)
    base, tip = np.empty((2, 3, n + 1))
    C, y, b, z, w = np.empty((3, 3)), np.empty(3), np.empty(3), np.empty(n), np.empty(n)
    k1, k2, k3, k4, x, new = np.empty((6, 3 + n))
    x[:] = start
    h = options.step
    report[0], report[1], report[2] = 0.0, states.shape[0] - 1.0, 0.0
    for step in range(states.shape[0]):
        wish = way[2 * step]
        off = _law(
            p, bounds, momentum, options, wish, x, d, e, second, base, tip, C, y, b, z, w, k1
        )
        states[step], rates[step] = x, k1
        if report[0] == 0.0 and wish[6] < 0.5 and off > options.tolerance:
            report[0], report[1], report[2] = 2.0, step, off
        for k in range(n):
            out = x[3 + k] < bounds[k, 0] or x[3 + k] > bounds[k, 1]
            if report[0] == 0.0 and out:
                report[0], report[1], report[2] = 1.0, step, k
        if report[0] > 0.0 or step == states.shape[0] - 1:
            break
        for i in range(3 + n):
            new[i] = x[i] + 0.5 * h * k1[i]
        wish = way[2 * step + 1]
        _law(p, bounds, momentum, options, wish, new, d, e, second, base, tip, C, y, b, z, w, k2)
        for i in range(3 + n):
            new[i] = x[i] + 0.5 * h * k2[i]
        _law(p, bounds, momentum, options, wish, new, d, e, second, base, tip, C, y, b, z, w, k3)
        for i in range(3 + n):
            new[i] = x[i] + h * k3[i]
        wish = way[2 * step + 2]
        _law(p, bounds, momentum, options, wish, new, d, e, second, base, tip, C, y, b, z, w, k4)
        for i in range(3 + n):
            x[i] += h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i])


@dataclass(frozen=True)
class Way:
    """Path of the tip over a share s of its length."""

    curve: Callable[..., Floats]  # x, y [m] and heading [rad], or a derivative
    length: float  # [m]
    rows: int  # 2: heading free; 3: heading given
    frame: str

    def table(self, end: float, lasts: float) -> Floats:
        """Return places, headings, their rates and the bump at half steps, (2 STEPS + 1, 7)."""
        r = np.linspace(0.0, 1.0, 2 * STEPS + 1)
        s, speed, _ = run_through(r)
        places, slopes = self.curve(end * s), self.curve(end * s, 1)
        return np.column_stack([places, slopes * (end * speed / lasts)[:, None], bump(r)])


def bump(r: Floats) -> Floats:
    """Return 1 at the start and the end of the time, 0 in between, smooth."""
    x = np.clip(np.minimum(r, 1.0 - r) / RAMP_SHARE, 0.0, 1.0)
    return 1.0 - run_through(x)[0]


def way_of(start: Start, request: TipPath) -> Way:
    """Return the way from the current position of the tip.

    Raises:
        PlanError: it has no length.
    """
    from scipy.interpolate import CubicSpline

    p, state = start.arm.vector(), np.concatenate([start.pose, start.q])
    here = tip_pose(p, state) if request.frame == WORLD else tip_in_base(p, start.q)
    places = np.reshape(request.through or here[:2] + np.array(request.by), (-1, 2))
    headings = np.array(request.headings) if request.headings else np.full(len(places), here[2])
    rows = np.vstack([here, np.column_stack([places, headings])])
    rows[:, 2] = np.unwrap(rows[:, 2])
    lengths = np.linalg.norm(np.diff(rows[:, :2], axis=0), axis=1)
    if not (lengths > 1e-6).all():
        k = int(np.argmin(lengths))
        raise PlanError(f"place {k + 1} is {places[k].tolist()} m, where the one before it is")
    s = np.append(0.0, np.cumsum(lengths)) / lengths.sum()
    curve = CubicSpline(s, rows, bc_type="natural") if len(s) > 2 else CubicSpline(s, rows)
    return Way(curve, float(lengths.sum()), 3 if request.headings else 2, request.frame)


def _follow(
    start: Start, way: Way, end: float, lasts: float, tolerance: float
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return times, states and rates on the way, (m, 3 + n), and how it ended, (3,)."""
    floating = way.frame == WORLD
    options = FollowOptions(way.rows, floating, SETTLING_SHARE * lasts, lasts / STEPS, tolerance)
    begin = np.concatenate([start.pose if floating else np.zeros(3), start.q])
    room, table = np.empty(STEPS + 1), way.table(end, lasts)
    states, rates, report = _follow_path(
        start.bodies, start.limits.bounds, begin, start.momentum, options, table, room
    )
    return np.linspace(0.0, lasts, STEPS + 1), states, rates, report


def tip_path(start: Start, request: TipPath) -> Plan:
    """Plan the motion, as fast as limits allow or in the requested time.

    Raises:
        PlanError: a joint's limit or a singularity ends the way early, and a part of it is not
            accepted; or limits cannot be kept.
    """
    way = way_of(start, request)
    end, lasts, ended = 1.0, request.duration or max(1.0, 2.0 * way.length), ""
    p = start.arm.vector()
    for _ in range(30):
        times, states, rates, report = _follow(start, way, end, lasts, request.tolerance)
        if report[0] != FULL:
            share = float(run_through(times[[int(report[1])]] / lasts)[0][0]) * end
            last = states[int(report[1]), 3:]
            ended = _reason(start, report, last, share * way.length, way.length)
            if not request.partial:
                raise PlanError(f"{ended}; --partial accepts the part up to there")
            if share < 0.02:
                raise PlanError(f"the path is too short: {ended}")
            end = min(0.99 * share, 0.995 * end)
            continue
        q, qd = states[:, 3:], rates[:, 3:]
        qdd = np.gradient(qd, times, axis=0)
        used = start.limits.used(p, q, qd, qdd, start.L).max(axis=(0, 2))
        if request.duration or used.max() <= 1.0:
            break
        lasts *= 1.002 * max(used[0], math.sqrt(used[1:].max()))
    if used.max() > 1.0:
        what = ("rates", "accelerations", "torques")[int(np.argmax(used))]
        raise PlanError(
            f"duration is {lasts:g} s, expected more: {what} of {100 * used.max():.0f} %"
        )
    from scipy.interpolate import CubicHermiteSpline

    spline = CubicHermiteSpline(times, q, qd)
    at = knots(lambda t: (spline(t), spline(t, 1)), lasts)
    arguments = {
        "by": list(request.by),
        "through": list(request.through),
        "headings": list(request.headings),
        "frame": request.frame,
        "duration": request.duration,
        "tolerance": request.tolerance,
        "partial": request.partial,
    }
    plan = finished(start, "tip_path", arguments, *at[:3], {}, ended)
    notes = {"length": end * way.length, "error": _error(start, way, end, plan), "deviation": at[3]}
    return Plan(
        plan.kind, arguments, plan.times, plan.q, plan.qd, plan.prediction, plan.used, notes, ended
    )


def _reason(start: Start, report: Floats, q: Floats, gone: float, length: float) -> str:
    """Return the reason why a path ended, with the joint nearest to its limit if one is near."""
    low, high = start.limits.bounds.T
    i = int(report[2]) if report[0] == JOINT else int(np.argmin(np.minimum(q - low, high - q)))
    words = f"ends after {gone:.3f} m of {length:.3f} m"
    if report[0] == JOINT or min(q[i] - low[i], high[i] - q[i]) < LIMIT_DISTANCE:
        limits = f"{in_degrees([low[i]])} to {in_degrees([high[i]])}"
        return f"joint {i + 1} reaches its limit, {limits}: {words}"
    return f"singularity: {words}, the end effector {1e3 * report[2]:.1f} mm off its way"


def tips(start: Start, plan: Plan, frame: str) -> Floats:
    """Return the end effector's poses at the times of a plan's prediction, (k, 3)."""
    q = plan.at(plan.prediction.times)[0]
    if frame == BASE:
        return tip_in_base(start.arm.vector(), q)
    return tip_pose(start.arm.vector(), np.concatenate([plan.prediction.pose, q], axis=1))


def _error(start: Start, way: Way, end: float, plan: Plan) -> float:
    """Return the tip's largest distance from its way [m], for the motion through the knots."""
    at = tips(start, plan, way.frame)[:, :2]
    line = way.curve(end * np.linspace(0.0, 1.0, 401))[:, :2]
    begin, along = line[:-1], np.diff(line, axis=0)
    share = ((at[:, None] - begin) * along).sum(axis=2) / (along**2).sum(axis=1)
    nearest = begin + share.clip(0.0, 1.0)[..., None] * along
    return float(np.linalg.norm(at[:, None] - nearest, axis=2).min(axis=1).max())
