"""What a dynamic calibration concludes from its maneuvers, and whether to believe it."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from math import hypot, inf, nan
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
    provenance,
)
from fss_arm_calib.dynamic.identifiability import (
    INVISIBLE,
    Combination,
    Direction,
    combinations,
    directions,
)
from fss_arm_calib.dynamic.parameters import Choice
from fss_arm_calib.dynamic.problem import DynamicProblem, DynamicResult, solve
from fss_arm_calib.dynamic.settings import GRAVITY, HEADING, DynamicCalibrationSettings
from fss_arm_calib.estimation.least_squares import Floats
from fss_arm_calib.kinematic.problem import LOSSES, SQUARE, root_mean_square, wrap
from fss_arm_calib.segments.maneuvers import Maneuver
from fss_arm_calib.segments.streams import Streams
from fss_arm_model.base_motion import Path, stack
from fss_arm_model.description import Arm, to_yaml
from fss_arm_model.kinematics import tip_in_base

LIVE = "live"  # source of data that came by topics
TOLERANCE = 1e-9  # of the last update [deviations]
ROUNDS = 20  # of weighing maneuvers anew by a robust loss


@dataclass(frozen=True)
class DynamicCalibration:
    """All that DynamicCalibration.msg tells, under the names of its fields.

    Without a solution the values are NaN and what follows from them is empty or NaN.
    """

    stamp: int  # end of the last maneuver used [ns]; 0: none
    verdict: str
    reason: str
    stages: tuple[Stage, ...]
    provenance: Provenance
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Floats
    initial: Floats
    known: Floats
    marks: tuple[int, ...]
    weights: Floats
    reasons: tuple[str, ...]
    maneuvers_used: int
    maneuvers_refused: int
    refused_kinds: tuple[str, ...]
    refused: tuple[int, ...]
    arm: str
    guess: str
    description: str
    deviations: Floats
    covariance: Floats
    random_covariance: Floats
    prior_share: Floats
    at_bound: tuple[str, ...]
    assumed: tuple[str, ...]
    assumed_deviations: Floats
    bias: Floats
    combinations: tuple[str, ...]
    combination_units: tuple[str, ...]
    combination_values: Floats
    combination_before: Floats
    combination_deviations: Floats
    directions: tuple[str, ...]
    direction_kinds: tuple[str, ...]
    direction_gains: Floats
    residuals: Floats
    momenta: Floats
    leverage: Floats
    prediction_errors: Floats
    position_residual: float
    heading_residual: float
    chi_square: float
    degrees_of_freedom: int
    iterations: int
    last_update: float
    time_offset: float
    time_offset_deviation: float


def problem_of(
    maneuvers: Sequence[Maneuver], arm: Arm, settings: DynamicCalibrationSettings
) -> DynamicProblem:
    """The problem that maneuvers with poses make.

    Raises:
        ValueError: maneuvers and arm do not fit, or a word names no parameter.
    """
    s, n = settings, arm.n
    if strange := [len(one.times) for one in maneuvers if len(one.times) != n]:
        raise ValueError(f"a maneuver is of {strange[0]} joints, expected {n}")
    longest = max(len(one.marks) for one in maneuvers)
    poses = np.zeros((len(maneuvers), longest, 3))
    sigma = np.full_like(poses, inf)
    deviations = np.array([s.position_deviation, s.position_deviation, s.heading_deviation])
    if s.residuals == HEADING:
        deviations[:2] = inf
    for one, pose, spread in zip(maneuvers, poses, sigma, strict=True):
        pose[: len(one.marks)] = one.poses
        fresh = np.minimum(one.frames, np.maximum(1.0, s.fresh_rate * np.array(one.seconds)))
        spread[: len(one.marks)] = deviations / np.sqrt(fresh)[:, None]
    return DynamicProblem(
        path=stack([one.path() for one in maneuvers]),
        poses=poses,
        sigma=sigma,
        arm=arm,
        **known_beforehand(s, n),
    )


def known_beforehand(settings: DynamicCalibrationSettings, n: int) -> dict[str, Any]:
    """The fields of a DynamicProblem that settings alone decide."""
    s, choice = settings, Choice.of(settings.estimate, n)
    deviations = s.deviations(n)
    prior = choice.basis.T @ deviations / choice.basis.sum(axis=0)
    words = s.priors.strip()
    held = Choice.of(words, n).indices if words else np.arange(0)
    closed = choice.basis[held].any(axis=0)
    return {
        "choice": choice,
        "prior": np.where(closed, prior, inf),
        "assumed": np.diag(deviations**2),
        "momentum": np.array([s.momentum_deviation] * 2 + [s.spin_deviation]),
        "tilt": GRAVITY * s.tilt_deviation,
    }


@dataclass(frozen=True)
class Solution:
    """A result, and which of M maneuvers it is from."""

    result: DynamicResult  # of those not rejected
    kept: npt.NDArray[np.bool_]  # (M,)
    weights: Floats  # (M,) 1: used; 0: rejected; between: by a robust loss
    reasons: tuple[str, ...]  # (M,) why it was rejected, else empty
    errors: Floats  # (M,) predicted from the others, or when it was rejected [deviations]
    leverage: Floats  # (M,)


def solution_of(problem: DynamicProblem, settings: DynamicCalibrationSettings) -> Solution:
    """Solve with the loss asked for; reject as many outliers as allowed, one after the other."""
    size = len(problem.poses)
    kept, reasons = np.ones(size, dtype=bool), [""] * size
    weights, errors, leverage = np.zeros((3, size))
    while True:
        weights[:] = kept
        for _ in range(1 if settings.loss == SQUARE else ROUNDS):
            result = _weighed(problem, kept, weights)
            leverage[kept], errors[kept] = result.checks
            errors[kept] /= np.sqrt(weights[kept])
            if settings.loss != SQUARE:  # errors are those of one coordinate, of three
                weights[kept] = LOSSES[settings.loss].weight(3.0 * errors[kept] ** 2)
        worst = int(np.argmax(np.where(kept, errors, 0.0)))
        enough = np.sum(kept) > settings.min_maneuvers  # to do without one
        rejected = np.sum(~kept)
        if errors[worst] <= settings.outlier or rejected >= settings.max_outliers or not enough:
            return Solution(result, kept, weights, tuple(reasons), errors, leverage)
        kept[worst], leverage[worst] = False, 0.0
        reasons[worst] = (
            f"error {errors[worst]:.3g} of its deviations, more than {settings.outlier:g}"
        )


def _weighed(
    problem: DynamicProblem, kept: npt.NDArray[np.bool_], weights: Floats
) -> DynamicResult:
    some = problem.only(kept)
    scale = np.sqrt(weights[kept])[:, None, None]
    return solve(replace(some, sigma=some.sigma / scale), tolerance=TOLERANCE)


def calibrate(
    maneuvers: Sequence[Maneuver],
    arm: Arm,
    settings: DynamicCalibrationSettings | None = None,
    streams: Streams | None = None,
    source: str = LIVE,
) -> DynamicCalibration:
    """Solve for the arm's dynamics and judge the result.

    Args:
        maneuvers: in order of time; those not used count as refused.
        arm: the initial guess, and what is assumed.
        settings: what to estimate, what is known, and criteria.
        streams: what befell the streams that the maneuvers are from.
        source: of the maneuvers.

    Raises:
        ValueError: maneuvers and arm do not fit, or a setting is impossible.
    """
    s, streams = settings or DynamicCalibrationSettings(), streams or Streams()
    used = [one for one in maneuvers if one.used]
    enough = _enough(used, maneuvers, streams, s)
    stages = [joints_known(streams, arm), clocks_kept(streams, s.joint_gap), enough]
    stages += _tips_described(used, arm, s)
    problem = problem_of(used, arm, s) if enough.verdict == PASS else None
    solution = solution_of(problem, s) if problem else None
    told = _nothing_told(arm, s)
    if solution:
        seen = directions(solution.result, s)
        stages += _judged(solution, seen, s)
        told = _told(solution, seen)
    verdict, reason = conclude(stages)
    return DynamicCalibration(
        stamp=used[-1].end if used else 0,
        verdict=verdict,
        reason=reason,
        stages=tuple(stages),
        provenance=provenance(
            s,
            DynamicCalibrationSettings,
            [np.array(part) for one in used for part in _data(one)],
            source,
            used[0].start if used else 0,
            used[-1].end if used else 0,
        ),
        marks=tuple(len(one.marks) for one in used),
        weights=solution.weights if solution else np.empty(0),
        reasons=solution.reasons if solution else len(used) * ("",),
        maneuvers_used=int(np.sum(solution.kept)) if solution else len(used),
        maneuvers_refused=len(maneuvers) - len(used),
        refused_kinds=tuple(streams.refused),
        refused=tuple(streams.refused.values()),
        time_offset=streams.offset.value,
        time_offset_deviation=streams.offset.deviation,
        arm=arm.name,
        guess=to_yaml(arm),
        description=to_yaml(solution.result.calibrated()) if solution and verdict == PASS else "",
        residuals=_residuals(solution, used) if solution else np.empty((0, 3)),
        leverage=solution.leverage if solution else np.empty(0),
        prediction_errors=solution.errors if solution else np.empty(0),
        **told,
    )


def _data(one: Maneuver) -> list[Any]:
    flat = [np.concatenate(part) for part in (one.times, one.q, one.qd)]
    return [*flat, one.marks, one.poses, one.frames, one.seconds, one.tip]


def _residuals(solution: Solution, used: Sequence[Maneuver]) -> Floats:
    """(sum of marks, 3) of all maneuvers; NaN of those rejected."""
    every = np.full((len(used), solution.result.residuals.shape[1], 3), nan)
    every[solution.kept] = solution.result.residuals
    rows = zip(every, used, strict=True)
    return np.concatenate([residuals[: len(one.marks)] for residuals, one in rows])


def _enough(
    used: Sequence[Maneuver],
    every: Sequence[Maneuver],
    streams: Streams,
    s: DynamicCalibrationSettings,
) -> Stage:
    reason = f"{count(len(used), 'maneuver')} (at least {s.min_maneuvers})"
    if len(used) >= s.min_maneuvers:
        return Stage("maneuvers", PASS, len(used), s.min_maneuvers, reason)
    if spoiled := [one for one in every if not one.used]:
        reason += f"; {count(len(spoiled), 'maneuver')} spoiled ({spoiled[0].reason})"
    if streams.silent:
        reason += f"; nothing heard of {', '.join(streams.silent)}"
    if streams.refused:
        told = (f"{number} {kind}" for kind, number in streams.refused.items())
        reason += f"; samples refused: {', '.join(told)}"
    return Stage("maneuvers", NOT_EVALUATED, len(used), s.min_maneuvers, reason)


def _tips_described(
    used: Sequence[Maneuver], arm: Arm, s: DynamicCalibrationSettings
) -> list[Stage]:
    """Whether the end effector is where the description puts it; nothing if it was not seen.

    The base's motion does not tell: lengths of another arm hide in centres of mass.
    """
    known = [one for one in used if one.tip]
    if not known:
        return []
    seen = np.array([one.tip for one in known])
    q = np.array([[readings[0] for readings in one.q] for one in known])
    away = seen[:, :2] - tip_in_base(arm.vector(), q)[:, :2]
    distance = float(np.sqrt(np.mean(np.sum(away**2, axis=1))))
    # Poses of base and end effector err by so much themselves.
    reach = float(np.sqrt(np.mean(np.sum(seen[:, :2] ** 2, axis=1))))
    errors = hypot(2.0 * s.position_deviation, reach * s.heading_deviation)
    limit = hypot(s.max_tip_error, errors)
    words = f"end effector {distance:.3f} m from where it is described (at most {limit:.3f} m)"
    failing = "another arm's data, or its kinematics are to be calibrated first"
    stage = at_most("end_effector", distance, limit, words, failing)
    return [stage if stage.verdict == FAIL else replace(stage, reason="")]


def _judged(
    solution: Solution, seen: Sequence[Direction], s: DynamicCalibrationSettings
) -> list[Stage]:
    """The stages of a solution, each threshold beside its value."""
    r = solution.result
    stages = [_determined(r, seen)]
    m = r.minimum
    words = f"{count(m.iterations, 'iteration')}, last update {m.last_update:.2g} deviations"
    words = words if m.converged else f"not converged: {words} (at most {TOLERANCE:g})"
    stages.append(
        Stage("convergence", PASS if m.converged else FAIL, m.last_update, TOLERANCE, words)
    )
    held = r.at_bound
    words = f"at the bound of what is possible: {', '.join(held)}" if held else ""
    words += "; of another arm, or its masses or lengths are others?" if held else ""
    stages.append(Stage("bounds", FAIL if held else PASS, len(held), 0, words))
    fit = by_chance(
        "fit", r.chi_square, r.problem.degrees_of_freedom, s.min_probability,
        "residuals are larger than the deviations allow",
    )  # fmt: skip
    if fit.verdict == FAIL and _fits_swapped(r.problem, s):
        fit = replace(fit, reason=f"the end effector is taken for the base; {fit.reason}")
    stages.append(fit)
    worst = int(np.argmax(np.where(solution.kept, solution.errors, 0.0)))
    words = (
        f"largest error of a maneuver predicted from the others {solution.errors[worst]:.3g} of "
        f"its deviations (at most {s.outlier:g})"
    )
    if rejected := np.flatnonzero(~solution.kept).tolist():
        words += f", rejected: {', '.join(str(k + 1) for k in rejected)} (at most {s.max_outliers})"
    failing = f"maneuver {worst + 1} is off"
    stages.append(at_most("outliers", float(solution.errors[worst]), s.outlier, words, failing))
    return [*stages, _precise(r, s)]


def _fits_swapped(problem: DynamicProblem, s: DynamicCalibrationSettings) -> bool:
    """Whether the maneuvers fit if the subject seen as the base is the end effector."""
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
    r = solve(replace(problem, poses=poses, sigma=sigma), tolerance=TOLERANCE)
    freedom = problem.degrees_of_freedom
    return by_chance("", r.chi_square, freedom, s.min_probability, "").verdict == PASS


def _determined(r: DynamicResult, seen: Sequence[Direction]) -> Stage:
    lost = [name for name, u in zip(r.problem.names, r.undetermined, strict=True) if u]
    lost = [name for name in lost if name not in r.at_bound]
    missing = len(r.values) - len(r.minimum.basis.s) - len(r.at_bound)
    invisible = sum(d.kind == INVISIBLE for d in seen)
    if not lost:
        return Stage("determined", PASS, 0, 0, "")
    reason = (
        f"{', '.join(lost)} cannot be told apart: {count(missing, 'combination')} undetermined, "
        f"{invisible} invisible to any maneuver"
    )
    return Stage("determined", NOT_EVALUATED, missing, 0, reason)


def _precise(r: DynamicResult, s: DynamicCalibrationSettings) -> Stage:
    """The parameter known worst against what is asked.

    Of masses and inertias as described: a share of what was found would be asked by chance.
    """
    names, described = r.problem.names, r.problem.guess
    worst, at = 0.0, ""
    for name, value, deviation in zip(names, described, r.deviations, strict=True):
        if name[0] in "mI":
            limit, words = s.max_relative * abs(value), f"{100 * deviation / abs(value):.0f} %"
        elif name[0] in "abxy":
            limit, words = s.max_place, f"{1000 * deviation:.1f} mm"
        else:
            continue
        if deviation / limit > worst:
            worst, at = float(deviation / limit), f"{name} has a deviation of {words}"
    share = f"{100 * s.max_relative:g} % of a described mass or inertia"
    asked = f"(at most {share}, {s.max_place:g} m)"
    return at_most("precision", worst, 1.0, f"{at} {asked}" if at else "", "too uncertain")


def _told(solution: Solution, seen: Sequence[Direction]) -> dict[str, Any]:
    """The fields of a DynamicCalibration that a solution has."""
    r, problem = solution.result, solution.result.problem
    momenta = np.full((len(solution.kept), 3), nan)
    momenta[solution.kept] = r.momenta
    found: list[Combination] = combinations(r)
    residuals = r.residuals
    return {
        "names": problem.names,
        "units": problem.units,
        "values": r.values,
        "initial": problem.guess,
        "known": problem.known,
        "deviations": r.deviations,
        "covariance": r.covariance,
        "random_covariance": r.random,
        "prior_share": r.prior_share,
        "at_bound": r.at_bound,
        "assumed": r.assumed_names,
        "assumed_deviations": np.sqrt(np.diag(problem.assumed)[r.assumed]),
        "bias": r.bias,
        "combinations": tuple(c.name for c in found),
        "combination_units": tuple(c.unit for c in found),
        "combination_values": np.array([c.value for c in found]),
        "combination_before": np.array([c.before for c in found]),
        "combination_deviations": np.array([c.deviation for c in found]),
        "directions": tuple(d.text(problem.names) for d in seen),
        "direction_kinds": tuple(d.kind for d in seen),
        "direction_gains": np.array([d.gain for d in seen]),
        "momenta": momenta,
        "position_residual": root_mean_square(residuals[..., :2][np.isfinite(residuals[..., :2])]),
        "heading_residual": root_mean_square(residuals[..., 2][np.isfinite(residuals[..., 2])]),
        "chi_square": r.chi_square,
        "degrees_of_freedom": problem.degrees_of_freedom,
        "iterations": r.minimum.iterations,
        "last_update": r.minimum.last_update,
    }


def _nothing_told(arm: Arm, s: DynamicCalibrationSettings) -> dict[str, Any]:
    """The same fields without a solution."""
    n = arm.n
    nowhere = Path(np.empty((0, 1, 3 * n + 1)), np.empty((0, 1, 2 * n + 2)))
    none = np.empty((0, 1, 3))
    problem = DynamicProblem(nowhere, none, none, arm, **known_beforehand(s, n))
    empty = {f.name: np.empty(0) for f in fields(DynamicCalibration) if f.type is Floats}
    words = ("at_bound", "assumed", "combinations", "combination_units", "directions")
    told = {
        "names": problem.names,
        "units": problem.units,
        "values": np.full(len(problem.names), nan),
        "initial": problem.guess,
        "known": problem.known,
        "deviations": np.full(len(problem.names), inf),
        **dict.fromkeys((*words, "direction_kinds"), ()),
        **dict.fromkeys(
            ("position_residual", "heading_residual", "chi_square", "last_update"), nan
        ),
        "degrees_of_freedom": 0,
        "iterations": 0,
    }
    given = {"weights", "residuals", "leverage", "prediction_errors"}
    return {k: v for k, v in empty.items() if k not in given} | told
