"""Dynamic calibration from maneuvers: the solution and its acceptance checks."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import degrees, hypot, isnan

import numpy as np
import numpy.typing as npt

from fss_arm_calib.acceptance import (
    FAIL,
    PASS,
    UPDATE_TOLERANCE,
    Check,
    cause_check,
    check_clocks,
    check_convergence,
    check_data_amount,
    check_fit,
    check_identifiability,
    check_joint_names,
    check_limit,
    check_outliers,
    check_redundancy,
    format_count,
    hide_pass_reason,
)
from fss_arm_calib.dynamic.identifiability import INVISIBLE
from fss_arm_calib.dynamic.problem import DynamicProblem
from fss_arm_calib.dynamic.settings import DynamicSettings
from fss_arm_calib.dynamic.solution import Solution, estimate_of, problem_of, solution_of
from fss_arm_calib.dynamic.solve import DynamicResult, solve
from fss_arm_calib.estimation.least_squares import MAX_CONDITION
from fss_arm_calib.estimation.noise import assumed_noise
from fss_arm_calib.estimation.statistics import probability
from fss_arm_calib.outcome import LIVE, Outcome, make_outcome
from fss_arm_calib.segments.maneuvers import Maneuver
from fss_arm_calib.segments.streams import Streams
from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_model.kinematics import tip_in_base
from fss_arm_model.planar import wrap

MAX_GYRO_DIFFERENCE = 0.2  # largest relative difference of the turns by gyro and by motion capture
UNMEASURED = ": give a prior or do not estimate it"
AT_BOUND = "; another arm's data, or wrong masses or lengths?"


def calibrate(
    maneuvers: Sequence[Maneuver],
    arm: Arm,
    settings: DynamicSettings | None = None,
    streams: Streams | None = None,
    source: str = LIVE,
) -> Outcome[Maneuver, Solution]:
    """Solve for the arm's dynamics, starting from `arm`, and check the result."""
    s, streams = settings or DynamicSettings(), streams or Streams()
    used = [one for one in maneuvers if one.used]
    number = check_number(maneuvers, streams, s)
    found = [check_joint_names(streams, arm), check_clocks(streams, s.joint_gap), number]
    found += [check_gyro(streams), *check_tips(used, arm, s)]
    solution = solution_of(problem_of(used, arm, s), s) if number.verdict == PASS else None
    found += evaluate(solution, s) if solution else []
    arrays = [array for one in used for array in _arrays(one)]
    estimate = estimate_of(arm, s, used, solution)
    origin = arm, s, DynamicSettings, streams, source
    calibrated = solution.result.calibrated if solution else None
    return make_outcome(maneuvers, used, arrays, *origin, found, estimate, solution, calibrated)


def _arrays(one: Maneuver) -> list[npt.NDArray[np.int64] | Floats]:
    flat = [np.concatenate(part) for part in (one.times, one.q, one.qd)]
    rest = (one.marks, one.poses, one.frames, one.seconds, one.tip)
    return [*flat, *map(np.array, rest)]


def check_number(every: Sequence[Maneuver], streams: Streams, s: DynamicSettings) -> Check:
    """Check that the number of maneuvers is sufficient."""
    lost = [one for one in every if not one.used]
    found = len(every) - len(lost)
    number = format_count(found, "maneuver")
    reason = f"{number} (at least {s.min_maneuvers})"
    if found < s.min_maneuvers and lost:
        reason += f"; {format_count(len(lost), 'maneuver')} rejected ({lost[0].reason})"
    return check_data_amount("maneuvers", found, s.min_maneuvers, reason, streams, number)


def check_gyro(streams: Streams) -> Check:
    """Check the relative difference between the base's turns by gyro and by motion capture."""
    ratio = streams.gyro_ratio

    def is_near(expected: float) -> bool:
        return abs(ratio / expected - 1.0) <= MAX_GYRO_DIFFERENCE

    difference = abs(ratio - 1.0)
    if isnan(ratio) or is_near(1.0):
        return Check("gyro", PASS, difference, MAX_GYRO_DIFFERENCE, "")
    words = f"the gyro measures {ratio:.3g} times the turn that motion capture measures"
    if is_near(degrees(1.0)):
        words = f"gyro in degrees per second? {words}"
    elif is_near(-1.0):
        words = f"gyro with the wrong sign? {words}"
    return Check("gyro", FAIL, difference, MAX_GYRO_DIFFERENCE, words)


def check_tips(used: Sequence[Maneuver], arm: Arm, s: DynamicSettings) -> list[Check]:
    """Check that the observed end effector agrees with the description; [] without its poses.

    The base's motion cannot show this, because wrong link lengths are absorbed by the estimated
    centres of mass. Errors of the observed poses of base and end effector widen the limit.
    """
    known = [one for one in used if one.tip]
    if not known:
        return []

    def mean_length(vectors: Floats) -> float:
        return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))

    seen = np.array([one.tip for one in known])[:, :2]
    q = np.array([[readings[0] for readings in one.q] for one in known])
    distance = mean_length(seen - tip_in_base(arm.vector(), q)[:, :2])
    position, heading = assumed_noise(s).deviations
    limit = hypot(s.max_tip_error, hypot(2.0 * position, mean_length(seen) * heading))
    words = f"end effector {distance:.3f} m from its described position (at most {limit:.3f} m)"
    failing = "another arm's data, or its kinematics must be calibrated first"
    return [hide_pass_reason(check_limit("end_effector", distance, limit, words, failing))]


def evaluate(solution: Solution, s: DynamicSettings) -> Iterator[Check]:
    """Yield the checks of a solution."""
    r, m = solution.result, solution.result.minimum
    left = solution.nominal.residual_sums
    words = "residuals are larger than the deviations allow"
    squares, freedom = float(np.sum(left.squares)), float(np.sum(left.freedom))
    fit = check_fit(squares, freedom, s.min_probability, words, solution.noise)
    if fit.verdict == FAIL and _fits_swapped(solution.nominal.problem, s):
        yield cause_check("the poses of the base are those of the end effector")
    yield _check_identifiability(solution)
    yield check_convergence(m.converged, m.iterations, m.last_update)
    yield from _check_bounds(r)
    yield fit
    error_name, noun = "normalized prediction error", "maneuver"
    limits = s.outlier, s.max_outliers
    yield check_outliers(solution.errors, solution.kept, *limits, noun, error_name)
    yield check_redundancy(r.redundancy, solution.kept, s.min_redundancy, noun)
    yield _check_precision(r, s)


def _check_identifiability(solution: Solution) -> Check:
    r = solution.result
    missing = len(r.values) - len(r.minimum.basis.s) - len(r.at_bound)
    invisible = sum(d.kind == INVISIBLE for d in solution.directions)
    hint = f", {invisible} invisible to any maneuver"
    return hide_pass_reason(
        check_identifiability(r.undetermined, missing, r.condition_number, MAX_CONDITION, hint)
    )


def _check_bounds(r: DynamicResult) -> Iterator[Check]:
    """Check that no parameter, measured or not, is at a bound of what is physically possible."""
    unmeasured = [name for name in r.at_bound if name in r.beyond_reach]
    held = [name for name in r.at_bound if name not in r.beyond_reach]
    for check, names, fact, advice in (
        ("measurable", unmeasured, "{} not measurable with these data", UNMEASURED),
        ("bounds", held, "at a physical bound: {}", AT_BOUND),
    ):
        brief = fact.format(", ".join(names)) if names else ""
        words = f"{brief}{advice}" if names else ""
        yield Check(check, FAIL if names else PASS, len(names), 0, words, brief=brief)


def _fits_swapped(problem: DynamicProblem, s: DynamicSettings) -> bool:
    """Return True if the maneuvers fit when the subject used as the base is the end effector."""
    p, n = problem.arm.vector(), problem.arm.n
    turns = problem.path.marks[..., : 2 * n]
    q = wrap(np.diff(np.arctan2(turns[..., 1::2], turns[..., ::2]), axis=-1, prepend=0.0))
    tip = tip_in_base(p, q)
    heading = problem.poses[..., 2] - tip[..., 2]
    away = (tip[..., 0] + 1j * tip[..., 1]) * np.exp(1j * heading)
    x, y = problem.poses[..., 0] - away.real, problem.poses[..., 1] - away.imag
    sigma = problem.sigma.copy()
    sigma[..., :2] = np.hypot(sigma[..., :2], (np.abs(away) * sigma[..., 2])[..., None])
    swapped = replace(problem, poses=np.stack([x, y, heading], axis=-1), sigma=sigma)
    chi_square = solve(swapped, tolerance=UPDATE_TOLERANCE).chi_square
    return probability(chi_square, problem.degrees_of_freedom) >= s.min_probability


def _check_precision(r: DynamicResult, s: DynamicSettings) -> Check:
    """Check the least certain parameter against the required precision.

    The limit for masses and inertias is a share of the described value: that of an estimate would
    depend on chance.
    """
    worst, at = 0.0, ""
    for name, value, deviation in zip(r.problem.names, r.problem.guess, r.deviations, strict=True):
        if name in r.at_bound or name[0] not in "mIabxy":
            continue
        if name[0] in "mI":
            limit, words = s.max_relative * abs(value), f"{100 * deviation / abs(value):.0f} %"
        else:
            limit, words = s.max_place, f"{1000 * deviation:.1f} mm"
        if deviation / limit > worst:
            worst, at = float(deviation / limit), f"{name} has a deviation of {words}"
    share = f"{100 * s.max_relative:g} % of a described mass or inertia"
    words = f"{at} (at most {share}, {s.max_place:g} m)" if at else ""
    check = check_limit("precision", worst, 1.0, words, "too uncertain")
    if check.verdict == PASS:
        return check
    advice = "give a prior, do not estimate it, or record more maneuvers"
    return replace(check, reason=f"{check.reason}: {advice}", brief=f"too uncertain: {at}")
