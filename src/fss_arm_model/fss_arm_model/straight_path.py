"""The tip drawn along a straight line, from a start posture until no motion is left.

Along the line's length s, the joints move at the rates x = dq_m/ds that minimize

    (x - z)^T W (x - z)    with    A x = b    and no joint beyond its limits.

A x = b are the line, the first two rows of the tip's Jacobian (J_m if the base is held, J* if it
floats without momentum), x being in its direction; and for zero reaction a third row, the base's
angular rate, which is to vanish. The rule that resolves the redundancy chooses z and W:

    minimum norm          z = 0                                W = 1
    away from limits      z_i = -gain (q_i - mid_i) / half_i   W = 1          (Liegeois 1977)
    weighted least norm   z = 0                                W_i = 1 + |dH/dq_i| for joints that
                          move from the middle, else 1              (Chan and Dubey 1995)
    preferred             z given, piecewise constant in s     W = 1

    H = sum of (max_i - min_i)^2 / (4 (max_i - q_i) (q_i - min_i))

The base's heading is integrated with the joints (momentum is conserved but not integrable); its
position follows from the centre of mass, which stays. Which limits hold is fixed within a step of
the Runge-Kutta method of 4th order, and steps end where a joint meets its limit.
"""

import math

import numpy as np
import numpy.typing as npt

from ._cache import Complexes, Floats, helper, kernel
from .kinematics import _chain, _mass, checked
from .manipulability import _held
from .momentum import _floating

__all__ = ["BASES", "REASONS", "RULES", "trace"]

BASES = ("fixed", "floating", "zero reaction")
RULES = ("minimum norm", "away from limits", "weighted least norm", "preferred")
REASONS = (
    "the end of the table",
    "a joint limit that leaves no motion",
    "all joints but one at their limits",
    "a singularity",
)
_TABLE, _LIMIT, _LIMITS, _SINGULAR = 0.0, 1.0, 2.0, 3.0

_TURN = 0.02  # of a joint in a step, at most [rad]
_GROWTH = 0.2  # of the rates in a step, at most
_NEARING = 0.1  # of a joint to a limit in a step, where weights grow without bound, at most
_SHORTEST = 1e-5  # step, unless a joint meets its limit within [m]
_HEAVY = 1e-3  # distance from which on weights all but stop a joint, and it counts as held [rad]
_MET = 1e-11  # distance from a limit that counts as none [rad]
_ON_LINE = 1e-6  # distance of the tip from its line that counts as none [m]


@helper
def _com(p: Floats, d: Complexes, e: Complexes) -> complex:
    """The system's centre of mass from the base's origin."""
    M, S, r = 0.0, 0j, 0j
    for k in range(d.size):
        m = _mass(p, k)
        M += m
        S += m * (r + e[k])
        r += d[k]
    return S / M


@helper
def _solve(C: Floats, rows: int, y: Floats) -> bool:
    """Solve C y' = y in place, C (rows, rows) symmetric and spoiled; False if it is singular."""
    for i in range(rows):
        scale = C[i, i]
        for k in range(i):
            C[i, i] -= C[i, k] * C[i, k]
        if not C[i, i] > 1e-13 * scale:
            return False
        C[i, i] = math.sqrt(C[i, i])
        for j in range(i + 1, rows):
            for k in range(i):
                C[j, i] -= C[j, k] * C[i, k]
            C[j, i] /= C[i, i]
        for k in range(i):
            y[i] -= C[i, k] * y[k]
        y[i] /= C[i, i]
    for i in range(rows - 1, -1, -1):
        for k in range(i + 1, rows):
            y[i] -= C[k, i] * y[k]
        y[i] /= C[i, i]
    return True


@helper
def _least(
    A: Floats, rows: int, free: Floats, z: Floats, W: Floats, C: Floats, y: Floats, x: Floats
) -> bool:
    """Write the free joints' x with A x = y nearest to z, and multipliers y; False if in vain."""
    for i in range(rows):
        for j in range(i + 1):
            C[i, j] = 0.0
            for k in range(x.size):
                C[i, j] += free[k] * A[i, k] * A[j, k] / W[k]
        for k in range(x.size):
            y[i] -= free[k] * A[i, k] * z[k]
    if not _solve(C, rows, y):
        return False
    for k in range(x.size):
        x[k] = 0.0
        for i in range(rows):
            x[k] += A[i, k] * y[i]
        x[k] = free[k] * (z[k] + x[k] / W[k])
    return True


@helper
def _rows(p: Floats, q: Floats, base: float, d: Complexes, e: Complexes, A: Floats) -> None:
    """Write A (3, n): the tip's two rows, and the base's angular rate per joint rate."""
    _chain(p, q, d, e)
    if base > 0.0:
        _floating(p, d, e, A)
        for k in range(A.shape[1]):
            A[2, k] -= 1.0
    else:
        _held(d, A)
        A[2] = 0.0


@helper
def _weight(low: float, high: float, here: float) -> float:
    """1 + |dH/dq| of one joint."""
    room = max(high - here, _MET) * max(here - low, _MET)
    side = (high - low) / (2.0 * room)
    return 1.0 + side * side * abs(2.0 * here - high - low)


@helper
def _rates(
    limits: Floats,
    q: Floats,
    A: Floats,
    rows: int,
    rule: float,
    gain: float,
    preferred: Floats,
    direction: complex,
    free: Floats,
    z: Floats,
    W: Floats,
    C: Floats,
    y: Floats,
    x: Floats,
) -> bool:
    """Write the rates x (n,) [rad/m] of the free joints by the rule; False if there are none."""
    z[:] = 0.0
    W[:] = 1.0
    for k in range(x.size):
        low, high, here = limits[k, 0], limits[k, 1], q[3 + k]
        if rule == 1.0:
            z[k] = -gain * (2.0 * here - high - low) / (high - low)
        elif rule == 2.0:
            W[k] = _weight(low, high, here)
        elif rule == 3.0:
            z[k] = preferred[k]
    # W of a rate that itself depends on W: the sum is convex, so few rounds lead to its least.
    for _ in range(2 * x.size):
        y[0], y[1], y[2] = direction.real, direction.imag, 0.0
        if not _least(A, rows, free, z, W, C, y, x):
            return False
        settled = True
        for k in range(x.size if rule == 2.0 else 0):
            low, high, here = limits[k, 0], limits[k, 1], q[3 + k]
            outward = x[k] * (2.0 * here - high - low) > 0.0
            weight = _weight(low, high, here) if outward else 1.0
            settled &= weight == W[k]
            W[k] = weight
        if settled:
            break
    return True


@helper
def _at_limit(limits: Floats, q: Floats, k: int, rule: float) -> float:
    """-1 or 1 if joint k is at its lowest or highest reading, else 0."""
    near = _HEAVY if rule == 2.0 else _MET
    if q[3 + k] - limits[k, 0] <= near:
        return -1.0
    if limits[k, 1] - q[3 + k] <= near:
        return 1.0
    return 0.0


@helper
def _choose(
    limits: Floats,
    q: Floats,
    A: Floats,
    rows: int,
    options: Floats,
    wish: Floats,
    direction: complex,
    free: Floats,
    rates: Floats,
    C: Floats,
    x: Floats,
) -> tuple[bool, int]:
    """Write which joints move (n,), and their rates x; return whether they do, and their count.

    A joint that would leave its limit is held, the hastiest first, until none would; one whose
    multiplier says that it would better move inwards is let go again.
    """
    n = x.size
    z, W, y = rates[0, :n], rates[1, :n], rates[2]
    free[:] = 1.0
    left = n
    for _ in range(4 * n):
        if left < rows:
            return False, left
        if not _rates(
            limits, q, A, rows, options[3], options[4], wish, direction, free, z, W, C, y, x
        ):
            return False, left
        chosen, most = -1, 0.0
        for k in range(n):
            out = free[k] * x[k] * _at_limit(limits, q, k, options[3])
            if out > most:
                chosen, most = k, out
        if chosen >= 0:
            free[chosen] = 0.0
            left -= 1
            continue
        most = 1e-9
        for k in range(n):
            pull = W[k] * z[k]
            for i in range(rows):
                pull += A[i, k] * y[i]
            inward = -(1.0 - free[k]) * pull * _at_limit(limits, q, k, options[3])
            if inward > most:
                chosen, most = k, inward
        if chosen < 0:
            break
        free[chosen] = 1.0
        left += 1
    return True, left


@helper
def _advance(
    p: Floats,
    limits: Floats,
    options: Floats,
    preferred: Floats,
    direction: complex,
    free: Floats,
    q: Floats,
    h: float,
    d: Complexes,
    e: Complexes,
    A: Floats,
    C: Floats,
    rates: Floats,
    stage: Floats,
    new: Floats,
) -> bool:
    """Write the state `new` a distance h on: heading and joints by a step of Runge and Kutta.

    rates (4, n + 3) is scratch. False if a stage has no rates, or too high ones.
    """
    base, rule, gain, fastest = options[2], options[3], options[4], options[5]
    rows = 3 if base == 2.0 else 2
    z, W, y, x = rates[0], rates[1], rates[2], rates[3]
    n = x.size - 3
    new[:] = q
    stage[:] = q
    for i in range(4):
        _rows(p, stage, base, d, e, A)
        if not _rates(
            limits, stage, A, rows, rule, gain, preferred, direction, free,
            z[:n], W[:n], C, y, x[:n],
        ):  # fmt: skip
            return False
        turn = 0.0
        for k in range(n):
            if abs(x[k]) > fastest:
                return False
            turn += A[2, k] * x[k]
        share = h / 6.0 if i in (0, 3) else h / 3.0
        ahead = h if i == 2 else 0.5 * h
        new[2] += share * turn
        stage[2] = q[2] + ahead * turn
        for k in range(n):
            new[3 + k] += share * x[k]
            stage[3 + k] = q[3 + k] + ahead * x[k]
    return True


@helper
def _settle(
    p: Floats,
    limits: Floats,
    base: float,
    com: complex,
    origin: complex,
    tip: complex,
    free: Floats,
    q: Floats,
    d: Complexes,
    e: Complexes,
    A: Floats,
    C: Floats,
    rates: Floats,
) -> bool:
    """Put the base where the centre of mass (or the base itself) stays, and the tip on its line.

    False if that takes more than a small correction, as it does past a singularity.
    """
    rows = 3 if base == 2.0 else 2
    z, W, y, x = rates[0], rates[1], rates[2], rates[3]
    n = x.size - 3
    error = 0j
    for corrections in range(4):
        _rows(p, q, base, d, e, A)
        place = origin if base == 0.0 else com - _com(p, d, e)
        q[0], q[1] = place.real, place.imag
        error = tip - place
        for k in range(n + 1):
            error -= d[k]
        z[:] = 0.0
        W[:] = 1.0
        y[0], y[1], y[2] = error.real, error.imag, 0.0
        if abs(error) < 1e-13 or corrections == 3:
            break
        if not _least(A, rows, free, z[:n], W[:n], C, y, x[:n]):
            break
        for k in range(n):
            if abs(x[k]) > _TURN:
                return False
            turn = min(max(q[3 + k] + x[k], limits[k, 0]), limits[k, 1]) - q[3 + k]
            q[3 + k] += turn
            q[2] += A[2, k] * turn
    return abs(error) < _ON_LINE


@helper
def _within(limits: Floats, free: Floats, q: Floats, new: Floats) -> float:
    """Share of the step from q to `new` after which the first of the free joints is at a limit."""
    share = 1.0
    for k in range(free.size):
        bound = limits[k, 1] if new[3 + k] > q[3 + k] else limits[k, 0]
        turn, room = abs(new[3 + k] - q[3 + k]), abs(bound - q[3 + k])
        if free[k] > 0.0 and turn - room > _MET:
            share = min(share, room / turn)
    return share


@helper
def _state_rates(d: Complexes, A: Floats, x: Floats, J: Floats, qd: Floats) -> None:
    """Write the rates (3 + n,) of base and joints: the base moves as the tip with joints held."""
    turn, v = 0.0, 0j
    reach = _held(d, J)
    for k in range(x.size):
        turn += A[2, k] * x[k]
        v += complex(A[0, k] - J[0, k], A[1, k] - J[1, k]) * x[k]
        qd[3 + k] = x[k]
    v -= 1j * turn * reach
    qd[0], qd[1], qd[2] = v.real, v.imag, turn


@kernel("(p),(n,k),(m),(o),(c,n),(s),(r)->(s,m),(s,m),(m),(r)")
def _traced(
    p: Floats,
    limits: Floats,
    start: Floats,
    options: Floats,
    preferred: Floats,
    samples: Floats,
    _r: Floats,
    states: Floats,
    derivatives: Floats,
    q: Floats,
    result: Floats,
) -> None:
    n = start.size - 3
    d, e = np.empty((2, n + 1), np.complex128)
    A, J = np.empty((2, 3, n))
    C, rates = np.empty((3, 3)), np.empty((4, n + 3))
    free, stage, new, x = np.empty(n), np.empty(n + 3), np.empty(n + 3), np.empty(n)
    direction, base = complex(options[0], options[1]), options[2]
    fastest, longest_step, far = options[5], options[6], options[7]
    segment = options[8]
    rows = 3 if base == 2.0 else 2
    q[:] = start
    states[:], derivatives[:] = math.nan, math.nan
    _chain(p, q, d, e)
    origin = complex(q[0], q[1])
    com = origin + _com(p, d, e)
    tip = origin
    for k in range(n + 1):
        tip += d[k]
    s, peak, highest, reason, sampled, still = 0.0, 0.0, 0.0, _TABLE, 0, 0
    rate, slope, h = 0.0, 0.0, 0.0
    while True:
        wish = preferred[min(int(s / segment), preferred.shape[0] - 1)]
        _rows(p, q, base, d, e, A)
        moving, left = _choose(limits, q, A, rows, options, wish, direction, free, rates, C, x)
        while sampled < samples.size and samples[sampled] <= s:
            states[sampled] = q
            if moving:
                _state_rates(d, A, x, J, derivatives[sampled])
            sampled += 1
        if s >= far:
            break
        stuck = 0
        for k in range(n):
            stuck += int(_at_limit(limits, q, k, options[3]) != 0.0)
        if left < rows <= n:
            reason = _LIMITS if stuck >= n - 1 else _LIMIT
            break
        before, rate = rate, 0.0
        for k in range(n):
            rate = max(rate, abs(x[k]))
        slope = (rate - before) / h if h > 0.0 else 0.0
        if not moving or rate > fastest:
            reason = _SINGULAR
            break
        highest = max(highest, rate)
        if rate < 0.5 * highest:
            peak = max(peak, highest)
            highest = rate
        h = min(longest_step, far - s, _TURN / max(rate, 1e-9))
        if slope > 0.0:  # towards a singularity
            h = min(h, max(_GROWTH * rate / slope, _SHORTEST))
        if sampled < samples.size:
            h = min(h, samples[sampled] - s)
        if options[3] == 2.0:  # its weights grow as fast as the room shrinks
            for k in range(n):
                if free[k] == 0.0:
                    continue
                room = limits[k, 1] - q[3 + k] if x[k] > 0.0 else q[3 + k] - limits[k, 0]
                h = min(h, max(_NEARING * room / max(abs(x[k]), 1e-9), _SHORTEST))
        if options[3] == 3.0:
            h = max(min(h, segment * (math.floor(s / segment) + 1.0) - s), 1e-9)
        good = False
        for _ in range(60):  # until the step ends where the first joint meets its limit
            fits = _advance(
                p, limits, options, wish, direction, free, q, h, d, e, A, C, rates, stage, new
            )
            share = _within(limits, free, q, new) if fits else 0.5
            if share == 1.0:
                for k in range(n):
                    new[3 + k] = min(max(new[3 + k], limits[k, 0]), limits[k, 1])
                place = tip + (s + h) * direction
                good = _settle(p, limits, base, com, origin, place, free, new, d, e, A, C, rates)
                if good:
                    break
                fits, share = False, 0.5
            h *= share
            if not fits and h < _SHORTEST:
                break
        if not good:
            reason = _SINGULAR
            break
        still = still + 1 if h < 1e-12 else 0
        if still > 2 * n:
            reason = _LIMIT
            break
        s += h
        q[:] = new
    result[0], result[1], result[2] = s, reason, peak
    # Near a singularity the rate grows as (s* - s)^-1/2, so that this much is left of the line.
    result[3] = 0.5 * rate / slope if reason == _SINGULAR and slope > 0.0 else 0.0


def trace(
    p: npt.ArrayLike,
    q: npt.ArrayLike,
    limits: npt.ArrayLike,
    options: npt.ArrayLike,
    preferred: npt.ArrayLike,
    samples: npt.ArrayLike,
) -> tuple[Floats, Floats, Floats, Floats]:
    """Draw the tip along straight lines.

    Args:
        p: parameters of the arm.
        q: start states (..., 3 + n), the base's pose in the world.
        limits: lowest and highest joint readings (..., n, 2) [rad].
        options: (..., 9) direction x, y (unit vector, world); index in BASES; index in RULES; gain
            [rad/m]; joint rate that counts as a singularity [rad/m]; longest step [m]; length at
            which the table ends [m]; length of a segment of z [m].
        preferred: z of the rule "preferred", (..., c, n) [rad/m], one row a segment.
        samples: lengths (..., s) at which to report the state, ascending [m].

    Returns:
        States at the samples, and their derivatives by the length, (..., s, 3 + n), NaN beyond the
        end; the last state (..., 3 + n); and (..., 4): length [m], index in REASONS, highest rate
        that was passed and sank again [rad/m], and estimated length between a stop for the rate
        and the singularity itself [m].

    Raises:
        ValueError: shapes do not fit.
    """
    p, q, _ = checked(p, q)
    return _traced(p, limits, q, options, preferred, samples, np.empty(4))
