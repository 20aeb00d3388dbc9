"""What a kinematic calibration concludes from its observations, and whether to believe it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import nan
from typing import Any

import numpy as np
import numpy.typing as npt

from fss_arm_calib.acceptance import (
    FAIL,
    NOT_EVALUATED,
    PASS,
    Provenance,
    Stage,
    at_most,
    by_chance,
    clocks_kept,
    conclude,
    count,
    joints_known,
    numbers,
    provenance,
)
from fss_arm_calib.kinematic.problem import (
    CAUCHY,
    FULL,
    Floats,
    KinematicProblem,
    KinematicResult,
    NotIdentifiable,
    Prediction,
    inverse,
    root_mean_square,
    solve,
)
from fss_arm_calib.kinematic.settings import CalibrationSettings
from fss_arm_calib.segments.rests import Observation, homed, since_homed, spoiled
from fss_arm_calib.segments.streams import Streams
from fss_arm_model.description import Arm, DescriptionError, to_yaml

__all__ = ["FAIL", "NOT_EVALUATED", "PASS", "Calibration", "calibrate"]

TOLERANCE = 1e-9  # of the last update [deviations]

ALIKE = 0.01  # described lengths that differ by no more are as good as equal [m]

LIVE = "live"  # source of data that came by topics


@dataclass(frozen=True)
class Calibration:
    """All that KinematicCalibration.msg tells, under the names of its fields.

    Without an identifiable solution the values are NaN and what follows from them is empty or NaN.
    """

    stamp: int  # end of the last observation used [ns]; 0: none
    verdict: str
    reason: str
    stages: tuple[Stage, ...]
    provenance: Provenance
    parametrization: str
    loss: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Floats
    initial: Floats
    covariance: Floats
    q: Floats
    tip: Floats
    residuals: Floats
    weights: Floats
    leverage: Floats
    normalized_residuals: Floats
    reasons: tuple[str, ...]
    held_out: tuple[int, ...]
    held_out_residuals: Floats
    held_out_normalized: Floats
    held_out_position_residual: float
    held_out_heading_residual: float
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
    refused_kinds: tuple[str, ...]
    refused: tuple[int, ...]
    time_offset: float
    time_offset_deviation: float
    boots: tuple[int, ...]
    homings: tuple[int, ...]
    arm: str
    guess: str
    description: str
    observations_hash: str
    software: str


def calibrate(
    observations: Sequence[Observation],
    arm: Arm,
    settings: CalibrationSettings | None = None,
    streams: Streams | None = None,
    source: str = LIVE,
) -> Calibration:
    """Solve for the arm's kinematics and judge the result.

    Args:
        observations: in order of time; those not used count as refused, and so do those from
            before a link was homed last, as the offsets have changed by it.
        arm: the initial guess.
        settings: parametrization, deviations of an observation and criteria.
        streams: what befell the streams that the observations are from.
        source: of the observations.

    Raises:
        ValueError: observations and arm do not fit, or a setting is impossible.
    """
    s = settings or CalibrationSettings()
    comparable = since_homed(observations)
    used = [o for o in comparable if o.used]
    problem = KinematicProblem(
        q=np.array([o.q for o in used]).reshape(len(used), -1 if used else arm.n),
        tip=np.array([o.tip for o in used]).reshape(-1, 3),
        arm=arm,
        parametrization=s.parametrization,
        position_deviation=s.position_deviation,
        heading_deviation=s.heading_deviation,
        theta_e=s.theta_e,
        loss=s.loss,
    )
    streams = streams or Streams()
    stages = [
        joints_known(streams, arm),
        _homings(observations),
        _rests(comparable, _needed(problem, s), s),
        clocks_kept(streams, s.joint_gap),
        _enough(problem, streams, s),
    ]
    solution: Solution | None = None
    if stages[-1].verdict == PASS:
        try:
            solution = solution_of(problem, s)
            stages += _judged(solution, s)
        except NotIdentifiable as error:
            stages.append(_inseparable(problem, error, s))
    verdict, reason = conclude(stages)
    origin = provenance(
        s,
        CalibrationSettings,
        (problem.q, problem.tip),
        source,
        used[0].start if used else 0,
        used[-1].end if used else 0,
    )
    return Calibration(
        stamp=origin.end,
        verdict=verdict,
        reason=reason,
        stages=tuple(stages),
        provenance=origin,
        parametrization=s.parametrization,
        loss=s.loss,
        names=problem.names,
        units=problem.units,
        initial=problem.initial,
        q=problem.q,
        tip=problem.tip,
        position_deviation=s.position_deviation,
        heading_deviation=s.heading_deviation,
        observations_refused=len(observations) - len(used),
        gaps=len(comparable) - len(used),
        refused_kinds=tuple(streams.refused),
        refused=tuple(streams.refused.values()),
        time_offset=streams.offset.value,
        time_offset_deviation=streams.offset.deviation,
        boots=used[-1].boots if used else (),
        homings=used[-1].homings if used else (),
        arm=arm.name,
        guess=to_yaml(arm),
        description=to_yaml(solution.result.calibrated()) if solution and verdict == PASS else "",
        observations_hash=origin.data_hash,
        software=origin.software,
        **(_numbers_of(solution) if solution else _no_numbers(problem)),
    )


@dataclass(frozen=True)
class Solution:
    """A result, which observations it is from, and how well it predicts without some of them."""

    problem: KinematicProblem  # of all s observations
    result: KinematicResult  # of those kept
    kept: npt.NDArray[np.bool_]  # (s,)
    reasons: tuple[str, ...]  # (s,) why it was rejected, else empty
    held_out: npt.NDArray[np.intp]  # (h,)
    prediction: Prediction  # of those held out, by a solution without them


def solution_of(problem: KinematicProblem, settings: CalibrationSettings) -> Solution:
    """Solve, reject as many outliers as allowed, one after the other, and hold some out.

    Raises:
        NotIdentifiable: the observations are too few or too alike for all parameters.
    """
    s = settings
    kept, reasons = np.ones(len(problem.q), dtype=bool), [""] * len(problem.q)
    while True:
        result = solve(problem.only(kept), TOLERANCE, max_condition=s.max_condition)
        worst = int(np.flatnonzero(kept)[np.argmax(result.normalized_residuals)])
        length = float(np.max(result.normalized_residuals))
        enough = np.sum(kept) > _needed(problem, s)  # to do without one
        if length <= s.outlier or np.sum(~kept) >= s.max_outliers or not enough:
            break
        kept[worst] = False
        reasons[worst] = f"normalized residual {length:.3g}, more than {s.outlier:g}"
        if _fits_swapped(result, problem, s)[worst]:
            reasons[worst] += ": base and end effector are swapped"
    return Solution(problem, result, kept, tuple(reasons), *_held_out(problem, result, kept, s))


def _held_out(
    problem: KinematicProblem,
    result: KinematicResult,
    kept: npt.NDArray[np.bool_],
    s: CalibrationSettings,
) -> tuple[npt.NDArray[np.intp], Prediction]:
    """Every so-manyth observation, predicted by a solution without them; none if too few remain."""
    held_out = (
        np.flatnonzero(kept)[s.held_out - 1 :: s.held_out] if s.held_out else np.array([], int)
    )
    rest = kept.copy()
    rest[held_out] = False
    if len(held_out) and np.sum(rest) >= _needed(problem, s):
        try:
            without = solve(problem.only(rest), TOLERANCE, max_condition=s.max_condition)
            return held_out, without.predicted(problem.only(held_out))
        except NotIdentifiable:
            pass
    return held_out[:0], result.predicted(problem.only(held_out[:0]))


def _homings(observations: Sequence[Observation]) -> Stage:
    """What is from before a homing is left out, which is no reason not to believe the rest."""
    joints = sorted({i for o in observations for i in homed(o, observations[-1])})
    left_out = len(observations) - len(since_homed(observations))
    names = ", ".join(f"joint_{i}" for i in joints)
    words = f"{count(left_out, 'observation')} left out: {names} homed or restarted since"
    return Stage("homings", PASS, left_out, nan, words if left_out else "")


def _rests(observations: Sequence[Observation], needed: int, s: CalibrationSettings) -> Stage:
    """What was spoiled need not be repeated once those used since then are enough by themselves."""
    used = [o for o in observations if o.used]
    since = used[-needed].start if len(used) >= needed else 0
    lost = [o for o in spoiled(observations, s.same_posture) if o.end >= since]
    reason = (
        f"{count(len(lost), 'rest')} spoiled ({lost[0].reason}) and not repeated" if lost else ""
    )
    return Stage("rests", NOT_EVALUATED if lost else PASS, len(lost), 0.0, reason)


def _needed(problem: KinematicProblem, s: CalibrationSettings) -> int:
    return max(s.min_observations, len(problem.names) // 3 + 1)


def _enough(problem: KinematicProblem, streams: Streams, s: CalibrationSettings) -> Stage:
    found, needed = len(problem.q), _needed(problem, s)
    if found >= needed:
        reason = f"{count(found, 'observation')} (at least {needed})"
        return Stage("observations", PASS, found, needed, reason)
    names = ", ".join(problem.names)
    reason = f"{count(found, 'observation')}, at least {needed} needed for {names}"
    if streams.silent:
        reason += f"; nothing heard of {', '.join(streams.silent)}"
    if any(streams.refused.values()):
        told = (f"{number} {kind}" for kind, number in streams.refused.items() if number)
        reason += f"; samples refused: {', '.join(told)}"
    return Stage("observations", NOT_EVALUATED, found, needed, reason)


def _inseparable(
    problem: KinematicProblem, error: NotIdentifiable, s: CalibrationSettings
) -> Stage:
    """The named parameters, and the joints whose standing still explains them."""
    span = np.ptp(problem.q, axis=0)
    still = [f"joint_{i + 1}" for i in np.flatnonzero(span < s.same_posture)]
    hint = f"; {', '.join(still)} hardly moved" if still else ""
    reason = f"{error}, at most {s.max_condition:g} to judge by{hint}"
    return Stage("condition", NOT_EVALUATED, error.condition, s.max_condition, reason)


def _judged(solution: Solution, s: CalibrationSettings) -> list[Stage]:
    """The stages of a solution, each threshold beside its value."""
    r = solution.result
    words = f"condition number {r.condition_number:.3g} (at most {s.max_condition:g})"
    stages = [at_most("condition", r.condition_number, s.max_condition, words)]
    words = f"{count(r.iterations, 'iteration')}, last update {r.last_update:.2g} deviations"
    verdict = PASS if r.converged else FAIL
    words = words if r.converged else f"not converged: {words} (at most {TOLERANCE:g})"
    stages.append(Stage("convergence", verdict, r.last_update, TOLERANCE, words))
    try:
        r.calibrated()
    except DescriptionError as error:
        least = float(np.min(solution.problem.all_parameters(r.values)[: solution.problem.arm.n]))
        stages.append(Stage("lengths", FAIL, least, 0.0, f"a mirrored solution: {error}"))
    stages.append(_lengths_kept(solution, s))
    fit = by_chance(
        "fit", r.chi_square, r.degrees_of_freedom, s.min_probability,
        "residuals are larger than the assumed deviations allow",
    )  # fmt: skip
    outliers = _outliers(solution, s)
    if FAIL in (fit.verdict, outliers.verdict) and (hint := _swap_hint(solution, s)):
        fit = replace(fit, verdict=FAIL, reason=f"{hint}; {fit.reason}")
    return [*stages, fit, outliers, _checked(solution, s), _predicted(solution, s)]


def _lengths_kept(solution: Solution, s: CalibrationSettings) -> Stage:
    """Whether the links are about as long as described: data of another arm fit as well."""
    problem = solution.problem
    described = np.array([link.a for link in problem.arm.links])
    lengths = problem.all_parameters(solution.result.values)[: len(described)]
    k = int(np.argmax(np.abs(lengths - described)))
    change = float(abs(lengths[k] - described[k]))
    words = f"a_{k + 1} is {lengths[k]:.4f} m, {described[k]:.4f} m in the description"
    words += f" (at most {s.max_length_change:g} m apart)"
    stage = at_most("description", change, s.max_length_change, words, "another arm's data")
    return stage if stage.verdict == FAIL else replace(stage, reason=_averaged(problem))


def _averaged(problem: KinematicProblem) -> str:
    """What is told of links described with unlike lengths of which one is estimated.

    No more, as the lengths of a full calibration scatter by as much: from 13 postures, 9 mm.
    """
    lengths = [link.a for link in problem.arm.links[:-1]]
    if not problem.shares_length or max(lengths) - min(lengths) <= ALIKE:
        return ""
    unlike = f"links described as {min(lengths):.3f} to {max(lengths):.3f} m long"
    return f"{unlike} are taken as equal: {FULL} tells them apart"


def _checked(solution: Solution, s: CalibrationSettings) -> Stage:
    """Whether the others check each observation: of one that decides alone no error is seen.

    Where they hardly do, lengths and mount may: if these came out as described, an error can only
    hide in the angles, which leaves the others more to check it by.
    """
    r = solution.result
    regressor = r.problem.linear(r.values).regressor
    checked = _redundancy(regressor)
    worst = int(np.argmin(checked))
    least, which = float(checked[worst]), numbers([int(np.flatnonzero(solution.kept)[worst])])
    hardly = f"{which} hardly checked by the others: redundancy {least:.2g}"
    hardly += f" (at least {s.min_redundancy:g})"
    if least >= s.min_redundancy:
        return Stage("redundancy", PASS, least, s.min_redundancy, "")
    angles = np.array(r.problem.units) == "rad"
    change = float(np.max(np.abs(r.values - r.problem.initial)[~angles], initial=0.0))
    by_angles = float(np.min(_redundancy(regressor[:, angles])))
    if change <= s.max_length_change and by_angles >= s.min_redundancy:
        words = f"{hardly}, but lengths and mount are as described: then {by_angles:.2g}"
        return Stage("redundancy", PASS, by_angles, s.min_redundancy, words)
    return Stage("redundancy", NOT_EVALUATED, least, s.min_redundancy, hardly)


def _redundancy(regressor: Floats) -> Floats:
    """(s,) what share of an error of an observation shows in its residual at least, squared.

    The least eigenvalue of 1 - hat of each three rows. An error e (in deviations) along it has a
    normalized residual of e sqrt(redundancy); 0: it moves the parameters alone.
    """
    Q = np.linalg.qr(regressor)[0].reshape(-1, 3, regressor.shape[1])
    return np.asarray(1.0 - np.linalg.norm(Q, 2, axis=(1, 2)) ** 2)


def _outliers(solution: Solution, s: CalibrationSettings) -> Stage:
    lengths, kept = solution.result.normalized_residuals, np.flatnonzero(solution.kept)
    words = f"largest normalized residual {np.max(lengths):.3g} (at most {s.outlier:g})"
    if rejected := np.flatnonzero(~solution.kept).tolist():
        words += f", {numbers(rejected)} rejected (at most {s.max_outliers})"
    far = kept[lengths > s.outlier].tolist()
    failing = f"{numbers(far)} off" if far else ""
    return at_most("outliers", float(np.max(lengths)), s.outlier, words, failing)


def _predicted(solution: Solution, s: CalibrationSettings) -> Stage:
    held_out = solution.held_out.tolist()
    if not held_out:
        words = "no observation was held out" + (", as they are too few" if s.held_out else "")
        return Stage("prediction", NOT_EVALUATED, nan, s.min_probability, words, needed=False)
    what = f"{numbers(held_out)} predicted from the others"
    stage = by_chance(
        "prediction", solution.prediction.chi_square, 3 * len(held_out), s.min_probability,
        "worse than the deviations allow",
    )  # fmt: skip
    return replace(stage, reason=f"{what}: {stage.reason}")


def _fits_swapped(
    result: KinematicResult, problem: KinematicProblem, s: CalibrationSettings
) -> npt.NDArray[np.bool_]:
    """Which observations would fit with base and end effector exchanged, (s,)."""
    swapped = replace(problem, tip=inverse(problem.tip))
    return np.asarray(result.predicted(swapped).normalized <= s.outlier)


def _swap_hint(solution: Solution, s: CalibrationSettings) -> str:
    """Whether exchanged subjects explain what does not fit; empty if not."""
    problem = solution.problem.only(solution.kept)
    try:
        all_swapped = solve(
            replace(problem, tip=inverse(problem.tip)), max_condition=s.max_condition
        )
        robust = solve(replace(problem, loss=CAUCHY), max_condition=s.max_condition)
    except NotIdentifiable:
        return ""
    stage = by_chance(
        "", all_swapped.chi_square, all_swapped.degrees_of_freedom, s.min_probability, ""
    )
    if stage.verdict == PASS:
        return "base and end effector are swapped"
    some = _fits_swapped(robust, problem, s) & (robust.normalized_residuals > s.outlier)
    which = np.flatnonzero(solution.kept)[some].tolist()
    return f"base and end effector are swapped in {numbers(which)}" if which else ""


def _numbers_of(solution: Solution) -> dict[str, Any]:
    """The fields of a Calibration that a solution has."""
    r, kept, ahead = solution.result, solution.kept, solution.prediction
    weights, leverage = np.zeros(len(kept)), np.zeros(len(kept))
    weights[kept], leverage[kept] = r.weights, r.leverage
    all_of_them = r.predicted(solution.problem)
    normalized = all_of_them.normalized
    normalized[kept] = r.normalized_residuals
    return {
        "values": r.values,
        "covariance": r.covariance,
        "residuals": all_of_them.residuals,
        "weights": weights,
        "leverage": leverage,
        "normalized_residuals": normalized,
        "reasons": solution.reasons,
        "held_out": tuple(solution.held_out.tolist()),
        "held_out_residuals": ahead.residuals,
        "held_out_normalized": ahead.normalized,
        "held_out_position_residual": root_mean_square(ahead.residuals[:, :2]),
        "held_out_heading_residual": root_mean_square(ahead.residuals[:, 2]),
        "position_residual": r.position_residual,
        "heading_residual": r.heading_residual,
        "chi_square": r.chi_square,
        "degrees_of_freedom": r.degrees_of_freedom,
        "condition_number": r.condition_number,
        "iterations": r.iterations,
        "last_update": r.last_update,
        "observations_used": int(np.sum(kept)),
    }


def _no_numbers(problem: KinematicProblem) -> dict[str, Any]:
    """The same fields without a solution."""
    s, p = len(problem.q), len(problem.names)
    unknown = (
        "held_out_position_residual", "held_out_heading_residual", "position_residual",
        "heading_residual", "chi_square", "condition_number", "last_update",
    )  # fmt: skip
    return {
        "values": np.full(p, nan),
        "covariance": np.empty((0, 0)),
        "residuals": np.empty((0, 3)),
        "weights": np.empty(0),
        "leverage": np.empty(0),
        "normalized_residuals": np.empty(0),
        "reasons": s * ("",),
        "held_out": (),
        "held_out_residuals": np.empty((0, 3)),
        "held_out_normalized": np.empty(0),
        **dict.fromkeys(unknown, nan),
        "degrees_of_freedom": max(problem.tip.size - p, 0),
        "iterations": 0,
        "observations_used": s,
    }
