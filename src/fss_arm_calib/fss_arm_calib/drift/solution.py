"""Solution of a drift calibration: prior knowledge, outlier rejection and the estimate."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import nan

import numpy as np

from fss_arm_calib.drift.problem import (
    NAMES,
    UNITS,
    DriftProblem,
    DriftResult,
    solve,
)
from fss_arm_calib.drift.settings import DriftSettings
from fss_arm_calib.estimation.least_squares import Mask
from fss_arm_calib.estimation.outliers import reject_outliers, solve_robustly
from fss_arm_calib.estimation.statistics import root_mean_square
from fss_arm_calib.outcome import Estimate
from fss_arm_calib.segments.drifts import Drift
from fss_arm_calib.segments.poses import count_independent
from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_model.drifting import single_body, single_body_sensitivities
from fss_arm_model.parameters import parameter_names, to_vector


@dataclass(frozen=True)
class Solution:
    """Result, and the drifts (of s) that it uses."""

    result: DriftResult  # from the drifts that were not rejected
    kept: Mask  # (s,) drifts that were not rejected
    weights: Floats  # (s,) 1: used; 0: rejected; between: weight of a robust loss
    reasons: tuple[str, ...]  # (s,) reason for the rejection, else empty
    errors: Floats  # (s,) when predicted from the others, or at its rejection [deviations]

    def expand(self, values: Floats) -> Floats:
        """Expand rows of the kept drifts to rows of all drifts; NaN for rejected ones."""
        every = np.full((len(self.kept), *values.shape[1:]), nan)
        every[self.kept] = values
        return every


def body_deviations(drifts: Sequence[Drift], arm: Arm, s: DriftSettings) -> tuple[float, float]:
    """Return the deviations of the centre of mass of base and arm, and of mass and inertia.

    The first is for each axis [m], the second is relative. If the description has a covariance of
    all parameters, they are the largest at any drift; otherwise they are those of the settings.
    """
    names = parameter_names(arm.n)
    if not drifts or not set(arm.known.names).issuperset(names):
        return s.com_deviation, s.mass_deviation
    C = arm.known.covariance_of(names, np.zeros(len(names)))
    p, q = arm.vector(), np.array([one.q for one in drifts])
    J = single_body_sensitivities(p, q) @ to_vector(arm.n)
    sigma = np.sqrt(np.einsum("kij,jl,kil->ki", J, C, J))
    relative = sigma[:, :2] / single_body(p, q)[:, :2]
    return float(sigma[:, 2:].max()), float(relative.max())


def pose_deviations(drifts: Sequence[Drift], s: DriftSettings, weights: Floats) -> list[Floats]:
    """Return the deviations (m, 3) of each drift's poses, scaled by the drift's weight."""
    of_one = np.array([s.position_deviation, s.position_deviation, s.heading_deviation])
    sigma = []
    for drift, weight in zip(drifts, weights, strict=True):
        fresh = count_independent(drift.frames, drift.seconds, s.fresh_rate)
        sigma.append(of_one / np.sqrt(fresh * weight)[:, None])
    return sigma


def problem_of(
    drifts: Sequence[Drift], arm: Arm, s: DriftSettings, weights: Floats
) -> DriftProblem:
    """Return the drift problem of weighted drifts."""
    bodies = single_body(arm.vector(), np.array([drift.q for drift in drifts]))
    return DriftProblem(
        drifts,
        bodies,
        pose_deviations(drifts, s, weights),
        s.torque_deviation,
        s.twist_deviation,
        s.drag_deviation,
        *body_deviations(drifts, arm, s),
    )


def solution_of(drifts: Sequence[Drift], arm: Arm, s: DriftSettings) -> Solution:
    """Solve with the loss of the settings, and reject outliers one by one up to the limit."""
    weights = np.zeros(len(drifts))

    def solved(mask: Mask) -> tuple[DriftResult, Floats]:
        some = [drift for drift, kept in zip(drifts, mask, strict=True) if kept]

        def weigh(weight: Floats) -> tuple[DriftResult, Floats]:
            result = solve(problem_of(some, arm, s, weight))
            return result, result.cross_checks.errors

        weights[:] = 0.0
        result, weights[mask], errors = solve_robustly(weigh, len(some), s.loss)
        return result, errors

    found = reject_outliers(solved, len(drifts), s.outlier, s.max_outliers, 1, "error")
    return Solution(found.result, found.mask, weights, found.reasons, found.errors)


def estimate_of(drifts: Sequence[Drift], solution: Solution | None) -> Estimate:
    """Convert the solution to the estimate that all kinds of calibration share."""
    initial = np.zeros(len(NAMES))
    if solution is None:
        return Estimate(NAMES, UNITS, initial, reasons=len(drifts) * ("",))
    r, minimum = solution.result, solution.result.minimum
    found = iter(r.residuals)
    residuals = np.concatenate(
        [
            next(found) if kept else np.full((len(drift.times), 3), nan)
            for drift, kept in zip(drifts, solution.kept, strict=True)
        ]
    )
    return Estimate(
        NAMES,
        UNITS,
        initial,
        r.values,
        r.covariance,
        undetermined=r.undetermined,
        at_bound=r.at_bound,
        residuals=residuals,
        weights=solution.weights,
        leverage=np.nan_to_num(solution.expand(r.cross_checks.leverage)),
        errors=solution.errors,
        reasons=solution.reasons,
        position_residual=root_mean_square(residuals[:, :2]),
        heading_residual=root_mean_square(residuals[:, 2]),
        chi_square=minimum.cost,
        degrees_of_freedom=r.problem.degrees_of_freedom,
        condition_number=r.condition_number,
        iterations=minimum.iterations,
        last_update=minimum.last_update,
    )
