"""Identifiability analysis of a dynamic calibration.

For n links on a known base, the motion depends on only 2 n + 1 combinations of the masses, centres
of mass and inertias (see fss_arm_model.base_motion):

    m = sum_k m_k
    S_j = m_j g_j + a_j sum_{k>j} m_k
    K_j = I_j + m_j g_j^2 + a_j^2 sum_{k>j} m_k
"""

from dataclasses import dataclass
from math import inf

import numpy as np

from fss_arm_calib.dynamic.information import information
from fss_arm_calib.dynamic.parameters import Choice, Knowledge
from fss_arm_calib.dynamic.result import DynamicResult
from fss_arm_model.arrays import Floats
from fss_arm_model.base_motion import base_pose_sensitivities
from fss_arm_model.description import Arm
from fss_arm_model.joint_path import Law, path, stack
from fss_arm_model.parameters import to_vector, values

INVISIBLE, HARDLY_SEEN, VISIBLE = "invisible", "hardly seen", "seen"

#: Singular values below this share of the largest are rounding errors.
RANK_TOLERANCE = 1e-9

#: Components of a direction below this are not printed.
MIN_PRINTED_WEIGHT = 0.1


@dataclass(frozen=True)
class Direction:
    """Combination of parameters, each in units of its prior standard deviation."""

    weights: Floats  # (p,) of unit length
    gain: float  # prior standard deviation divided by the one from the data alone
    kind: str  # INVISIBLE to any experiment; HARDLY seen: gain below 1; SEEN otherwise

    def text(self, names: tuple[str, ...]) -> str:
        """Return its largest components as text, such as `+0.7 b_1 -0.7 I_1`."""
        order = np.argsort(-np.abs(self.weights))
        sign = np.sign(self.weights[order[0]])
        worth = [k for k in order if abs(self.weights[k]) >= MIN_PRINTED_WEIGHT]
        return " ".join(f"{sign * self.weights[k]:+.2f} {names[k]}" for k in worth)


@dataclass(frozen=True)
class Combination:
    """Combination of parameters that the motion depends on."""

    name: str
    unit: str
    value: float
    before: float  # prior standard deviation; inf: no prior
    deviation: float  # standard deviation of the result; inf: not determined


def invisible_directions(arm: Arm, choice: Choice, scale: Floats) -> Floats:
    """Return combinations of the chosen parameters that no maneuver depends on.

    They are computed from the sensitivities of random maneuvers that excite every observable
    combination.

    Args:
        arm: arm at which the sensitivities are evaluated.
        choice: the p parameters.
        scale: (p,) unit of each parameter.

    Returns:
        (k, p) orthonormal directions in these units.
    """
    rng = np.random.default_rng(0)
    paths = [
        path(_random_swing(arm.n, rng), np.arange(5.0), [0.0, 2.0, 4.0])
        for _ in range(len(scale) + 4)
    ]
    J = base_pose_sensitivities(arm.vector(), stack(paths), np.zeros(8))[1]
    J = J[..., :-8] @ (to_vector(arm.n) @ choice.basis * scale)
    _, s, Vt = np.linalg.svd(J.reshape(-1, len(scale)))
    return np.asarray(Vt[np.count_nonzero(s > RANK_TOLERANCE * s[0]) :])


def _random_swing(n: int, rng: np.random.Generator) -> Law:
    """Return a law of motion in which each joint swings at its own frequency."""
    reach, pace, phase = rng.uniform([[0.3], [0.5], [0.0]], [[1.5], [2.0], [6.0]], (3, n))

    def law(t: Floats) -> tuple[Floats, Floats]:
        angle = t[:, None] * pace + phase
        return reach * np.sin(angle), reach * pace * np.cos(angle)

    return law


def prior_scales(result: DynamicResult, knowledge: Knowledge) -> Floats:
    """Return the prior standard deviation of each parameter (p,); a typical one if no prior."""
    choice, known = result.problem.choice, result.problem.prior_deviations
    typical = choice.basis.T @ knowledge.deviations(result.problem.arm.n)
    typical = typical / choice.basis.sum(axis=0)
    typical = np.concatenate([typical, known[len(typical) :]])
    return np.where(np.isfinite(known), known, typical)


def directions(result: DynamicResult, knowledge: Knowledge) -> list[Direction]:
    """Return all p directions, best observed first, from the data without the priors."""
    problem, scale = result.problem, prior_scales(result, knowledge)
    unseen = np.zeros((0, len(scale)))
    if chosen := len(problem.choice.names):
        unseen = invisible_directions(problem.arm, problem.choice, scale[:chosen])
        unseen = np.pad(unseen, ((0, 0), (0, len(scale) - chosen)))
    N = information(problem, result.minimum.x).sum(axis=0)[: len(scale), : len(scale)]
    N *= np.outer(scale, scale)
    seen = np.eye(len(scale)) - unseen.T @ unseen
    gains, vectors = np.linalg.eigh(seen @ N @ seen)
    order = np.argsort(-gains)[: len(scale) - len(unseen)]
    found = []
    for k in order:
        gain = float(np.sqrt(max(gains[k], 0.0)))
        found.append(Direction(vectors[:, k], gain, VISIBLE if gain >= 1.0 else HARDLY_SEEN))
    return found + [Direction(weights, 0.0, INVISIBLE) for weights in unseen]


def _combination_gradients(arm: Arm) -> tuple[Floats, Floats]:
    """Return the 2 n + 1 combinations and their derivatives by all parameters.

    The derivatives have shape (2 n + 1, 5 n + 6).
    """
    n, v = arm.n, values(arm)
    a, m, b, inertia = v[4 : 4 + n], *v[2 * n + 6 :].reshape(3, n)
    g, beyond = a - b, np.cumsum(m[::-1])[::-1] - m
    combined = np.concatenate([[m.sum()], m * g + a * beyond, inertia + m * g**2 + a**2 * beyond])
    G = np.zeros((2 * n + 1, len(v)))
    by_a, by_m, by_b, by_I = 4, 2 * n + 6, 3 * n + 6, 4 * n + 6
    G[0, by_m : by_m + n] = 1.0
    for j in range(n):
        S, K = 1 + j, 1 + n + j
        G[S, by_m + j], G[K, by_m + j] = g[j], g[j] ** 2
        G[S, by_m + j + 1 : by_m + n], G[K, by_m + j + 1 : by_m + n] = a[j], a[j] ** 2
        G[S, by_b + j], G[K, by_b + j] = -m[j], -2.0 * m[j] * g[j]
        G[S, by_a + j] = m[j] + beyond[j]
        G[K, by_a + j] = 2.0 * (m[j] * g[j] + a[j] * beyond[j])
        G[K, by_I + j] = 1.0
    return combined, G


def combinations(result: DynamicResult) -> list[Combination]:
    """Return the combinations that the motion depends on, with their uncertainty."""
    problem = result.problem
    n, chosen = problem.arm.n, problem.choice.basis
    combined, G = _combination_gradients(result.calibrated())
    size = chosen.shape[1]
    by_x, by_assumed = G @ chosen, G[:, result.assumed]
    through = by_x @ result.influence[:size] - by_assumed
    assumed = problem.assumed[np.ix_(result.assumed, result.assumed)]
    known = by_x**2 @ np.minimum(problem.prior_deviations[:size], 1e150) ** 2
    before = known + np.einsum("ij,jk,ik->i", by_assumed, assumed, by_assumed)
    now = np.einsum("ij,jk,ik->i", by_x, result.random[:size, :size], by_x)
    now += np.einsum("ij,jk,ik->i", through, assumed, through)
    lost = _are_undetermined(result, by_x)
    names = ["m", *(f"{kind}_{j}" for kind in "SK" for j in range(1, n + 1))]
    kinds = ["kg", *["kg m"] * n, *["kg m^2"] * n]
    return [
        Combination(
            name,
            kind,
            float(combined[k]),
            float(np.sqrt(before[k])) if before[k] < 1e100 else inf,
            inf if lost[k] else float(np.sqrt(now[k])),
        )
        for k, (name, kind) in enumerate(zip(names, kinds, strict=True))
    ]


def _are_undetermined(result: DynamicResult, by_x: Floats) -> list[bool]:
    """Return, for each gradient, True if it has components in undetermined directions."""
    basis, size = result.minimum.basis, by_x.shape[1]
    rows = np.pad(by_x, ((0, 0), (0, len(result.values) - size))) / basis.scale
    rest = rows - rows @ basis.Vt.T @ basis.Vt
    return list(np.linalg.norm(rest, axis=1) > 1e-6 * np.linalg.norm(rows, axis=1))
