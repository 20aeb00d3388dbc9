"""Drift calibration: solution, acceptance checks, and parameters for other nodes."""

from collections.abc import Iterator, Sequence
from math import nan

import numpy as np
import yaml

from fss_arm_calib import checks
from fss_arm_calib.acceptance import FIT, PASS, Check
from fss_arm_calib.drift.problem import (
    NAMES,
    TOLERANCE,
    UNITS,
    DriftMeasurements,
    DriftProblem,
    DriftResult,
    solve,
)
from fss_arm_calib.drift.settings import DriftSettings
from fss_arm_calib.outcome import LIVE, Estimate, Outcome, estimate_of_fit, make_outcome
from fss_arm_calib.segments.drifts import Drift
from fss_arm_calib.segments.poses import count_independent
from fss_arm_calib.segments.streams import Streams
from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_model.drifting import single_body, single_body_sensitivities
from fss_arm_model.estimation import outliers
from fss_arm_model.estimation.least_squares import Mask
from fss_arm_model.estimation.outliers import expand, reject_outliers, solve_robustly
from fss_arm_model.estimation.statistics import root_mean_square
from fss_arm_model.parameters import parameter_names, to_vector
from fss_arm_model.units import GRAVITY

Solution = outliers.Solution[DriftResult]


def calibrate(
    drifts: Sequence[Drift],
    arm: Arm,
    settings: DriftSettings | None = None,
    streams: Streams | None = None,
    source: str = LIVE,
) -> Outcome[Drift, Solution]:
    """Solve for the external forces and torques on base and arm, and check the result.

    Even very short drifts are solved. The standard deviations are then large.
    """
    s, streams = settings or DriftSettings(), streams or Streams()
    used, names = [one for one in drifts if one.used], checks.joint_names(streams, arm)
    criteria = [names, checks.clocks(streams, s.joint_gap), check_time(used, streams, s)]
    solution = solution_of(used, arm, s) if used and names.verdict == PASS else None
    criteria += evaluate(solution, s) if solution else []
    parts = [(one.q, one.times, one.poses, one.frames, one.seconds) for one in used]
    arrays = [np.array(part) for one in parts for part in one]
    estimate = estimate_of(used, solution)
    origin = arm, s, DriftSettings, streams, source
    return make_outcome(drifts, used, arrays, *origin, criteria, estimate, solution)


def check_time(drifts: Sequence[Drift], streams: Streams, s: DriftSettings) -> Check:
    """Check that the base drifted for long enough."""
    total = sum(drift.times[-1] for drift in drifts)
    brief = f"{total:.4g} s of drift"
    reason = f"{brief}, at least {s.min_time:g} s needed"
    return checks.data_amount("time", total, s.min_time, reason, streams, brief)


def evaluate(solution: Solution, s: DriftSettings) -> Iterator[Check]:
    """Yield the checks of a solution."""
    r, m, kept = solution.result, solution.result.minimum, solution.kept
    yield checks.identifiability(r)
    yield checks.convergence(m, TOLERANCE)
    words = "another force moved the base, or its poses have larger errors than assumed"
    freedom = r.problem.degrees_of_freedom
    yield checks.chi_square(FIT, m.cost, freedom, s.min_probability, words)
    words = "normalized prediction error"
    yield checks.outliers(solution.errors, kept, s.outlier, s.max_outliers, "drift", words)
    yield checks.redundancy(r.cross_checks.redundancy, kept, s.min_redundancy, "drift")
    tilt = float(np.sqrt(np.diag(r.covariance)[:2]).max()) / GRAVITY
    limit = np.degrees(s.max_tilt)
    words = f"tilt known to {np.degrees(tilt):.4g} degrees (at most {limit:.4g})"
    yield checks.limit("tilt", tilt, s.max_tilt, words, "drift for longer")
    torque = r.hose_torque[1]
    words = f"hose torque known to {torque:.4g} N m (at most {s.max_torque:g})"
    yield checks.limit("torque", torque, s.max_torque, words, "drift for longer")


def body_deviations(drifts: Sequence[Drift], arm: Arm, s: DriftSettings) -> tuple[float, float]:
    """Return the deviations of base and arm as one body: centre of mass [m], mass (relative).

    The relative deviation is that of the inertia, too. If the description has the covariance of all
    parameters, both are the largest among the drifts; otherwise they are those of the settings.
    """
    names = parameter_names(arm.n)
    if not set(arm.known.names).issuperset(names):
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
    counts = [count_independent(one.frames, one.seconds, s.fresh_rate) for one in drifts]
    weighted = zip(counts, weights, strict=True)
    return [of_one / np.sqrt(count * weight)[:, None] for count, weight in weighted]


def measurements_of(drifts: Sequence[Drift], arm: Arm, s: DriftSettings) -> DriftMeasurements:
    """Return the measurements of drifts, for the joint estimate."""
    return DriftMeasurements(drifts, pose_deviations(drifts, s, np.ones(len(drifts))), arm.n)


def problem_of(
    drifts: Sequence[Drift], arm: Arm, s: DriftSettings, weights: Floats
) -> DriftProblem:
    """Return the drift problem of weighted drifts."""
    bodies = single_body(arm.vector(), np.array([drift.q for drift in drifts]))
    hose = s.torque_deviation, s.twist_deviation, s.drag_deviation
    sigma = pose_deviations(drifts, s, weights)
    return DriftProblem(drifts, bodies, sigma, *hose, *body_deviations(drifts, arm, s))


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
    leverage = expand(found.result.cross_checks.leverage, found.mask, 0.0)
    return Solution(found.result, found.mask, found.reasons, found.errors, weights, leverage)


def estimate_of(drifts: Sequence[Drift], solution: Solution | None) -> Estimate:
    """Convert the solution to the estimate that all kinds of calibration share."""
    if solution is None:
        return Estimate(NAMES, UNITS, np.zeros(len(NAMES)), reasons=len(drifts) * ("",))
    r = solution.result
    every = [np.full((len(drift.times), 3), nan) for drift in drifts]
    for k, rows in zip(np.flatnonzero(solution.kept), r.residuals, strict=True):
        every[k] = rows
    residuals = np.concatenate(every)
    return estimate_of_fit(
        r,
        solution,
        residuals=residuals,
        position_residual=root_mean_square(residuals[:, :2]),
        heading_residual=root_mean_square(residuals[:, 2]),
        chi_square=r.minimum.cost,
    )


def parameters(outcome: Outcome[Drift, Solution]) -> str:
    """Return parameters for `dynamic` and `base_reaction`, as a ROS parameter file.

    `dynamic` estimates tilt and momentum, about 0 with these deviations. `base_reaction` subtracts
    the tilt; its deviation is part of the uncertainty. The file is valid in any namespace.
    """
    if outcome.solution is None:
        raise ValueError("no solution: the external forces on the base are unknown")
    g, deviation = outcome.values[:2], outcome.deviations[:2]
    tilt = float(np.sqrt(np.max(g**2 + deviation**2))) / GRAVITY
    momenta, deviations = outcome.solution.result.momenta
    squares = np.mean(momenta**2 + deviations**2, axis=0)
    found = {
        "dynamic": {
            "tilt_deviation": tilt,
            "momentum_deviation": float(np.sqrt(squares[:2].max())),
            "spin_deviation": float(np.sqrt(squares[2])),
        },
        "base_reaction": {
            "tilt": [float(x) / GRAVITY for x in g],
            "tilt_deviation": float(deviation.max()) / GRAVITY,
        },
    }
    nodes = {f"/**/{node}": {"ros__parameters": values} for node, values in found.items()}
    origin = f"# From {outcome.provenance.source}: {outcome.reason}\n"
    return origin + yaml.safe_dump(nodes, sort_keys=False)
