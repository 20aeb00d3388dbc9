"""Simulation of chains of bodies, many steps in one kernel: free motion, contact, and welds.

Between contacts each chain moves independently. The number of steps without any contact is
estimated from gaps and speeds, and checked afterwards. A step that would otherwise end with
overlapping parts, or with a weld out of place, begins with impulses (impact.py). Both chains
receive their impulse at the same point, which conserves momentum.

Each call also audits momentum and energy. It computes the momentum and the energy of the bodies,
and integrates the impulse and the work of every force on them. The two must change by the same
amount, but for the work of contacts and welds, which the call returns.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from fss_arm_model.arrays import Floats
from fss_arm_model.integration import STEP
from fss_arm_model.kernels import helper, kernel
from fss_sim.plant.chain import (
    FIXED_SIZE,
    FIXED_STATE,
    JOINT_SIZE,
    JOINT_STATE,
    finish_chain,
    make_chain,
    restore,
    save,
    step_chain,
)
from fss_sim.plant.contact import (
    GAP,
    OVERLAPS,
    PAIR_SIZE,
    PUSHED,
    RADIUS,
    SPEED,
    Contact,
    make_places,
    measure_gaps,
    place_bodies,
    place_parts,
    time_to_touch,
)
from fss_sim.plant.impact import IMPULSE, NEW_WELD, POSE, WELD_BIAS, touch_step

# Parts can touch in one step within this gap plus their motion in two steps [m].
CONTACT_RANGE = 5e-3
# No check afterwards if the time to a possible contact is this multiple of the advance.
SAFE_RATIO = 10
ADVANCE, SHORT, STOP = range(3)  # ways to advance, see `advance`
NO_LAW = Contact()  # not used without pairs


class Moving(Protocol):
    """A chain of bodies that moves independently."""

    @property
    def n(self) -> int:
        """Number of joints."""

    @property
    def snapshot(self) -> Floats:
        """State that a step changes, as in `advance`."""

    @snapshot.setter
    def snapshot(self, snapshot: Floats) -> None: ...

    def constants(self, first_step: int) -> Floats:
        """Return the constants of the steps from `first_step` on, as in `advance`."""


class Scene(NamedTuple):
    """Parts of several chains, the pairs that can touch, and welds, with the state of both."""

    parts: Floats  # (s, 7)
    pairs: Floats  # (g, 2) indices of parts
    touched: Floats  # (g, PAIR_SIZE)
    welds: Floats  # (w, 5) two chains, and the pose of the tip of the second in the first one's
    held: Floats  # (w, 15)


EMPTY_SCENE = Scene(
    np.zeros((0, RADIUS + 1)),
    np.zeros((0, 2)),
    np.zeros((0, PAIR_SIZE)),
    np.zeros((0, POSE + 3)),
    np.zeros((0, NEW_WELD.size)),
)


@helper
def _place_chains(chains, places):  # type: ignore[no-untyped-def]
    for c in range(len(chains)):
        place_bodies(chains[c], places, c)
    place_parts(places)


@helper
def _find_close(touched, close):  # type: ignore[no-untyped-def]
    """Return the least time in which a pair can touch [s], and the number of close pairs.

    Their indices are written to `close`. Pairs that have overlapped from the start do not count.
    """
    slack, near = math.inf, 0
    for g in range(touched.shape[0]):
        gap, speed = touched[g, GAP], touched[g, SPEED]
        if touched[g, OVERLAPS] > 0.0 and gap < 0.0:
            continue
        touched[g, OVERLAPS] = 0.0
        slack = min(slack, time_to_touch(gap, speed))
        if gap < CONTACT_RANGE + 2.0 * STEP * speed:
            close[near] = g
            near += 1
    return slack, near


@helper
def _touch(before, after, time):  # type: ignore[no-untyped-def]
    """Return True if a pair may have touched within a time, by its gaps before and after it."""
    for g in range(after.shape[0]):
        travel = time * max(before[g, SPEED], after[g, SPEED])
        if after[g, OVERLAPS] == 0.0 and before[g, GAP] + after[g, GAP] <= travel:
            return True
    return False


@kernel("(a),(x),(c),(s,h),(g,i),(g,t),(w,l),(w,k),(o),(r)->(x),(g,t),(w,k),(r)")
def _advance(  # type: ignore[no-untyped-def]
    constants, state0, counts, parts, pairs, touched0, welds, held0, options, _r,
    state, touched, held, result,
):  # fmt: skip
    steps, tolerance, way = int(options[0]), options[1], int(options[2])
    at, x, n, done, work = 0, 0, int(counts[0]), 0, 0.0
    chains = [make_chain(constants, state0, n)]
    for c in range(1, counts.size):
        at, x = at + FIXED_SIZE + JOINT_SIZE * n, x + FIXED_STATE + JOINT_STATE * n
        n = int(counts[c])
        chains.append(make_chain(constants[at:], state0[x:], n))
    touched[:], held[:] = touched0, held0
    touched[:, PUSHED], held[:, IMPULSE:WELD_BIAS] = 0.0, 0.0
    places = make_places(parts, pairs, counts)
    close, grips, law = np.empty(pairs.shape[0], np.int64), welds.copy(), options[3:].copy()
    states, touches, changes = held.copy(), touched.copy(), np.zeros(places.offsets[-1])
    _place_chains(chains, places)
    measure_gaps(places, touches, SAFE_RATIO * steps * STEP if steps > 0 else math.inf)
    if way == STOP:
        work = touch_step(
            chains, places, close[:0], touches, grips, states, law, 0, 0.0, True, changes
        )
    while done < steps:
        slack, near = _find_close(touches, close)
        if way == SHORT and near > 0 and done > 0:
            break
        count = steps - done
        if grips.shape[0] > 0:
            count = 1
        elif slack < count * STEP:
            count = max(int(slack / STEP), 1)
        for c in range(len(chains)):
            save(chains[c])
        before = touches.copy()
        while count > 1:
            for c in range(len(chains)):
                chain = chains[c]
                for i in range(count):
                    step_chain(chain, done + i, tolerance)
            if slack >= SAFE_RATIO * count * STEP:
                break
            _place_chains(chains, places)
            measure_gaps(places, touches, math.inf)
            if not _touch(before, touches, count * STEP):
                break
            for c in range(len(chains)):
                restore(chains[c])
            _place_chains(chains, places)
            touches[:] = before
            count //= 2
        if count == 1:
            work += touch_step(
                chains,
                places,
                close[:near],
                touches,
                grips,
                states,
                law,
                done,
                tolerance,
                False,
                changes,
            )
        done += count
        if way == SHORT and near > 0 and count == 1:
            break
        if done < steps:
            _place_chains(chains, places)
            measure_gaps(places, touches, SAFE_RATIO * (steps - done) * STEP)
    x = 0
    for c in range(len(chains)):
        finish_chain(chains[c], changes[places.offsets[c] :], state[x:])
        x += FIXED_STATE + JOINT_STATE * int(counts[c])
    touched[:], held[:], result[0], result[1] = touches, states, done, work


def advance(
    chains: Sequence[Moving],
    scene: Scene,
    steps: int,
    first_step: int,
    tolerance: float = 0.0,
    law: Contact | None = None,
    way: int = ADVANCE,
) -> tuple[Scene, int, float]:
    """Advance chains by at most `steps` steps; with 0 steps, only update audits and gaps.

    The constants of a chain of n joints are

        p: (8 + 6 n,) Arm.vector().
        rotor: (2,) N^2 J and N J [kg m^2]: each joint's rotor has inertia J and turns N times as
            fast as the joint.
        gears: (10,) GearParameters without `rest`; a stiffness of 0: rigid joints.
        around: (12,) Surroundings.vector().
        valves: (8, 5) force on the base's origin in the base frame [N] and torque [N m] of a
            thruster while its valve is open; the first step in which it is open; the step in which
            it is closed again.
        rest: (n,) angle of each joint at an encoder reading of 0 [rad].
        joints: (n, 7) minimum and maximum angle [rad], maximum torque of the motor [N m]; viscous
            [N m s/rad] and Coulomb friction [N m]; stiffness [N m/rad] and damping [N m s/rad] of
            the end stops.
        demand: (n, 4) for each drive: mode, set point [N m, rad/s or rad, by mode], speed [rad/s]
            and acceleration [rad/s^2] of the profile. The acceleration is above 0 except in mode
            off. Position mode at speed 0 means: decelerate, then hold the angle reached.

    and its state, which changes, is

        q and qd, (2, 3 + n).
        reference: (n, 2) reference angle [rad] and rate [rad/s] of each drive.
        motors: (n, 3) behind flexible gears: angle [rad], rate [rad/s] and torque [N m].
        torques: (n, 2) [N m] of the last step: of each motor, and transmitted by each gear, which
            is the former minus friction. With flexible gears: at its end.
        audit: (2, 4) linear momentum [N s], angular momentum about the world's origin [N m s] and
            energy [J], with that of the gears' springs. The first row is that of the bodies. The
            second row is the sum of what forces supplied.

    Args:
        chains: the chains.
        scene: what can touch and what is welded.
        steps: number of steps.
        first_step: number of the first one.
        tolerance: largest error of a step in any coordinate or rate, in SI units, for the
            Dormand-Prince method with error control; 0: classical Runge-Kutta method.
        law: law of contact; not needed without pairs.
        way: ADVANCE; SHORT: a step in which parts are close is made alone; STOP: no time passes,
            and impulses stop the relative motion of welds.

    Returns:
        The scene with its new state; the number of steps; the work of contacts and welds [J].
    """
    law = law or NO_LAW
    before = [chain.snapshot for chain in chains]
    state, touched, held, (done, work) = _advance(
        np.concatenate([chain.constants(first_step) for chain in chains]),
        np.concatenate(before),
        np.array([chain.n for chain in chains], dtype=float),
        *scene,
        np.array([steps, tolerance, way, law.restitution, law.friction, law.threshold]),
        np.empty(2),
    )
    at = 0
    for chain, row in zip(chains, before, strict=True):
        chain.snapshot = state[at : at + row.size]
        at += row.size
    return scene._replace(touched=touched, held=held), int(done), float(work)
