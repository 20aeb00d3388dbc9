"""Postures that determine the kinematic parameters best, in an order of short moves."""

from itertools import combinations, pairwise

import numpy as np

from fss_arm_calib.kinematic.problem import HEADING_DEVIATION, POSITION_DEVIATION
from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_model.guard.guard import Guard, GuardError
from fss_arm_model.guard.settings import GuardSettings
from fss_arm_model.kinematics import tip_regressor

MIN_DIFFERENCE = np.radians(45.0)  # least difference of two postures in at least one joint
MAX_ANGLE = np.radians(85.0)  # of a joint in a designed posture
MAX_ROUNDS = 20  # of exchanges; about five suffice, except for many postures of one joint

#: Result of design(paper_arm(), seed=5), for the paper's arm and similar ones, (13, 4) [rad].
DEFAULT_POSTURES: Floats = np.radians(
    [
        [0, -5, 10, 10],
        [-70, -75, 80, 75],
        [-85, -80, -60, 85],
        [-85, -80, 85, -75],
        [-70, 70, 70, 75],
        [-80, 80, -85, -60],
        [80, -85, -85, -10],
        [75, -85, -65, -85],
        [80, -85, 85, -80],
        [85, 75, 65, -80],
        [85, 75, -75, -75],
        [80, 75, -60, 70],
        [-75, 80, 80, -80],
    ]
)


def default_postures(arm: Arm, settings: GuardSettings | None = None) -> Floats:
    """Return postures for an arm, (s, n) [rad]: DEFAULT_POSTURES if possible, else a design.

    An arm of four links takes them if they are within its limits and all moves keep it clear.
    """
    if arm.n == DEFAULT_POSTURES.shape[1]:
        guard = Guard(arm, settings)
        low, high = (np.array([getattr(k, q) for k in arm.links]) for q in ("q_min", "q_max"))
        within = np.all((low <= DEFAULT_POSTURES) & (high >= DEFAULT_POSTURES))
        if within and all(is_clear(guard, *move) for move in pairwise(DEFAULT_POSTURES)):
            return DEFAULT_POSTURES
    return design_postures(arm, max(13, 2 * arm.n + 2), settings=settings)


def design_postures(
    arm: Arm,
    count: int = 13,
    seed: int = 0,
    candidates: int = 2000,
    settings: GuardSettings | None = None,
) -> Floats:
    """Choose postures (count, n) by their information about all 2n+2 parameters (D-optimality).

    Candidates are seeded random postures within the joints' limits and +-MAX_ANGLE, for which the
    guard finds the arm clear of itself and of the base. One posture after the other is replaced by
    the candidate that increases det(Phi' W Phi) most, among those that differ enough from the
    others. This is repeated until nothing changes, at most MAX_ROUNDS times. The first posture is
    the candidate nearest to zero. Finally the postures are put in an order of short moves that keep
    clear, too.

    Raises:
        ValueError: too few candidates keep the arm clear.
    """
    step = np.radians(5.0)
    low = np.ceil(np.maximum([k.q_min for k in arm.links], -MAX_ANGLE) / step)
    high = np.floor(np.minimum([k.q_max for k in arm.links], MAX_ANGLE) / step)
    rng = np.random.default_rng(seed)
    q = step * rng.integers(low, high, (candidates, arm.n), endpoint=True)
    guard = Guard(arm, settings)
    q = q[guard.slack(q) >= 0.0]
    if len(q) < count:
        raise ValueError(f"only {len(q)} of {candidates} postures keep the arm clear of itself")
    q = q[np.argsort(np.max(np.abs(q), axis=1))]
    sigma = np.array([POSITION_DEVIATION, POSITION_DEVIATION, HEADING_DEVIATION])
    Phi = tip_regressor(arm.vector(), q) / sigma[:, None]
    information = np.swapaxes(Phi, 1, 2) @ Phi
    chosen = list(range(count))
    for _ in range(MAX_ROUNDS):
        before = list(chosen)
        for k in range(1, count):
            others = information[chosen[:k] + chosen[k + 1 :]].sum(axis=0)
            # det(A + Phi' Phi) = det(A) det(1 + Phi A^-1 Phi'), with A regularized
            inverse = np.linalg.inv(others + 1e-6 * np.eye(len(others)))
            gain = np.linalg.det(np.eye(3) + Phi @ inverse @ np.swapaxes(Phi, 1, 2))
            gain[~_are_different(q, q[chosen[:k] + chosen[k + 1 :]])] = 0.0
            chosen[k] = int(np.argmax(gain))
        if chosen == before:
            break
    return q[chosen][_order_by_short_moves(guard, q[chosen])]


def _are_different(q: Floats, others: Floats) -> np.ndarray:
    """Return a mask (c,) of postures that differ from all others by MIN_DIFFERENCE in a joint.

    If there is none, as with few joints and many postures, the limit is smaller.
    """
    nearest = np.min(np.max(np.abs(q[:, None] - others), axis=-1), axis=1)
    return nearest >= min(MIN_DIFFERENCE, np.max(nearest))


def is_clear(guard: Guard, begin: Floats, end: Floats) -> bool:
    """Return True if a straight move between two postures (n) keeps the arm clear of itself."""
    try:
        guard.check_path((0.0, 1.0), (begin, end), np.zeros((2, len(begin))))
    except GuardError:
        return False
    return True


def _order_by_short_moves(guard: Guard, q: Floats) -> list[int]:
    """Return a short order of postures by 2-opt (reversal of parts); the first stays first."""
    cost = np.zeros((len(q), len(q)))
    for i, j in combinations(range(len(q)), 2):
        blocked = not is_clear(guard, q[i], q[j])
        cost[i, j] = cost[j, i] = np.max(np.abs(q[j] - q[i])) + 100.0 * blocked

    def length(way: list[int]) -> float:
        return float(sum(cost[i, j] for i, j in pairwise(way)))

    way, better = list(range(len(q))), True
    while better:
        better = False
        for i, j in combinations(range(1, len(q) + 1), 2):
            other = way[:i] + way[i:j][::-1] + way[j:]
            if length(other) < length(way) - 1e-9:
                way, better = other, True
    return way
