"""Motion of the tip along a straight line, from a start posture until no motion is left.

The base's heading is integrated with the joints (momentum is conserved but not integrable). Its
position follows from the centre of mass, which does not move. The set of joints held at limits is
constant within a step of the 4th-order Runge-Kutta method; steps end where a joint meets its limit.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fss_arm_model.arrays import Complexes, Floats
from fss_arm_model.kernels import helper, kernel
from fss_arm_model.kinematics import body_mass, checked, write_chain
from fss_arm_workspace.straight_path.redundancy import (
    LIMIT_TOLERANCE,
    at_limit,
    choose_free_joints,
    constraint_rows,
    joint_rates,
    least_rates,
)

REASONS = (
    "the end of the table",
    "a joint limit that leaves no motion",
    "all joints but one at their limits",
    "a singularity",
)
_TABLE_END, _ONE_LIMIT, _ALL_LIMITS, _SINGULARITY = 0.0, 1.0, 2.0, 3.0

_MAX_TURN = 0.02  # maximum rotation of a joint in a step [rad]
_MAX_GROWTH = 0.2  # maximum relative growth of the rates in a step
_MAX_APPROACH = 0.1  # maximum share of the room to a limit used in a step, if weights are unbounded
_MIN_STEP = 1e-5  # minimum step, unless a joint meets its limit within it [m]
_LINE_TOLERANCE = 1e-6  # distance below which the tip is on its line [m]

STOPPING_RATE = 100.0  # joint rate above which a path ends at a singularity [rad/m]


class LineOptions(NamedTuple):
    """Options of a straight path: numbers in the kernel, numbers or arrays (k,) for `trace`."""

    x: Floats | float  # direction in the world, a unit vector, as the next
    y: Floats | float
    base: Floats | float  # index in BASES
    rule: Floats | float  # index in RULES
    gain: Floats | float  # [rad/m]
    step: Floats | float  # maximum step [m]
    table_end: Floats | float  # length at which the table ends [m]


@helper
def _line_options(o):  # type: ignore[no-untyped-def]
    """Return an array (7,) as LineOptions."""
    return LineOptions(o[0], o[1], o[2], o[3], o[4], o[5], o[6])


@helper
def _com(p: Floats, d: Complexes, e: Complexes) -> complex:
    """Return the system's centre of mass relative to the base's origin."""
    M, S, r = 0.0, 0j, 0j
    for k in range(d.size):
        m = body_mass(p, k)
        M += m
        S += m * (r + e[k])
        r += d[k]
    return S / M


@helper
def _integrate_step(  # type: ignore[no-untyped-def]
    p, limits, options, direction, free, q, h, d, e, A, C, rates, stage, new
):
    """Write the state `new` after a distance h: heading and joints by one Runge-Kutta step.

    rates (4, n + 3) is scratch. Return False if a stage has no rates, or rates that are too high.
    """
    rows = 3 if options.base == 2.0 else 2
    z, W, y, x = rates[0], rates[1], rates[2], rates[3]
    n = x.size - 3
    new[:] = q
    stage[:] = q
    for i in range(4):
        constraint_rows(p, stage, options.base, d, e, A)
        if not joint_rates(
            limits,
            stage,
            A,
            rows,
            options.rule,
            options.gain,
            direction,
            free,
            z[:n],
            W[:n],
            C,
            y,
            x[:n],
        ):
            return False
        turn = 0.0
        for k in range(n):
            if abs(x[k]) > STOPPING_RATE:
                return False
            turn += A[2, k] * x[k]
        share = h / 6.0 if i in (0, 3) else h / 3.0
        step = h if i == 2 else 0.5 * h
        new[2] += share * turn
        stage[2] = q[2] + step * turn
        for k in range(n):
            new[3 + k] += share * x[k]
            stage[3 + k] = q[3 + k] + step * x[k]
    return True


@helper
def _correct(  # type: ignore[no-untyped-def]
    p, limits, base, com, origin, tip, free, q, d, e, A, C, rates
):
    """Move the base so that the centre of mass (or the base) keeps its place, the tip to its line.

    Return False if this needs more than a small correction, as it does past a singularity.
    """
    rows = 3 if base == 2.0 else 2
    z, W, y, x = rates[0], rates[1], rates[2], rates[3]
    n = x.size - 3
    error = 0j
    for corrections in range(4):
        constraint_rows(p, q, base, d, e, A)
        position = origin if base == 0.0 else com - _com(p, d, e)
        q[0], q[1] = position.real, position.imag
        error = tip - position
        for k in range(n + 1):
            error -= d[k]
        z[:] = 0.0
        W[:] = 1.0
        y[0], y[1], y[2] = error.real, error.imag, 0.0
        if abs(error) < 1e-13 or corrections == 3:
            break
        if not least_rates(A, rows, free, z[:n], W[:n], C, y, x[:n]):
            break
        for k in range(n):
            if abs(x[k]) > _MAX_TURN:
                return False
            turn = min(max(q[3 + k] + x[k], limits[k, 0]), limits[k, 1]) - q[3 + k]
            q[3 + k] += turn
            q[2] += A[2, k] * turn
    return abs(error) < _LINE_TOLERANCE


@helper
def _share_to_limit(limits: Floats, free: Floats, q: Floats, new: Floats) -> float:
    """Return the share of the step from q to `new` after which a free joint first meets a limit."""
    share = 1.0
    for k in range(free.size):
        bound = limits[k, 1] if new[3 + k] > q[3 + k] else limits[k, 0]
        turn, room = abs(new[3 + k] - q[3 + k]), abs(bound - q[3 + k])
        if free[k] > 0.0 and turn - room > LIMIT_TOLERANCE:
            # Vectorized code also computes this for joints at rest; it must not divide by zero.
            share = min(share, room / max(turn, LIMIT_TOLERANCE))
    return share


@kernel("(p),(n,k),(m),(o),(r)->(m),(r)")
def _trace(  # type: ignore[no-untyped-def]
    p, limits, start, options_, _r, q, result
):
    n = start.size - 3
    d, e = np.empty((2, n + 1), np.complex128)
    A, C, rates = np.empty((3, n)), np.empty((3, 3)), np.empty((4, n + 3))
    free, stage, new, x = np.empty(n), np.empty(n + 3), np.empty(n + 3), np.zeros(n)
    options = _line_options(options_)
    direction, base = complex(options.x, options.y), options.base
    rows = 3 if base == 2.0 else 2
    q[:] = start
    write_chain(p, q, d, e)
    origin = complex(q[0], q[1])
    com = origin + _com(p, d, e)
    tip = origin
    for k in range(n + 1):
        tip += d[k]
    s, peak, highest, reason, stalled_steps = 0.0, 0.0, 0.0, _TABLE_END, 0
    rate, slope, h = 0.0, 0.0, 0.0
    while True:
        constraint_rows(p, q, base, d, e, A)
        moving, count = choose_free_joints(
            limits, q, A, rows, options.rule, options.gain, direction, free, rates, C, x
        )
        if s >= options.table_end:
            break
        at_limits = 0
        for k in range(n):
            at_limits += int(at_limit(limits, q, k, options.rule) != 0.0)
        if count < rows <= n:
            reason = _ALL_LIMITS if at_limits >= n - 1 else _ONE_LIMIT
            break
        before, rate = rate, 0.0
        for k in range(n):
            rate = max(rate, abs(x[k]))
        slope = (rate - before) / h if h > 0.0 else 0.0
        if not moving or rate > STOPPING_RATE:
            reason = _SINGULARITY
            break
        highest = max(highest, rate)
        if rate < 0.5 * highest:
            peak = max(peak, highest)
            highest = rate
        h = min(options.step, options.table_end - s, _MAX_TURN / max(rate, 1e-9))
        if slope > 0.0:  # rates grow towards a singularity
            h = min(h, max(_MAX_GROWTH * rate / slope, _MIN_STEP))
        if options.rule == 2.0:  # weights of this rule grow as fast as the room to a limit shrinks
            for k in range(n):
                if free[k] == 0.0:
                    continue
                room = limits[k, 1] - q[3 + k] if x[k] > 0.0 else q[3 + k] - limits[k, 0]
                h = min(h, max(_MAX_APPROACH * room / max(abs(x[k]), 1e-9), _MIN_STEP))
        accepted = False
        for _ in range(60):  # shorten the step until it ends where the first joint meets its limit
            fits = _integrate_step(
                p, limits, options, direction, free, q, h, d, e, A, C, rates, stage, new
            )
            share = _share_to_limit(limits, free, q, new) if fits else 0.5
            if share == 1.0:
                for k in range(n):
                    new[3 + k] = min(max(new[3 + k], limits[k, 0]), limits[k, 1])
                position = tip + (s + h) * direction
                accepted = _correct(
                    p, limits, base, com, origin, position, free, new, d, e, A, C, rates
                )
                if accepted:
                    break
                fits, share = False, 0.5
            h *= share
            if not fits and h < _MIN_STEP:
                break
        if not accepted:
            reason = _SINGULARITY
            break
        stalled_steps = stalled_steps + 1 if h < 1e-12 else 0
        if stalled_steps > 2 * n:
            reason = _ONE_LIMIT
            break
        s += h
        q[:] = new
    result[0], result[1], result[2] = s, reason, peak
    # Near a singularity the rate grows as (s* - s)^-1/2; so this is the length left of the line.
    # It is computed for all reasons, and must not divide by zero.
    remaining = 0.5 * rate / max(slope, 1e-300)
    result[3] = remaining if reason == _SINGULARITY and slope > 0.0 else 0.0


def trace(
    p: npt.ArrayLike,
    q: npt.ArrayLike,
    limits: npt.ArrayLike,
    options: LineOptions,
) -> tuple[Floats, Floats]:
    """Move the tip along straight lines.

    Args:
        p: parameters of the arm.
        q: start states (..., 3 + n); the base's pose is in the world.
        limits: lowest and highest joint readings (..., n, 2) [rad].
        options: of the lines, each a number or an array (...).

    Returns:
        The last state (..., 3 + n); and (..., 4): length [m], index in REASONS, highest peak after
        which the rate fell again [rad/m], and estimated length between a stop for the rate and the
        singularity itself [m].

    Raises:
        ValueError: shapes do not fit.
    """
    p, q, _ = checked(p, q)
    packed = np.stack(np.broadcast_arrays(*options), axis=-1)
    return _trace(p, limits, q, packed, np.empty(4))
