"""Continuous collision check of a path, with a floating base: first time of a violated margin.

From a time t, no gap g can shrink to its margin before t + (g - margin) / V, where V is a bound on
the approach speed of its two bodies within a window (conservative advancement; Mirtich 1996). In a
window of length h from t, w_k is the rate of body k against the base, and alpha_k the largest
change of it in a second,

    bodies i < j of the arm     V = sum_{m=i+1..j} (|w_m - w_i| + (alpha_m + alpha_i) h) a_m
    pivot k in the world        V = (|P| + sum_{j>=k} |T_j| Psi_j) / M + sum_{j<k} |S_j| Psi_j

The floating base moves with constant momentum P and L, L about the centre of mass. With
centroidal.py's A_jk, S_k, T_k and n_k = sum_j A_jk,

    psi'_0 = (L - sum_k n_k w_k) / I,   I = sum_k n_k,   psi'_k = psi'_0 + w_k

Psi_k bounds |psi'_k| within the window, by

    |n_k'| <= sum_j |S_j| |T_k| |w_j - w_k|   (j < k, and the same with j and k exchanged)

The base's heading is integrated along (Simpson); its position follows from the centre of mass.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fss_arm_model.arrays import Floats
from fss_arm_model.centroidal import make_bodies, scaled, turn_body
from fss_arm_model.clearance import EDGE, body_gap
from fss_arm_model.kernels import helper, kernel
from fss_arm_model.kinematics import body_inertia
from fss_arm_model.layout import LINK_SIZE, MOUNT_ANGLE, OFFSET

ALLOWED_DECREASE = (
    0.001  # allowed decrease of a gap below its margin, from its largest value on the path [m]
)
END_TOLERANCE = 1e-6  # allowed decrease of such a gap from the start to the end [m]
MIN_STEP = 2e-5  # shortest step; if it cannot exclude a contact, this counts as one [s]
MAX_TURN = 0.2  # largest turn of a body against the base in a window [rad]
TINY = 1e-300  # replaces 0 in a quotient
CHECK_STEP = 0.005  # step for gaps below their margin [s]
MAX_EPOCH = 0.4  # longest time until distant pairs are checked again [s]


@helper
def _cubic(times, q, qd, k, t, angle, rate):  # type: ignore[no-untyped-def]
    """Write angles and rates at t, which is in segment k."""
    h = times[k + 1] - times[k]
    x = (t - times[k]) / h
    y = 1.0 - x
    for i in range(angle.size):
        slope = (q[k + 1, i] - q[k, i]) / h
        first, last = qd[k, i] - slope, qd[k + 1, i] - slope
        angle[i] = q[k, i] * y + q[k + 1, i] * x + x * y * (y * first - x * last) * h
        rate[i] = slope + y * (1.0 - 3.0 * x) * first + x * (3.0 * x - 2.0) * last


@helper
def _accelerations(times, q, qd, k, alpha):  # type: ignore[no-untyped-def]
    """Write the largest angular acceleration of each body against the base in segment k."""
    h = times[k + 1] - times[k]
    first = last = alpha[0] = 0.0
    for i in range(alpha.size - 1):
        slope = (q[k + 1, i] - q[k, i]) / h
        first += (6.0 * slope - 4.0 * qd[k, i] - 2.0 * qd[k + 1, i]) / h
        last += (2.0 * qd[k, i] + 4.0 * qd[k + 1, i] - 6.0 * slope) / h
        alpha[i + 1] = max(abs(first), abs(last))


@helper
def _turn_bodies(bodies, angle, rate, turned, w, N):  # type: ignore[no-untyped-def]
    """Turn the bodies in the base frame; write their rates and n_k. Return I and sum n_k w_k."""
    p, m = bodies.p, w.size
    heading, w[0] = 0.0, 0.0
    turn_body(bodies, turned, 0, 1.0 + 0.0j)
    for k in range(1, m):
        mount = p[MOUNT_ANGLE] if k == 1 else 0.0
        heading += p[LINK_SIZE * k + OFFSET] + angle[k - 1] + mount
        w[k] = w[k - 1] + rate[k - 1]
        turn_body(bodies, turned, k, complex(math.cos(heading), math.sin(heading)))
    before, after = 0j, 0j
    for k in range(m):
        after += turned[2, k]
    inertia = moment = 0.0
    for k in range(m):
        S, T = turned[1, k], turned[2, k]
        after -= T
        N[k] = bodies.inertia[0, k] + T.real * before.real + T.imag * before.imag
        N[k] += S.real * after.real + S.imag * after.imag
        before += S
        inertia += N[k]
        moment += N[k] * w[k]
    return inertia, moment


@helper
def _positions(bodies, turned, com, heading, r):  # type: ignore[no-untyped-def]
    """Write base, joints and tip in the world; return the base's position relative to `com`."""
    turn = complex(math.cos(heading), math.sin(heading))
    at = 0j
    for k in range(turned.shape[1]):
        at -= scaled(1.0 / bodies.mass, turned[2, k])
    away = turn * at
    r[0] = com + away
    for k in range(turned.shape[1]):
        at += turned[1, k] + scaled(1.0 / bodies.mass, turned[2, k])
        r[k + 1] = com + turn * at
    return away


class Motion(NamedTuple):
    """Motion of the bodies at a time, and bounds on it from then on, in the base frame."""

    w: Floats  # (m,) rates of the bodies
    alpha: Floats  # (m,) largest change of these in a second
    N: Floats  # (m,) n_k
    length: Floats  # (m,) from each pivot to the next
    arms: Floats  # (3, m) |S_k|, |T_k| and |T_k| / M
    speed: float  # of the centre of mass
    own: float  # lower bound of I: the bodies' own inertias
    chase: float  # speed of the target


@helper
def _world_speeds(motion, h, inertia, moment, L, Psi, U):  # type: ignore[no-untyped-def]
    """Write bounds on the speeds of base, joints and tip in a window of length h."""
    w, alpha, N, arms = motion.w, motion.alpha, motion.N, motion.arms
    m = w.size
    less = change = 0.0  # largest loss of I in the window; largest change of sum n_k w_k
    for k in range(m):
        swing = 0.0
        for j in range(k):
            swing += arms[0, j] * arms[1, k] * (abs(w[j] - w[k]) + (alpha[j] + alpha[k]) * h)
        for j in range(k + 1, m):
            swing += arms[0, k] * arms[1, j] * (abs(w[j] - w[k]) + (alpha[j] + alpha[k]) * h)
        swing *= h
        less += swing
        change += swing * (abs(w[k]) + alpha[k] * h) + abs(N[k]) * alpha[k] * h
    spin = (L - moment) / inertia
    least = max(inertia - less, motion.own)
    drift = (change + abs(spin) * less) / least  # largest change of psi'_0
    for k in range(m):
        Psi[k] = abs(spin + w[k]) + drift + alpha[k] * h
    total = motion.speed
    for k in range(m):
        total += arms[2, k] * Psi[k]
    U[0] = total
    for k in range(m):
        total += (arms[0, k] - arms[2, k]) * Psi[k]
        U[k + 1] = total


@helper
def _closing_speed(i, j, h, motion, U):  # type: ignore[no-untyped-def]
    """Return a bound on the approach speed of two bodies in a window of length h."""
    w, alpha = motion.w, motion.alpha
    n = w.size - 1
    if j <= n:
        V = 0.0
        for m in range(i + 1, j + 1):
            V += (abs(w[m] - w[i]) + (alpha[m] + alpha[i]) * h) * motion.length[m]
        return V
    if j == n + EDGE:
        return U[i]
    if i == 0:
        return U[0] + motion.chase
    return max(U[min(i, n)], U[min(i, n) + 1]) + motion.chase


@helper
def _turn_window(motion, h):  # type: ignore[no-untyped-def]
    """Return the window, at most h long, in which no body turns by more than about MAX_TURN."""
    fastest = most = TINY
    for k in range(1, motion.w.size):
        fastest, most = max(fastest, abs(motion.w[k])), max(most, motion.alpha[k])
    return min(h, MAX_TURN / fastest, math.sqrt(MAX_TURN / most))


@helper
def _safe_step(h, near, pairs, best, limit, motion, floats, inertia, moment, L, Psi, U):  # type: ignore[no-untyped-def]
    """Return a safe step in a window of length h, and the pair that limits it, or -1.

    A shorter window has lower bounds on speeds. A gap below its margin is checked every CHECK_STEP.
    """
    step, first = h, -1
    for _ in range(4):
        if floats:
            _world_speeds(motion, h, inertia, moment, L, Psi, U)
        step, first = h, -1
        for k in near:
            V = _closing_speed(int(pairs[k, 0]), int(pairs[k, 1]), h, motion, U)
            if limit[k] < V * step:
                holds = limit[k] / max(V, TINY)
                if best[k] < pairs[k, 2]:
                    step = min(step, max(holds, CHECK_STEP))
                else:
                    step, first = holds, k
        if step >= 0.5 * h:
            break
        h = min(h, max(2.0 * step, MIN_STEP))
    return step, first


@kernel("(p),(b),(k),(k,n),(k,n),(g,f),(s),(c),(o)->(o),(n)")
def _sweep(p, base, times, q, qd, pairs, sizes, target, _o, found, where):  # type: ignore[no-untyped-def]
    n, knots, floats = q.shape[1], times.size, not math.isnan(base[0])
    bodies = make_bodies(p.copy(), np.zeros(2))
    turned = np.empty((3, n + 1), np.complex128)
    r = np.empty(n + 2, np.complex128)
    angle, rate = np.empty((2, n))
    w, alpha, N, Psi, length = np.zeros((5, n + 1))
    arms, U = np.empty((3, n + 1)), np.zeros(n + 2)
    start, best, limit, top, due = np.empty((5, pairs.shape[0]))
    near = np.empty(pairs.shape[0], np.int64)
    at, chase = complex(target[0], target[1]), complex(target[2], target[3])
    own = 0.0
    for k in range(n + 1):
        length[k] = abs(bodies.arms[0, k] + scaled(1.0 / bodies.mass, bodies.arms[1, k]))
        own += body_inertia(p, k)
        arms[0, k], arms[1, k] = abs(bodies.arms[0, k]), abs(bodies.arms[1, k])
        arms[2, k] = arms[1, k] / bodies.mass

    _cubic(times, q, qd, 0, times[0], angle, rate)
    _accelerations(times, q, qd, 0, alpha)
    inertia, moment = _turn_bodies(bodies, angle, rate, turned, w, N)
    heading, com, velocity, L = 0.0, 0j, 0j, 0.0
    if floats:
        heading = base[2]
        com = complex(base[0], base[1]) - _positions(bodies, turned, 0j, heading, r)
        if not math.isnan(base[3]):
            turn = complex(math.cos(heading), math.sin(heading))
            L, velocity = inertia * base[5] + moment, complex(base[3], base[4])
            for k in range(n + 1):
                velocity += 1j * scaled((base[5] + w[k]) / bodies.mass, turn * turned[2, k])
    motion = Motion(w, alpha, N, length, arms, abs(velocity), own, abs(chase))

    t, segment, worst, contact = times[0], 0, np.inf, False
    window, epoch = np.inf, t  # length of a step's window, and time when all pairs are due again
    best[:] = -np.inf
    found[0], found[1], found[2], found[3] = 0.0, t, np.inf, -1.0
    while True:
        _positions(bodies, turned, com + velocity * (t - times[0]), heading, r)
        now = at + chase * (t - times[0])
        ended = segment + 1 >= knots
        rest = 0.0 if ended else times[segment + 1] - t
        step = min(rest, max(CHECK_STEP, (times[knots - 1] - found[1]) / 500.0))
        if contact:  # continue, to find the least distance
            k = int(found[3])
            gap = body_gap(int(pairs[k, 0]), int(pairs[k, 1]), r, now, sizes)
            if gap < found[2]:
                found[2] = gap
                where[:] = angle
        else:
            all_due = ended or t >= epoch
            if all_due:
                epoch = t + min(rest, MAX_EPOCH)
                if floats:
                    _world_speeds(motion, epoch - t, inertia, moment, L, Psi, U)
            h = _turn_window(motion, min(epoch - t, window))
            active, first = 0, -1
            for k in range(pairs.shape[0]):
                if not all_due and due[k] > t + h:
                    continue
                a, b, margin = int(pairs[k, 0]), int(pairs[k, 1]), pairs[k, 2]
                gap = body_gap(a, b, r, now, sizes)
                if best[k] == -np.inf:
                    start[k] = gap
                best[k] = max(best[k], gap)
                if gap - margin < worst:
                    worst = gap - margin
                    found[1], found[2], found[3] = t, gap, k
                    where[:] = angle
                if best[k] >= margin:
                    limit[k] = max(gap - margin, 0.0)
                else:
                    limit[k] = gap - best[k] + ALLOWED_DECREASE
                    if limit[k] < 0.0 or (ended and gap < start[k] - END_TOLERANCE):
                        first = k
                if all_due:
                    top[k] = _closing_speed(a, b, epoch - t, motion, U)
                due[k] = t + limit[k] / max(top[k], TINY)
                if due[k] <= t + h:
                    near[active] = k
                    active += 1
            is_rejected, step = first >= 0, h
            if not is_rejected and not ended:
                step, first = _safe_step(
                    h, near[:active], pairs, best, limit, motion, floats, inertia, moment, L, Psi, U
                )
                is_rejected = first >= 0 and step < min(MIN_STEP, rest)
                window = 4.0 * (max(step, MIN_STEP) if step < h else window)
            if is_rejected:
                contact = True
                found[0], found[1], found[2], found[3] = 1.0, t, np.inf, first
                continue
        if ended:
            break
        until = t + step if step < rest else times[segment + 1]
        spin = (L - moment) / inertia
        if floats:
            _cubic(times, q, qd, segment, 0.5 * (t + until), angle, rate)
            inertia, moment = _turn_bodies(bodies, angle, rate, turned, w, N)
            spin += 4.0 * (L - moment) / inertia
        _cubic(times, q, qd, segment, until, angle, rate)
        inertia, moment = _turn_bodies(bodies, angle, rate, turned, w, N)
        if floats:
            spin += (L - moment) / inertia
            heading += (until - t) / 6.0 * spin
        t = until
        if step >= rest:
            segment, epoch = segment + 1, t
            if segment + 1 < knots:
                _cubic(times, q, qd, segment, t, angle, rate)
                _accelerations(times, q, qd, segment, alpha)


def sweep(
    p: npt.ArrayLike,
    base: npt.ArrayLike,
    times: npt.ArrayLike,
    q: npt.ArrayLike,
    qd: npt.ArrayLike,
    pairs: npt.ArrayLike,
    sizes: npt.ArrayLike,
    target: npt.ArrayLike,
) -> tuple[bool, float, float, int, Floats]:
    """Follow a path until two bodies would be nearer than their margin, or to its end.

    Args:
        p: (8 + 6 n,) Arm.vector().
        base: (6,) pose and twist at the first knot; no twist (NaN): without momentum; no pose
            either: the base is held fixed.
        times: (k,) of the knots [s].
        q: (k, n) readings at these times, cubic in between [rad].
        qd: (k, n) rates at these times [rad/s].
        pairs: (g, 3) two bodies by number, as in clearance.py, and their margin [m].
        sizes: (6,) of clearance.py.
        target: (4,) its position at the first knot and its velocity [m, m/s].

    Returns:
        True if there are two such bodies; the time of the violation, or else of the smallest
        distance from the margin [s]; the least distance of these two from then on [m]; their row
        of `pairs`, -1 if there is none; readings at that distance (n) [rad].
    """
    found, where = _sweep(p, base, times, q, qd, pairs, sizes, target, np.empty(4))
    return bool(found[0]), float(found[1]), float(found[2]), int(found[3]), where


def contacts(
    p: npt.ArrayLike,
    base: npt.ArrayLike,
    times: npt.ArrayLike,
    q: npt.ArrayLike,
    qd: npt.ArrayLike,
    pairs: npt.ArrayLike,
    sizes: npt.ArrayLike,
    target: npt.ArrayLike,
) -> npt.NDArray[np.bool_]:
    """Return True for paths on which `sweep` finds such bodies; leading dimensions broadcast."""
    found, _ = _sweep(p, base, times, q, qd, pairs, sizes, target, np.empty(4))
    return np.asarray(found[..., 0] > 0.0)
