"""Kinematic calibration from observations: the solution and its acceptance checks."""

from collections.abc import Sequence
from dataclasses import replace
from math import nan

import numpy as np

from fss_arm_calib import checks
from fss_arm_calib.acceptance import FAIL, NOT_EVALUATED, PASS, Check, format_count, format_indices
from fss_arm_calib.kinematic import model
from fss_arm_calib.kinematic.problem import EQUAL_LENGTH_TOLERANCE, FULL, KinematicProblem
from fss_arm_calib.kinematic.settings import KinematicSettings
from fss_arm_calib.kinematic.solution import (
    RELAXED_MAX_CONDITION,
    Solution,
    estimate_of,
    min_observations,
    problem_of,
    solution_of,
)
from fss_arm_calib.kinematic.solve import KinematicResult, fit
from fss_arm_calib.outcome import LIVE, Outcome, make_outcome
from fss_arm_calib.segments.rests import SAME_POSTURE, Observation, rejected_without_repeat
from fss_arm_calib.segments.streams import Streams
from fss_arm_calib.segments.telemetry import keep_since_homing, rehomed_joints
from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_model.description_fields import DescriptionError
from fss_arm_model.estimation.least_squares import CAUCHY, Mask
from fss_arm_model.estimation.statistics import probability, redundancy
from fss_arm_model.planar import inverse


def calibrate(
    observations: Sequence[Observation],
    arm: Arm,
    settings: KinematicSettings | None = None,
    streams: Streams | None = None,
    source: str = LIVE,
) -> Outcome[Observation, Solution]:
    """Solve for the arm's kinematics, starting from `arm`, and check the result.

    Observations before the last homing of a link are left out: homing changes the joint offsets.
    """
    s, streams = settings or KinematicSettings(), streams or Streams()
    comparable = keep_since_homing(observations)
    used = [o for o in comparable if o.used]
    problem = problem_of(used, arm, s)
    homings, number = check_homings(observations), check_number(problem, streams, s)
    if why := homings.reason and f"; {homings.reason}":
        reason = number.reason + why * (number.verdict != PASS)  # those of a pass have it already
        number = replace(number, reason=reason, brief=number.brief + why)
    rests = check_rests(comparable, min_observations(problem, s))
    clocks = checks.clocks(streams, s.joint_gap)
    found = [checks.joint_names(streams, arm), clocks, homings, rests, number]
    solution = solution_of(problem, s) if number.verdict == PASS else None
    if solution:
        swapped = fits_swapped(solution.result, solution.problem, s)
        words = (": base and end effector are swapped" * bool(swap) for swap in swapped)
        reasons = (why and why + word for why, word in zip(solution.reasons, words, strict=True))
        solution = replace(solution, reasons=tuple(reasons))
        found += evaluate(solution, s)
    arrays, estimate = (problem.q, problem.tip), estimate_of(problem, solution)
    origin = arm, s, KinematicSettings, streams, source
    calibrated = solution.result.calibrated if solution else None
    return make_outcome(observations, used, arrays, *origin, found, estimate, solution, calibrated)


def check_homings(observations: Sequence[Observation]) -> Check:
    """Report the observations left out because a joint was homed later; this always passes."""
    joints = sorted({i for o in observations for i in rehomed_joints(o, observations[-1])})
    left_out = len(observations) - len(keep_since_homing(observations))
    names = ", ".join(f"joint_{i}" for i in joints)
    words = f"{format_count(left_out, 'observation')} left out: {names} homed or restarted since"
    return Check("homings", PASS, left_out, nan, words if left_out else "")


def check_rests(observations: Sequence[Observation], needed: int) -> Check:
    """Check that each rejected rest was repeated.

    A rest need not be repeated once the observations used since then suffice by themselves.
    """
    used = [o for o in observations if o.used]
    since = used[-needed].start if len(used) >= needed else 0
    lost = [o for o in rejected_without_repeat(observations, SAME_POSTURE) if o.end >= since]
    if not lost:
        return Check("rests", PASS, 0, 0.0, "")
    reason = f"{format_count(len(lost), 'rest')} rejected ({lost[0].reason}) and not repeated"
    return Check("rests", NOT_EVALUATED, len(lost), 0.0, reason)


def check_number(problem: KinematicProblem, streams: Streams, s: KinematicSettings) -> Check:
    """Check that the observations suffice for the parameters."""
    found, needed = len(problem.q), min_observations(problem, s)
    number, names = format_count(found, "observation"), f" for {', '.join(problem.names)}"
    if found >= needed:
        reason = f"{number} (at least {needed})"
        return checks.data_amount("observations", found, needed, reason, streams, number)
    reason = f"{number}, at least {needed} needed{names}"
    check = checks.data_amount("observations", found, needed, reason, streams)
    return replace(check, brief=check.reason.replace(names, ""))


def evaluate(solution: Solution, s: KinematicSettings) -> list[Check]:
    """Evaluate the checks of a solution."""
    r = solution.result
    criteria = [_check_determined(solution.nominal, s)]
    if r.undetermined:
        return criteria
    criteria.append(checks.convergence(r.minimum))
    try:
        r.calibrated()
    except DescriptionError as error:
        least = float(np.min(_lengths(solution)))
        criteria.append(Check("lengths", FAIL, least, 0.0, f"a mirrored solution: {error}"))
    nominal, words = solution.nominal, "residuals are larger than the assumed deviations allow"
    size = nominal.chi_square, nominal.problem.degrees_of_freedom
    residuals = checks.fit(*size, s.min_probability, words, solution.noise)
    errors, limits = (solution.errors, solution.kept), (s.outlier, s.max_outliers)
    far = checks.outliers(*errors, *limits, "observation", "normalized residual")
    if FAIL in (residuals.verdict, far.verdict) and (hint := _swap_hint(solution, s)):
        criteria.append(checks.cause(hint))
        residuals = replace(residuals, verdict=FAIL)
    criteria += [_check_lengths(solution, s), residuals, far]
    return [*criteria, _check_redundancy(solution, s), _check_prediction(solution, s)]


def _check_determined(r: KinematicResult, s: KinematicSettings) -> Check:
    """Check that all parameters are determined; name the joints that hardly moved."""
    span = np.ptp(r.problem.q, axis=0)
    still = [f"joint_{i + 1}" for i in np.flatnonzero(span < SAME_POSTURE)]
    hint = f"; {', '.join(still)} hardly moved" if still else ""
    return checks.identifiability(r, hint, s.max_condition, hide_reason=False)


def _lengths(solution: Solution) -> Floats:
    """Return the estimated lengths of the links (n,)."""
    every = model.all_parameters(solution.problem, solution.result.values)
    return every[: solution.problem.arm.n]


def _check_lengths(solution: Solution, s: KinematicSettings) -> Check:
    """Check that the link lengths are close to the description: data of another arm would fit."""
    described = np.array([link.a for link in solution.problem.arm.links])
    lengths = _lengths(solution)
    k = int(np.argmax(np.abs(lengths - described)))
    change = float(abs(lengths[k] - described[k]))
    words = f"a_{k + 1} is {lengths[k]:.4f} m, {described[k]:.4f} m in the description"
    words += f" (difference at most {s.max_length_change:g} m)"
    averaged = _equal_length_remark(solution.problem)
    failing = f"another arm's data, or {averaged}" if averaged else "another arm's data"
    check = checks.limit("description", change, s.max_length_change, words, failing)
    if check.verdict == FAIL:
        return check
    unequal = bool(averaged) and _equal_length_probability(solution) < s.min_probability
    return replace(check, verdict=FAIL if unequal else PASS, reason=averaged)


def _equal_length_probability(solution: Solution) -> float:
    """Return the probability that chance explains how much better separate lengths fit."""
    equal = solution.result
    full = fit(replace(equal.problem, parametrization=FULL), max_condition=RELAXED_MAX_CONDITION)
    more = len(full.values) - len(equal.values)
    if solution.noise.is_given.all():
        return probability(equal.chi_square - full.chi_square, more)
    freedom = full.problem.degrees_of_freedom
    scale = full.chi_square / max(freedom, 1)
    return probability((equal.chi_square - full.chi_square) / scale, more, freedom)


def _equal_length_remark(problem: KinematicProblem) -> str:
    """Return a remark if one length is estimated for links with different described lengths.

    It is no failure: the lengths of a full calibration scatter by as much, 9 mm with 13 postures.
    """
    lengths = [link.a for link in problem.arm.links[:-1]]
    if not problem.shares_length or max(lengths) - min(lengths) <= EQUAL_LENGTH_TOLERANCE:
        return ""
    unlike = f"links described as {min(lengths):.3f} to {max(lengths):.3f} m long"
    return f"{unlike} are assumed equal: --parametrization {FULL} separates them"


def _check_redundancy(solution: Solution, s: KinematicSettings) -> Check:
    """Check that each observation is verified by the others.

    If the redundancy is too small, the described lengths and mount may help. If their estimates
    agree with the description, an error can only hide in the angles. The redundancy is then
    computed for the angles alone, which is larger.
    """
    r = solution.result
    regressor = model.linearize(r.problem, r.values).regressor
    check = checks.redundancy(
        _redundancy(regressor), solution.kept, s.min_redundancy, "observation"
    )
    if check.verdict == PASS:
        return check
    angles = np.array(r.problem.units) == "rad"
    change = float(np.max(np.abs(r.values - r.problem.guess)[~angles], initial=0.0))
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
    size = solution.prediction.chi_square, 3 * len(held_out)
    words = "worse than the deviations allow"
    check = checks.chi_square("prediction", *size, s.min_probability, words, solution.noise.freedom)
    brief = check.brief and f"{what}: {check.brief}"
    return replace(check, reason=f"{what}: {check.reason}", brief=brief)


def fits_swapped(result: KinematicResult, problem: KinematicProblem, s: KinematicSettings) -> Mask:
    """Return a mask of the observations that would fit if base and tip were swapped, (s,)."""
    swapped = replace(problem, tip=inverse(problem.tip))
    return np.asarray(result.predict(swapped).normalized <= s.outlier)


def _swap_hint(solution: Solution, s: KinematicSettings) -> str:
    """Return a message if swapped subjects explain the bad fit, else an empty string."""
    problem = solution.problem.select(solution.kept).with_deviations(solution.noise.largest)
    swapped = inverse(problem.tip)

    def fits(tip: Floats) -> bool:
        found = fit(replace(problem, tip=tip), max_condition=s.max_condition)
        return probability(found.chi_square, problem.degrees_of_freedom) >= s.min_probability

    if fits(swapped):
        return "base and end effector are swapped"
    robust = fit(replace(problem, loss=CAUCHY), max_condition=s.max_condition)
    if robust.undetermined:
        return ""
    some = fits_swapped(robust, problem, s) & (robust.normalized_residuals > s.outlier)
    if not some.any() or not fits(np.where(some[:, None], swapped, problem.tip)):
        return ""
    which = np.flatnonzero(solution.kept)[some].tolist()
    return f"base and end effector are swapped in {format_indices(which)}"
