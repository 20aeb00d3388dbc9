"""Solution of a dynamic calibration: prior knowledge, outlier rejection and the estimate."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import inf

import numpy as np

from fss_arm_calib.checks import UPDATE_TOLERANCE
from fss_arm_calib.dynamic.identifiability import Combination, Direction, combinations, directions
from fss_arm_calib.dynamic.knowledge import independent_knowledge
from fss_arm_calib.dynamic.problem import DynamicProblem
from fss_arm_calib.dynamic.settings import HEADING, DynamicSettings
from fss_arm_calib.dynamic.solve import DynamicResult, solve
from fss_arm_calib.outcome import Estimate, estimate_of_fit
from fss_arm_calib.precision import unmeasured
from fss_arm_calib.segments.maneuvers import Maneuver
from fss_arm_calib.segments.poses import count_independent
from fss_arm_model.arrays import Floats
from fss_arm_model.choice import Choice
from fss_arm_model.description import Arm
from fss_arm_model.estimation import outliers
from fss_arm_model.estimation.least_squares import Mask
from fss_arm_model.estimation.noise import (
    Noise,
    NoiseSolution,
    ResidualSums,
    assumed_noise,
    solve_with_noise,
)
from fss_arm_model.estimation.outliers import expand, reject_outliers, solve_robustly
from fss_arm_model.estimation.statistics import root_mean_square
from fss_arm_model.joint_path import Path, stack
from fss_arm_model.layout import kinematic_names
from fss_arm_model.units import GRAVITY


def problem_of(
    maneuvers: Sequence[Maneuver], arm: Arm, settings: DynamicSettings
) -> DynamicProblem:
    """Return the dynamic problem of maneuvers with poses; ValueError: they are of another arm."""
    s, arm = settings, independent_knowledge(arm, maneuvers, kinematic_names(arm.n))
    if others := [len(one.times) for one in maneuvers if len(one.times) != arm.n]:
        raise ValueError(f"a maneuver is of {others[0]} joints, expected {arm.n}")
    most = max(len(one.marks) for one in maneuvers)
    poses = np.zeros((len(maneuvers), most, 3))
    sigma = np.full_like(poses, inf)
    deviations = pose_deviations(s)
    for one, pose, spread in zip(maneuvers, poses, sigma, strict=True):
        pose[: len(one.marks)] = one.poses
        fresh = count_independent(one.frames, one.seconds, s.fresh_rate)
        spread[: len(one.marks)] = deviations / np.sqrt(fresh)[:, None]
        if (rows := np.flatnonzero(one.in_motion)).size:
            late = s.path_timing * np.gradient(np.array(one.poses), one.marks, axis=0)
            spread[rows] = np.hypot(spread[rows], late[rows])
    return problem_with_priors(arm, s, stack([one.path for one in maneuvers]), poses, sigma)


def pose_deviations(s: DynamicSettings) -> Floats:
    """Return the deviations (3,) of a base pose with independent errors; inf: not used."""
    deviations = assumed_noise(s).deviations[[0, 0, 1]]
    if s.residuals == HEADING:
        deviations[:2] = inf
    return deviations


def problem_with_priors(
    arm: Arm, settings: DynamicSettings, path: Path, poses: Floats, sigma: Floats
) -> DynamicProblem:
    """Return the problem of maneuvers, with the prior knowledge from the settings."""
    s, n = settings, arm.n
    choice, C = Choice.of(s.estimate, n), s.covariance(arm)
    prior = choice.mean(np.sqrt(np.diag(C)))
    closed = choice.basis[s.prior_indices(arm, s.priors)].any(axis=0)
    return DynamicProblem(
        path,
        poses,
        sigma,
        arm,
        choice,
        prior=np.where(closed, prior, inf),
        assumed=C,
        momentum=np.array([s.momentum_deviation] * 2 + [s.spin_deviation]),
        tilt=GRAVITY * s.tilt_deviation,
    )


def problem_without_data(arm: Arm, settings: DynamicSettings) -> DynamicProblem:
    """Return the problem without any maneuver."""
    n, none = arm.n, np.empty((0, 1, 3))
    nowhere = Path(np.empty((0, 1, 3 * n + 1)), np.empty((0, 1, 2 * n + 2)))
    return problem_with_priors(arm, settings, nowhere, none, none)


@dataclass(frozen=True)
class Solution(outliers.Solution[DynamicResult]):
    """Result from M maneuvers, and what the motion can determine."""

    directions: tuple[Direction, ...]  # of the p parameters
    combinations: tuple[Combination, ...]
    noise: Noise  # of poses that are independent according to `fresh_rate`
    nominal: DynamicResult  # with the given deviations, or the largest plausible ones

    @property
    def momenta(self) -> Floats:
        """Momentum (M, 3) at the start of each maneuver [N s, N s, N m s]; NaN if rejected."""
        return expand(self.result.momenta, self.kept)


def solution_of(problem: DynamicProblem, settings: DynamicSettings) -> Solution:
    """Solve with the loss of the settings, and reject outliers one by one up to the limit."""
    s, size = settings, len(problem.poses)
    weights, largest = np.zeros(size), assumed_noise(s).deviations
    seen = np.asarray(np.isfinite(problem.sigma[..., 1:]).any(axis=(0, 1)))

    def solved(mask: Mask) -> tuple[NoiseSolution[DynamicResult, Noise], Floats]:
        weights[:], errors = 0.0, np.empty(np.count_nonzero(mask))
        some = problem.select(mask)

        def with_noise(deviations: Floats) -> tuple[DynamicResult, ResidualSums]:
            factors = (deviations / largest)[[0, 0, 1]]
            those = replace(some, sigma=some.sigma * factors)
            weigh = partial(_solve_weighted, those)
            result, weights[mask], errors[:] = solve_robustly(weigh, len(errors), s.loss)
            return result, result.residual_sums

        return solve_with_noise(s, with_noise, seen), errors

    found = reject_outliers(solved, size, s.outlier, s.max_outliers, s.min_maneuvers, "error")
    result, noise, first = found.result
    leverage = expand(result.checks[0], found.mask, 0.0)
    seen_motion = tuple(directions(result, s)), tuple(combinations(result))
    data = found.mask, found.reasons, found.errors, weights, leverage
    return Solution(result, *data, *seen_motion, noise, first)


def _solve_weighted(problem: DynamicProblem, weights: Floats) -> tuple[DynamicResult, Floats]:
    scale = np.sqrt(weights)[:, None, None]
    result = solve(replace(problem, sigma=problem.sigma / scale), tolerance=UPDATE_TOLERANCE)
    return result, result.checks[1]


def estimate_of(
    arm: Arm, s: DynamicSettings, used: Sequence[Maneuver], solution: Solution | None
) -> Estimate:
    """Convert the solution to the estimate that all kinds of calibration share."""
    if solution is None:
        problem = problem_without_data(arm, s)
        reasons = len(used) * ("",)
        return Estimate(problem.names, problem.units, problem.guess, reasons=reasons)
    r = solution.result
    return estimate_of_fit(
        r,
        solution,
        deviations=r.deviations,
        residuals=_pose_residuals(solution, used),
        position_residual=root_mean_square(r.residuals[..., :2]),
        heading_residual=root_mean_square(r.residuals[..., 2]),
        chi_square=r.chi_square,
        unmeasured=unmeasured(r.problem, r.deviations),
    )


def _pose_residuals(solution: Solution, used: Sequence[Maneuver]) -> Floats:
    """Return the residuals (sum of marks, 3) of all maneuvers; NaN for rejected ones."""
    every = expand(solution.result.residuals, solution.kept)
    rows = zip(every, used, strict=True)
    return np.concatenate([residuals[: len(one.marks)] for residuals, one in rows])
