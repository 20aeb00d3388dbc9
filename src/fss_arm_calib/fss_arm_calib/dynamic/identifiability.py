"""Identifiability analysis of a dynamic calibration.

For n links on a known base, the motion depends on only 2 n + 1 combinations of the masses, centres
of mass and inertias: m, S_j and K_j of fss_arm_model.parameters.
"""

from dataclasses import dataclass
from math import inf

import numpy as np
import numpy.typing as npt

from fss_arm_calib.dynamic.knowledge import Knowledge
from fss_arm_calib.dynamic.problem import DynamicProblem
from fss_arm_calib.dynamic.solve import DynamicResult
from fss_arm_model.arrays import Floats
from fss_arm_model.base_motion import base_pose_sensitivities
from fss_arm_model.choice import Choice
from fss_arm_model.description import Arm
from fss_arm_model.estimation.least_squares import Mask
from fss_arm_model.joint_path import Law, path, stack
from fss_arm_model.parameters import combination_gradients, to_vector

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
    """Return combinations (k, p) of the chosen parameters that no maneuver depends on.

    They are orthonormal in the units `scale` (p,). They are computed from the sensitivities, at
    `arm`, of random maneuvers that excite every observable combination.
    """
    rng = np.random.default_rng(0)
    laws = [_random_swing(arm.n, rng) for _ in range(len(scale) + 4)]
    paths = [path(law, np.arange(5.0), [0.0, 2.0, 4.0]) for law in laws]
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
    problem, known = result.problem, result.problem.prior_deviations
    typical = problem.choice.mean(knowledge.deviations(problem.arm))
    return np.where(np.isfinite(known), known, [*typical, *known[len(typical) :]])


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
    gains = np.sqrt(np.maximum(gains[order], 0.0))
    found = [
        Direction(weights, gain, VISIBLE if gain >= 1.0 else HARDLY_SEEN)
        for weights, gain in zip(vectors.T[order], gains.tolist(), strict=True)
    ]
    return found + [Direction(weights, 0.0, INVISIBLE) for weights in unseen]


def combinations(result: DynamicResult) -> list[Combination]:
    """Return the combinations that the motion depends on, with their uncertainty."""
    problem = result.problem
    n, chosen = problem.arm.n, problem.choice.basis
    combined, G = combination_gradients(result.calibrated())
    size = chosen.shape[1]
    by_x, by_assumed = G @ chosen, G[:, problem.uncertain]
    through, assumed = by_x @ result.influence[:size] - by_assumed, result.assumed_covariance
    known = by_x**2 @ np.minimum(problem.prior_deviations[:size], 1e150) ** 2
    before = known + np.einsum("ij,jk,ik->i", by_assumed, assumed, by_assumed)
    now = np.einsum("ij,jk,ik->i", by_x, result.random[:size, :size], by_x)
    now += np.einsum("ij,jk,ik->i", through, assumed, through)
    before = np.where(before < 1e100, np.sqrt(before), inf)
    now = np.where(_are_undetermined(result, by_x), inf, np.sqrt(now))
    names = ["m", *(f"{kind}_{j}" for kind in "SK" for j in range(1, n + 1))]
    units = ["kg", *["kg m"] * n, *["kg m^2"] * n]
    columns = names, units, combined.tolist(), before.tolist(), now.tolist()
    return [Combination(*row) for row in zip(*columns, strict=True)]


def _are_undetermined(result: DynamicResult, by_x: Floats) -> Mask:
    """Return a mask of the gradients with components in undetermined directions."""
    basis, size = result.minimum.basis, by_x.shape[1]
    rows = np.pad(by_x, ((0, 0), (0, len(result.values) - size))) / basis.scale
    rest = rows - rows @ basis.Vt.T @ basis.Vt
    return np.asarray(np.linalg.norm(rest, axis=1) > 1e-6 * np.linalg.norm(rows, axis=1))


def information(problem: DynamicProblem, unknowns: npt.ArrayLike | None = None) -> Floats:
    """Return Phi' W Phi of the observations (M, p + c, p + c) for each maneuver, without priors.

    It is information on the estimated and the assumed parameters; the unknowns of the maneuver are
    eliminated. The information of several maneuvers is the sum.
    """
    x = problem.start if unknowns is None else np.asarray(unknowns, dtype=float)
    columns = np.concatenate([problem.to_model, problem.uncertain_to_model], axis=1)
    Phi = problem.eliminate_states(x, columns).regressor
    Phi = Phi.reshape(len(problem.poses), -1, columns.shape[1])
    return np.asarray(np.swapaxes(Phi, 1, 2) @ Phi)


def propagate_covariance(problem: DynamicProblem, total: Floats) -> Floats:
    """Return the covariance (..., p, p) of an estimate, with that of the assumed parameters.

    `total` (..., p + c, p + c) is the information of all observations. It need not be regular by
    itself, only together with the priors.
    """
    p, rows, S = len(problem.names), problem.prior_rows, problem.uncertain
    random = np.linalg.inv(total[..., :p, :p] + rows.T @ rows)
    influence = random @ total[..., :p, p:]
    shared = random @ (rows.T @ problem.prior_with(S)) @ np.swapaxes(influence, -1, -2)
    moved = influence @ problem.assumed[np.ix_(S, S)] @ np.swapaxes(influence, -1, -2)
    return np.asarray(random + moved - shared - np.swapaxes(shared, -1, -2))
