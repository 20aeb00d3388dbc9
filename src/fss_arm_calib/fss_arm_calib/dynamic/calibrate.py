"""Dynamic calibration from maneuvers: the solution and its acceptance checks."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain
from math import degrees, hypot, isnan, nan

import numpy as np
import numpy.typing as npt

from fss_arm_calib import checks
from fss_arm_calib.acceptance import FAIL, NOT_EVALUATED, PASS, Check, format_count
from fss_arm_calib.dynamic.identifiability import INVISIBLE
from fss_arm_calib.dynamic.knowledge import advise_priors
from fss_arm_calib.dynamic.problem import DynamicProblem
from fss_arm_calib.dynamic.settings import DynamicSettings
from fss_arm_calib.dynamic.solution import Solution, estimate_of, problem_of, solution_of
from fss_arm_calib.dynamic.solve import solve
from fss_arm_calib.outcome import LIVE, Outcome, make_outcome
from fss_arm_calib.precision import check_precision
from fss_arm_calib.segments.maneuvers import Maneuver
from fss_arm_calib.segments.poses import TIP
from fss_arm_calib.segments.samples import OUT_OF_RANGE
from fss_arm_calib.segments.streams import Streams
from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_model.estimation.noise import assumed_noise
from fss_arm_model.estimation.statistics import probability
from fss_arm_model.kinematics import tip_in_base
from fss_arm_model.planar import wrap

MAX_GYRO_DIFFERENCE = 0.2  # largest relative difference of the turns by gyro and by motion capture
MAX_RATE_DIFFERENCE = 1.5  # largest relative difference of the joints' velocities and changes
MIN_STEP = 0.01  # smaller changes between two readings do not show a velocity [rad]


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
    found = [checks.joint_names(streams, arm), checks.clocks(streams, s.joint_gap), number]
    found += check_afloat(used, s)
    found += [check_gyro(streams), check_rates(used), *check_tips(used, arm, s, streams)]
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
    enough, few = f"{number} (at least {s.min_maneuvers})", f", at least {s.min_maneuvers} needed"
    reason = enough if found >= s.min_maneuvers else number + few
    if found < s.min_maneuvers and lost:
        reason += f"; {format_count(len(lost), 'maneuver')} rejected (the first: {lost[0].reason})"
    return checks.data_amount("maneuvers", found, s.min_maneuvers, reason, streams, number)


def check_afloat(used: Sequence[Maneuver], s: DynamicSettings) -> list[Check]:
    """Check that a maneuver moved the base by more than cameras may err; [] if one did."""
    ranges = np.array([np.ptp(one.poses, axis=0) for one in used]).reshape(-1, 3)
    position, heading = 2.0 * s.max_position_deviation, 2.0 * s.max_heading_deviation
    if not len(ranges) or (ranges > [position, position, heading]).any():
        return []
    x, y, turn = ranges.max(axis=0)
    words = (
        f"the base moved by at most {1e3 * max(x, y):.2g} mm and {degrees(turn):.2g} deg while the "
        "arm moved: does it float?"
    )
    return [Check("afloat", FAIL, float(turn), heading, words)]


def check_gyro(streams: Streams) -> Check:
    """Check the relative difference between the base's turns by gyro and by motion capture."""
    words = "the gyro measures {:.3g} times the turn that motion capture measures"
    return _check_ratio("gyro", streams.gyro_ratio, MAX_GYRO_DIFFERENCE, "gyro", words)


def check_rates(used: Sequence[Maneuver]) -> Check:
    """Check the joints' rates against the changes of their readings; rates of 0 are not given."""
    ratios = [np.zeros(0)]
    joints = (zip(one.times, one.q, one.qd, strict=True) for one in used)
    for times, q, qd in chain.from_iterable(joints):
        moved, mean = np.diff(q), 0.5 * (np.array(qd[1:]) + qd[:-1])
        moving = np.abs(moved) > MIN_STEP
        ratios.append((mean * np.diff(times))[moving] / moved[moving])
    found = np.concatenate(ratios)
    ratio = float(np.median(found)) if found.any() else nan
    words = "the joints' velocities are {:.3g} times the changes of their positions"
    return _check_ratio("rates", ratio, MAX_RATE_DIFFERENCE, "joint velocities", words)


def _check_ratio(name: str, ratio: float, limit: float, what: str, words: str) -> Check:
    """Check that a ratio is 1 within a limit; NaN: not known."""
    difference = abs(ratio - 1.0)
    if isnan(ratio) or difference <= limit:
        return Check(name, PASS, difference, limit, "")
    mistakes = {degrees(1.0): "in degrees per second", -1.0: "with the wrong sign"}
    near = (text for by, text in mistakes.items() if abs(ratio / by - 1.0) <= MAX_GYRO_DIFFERENCE)
    guess = "".join(f"{what} {text}? " for text in near)
    return Check(name, FAIL, difference, limit, guess + words.format(ratio))


def check_tips(
    used: Sequence[Maneuver], arm: Arm, s: DynamicSettings, streams: Streams
) -> list[Check]:
    """Check that the observed end effector agrees with the description; [] without its poses.

    The base's motion cannot show this, because wrong link lengths are absorbed by the estimated
    centres of mass. Errors of the observed poses of base and end effector widen the limit.
    """
    known = [one for one in used if one.tip]
    if not known:
        lost = [f"{count} {why}" for why, count in streams.rejected.items() if why.startswith(TIP)]
        words = f"end effector not compared with the description: {', '.join(lost)}"
        words += "; in millimeters?" * (OUT_OF_RANGE in words)
        return [Check("end_effector", NOT_EVALUATED, nan, nan, words, needed=False)] * bool(lost)

    def mean_length(vectors: Floats) -> float:
        return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))

    seen = np.array([one.tip for one in known])[:, :2]
    q = np.array([[readings[0] for readings in one.q] for one in known])
    distance = mean_length(seen - tip_in_base(arm.vector(), q)[:, :2])
    position, heading = assumed_noise(s).deviations
    limit = hypot(s.max_tip_error, hypot(2.0 * position, mean_length(seen) * heading))
    words = f"end effector {distance:.3f} m from its described position (at most {limit:.3f} m)"
    failing = "another arm's data, or its kinematics must be calibrated first"
    return [checks.hide_pass_reason(checks.limit("end_effector", distance, limit, words, failing))]


def evaluate(solution: Solution, s: DynamicSettings) -> Iterator[Check]:
    """Yield the checks of a solution."""
    r, m = solution.result, solution.result.minimum
    left = solution.nominal.residual_sums
    words = "residuals are larger than the deviations allow"
    squares, freedom = float(np.sum(left.squares)), float(np.sum(left.freedom))
    fit = checks.fit(squares, freedom, s.min_probability, words, solution.noise)
    if fit.verdict == FAIL and _fits_swapped(solution.nominal.problem, s):
        yield checks.cause("the poses of the base are those of the end effector")
    invisible = sum(d.kind == INVISIBLE for d in solution.directions)
    advice = advise_priors(r, s)
    yield checks.identifiability(r, f", {invisible} invisible to any maneuver{advice}")
    yield checks.convergence(m)
    yield checks.bounds(r.at_bound, advice)
    yield fit
    error_name, noun = "normalized prediction error", "maneuver"
    limits = s.outlier, s.max_outliers
    yield checks.outliers(solution.errors, solution.kept, *limits, noun, error_name)
    yield checks.redundancy(r.redundancy, solution.kept, s.min_redundancy, noun)
    yield check_precision(r, s)


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
    chi_square = solve(swapped, tolerance=checks.UPDATE_TOLERANCE).chi_square
    return probability(chi_square, problem.degrees_of_freedom) >= s.min_probability
