"""What a kinematic calibration concludes from its observations, and whether to believe it."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from math import nan

import numpy as np
from scipy.special import gammaincc

from fss_arm_model.description import Arm, DescriptionError, to_yaml

from . import __version__
from .kinematic import Floats, KinematicProblem, KinematicResult, NotIdentifiable, solve
from .rests import Observation, spoiled
from .settings import CalibrationSettings, Criteria

PASS, FAIL, NOT_EVALUATED = "pass", "fail", "not_evaluated"


@dataclass(frozen=True)
class Calibration:
    """All that KinematicCalibration.msg tells, under the names of its fields.

    Without an identifiable solution the values are NaN and what follows from them is empty or NaN.
    """

    stamp: int  # end of the last observation used [ns]; 0: none
    verdict: str
    reason: str
    parametrization: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Floats
    initial: Floats
    covariance: Floats
    q: Floats
    tip: Floats
    residuals: Floats
    position_deviation: float
    heading_deviation: float
    position_residual: float
    heading_residual: float
    chi_square: float
    degrees_of_freedom: int
    condition_number: float
    iterations: int
    last_update: float
    observations_used: int
    observations_refused: int
    gaps: int
    arm: str
    description: str
    observations_hash: str
    software: str


def calibrate(
    observations: Sequence[Observation], arm: Arm, settings: CalibrationSettings | None = None
) -> Calibration:
    """Solve for the arm's kinematics and judge the result.

    Args:
        observations: in order of time; those not used count as refused.
        arm: the initial guess.
        settings: parametrization, deviations of an observation and criteria.

    Raises:
        ValueError: observations and arm do not fit, or a setting is impossible.
    """
    s = settings or CalibrationSettings()
    used = [o for o in observations if o.used]
    problem = KinematicProblem(
        q=np.array([o.q for o in used]).reshape(len(used), -1 if used else arm.n),
        tip=np.array([o.tip for o in used]).reshape(-1, 3),
        arm=arm,
        parametrization=s.parametrization,
        position_deviation=s.position_deviation,
        heading_deviation=s.heading_deviation,
    )
    lost = spoiled(observations, s.same_posture)
    result: KinematicResult | None = None
    if short := _too_few(problem, s):
        verdict, reason = NOT_EVALUATED, short
    else:
        try:
            result = solve(problem, max_condition=s.max_condition)
            verdict, reason = _judge(result, s)
        except NotIdentifiable as error:
            verdict, reason = NOT_EVALUATED, _inseparable(problem, error, s)
    if lost:
        verdict = NOT_EVALUATED
        reason = (
            f"{_count(len(lost), 'rest')} spoiled ({lost[0].reason}) and not repeated; {reason}"
        )
    return Calibration(
        stamp=used[-1].end if used else 0,
        verdict=verdict,
        reason=reason,
        parametrization=s.parametrization,
        names=problem.names,
        units=problem.units,
        values=result.values if result else np.full(len(problem.names), nan),
        initial=problem.initial,
        covariance=result.covariance if result else np.empty((0, 0)),
        q=problem.q,
        tip=problem.tip,
        residuals=result.residuals if result else np.empty((0, 3)),
        position_deviation=s.position_deviation,
        heading_deviation=s.heading_deviation,
        position_residual=result.position_residual if result else nan,
        heading_residual=result.heading_residual if result else nan,
        chi_square=result.chi_square if result else nan,
        degrees_of_freedom=max(problem.tip.size - len(problem.names), 0),
        condition_number=result.condition_number if result else nan,
        iterations=result.iterations if result else 0,
        last_update=result.last_update if result else nan,
        observations_used=len(used),
        observations_refused=len(observations) - len(used),
        gaps=len(observations) - len(used),
        arm=arm.name,
        description=to_yaml(result.calibrated()) if result and verdict == PASS else "",
        observations_hash=hashlib.sha256(problem.q.tobytes() + problem.tip.tobytes()).hexdigest(),
        software=f"fss_arm_calib {__version__}",
    )


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'s' * (number != 1)}"


def _too_few(problem: KinematicProblem, criteria: Criteria) -> str:
    """Why there are too few observations; empty if there are enough."""
    s, p = len(problem.q), len(problem.names)
    needed = max(criteria.min_observations, p // 3 + 1)
    if s >= needed:
        return ""
    return f"{_count(s, 'observation')}, at least {needed} needed for {', '.join(problem.names)}"


def _inseparable(problem: KinematicProblem, error: NotIdentifiable, criteria: Criteria) -> str:
    """The named parameters, and the joints whose standing still explains them."""
    span = np.ptp(problem.q, axis=0)
    still = [f"joint_{i + 1}" for i in np.flatnonzero(span < criteria.same_posture)]
    hint = f"; {', '.join(still)} hardly moved" if still else ""
    return f"{error}, at most {criteria.max_condition:g} to judge by{hint}"


def _judge(result: KinematicResult, criteria: Criteria) -> tuple[str, str]:
    """Verdict and reason of a solution, each threshold beside its value."""
    probability = float(gammaincc(result.degrees_of_freedom / 2, result.chi_square / 2))
    failures = []
    if not result.converged:
        failures.append(
            f"not converged in {result.iterations} iterations "
            f"(last update {result.last_update:.2g} deviations)"
        )
    try:
        result.calibrated()
    except DescriptionError as error:
        failures.append(f"a mirrored solution: {error}")
    if probability < criteria.min_probability:
        failures.append("residuals are larger than the assumed deviations allow")
    facts = (
        f"{_count(len(result.residuals), 'observation')} (at least {criteria.min_observations}), "
        f"chi-square {result.chi_square:.4g} for {result.degrees_of_freedom} degrees of freedom, "
        f"probability {probability:.2g} (at least {criteria.min_probability:g}), "
        f"condition number {result.condition_number:.3g} (at most {criteria.max_condition:g}), "
        f"{_count(result.iterations, 'iteration')}"
    )
    return (FAIL if failures else PASS), "; ".join([*failures, facts])
