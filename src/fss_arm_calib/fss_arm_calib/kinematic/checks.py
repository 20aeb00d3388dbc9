"""Acceptance checks of a kinematic calibration; each reports its value and its threshold."""

from collections.abc import Sequence
from dataclasses import replace
from math import nan, radians

import numpy as np

from fss_arm_calib.acceptance import (
    FAIL,
    NOT_EVALUATED,
    PASS,
    Check,
    cause_check,
    check_chi_square,
    check_convergence,
    check_data_amount,
    check_fit,
    check_identifiability,
    check_limit,
    check_outliers,
    check_redundancy,
    format_count,
    format_indices,
)
from fss_arm_calib.estimation.least_squares import CAUCHY, Mask
from fss_arm_calib.estimation.statistics import probability, redundancy
from fss_arm_calib.kinematic import model
from fss_arm_calib.kinematic.problem import EQUAL_LENGTH_TOLERANCE, FULL, KinematicProblem
from fss_arm_calib.kinematic.result import KinematicResult
from fss_arm_calib.kinematic.settings import KinematicSettings
from fss_arm_calib.kinematic.solution import RELAXED_MAX_CONDITION, Solution, min_observations
from fss_arm_calib.kinematic.solve import fit
from fss_arm_calib.segments.rests import Observation, rejected_without_repeat
from fss_arm_calib.segments.streams import Streams
from fss_arm_calib.segments.telemetry import keep_since_homing, rehomed_joints
from fss_arm_model.arrays import Floats
from fss_arm_model.description import DescriptionError
from fss_arm_model.planar import inverse

SAME_POSTURE = radians(1.0)  # largest difference of a joint between equal postures [rad]


def check_homings(observations: Sequence[Observation]) -> Check:
    """Report the observations left out because a joint was homed later; this always passes."""
    joints = sorted({i for o in observations for i in rehomed_joints(o, observations[-1])})
    left_out = len(observations) - len(keep_since_homing(observations))
    names = ", ".join(f"joint_{i}" for i in joints)
    words = f"{format_count(left_out, 'observation')} left out: {names} homed or restarted since"
    return Check("homings", PASS, left_out, nan, words if left_out else "")


def check_rests(observations: Sequence[Observation], needed: int, s: KinematicSettings) -> Check:
    """Check that each rejected rest was repeated.

    A rest need not be repeated once the observations used since then suffice by themselves.
    """
    used = [o for o in observations if o.used]
    since = used[-needed].start if len(used) >= needed else 0
    lost = [o for o in rejected_without_repeat(observations, SAME_POSTURE) if o.end >= since]
    reason = (
        f"{format_count(len(lost), 'rest')} rejected ({lost[0].reason}) and not repeated"
        if lost
        else ""
    )
    return Check("rests", NOT_EVALUATED if lost else PASS, len(lost), 0.0, reason)


def check_number(problem: KinematicProblem, streams: Streams, s: KinematicSettings) -> Check:
    """Check that the observations suffice for the parameters."""
    found, needed = len(problem.q), min_observations(problem, s)
    number, names = format_count(found, "observation"), f" for {', '.join(problem.names)}"
    if found >= needed:
        reason = f"{number} (at least {needed})"
        return check_data_amount("observations", found, needed, reason, streams, number)
    reason = f"{number}, at least {needed} needed{names}"
    check = check_data_amount("observations", found, needed, reason, streams)
    return replace(check, brief=check.reason.replace(names, ""))


def evaluate(solution: Solution, s: KinematicSettings) -> list[Check]:
    """Evaluate the checks of a solution."""
    r = solution.result
    checks = [_check_determined(solution.nominal, s)]
    if r.undetermined:
        return checks
    checks.append(check_convergence(r.converged, r.iterations, r.last_update))
    try:
        r.calibrated()
    except DescriptionError as error:
        least = float(
            np.min(model.all_parameters(solution.problem, r.values)[: solution.problem.arm.n])
        )
        checks.append(Check("lengths", FAIL, least, 0.0, f"a mirrored solution: {error}"))
    residuals = check_fit(
        solution.nominal.chi_square,
        solution.nominal.degrees_of_freedom,
        s.min_probability,
        "residuals are larger than the assumed deviations allow",
        solution.noise,
    )
    far = check_outliers(
        solution.errors,
        solution.kept,
        s.outlier,
        s.max_outliers,
        "observation",
        "normalized residual",
    )
    if FAIL in (residuals.verdict, far.verdict) and (hint := _swap_hint(solution, s)):
        checks.append(cause_check(hint))
        residuals = replace(residuals, verdict=FAIL)
    return [
        *checks,
        _check_lengths(solution, s),
        residuals,
        far,
        _check_redundancy(solution, s),
        _check_prediction(solution, s),
    ]


def _check_determined(r: KinematicResult, s: KinematicSettings) -> Check:
    """Check that all parameters are determined; name the joints that hardly moved."""
    span = np.ptp(r.problem.q, axis=0)
    still = [f"joint_{i + 1}" for i in np.flatnonzero(span < SAME_POSTURE)]
    hint = f"; {', '.join(still)} hardly moved" if still else ""
    return check_identifiability(
        r.undetermined, r.missing, r.condition_number, s.max_condition, hint
    )


def _check_lengths(solution: Solution, s: KinematicSettings) -> Check:
    """Check that the link lengths are close to the description.

    Data of another arm would fit just as well.
    """
    problem = solution.problem
    described = np.array([link.a for link in problem.arm.links])
    lengths = model.all_parameters(problem, solution.result.values)[: len(described)]
    k = int(np.argmax(np.abs(lengths - described)))
    change = float(abs(lengths[k] - described[k]))
    words = f"a_{k + 1} is {lengths[k]:.4f} m, {described[k]:.4f} m in the description"
    words += f" (difference at most {s.max_length_change:g} m)"
    averaged = _equal_length_remark(problem)
    failing = f"another arm's data, or {averaged}" if averaged else "another arm's data"
    check = check_limit("description", change, s.max_length_change, words, failing)
    if (
        averaged
        and check.verdict == PASS
        and _equal_length_probability(solution) < s.min_probability
    ):
        return replace(check, verdict=FAIL, reason=averaged)
    return check if check.verdict == FAIL else replace(check, reason=averaged)


def _equal_length_probability(solution: Solution) -> float:
    """Return the probability that chance explains the larger residuals of equal lengths.

    The residuals are compared with those of a fit with a separate length for each link.
    """
    equal = solution.result
    full = fit(replace(equal.problem, parametrization=FULL), max_condition=RELAXED_MAX_CONDITION)
    more = len(full.values) - len(equal.values)
    if solution.noise.is_given.all():
        return probability(equal.chi_square - full.chi_square, more)
    freedom = full.degrees_of_freedom
    scale = full.chi_square / max(freedom, 1)
    return probability((equal.chi_square - full.chi_square) / scale, more, freedom)


def _equal_length_remark(problem: KinematicProblem) -> str:
    """Return a remark if one length is estimated for links with different described lengths.

    This is only a remark because the lengths of a full calibration scatter by as much: 9 mm with
    13 postures.
    """
    lengths = [link.a for link in problem.arm.links[:-1]]
    if not problem.shares_length or max(lengths) - min(lengths) <= EQUAL_LENGTH_TOLERANCE:
        return ""
    unlike = f"links described as {min(lengths):.3f} to {max(lengths):.3f} m long"
    return f"{unlike} are assumed equal: parametrization {FULL} separates them"


def _check_redundancy(solution: Solution, s: KinematicSettings) -> Check:
    """Check that each observation is verified by the others.

    If the redundancy is too small, the described lengths and mount may help. If their estimates
    agree with the description, an error can only hide in the angles. The redundancy is then
    computed for the angles alone, which is larger.
    """
    r = solution.result
    regressor = model.linearize(r.problem, r.values).regressor
    check = check_redundancy(_redundancy(regressor), solution.kept, s.min_redundancy, "observation")
    if check.verdict == PASS:
        return check
    angles = np.array(r.problem.units) == "rad"
    change = float(np.max(np.abs(r.values - r.problem.initial)[~angles], initial=0.0))
    by_angles = float(np.min(_redundancy(regressor[:, angles])))
    if change <= s.max_length_change and by_angles >= s.min_redundancy:
        words = f"{check.reason}, but lengths and mount agree with the description: "
        words += f"then {by_angles:.2g}"
        return Check("redundancy", PASS, by_angles, s.min_redundancy, words)
    return check


def _redundancy(regressor: Floats) -> Floats:
    """Return the redundancy of each observation, that is of three rows each, (s,)."""
    Q = np.linalg.qr(regressor)[0].reshape(-1, 3, regressor.shape[1])
    return redundancy(Q @ np.swapaxes(Q, 1, 2))


def _check_prediction(solution: Solution, s: KinematicSettings) -> Check:
    held_out = solution.held_out.tolist()
    if not held_out:
        words = "no observation was held out" + (": too few observations" if s.held_out else "")
        return Check("prediction", NOT_EVALUATED, nan, s.min_probability, words, needed=False)
    what = f"{format_indices(held_out)} predicted from the others"
    check = check_chi_square(
        "prediction",
        solution.prediction.chi_square,
        3 * len(held_out),
        s.min_probability,
        "worse than the deviations allow",
        solution.noise.freedom,
    )
    brief = check.brief and f"{what}: {check.brief}"
    return replace(check, reason=f"{what}: {check.reason}", brief=brief)


def _fits_swapped(result: KinematicResult, problem: KinematicProblem, s: KinematicSettings) -> Mask:
    """Return a mask of the observations that would fit if base and tip were swapped, (s,)."""
    swapped = replace(problem, tip=inverse(problem.tip))
    return np.asarray(result.predict(swapped).normalized <= s.outlier)


def misfit_causes(
    result: KinematicResult, problem: KinematicProblem, s: KinematicSettings
) -> list[str]:
    """Return the reason why each observation does not fit, (s,); empty if unknown."""
    words = ": base and end effector are swapped"
    return [words if swapped else "" for swapped in _fits_swapped(result, problem, s)]


def _swap_hint(solution: Solution, s: KinematicSettings) -> str:
    """Return a message if swapped subjects explain the bad fit, else an empty string."""
    problem = solution.problem.select(solution.kept).with_deviations(solution.noise.largest)
    all_swapped = fit(replace(problem, tip=inverse(problem.tip)), max_condition=s.max_condition)
    check = check_chi_square(
        "", all_swapped.chi_square, all_swapped.degrees_of_freedom, s.min_probability, ""
    )
    if check.verdict == PASS:
        return "base and end effector are swapped"
    robust = fit(replace(problem, loss=CAUCHY), max_condition=s.max_condition)
    if robust.undetermined:
        return ""
    some = _fits_swapped(robust, problem, s) & (robust.normalized_residuals > s.outlier)
    which = np.flatnonzero(solution.kept)[some].tolist()
    tip = np.where(some[:, None], inverse(problem.tip), problem.tip)
    back = fit(replace(problem, tip=tip), max_condition=s.max_condition)
    check = check_chi_square("", back.chi_square, back.degrees_of_freedom, s.min_probability, "")
    explains = bool(which) and check.verdict == PASS
    return f"base and end effector are swapped in {format_indices(which)}" if explains else ""
