"""Solution of a kinematic calibration: outlier rejection and held-out observations."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt

from fss_arm_calib.checks import UPDATE_TOLERANCE
from fss_arm_calib.kinematic import model
from fss_arm_calib.kinematic.problem import (
    DESCRIBED,
    EQUAL,
    EQUAL_LENGTH_TOLERANCE,
    FULL,
    KinematicProblem,
)
from fss_arm_calib.kinematic.settings import KinematicSettings
from fss_arm_calib.kinematic.solve import KinematicResult, Prediction, fit
from fss_arm_calib.outcome import Estimate, estimate_of_fit
from fss_arm_calib.segments.rests import Observation
from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_model.estimation import outliers
from fss_arm_model.estimation.least_squares import Mask
from fss_arm_model.estimation.noise import (
    MAX_ITERATIONS,
    MIN_FREEDOM,
    Noise,
    NoiseSolution,
    ResidualSums,
    assumed_noise,
    solve_with_noise,
)
from fss_arm_model.estimation.outliers import expand, reject_outliers
from fss_arm_model.estimation.statistics import equivalent_error
from fss_arm_model.estimation.variances import (
    PoseNoise,
    first_nodes,
    log_prior,
    mean_variances,
)

#: Limit of the condition number for solutions with estimated deviations. Whether all parameters are
#: determined is checked with the assumed deviations: very accurate headings increase the condition
#: number, but make no parameter less certain.
RELAXED_MAX_CONDITION = 1e6

MAX_VARIANCE_CHANGE = 1e-3  # relative, below which they have converged: far below their uncertainty


PoseSolution = NoiseSolution[KinematicResult, PoseNoise]


@dataclass(frozen=True)
class Solution(outliers.Solution[KinematicResult]):
    """Result from s observations, and a prediction of held-out observations.

    Errors are normalized residuals; those of rejected observations are predicted.
    """

    problem: KinematicProblem  # with all s observations
    held_out: npt.NDArray[np.intp]  # (h,) indices of the held-out observations
    prediction: Prediction  # of the held-out observations, by a solution without them
    noise: PoseNoise  # of the observations, as in `problem`
    nominal: KinematicResult  # with the given deviations, or the largest plausible ones


def problem_of(used: Sequence[Observation], arm: Arm, s: KinematicSettings) -> KinematicProblem:
    """Return the kinematic problem of the used observations; ValueError if the arm is another."""
    position, heading = assumed_noise(s).deviations.tolist()
    base = min(s.base_heading_deviation, heading)
    return KinematicProblem(
        q=np.array([o.q for o in used]).reshape(len(used), -1 if used else arm.n),
        tip=np.array([o.tip for o in used]).reshape(-1, 3),
        arm=arm,
        parametrization=parametrization(arm, s),
        position_deviation=position,
        heading_deviation=heading,
        base_heading_deviation=base,
        ripple_deviation=s.ripple_deviation,
        eccentricity_deviation=s.eccentricity_deviation,
        theta_e=s.theta_e,
        loss=s.loss,
    )


def parametrization(arm: Arm, s: KinematicSettings) -> str:
    """Return the parametrization of the arm's lengths."""
    if s.parametrization != DESCRIBED:
        return s.parametrization
    lengths = [link.a for link in arm.links[:-1]] or [0.0]
    return EQUAL if max(lengths) - min(lengths) <= EQUAL_LENGTH_TOLERANCE else FULL


def min_observations(problem: KinematicProblem, s: KinematicSettings) -> int:
    """Return the number of observations needed."""
    return max(s.min_observations, len(problem.names) // 3 + 1)


def solution_of(problem: KinematicProblem, settings: KinematicSettings) -> Solution:
    """Solve, reject outliers one by one up to the limit, and predict held-out observations."""
    s, largest = settings, problem.sigma[1:].tolist()
    fewest = min_observations(problem, s)

    def solved_only(mask: Mask) -> PoseSolution:
        those = problem.select(mask)

        def with_noise(deviations: Floats) -> tuple[KinematicResult, ResidualSums | None]:
            assumed = deviations.tolist() == largest
            most = s.max_condition if assumed else RELAXED_MAX_CONDITION
            known = those.with_deviations(deviations, s.base_heading_deviation)
            result = fit(known, UPDATE_TOLERANCE, max_condition=most)
            return result, result.residual_sums

        return separate_headings(solve_with_noise(s, with_noise), s)

    def solved(mask: Mask) -> tuple[PoseSolution, Floats]:
        found = solved_only(mask)
        errors = found.result.normalized_residuals
        if not found.noise.is_given.all() and np.sum(mask) > fewest:
            # Judge the worst by the noise of the others: an outlier inflates the estimated
            # deviation and so hides itself.
            worst, others = int(np.argmax(errors)), mask.copy()
            others[np.flatnonzero(mask)[worst]] = False
            without = solved_only(others)
            its = without.noise
            there = problem.select(mask & ~others).with_deviations(its.deviations, its.base_heading)
            off = without.result.predict(there).normalized[0]
            errors[worst] = max(errors[worst], equivalent_error(off, 3.0, its.freedom))
        return found, errors

    found = reject_outliers(
        solved, len(problem.q), s.outlier, s.max_outliers, fewest, "normalized residual"
    )
    result, noise, first = found.result
    problem = problem.with_deviations(noise.deviations, noise.base_heading)
    errors = np.where(found.mask, found.errors, result.predict(problem).normalized)
    weights, leverage = (expand(x, found.mask, 0.0) for x in (result.weights, result.leverage))
    held_out = _held_out(problem, result, found.mask, s, noise)
    data = found.mask, found.reasons, errors, weights, leverage
    return Solution(result, *data, problem, *held_out, noise, first)


def separate_headings(
    found: NoiseSolution[KinematicResult, Noise], s: KinematicSettings
) -> PoseSolution:
    """Separate errors of the base's heading from the others, unless a deviation is given."""
    result, sums = found.result, found.result.residual_sums
    given = min(s.base_heading_deviation, result.problem.heading_deviation)
    noise = PoseNoise(**vars(found.noise), base_heading=given)
    known = given or noise.is_given.any() or np.isinf(noise.freedom)
    if known or sums is None or np.min(sums.freedom) < MIN_FREEDOM:
        return PoseSolution(result, noise, found.nominal)
    before, nodes = result.problem.variances, first_nodes(noise.deviations)
    ratio = float(np.divide(*noise.largest) ** 2)
    for _ in range(MAX_ITERATIONS):
        variances, nodes = mean_variances(partial(_log_density, result, ratio), nodes)
        if np.all(np.abs(variances.mean - before) < MAX_VARIANCE_CHANGE * variances.mean):
            break
        before, noise = variances.mean, noise.with_variances(variances)
        problem = result.problem.with_deviations(noise.deviations, noise.base_heading)
        result = fit(problem, UPDATE_TOLERANCE, max_condition=RELAXED_MAX_CONDITION)
    return PoseSolution(result, noise, found.nominal)


def _log_density(result: KinematicResult, ratio: float, variances: Floats) -> Floats:
    """Return the log posterior density (k,) of variances (k, 3)."""
    return result.restricted_log_likelihood(variances) + log_prior(variances, ratio)


def _held_out(
    problem: KinematicProblem,
    result: KinematicResult,
    kept: Mask,
    s: KinematicSettings,
    noise: PoseNoise,
) -> tuple[npt.NDArray[np.intp], Prediction]:
    """Predict held-out observations by a solution without them; none if too few remain."""
    held_out = np.flatnonzero(kept)[s.held_out - 1 :: s.held_out] if s.held_out else np.arange(0)
    rest = kept.copy()
    rest[held_out] = False
    if len(held_out) and np.sum(rest) >= min_observations(problem, s):
        most = s.max_condition if noise.is_given.all() else RELAXED_MAX_CONDITION
        without = fit(problem.select(rest), UPDATE_TOLERANCE, max_condition=most)
        if not without.undetermined:
            return held_out, without.predict(problem.select(held_out))
    return held_out[:0], result.predict(problem.select(held_out[:0]))


def estimate_of(problem: KinematicProblem, solution: Solution | None) -> Estimate:
    """Convert the solution to the estimate that all kinds of calibration share."""
    if solution is None:
        freedom, reasons = problem.degrees_of_freedom, len(problem.q) * ("",)
        first = problem.names, problem.units, problem.guess
        return Estimate(*first, reasons=reasons, degrees_of_freedom=freedom)
    r = solution.result
    return estimate_of_fit(
        r,
        solution,
        residuals=model.residuals(problem, r.values),
        position_residual=r.position_residual,
        heading_residual=r.heading_residual,
        chi_square=r.chi_square,
        condition_number=solution.nominal.condition_number,
    )
