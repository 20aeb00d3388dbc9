"""Acceptance checks of a dynamic calibration; each reports its value and its threshold."""

from collections.abc import Sequence
from dataclasses import replace
from math import hypot, isnan, radians

import numpy as np

from fss_arm_calib.acceptance import (
    FAIL,
    PASS,
    UPDATE_TOLERANCE,
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
    hide_pass_reason,
)
from fss_arm_calib.dynamic.identifiability import INVISIBLE
from fss_arm_calib.dynamic.problem import DynamicProblem
from fss_arm_calib.dynamic.result import DynamicResult
from fss_arm_calib.dynamic.settings import DynamicSettings
from fss_arm_calib.dynamic.solution import Solution
from fss_arm_calib.dynamic.solve import solve
from fss_arm_calib.estimation.least_squares import MAX_CONDITION
from fss_arm_calib.estimation.noise import assumed_noise
from fss_arm_calib.segments.maneuvers import Maneuver
from fss_arm_calib.segments.streams import Streams
from fss_arm_model.description import Arm
from fss_arm_model.kinematics import tip_in_base
from fss_arm_model.planar import wrap

MAX_GYRO_DIFFERENCE = 0.2  # largest relative difference of the turns by gyro and by motion capture


def check_number(every: Sequence[Maneuver], streams: Streams, s: DynamicSettings) -> Check:
    """Check that the number of maneuvers is sufficient."""
    lost = [one for one in every if not one.used]
    found = len(every) - len(lost)
    reason = f"{format_count(found, 'maneuver')} (at least {s.min_maneuvers})"
    if found < s.min_maneuvers and lost:
        reason += f"; {format_count(len(lost), 'maneuver')} rejected ({lost[0].reason})"
    brief = format_count(found, "maneuver")
    return check_data_amount("maneuvers", found, s.min_maneuvers, reason, streams, brief)


def check_gyro(streams: Streams) -> Check:
    """Check that gyro and motion capture agree on the turns of the base."""
    ratio = streams.gyro_ratio
    if isnan(ratio) or abs(ratio - 1.0) <= MAX_GYRO_DIFFERENCE:
        return Check("gyro", PASS, ratio, MAX_GYRO_DIFFERENCE, "")
    words = f"the gyro measures {ratio:.3g} times the turn that motion capture measures"
    if abs(radians(ratio) - 1.0) <= MAX_GYRO_DIFFERENCE:
        words = f"gyro in degrees per second? {words}"
    elif abs(ratio + 1.0) <= MAX_GYRO_DIFFERENCE:
        words = f"gyro with the wrong sign? {words}"
    return Check("gyro", FAIL, ratio, MAX_GYRO_DIFFERENCE, words)


def check_tips(used: Sequence[Maneuver], arm: Arm, s: DynamicSettings) -> list[Check]:
    """Check that the observed end effector agrees with the description; [] without its poses.

    The base's motion cannot show this, because wrong link lengths are absorbed by the estimated
    centres of mass.
    """
    known = [one for one in used if one.tip]
    if not known:
        return []
    seen = np.array([one.tip for one in known])
    q = np.array([[readings[0] for readings in one.q] for one in known])
    away = seen[:, :2] - tip_in_base(arm.vector(), q)[:, :2]
    distance = float(np.sqrt(np.mean(np.sum(away**2, axis=1))))
    # Errors of the observed poses of base and end effector widen the limit.
    reach = float(np.sqrt(np.mean(np.sum(seen[:, :2] ** 2, axis=1))))
    position, heading = assumed_noise(s).deviations
    errors = hypot(2.0 * position, reach * heading)
    limit = hypot(s.max_tip_error, errors)
    words = f"end effector {distance:.3f} m from its described position (at most {limit:.3f} m)"
    failing = "another arm's data, or its kinematics must be calibrated first"
    return [hide_pass_reason(check_limit("end_effector", distance, limit, words, failing))]


def evaluate(solution: Solution, s: DynamicSettings) -> list[Check]:
    """Evaluate the checks of a solution."""
    r, m = solution.result, solution.result.minimum
    left = solution.nominal.residual_sums
    fit = check_fit(
        float(np.sum(left.squares)),
        float(np.sum(left.freedom)),
        s.min_probability,
        "residuals are larger than the deviations allow",
        solution.noise,
    )
    found = []
    if fit.verdict == FAIL and _fits_swapped(solution.nominal.problem, s):
        found = [cause_check("the poses of the base are those of the end effector")]
    return [
        *found,
        _check_identifiability(solution),
        check_convergence(m.converged, m.iterations, m.last_update),
        _check_measurable(r),
        _check_bounds(r),
        fit,
        check_outliers(
            solution.errors,
            solution.kept,
            s.outlier,
            s.max_outliers,
            "maneuver",
            "normalized prediction error",
        ),
        check_redundancy(r.redundancy, solution.kept, s.min_redundancy, "maneuver"),
        _check_precision(r, s),
    ]


def _check_measurable(r: DynamicResult) -> Check:
    """Check that no parameter is at a bound only because of its own errors."""
    names = [name for name in r.at_bound if name in r.beyond_reach]
    if not names:
        return Check("measurable", PASS, 0, 0, "")
    brief = f"{', '.join(names)} not measurable with these data"
    words = f"{brief}: give a prior or do not estimate it"
    return Check("measurable", FAIL, len(names), 0, words, brief=brief)


def _check_bounds(r: DynamicResult) -> Check:
    """Check that no well-measured parameter is at a bound of what is physically possible."""
    held = [name for name in r.at_bound if name not in r.beyond_reach]
    if not held:
        return Check("bounds", PASS, 0, 0, "")
    brief = f"at a physical bound: {', '.join(held)}"
    words = f"{brief}; another arm's data, or wrong masses or lengths?"
    return Check("bounds", FAIL, len(held), 0, words, brief=brief)


def _check_identifiability(solution: Solution) -> Check:
    r = solution.result
    missing = len(r.values) - len(r.minimum.basis.s) - len(r.at_bound)
    invisible = sum(d.kind == INVISIBLE for d in solution.directions)
    hint = f", {invisible} invisible to any maneuver"
    return hide_pass_reason(
        check_identifiability(r.inseparable, missing, r.condition_number, MAX_CONDITION, hint)
    )


def _fits_swapped(problem: DynamicProblem, s: DynamicSettings) -> bool:
    """Return True if the maneuvers fit when the subject used as the base is the end effector."""
    p, n = problem.arm.vector(), problem.arm.n
    turns = problem.path.marks[..., : 2 * n]
    q = wrap(np.diff(np.arctan2(turns[..., 1::2], turns[..., ::2]), axis=-1, prepend=0.0))
    tip = tip_in_base(p, q)
    heading = problem.poses[..., 2] - tip[..., 2]
    away = (tip[..., 0] + 1j * tip[..., 1]) * np.exp(1j * heading)
    poses = np.stack(
        [problem.poses[..., 0] - away.real, problem.poses[..., 1] - away.imag, heading], axis=-1
    )
    sigma = problem.sigma.copy()
    sigma[..., :2] = np.hypot(sigma[..., :2], (np.abs(away) * sigma[..., 2])[..., None])
    r = solve(replace(problem, poses=poses, sigma=sigma), tolerance=UPDATE_TOLERANCE)
    freedom = problem.degrees_of_freedom
    return check_chi_square("", r.chi_square, freedom, s.min_probability, "").verdict == PASS


def _check_precision(r: DynamicResult, s: DynamicSettings) -> Check:
    """Check the least certain parameter against the required precision.

    The limit for masses and inertias is a share of the described value. A share of the estimate
    would make the limit depend on chance.
    """
    names, described = r.problem.names, r.problem.guess
    worst, at = 0.0, ""
    for name, value, deviation in zip(names, described, r.deviations, strict=True):
        if name in r.at_bound:
            continue
        if name[0] in "mI":
            limit, words = s.max_relative * abs(value), f"{100 * deviation / abs(value):.0f} %"
        elif name[0] in "abxy":
            limit, words = s.max_place, f"{1000 * deviation:.1f} mm"
        else:
            continue
        if deviation / limit > worst:
            worst, at = float(deviation / limit), f"{name} has a deviation of {words}"
    share = f"{100 * s.max_relative:g} % of a described mass or inertia"
    limits = f"(at most {share}, {s.max_place:g} m)"
    words = f"{at} {limits}" if at else ""
    check = check_limit("precision", worst, 1.0, words, "too uncertain")
    if check.verdict == PASS:
        return check
    advice = "give a prior, do not estimate it, or record more maneuvers"
    return replace(check, reason=f"{check.reason}: {advice}", brief=f"too uncertain: {at}")
