"""A step in which parts touch, or in which arms hold each other: impulses at its start.

They are chosen so that at the end of the step

    parts   gap >= 0, by contact.py's law of impact
    grips   the pose of one gripper relative to the other is unchanged

The error at the end, e, depends on the velocity after the impulses, the goal g, almost linearly:
e = e_0 + rate g + bias, e_0 at the start. Servos make the rate less than a step, and forces the
bias. The bias changes slowly: the first trial of a step extrapolates it from the last two steps,
and is most often within the tolerance. Otherwise the goal is corrected, for a gap by a secant, for
a pose by Broyden's method.
"""

from typing import NamedTuple

import numpy as np

from fss_arm_model.arrays import Floats
from fss_arm_model.integration import STEP
from fss_arm_model.kernels import helper
from fss_arm_model.layout import TIP_ANGLE
from fss_sim.plant.chain import add_loads, add_rates, restore, step_chain
from fss_sim.plant.contact import (
    BIAS,
    BODY,
    CHAIN,
    FEATURES,
    PUSHED,
    RATE,
    TREND,
    find_touch,
    place_bodies,
    place_parts,
    solve_contacts,
)

GAP_TOLERANCE = 1e-7  # tolerance of a gap at the end of a step [m]
# Tolerance of a grip's relative pose at a step's end [m, rad]; the next step removes the error.
POSE_TOLERANCE = 1e-6
MAX_TRIALS = 8  # of a step
RESTITUTION, FRICTION, THRESHOLD = range(3)  # of the law of contact
# Columns of the table of welds, and of the state of a weld, three each but for its rate (3, 3). The
# pose is that of the tip of the other arm in the frame of the last link of the one.
ONE_ARM, OTHER_ARM, POSE = range(3)
IMPULSE, WELD_BIAS, WELD_TREND, WELD_RATE = 0, 3, 6, 9
NEW_WELD = np.append(np.zeros(WELD_RATE), STEP * np.eye(3))
# Rows, of three, of a weld in a step; columns of a contact in a step.
ERROR_BEFORE, WELD_GOAL, LAST_WELD_GOAL, LAST_ERROR, ERROR = range(5)
CLOSE, FEATURE, GAP_BEFORE, SPEED, GOAL, LAST_GOAL, LAST_GAP, SLOPE = range(8)


class Rows(NamedTuple):
    """Rows of the constraints of a step: three for each weld, then two for each contact."""

    J: Floats  # (r, d) relative velocity per rates of (c, psi) of all chains
    response: Floats  # (r, d) change of the rates per impulse
    W: Floats  # (r, r) J response'
    before: Floats  # (r,) relative velocity before the impulses
    impulse: Floats  # (r,)


@helper
def _write_rows(chains, places, rows, at, count, sides, x, n):  # type: ignore[no-untyped-def]
    """Write `count` rows from `at` on: along n, across it, and, if three, the turn.

    sides (2, 2): chain and body of the first and of the second part, which meet at x.
    """
    J, response, W, d = rows.J, rows.response, rows.W, places.speeds.size
    J[at : at + count], response[at : at + count] = 0.0, 0.0
    for side in range(2):
        c, body, sign = sides[side, 0], sides[side, 1], 1.0 - 2.0 * side
        chain, of, pivot = chains[c], places.offsets[c], places.pivots[c, body]
        ours, effects = J[at : at + count], response[at : at + count]
        add_loads(chain, of, pivot, body, x, sign * n, sign, ours, effects)
    for i in range(at, at + count):
        rows.before[i] = 0.0
        for k in range(d):
            rows.before[i] += J[i, k] * places.speeds[k]
        for j in range(i + 1):
            product = 0.0
            for k in range(d):
                product += J[j, k] * response[i, k]
            W[i, j] = W[j, i] = product


@helper
def _eliminate(A, pivots):  # type: ignore[no-untyped-def]
    """Eliminate the first unknowns from the equations A[:, :-1] x = A[:, -1] (Gauss-Jordan)."""
    rows, columns = A.shape
    for k in range(pivots):
        scale = 1.0 / A[k, k]
        for j in range(k, columns):
            A[k, j] *= scale
        for i in range(rows):
            factor = A[i, k]
            if i != k and factor != 0.0:
                for j in range(k, columns):
                    A[i, j] -= factor * A[k, j]


@helper
def _solve(rows, posed, contacts, friction):  # type: ignore[no-untyped-def]
    """Write the impulses that reach the goals; return their work [J]."""
    w = 3 * posed.shape[0]
    size = w + 2 * contacts.shape[0]
    A = np.empty((size, size + 1))
    for i in range(size):
        for j in range(size):
            A[i, j] = rows.W[i, j]
        A[i, size] = (posed[i // 3, WELD_GOAL, i % 3] if i < w else 0.0) - rows.before[i]
    _eliminate(A, w)
    if size > w:
        goals, impulse = contacts[:, GOAL].copy(), rows.impulse[w:size]
        solve_contacts(A[w:, w:size].copy(), -A[w:, size], goals, friction, impulse)
    for i in range(w):
        rows.impulse[i] = A[i, size]
        for j in range(w, size):
            rows.impulse[i] -= A[i, j] * rows.impulse[j]
    work = 0.0
    for i in range(size):
        mean = rows.before[i]
        for j in range(size):
            mean += 0.5 * rows.W[i, j] * rows.impulse[j]
        work += rows.impulse[i] * mean
    return work


@helper
def _solve_rate(rate, x):  # type: ignore[no-untyped-def]
    """Return rate^-1 x for a (3, 3) rate."""
    A = np.empty((3, 4))
    A[:, :3], A[:, 3] = rate, x
    _eliminate(A, 3)
    return A[:, 3]


@helper
def _write_pose_error(chains, places, weld, error):  # type: ignore[no-untyped-def]
    """Write the pose error of the other arm's tip, (3,) [m, m, rad]; return the tip's position."""
    c, d = int(weld[ONE_ARM]), int(weld[OTHER_ARM])
    one, other = chains[c], chains[d]
    k, tip = one.held.size - 1, places.pivots[d, other.held.size]
    place = places.pivots[c, k] + complex(weld[POSE], weld[POSE + 1]) * places.turns[c, k]
    error[0], error[1] = (tip - place).real, (tip - place).imag
    error[2] = other.z[0, 1 + other.held.size] + other.bodies.p[TIP_ANGLE] - weld[POSE + 2]
    error[2] -= one.z[0, 2 + k]
    return tip


@helper
def _start_weld(chains, places, rows, weld, state, posed, k):  # type: ignore[no-untyped-def]
    """Write the rows of weld k and its first goal."""
    tip = _write_pose_error(chains, places, weld, posed[ERROR_BEFORE])
    rate = state[WELD_RATE:].copy().reshape((3, 3))
    missing = -posed[ERROR_BEFORE] - state[WELD_BIAS:WELD_TREND] - state[WELD_TREND:WELD_RATE]
    posed[WELD_GOAL] = posed[LAST_WELD_GOAL] = _solve_rate(rate, missing)
    sides = np.empty((2, 2), np.int64)
    for side in range(2):
        c = int(weld[OTHER_ARM - side])
        sides[side, 0], sides[side, 1] = c, places.offsets[c + 1] - places.offsets[c] - 3
    _write_rows(chains, places, rows, 3 * k, 3, sides, tip, 1.0 + 0.0j)


@helper
def _correct_pose(state, posed):  # type: ignore[no-untyped-def]
    """Correct a weld's goal by its error at the step's end; return True if it was needed."""
    change, rate = posed[WELD_GOAL] - posed[LAST_WELD_GOAL], state[WELD_RATE:]
    square = change[0] ** 2 + change[1] ** 2 + change[2] ** 2
    if square > 0.0:
        for i in range(3):
            missed = posed[ERROR, i] - posed[LAST_ERROR, i]
            for j in range(3):
                missed -= rate[3 * i + j] * change[j]
            for j in range(3):
                rate[3 * i + j] += missed * change[j] / square
    posed[LAST_WELD_GOAL], posed[LAST_ERROR] = posed[WELD_GOAL], posed[ERROR]
    if np.abs(posed[ERROR]).max() <= POSE_TOLERANCE:
        return False
    posed[WELD_GOAL] -= _solve_rate(rate.copy().reshape((3, 3)), posed[ERROR])
    return True


@helper
def _remember_pose(state, posed):  # type: ignore[no-untyped-def]
    """Write the bias of the weld in this step, and its change since the last step."""
    for i in range(3):
        bias = posed[ERROR, i] - posed[ERROR_BEFORE, i]
        for j in range(3):
            bias -= state[WELD_RATE + 3 * i + j] * posed[LAST_WELD_GOAL, j]
        state[WELD_TREND + i] = bias - state[WELD_BIAS + i]
        state[WELD_BIAS + i] = bias


@helper
def _start_contact(chains, places, rows, g, state, law, at, contact):  # type: ignore[no-untyped-def]
    """Write the rows of a contact from `at` on, and its first goal; state is that of pair g."""
    f, sides = int(contact[FEATURE]), np.empty((2, 2), np.int64)
    gap, x, n = find_touch(places, g, f)
    for side in range(2):
        part = places.parts[int(places.pairs[g, side])]
        sides[side, 0], sides[side, 1] = int(part[CHAIN]), int(part[BODY])
    _write_rows(chains, places, rows, at, 2, sides, x, n)
    speed, goal, slope = rows.before[at], -max(gap, 0.0) / STEP, STEP
    if speed < -law[THRESHOLD]:
        goal = -law[RESTITUTION] * speed
    elif state[RATE + f] > 0.0:
        slope = state[RATE + f]
        bias = state[BIAS + f] + state[TREND + f]
        goal = min(-(gap + bias) / slope, max(-speed, 0.0))
    contact[GAP_BEFORE], contact[SPEED], contact[SLOPE] = gap, speed, slope
    contact[GOAL] = contact[LAST_GOAL] = goal


@helper
def _correct_goal(contact, gap, push, law):  # type: ignore[no-untyped-def]
    """Correct a contact's goal by the gap at the step's end; return True if it was needed."""
    goal, speed = contact[GOAL], contact[SPEED]
    change = goal - contact[LAST_GOAL]
    if abs(change) > 1e-9:
        slope = (gap - contact[LAST_GAP]) / change
        contact[SLOPE] = min(max(slope, 0.1 * STEP), STEP)
    contact[LAST_GOAL], contact[LAST_GAP] = goal, gap
    better = min(goal - gap / contact[SLOPE], max(-speed, 0.0))  # more would add energy
    unneeded = push > 0.0 and speed >= -law[THRESHOLD] and gap > GAP_TOLERANCE
    if not (gap < -GAP_TOLERANCE or unneeded) or better == goal:
        return False
    contact[GOAL] = better
    return True


@helper
def _remember_goal(contact, push, law, state):  # type: ignore[no-untyped-def]
    """Write the state of a pair that pushed: slope, bias and trend, unless it bounces apart."""
    f, slope, old = int(contact[FEATURE]), contact[SLOPE], state[RATE + int(contact[FEATURE])]
    state[PUSHED] += push
    state[RATE + f] = 0.0
    if push > 0.0 and contact[SPEED] >= -law[THRESHOLD]:
        bias = contact[LAST_GAP] - contact[GAP_BEFORE] - slope * contact[LAST_GOAL]
        state[TREND + f] = bias - state[BIAS + f] if old > 0.0 else 0.0
        state[BIAS + f], state[RATE + f] = bias, slope


@helper
def touch_step(  # type: ignore[no-untyped-def]
    chains, places, close, touched, welds, held, law, step, tolerance, stops, changes
):
    """Advance by one step, so that no close pair overlaps and no weld changes its pose.

    The chains are in place, and their state is saved. With `stops`, no time passes. What impulses
    change in the rates of (c, psi) of all chains is added to `changes` (d,).

    Returns:
        The work of the impulses [J].
    """
    near, w, d, count, work = close.size, welds.shape[0], places.offsets[-1], 0, 0.0
    r = 3 * w + 2 * FEATURES * near
    rows = Rows(
        np.empty((r, d)),
        np.empty((r, d)),
        np.empty((r, r)),
        np.empty(r),
        np.zeros(r),
    )
    change, posed = np.zeros(d), np.zeros((w, 5, 3))
    for k in range(w):
        _start_weld(chains, places, rows, welds[k], held[k], posed[k], k)
    every, ended = np.empty((FEATURES * near, 8)), np.empty((near, FEATURES))
    is_contact, new = np.zeros((2, near, FEATURES), np.bool_)
    for i in range(near):
        for f in range(FEATURES):
            new[i, f] = touched[close[i], RATE + f] > 0.0  # it pushed in the last step
    for trial in range(MAX_TRIALS):
        if trial > 0:
            for c in range(len(chains)):
                chain = chains[c]
                restore(chain)
                place_bodies(chain, places, c)
            place_parts(places)
        for i in range(near):
            for f in range(FEATURES):
                if new[i, f]:
                    contact, g, at = every[count], close[i], 3 * w + 2 * count
                    contact[CLOSE], contact[FEATURE] = i, f
                    _start_contact(chains, places, rows, g, touched[g], law, at, contact)
                    is_contact[i, f], count = True, count + 1
        if w + count > 0:
            work = _solve(rows, posed, every[:count], law[FRICTION])
            change[:] = 0.0
            for i in range(3 * w + 2 * count):
                for k in range(d):
                    change[k] += rows.impulse[i] * rows.response[i, k]
        for c in range(len(chains)):
            chain = chains[c]
            if w + count > 0:
                add_rates(chain, change, places.offsets[c])
            if not stops:
                step_chain(chain, step, tolerance)
                place_bodies(chain, places, c)
        if stops:
            break
        place_parts(places)
        repeat = False
        for k in range(w):
            _write_pose_error(chains, places, welds[k], posed[k, ERROR])
            repeat |= _correct_pose(held[k], posed[k])
        for i in range(near):
            for f in range(FEATURES):
                ended[i, f], _, _ = find_touch(places, close[i], f)
                new[i, f] = ended[i, f] < -GAP_TOLERANCE and not is_contact[i, f]
                repeat |= new[i, f]
        for k in range(count):
            contact = every[k]
            gap = ended[int(contact[CLOSE]), int(contact[FEATURE])]
            repeat |= _correct_goal(contact, gap, rows.impulse[3 * w + 2 * k], law)
        if not repeat:
            break

    for k in range(count):
        push, g = rows.impulse[3 * w + 2 * k], close[int(every[k, CLOSE])]
        _remember_goal(every[k], push, law, touched[g])
    for k in range(w):
        for i in range(3):
            held[k, IMPULSE + i] += rows.impulse[3 * k + i]
        if not stops:
            _remember_pose(held[k], posed[k])
    for k in range(d):
        changes[k] += change[k]
    return work
