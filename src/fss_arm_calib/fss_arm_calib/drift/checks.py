"""What a float concludes, whether to believe it, and what other nodes are told of it."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, nan, sqrt

import numpy as np
import yaml

from fss_arm_calib.acceptance import (
    NOT_EVALUATED,
    PASS,
    Provenance,
    Stage,
    at_most,
    by_chance,
    conclude,
    count,
    joints_known,
    provenance,
)
from fss_arm_calib.drift.problem import (
    NAMES,
    TOLERANCE,
    UNITS,
    Drift,
    DriftProblem,
    DriftResult,
    rigid_body,
    solve,
)
from fss_arm_calib.drift.settings import DriftSettings
from fss_arm_calib.estimation.least_squares import Floats
from fss_arm_calib.report import Report, Table
from fss_arm_calib.report_parts import origin, stages
from fss_arm_calib.segments.streams import Streams
from fss_arm_model.description import Arm, to_yaml
from fss_arm_model.units import GRAVITY

LIVE = "live"


@dataclass(frozen=True)
class FloatCalibration:
    """All that FloatCalibration.msg tells, under the names of its fields; NaN: not known."""

    stamp: int  # end of the last drift [ns]; 0: none
    verdict: str
    reason: str
    stages: tuple[Stage, ...]
    provenance: Provenance
    arm: str
    guess: str
    drifts: tuple[Drift, ...]
    values: Floats
    covariance: Floats
    hose_torque: float
    hose_torque_deviation: float
    momenta: Floats
    momentum_deviations: Floats
    position_residual: float
    heading_residual: float
    chi_square: float
    degrees_of_freedom: int
    names: tuple[str, ...] = NAMES
    units: tuple[str, ...] = UNITS

    @property
    def deviations(self) -> Floats:
        """(5,) of the values."""
        return np.sqrt(np.diag(self.covariance))


def problem_of(drifts: Sequence[Drift], arm: Arm, s: DriftSettings) -> DriftProblem:
    """The problem that drifts make."""
    deviations = np.array([s.position_deviation, s.position_deviation, s.heading_deviation])
    sigma = []
    for drift in drifts:
        fresh = np.minimum(drift.frames, np.maximum(1.0, s.fresh_rate * np.array(drift.seconds)))
        sigma.append(deviations / np.sqrt(fresh)[:, None])
    return DriftProblem(
        drifts, [rigid_body(arm, drift.q) for drift in drifts], sigma,
        s.torque_deviation, s.twist_deviation, s.drag_deviation, s.com_deviation, s.mass_deviation,
    )  # fmt: skip


def calibrate(
    drifts: Sequence[Drift],
    arm: Arm,
    settings: DriftSettings | None = None,
    streams: Streams | None = None,
    source: str = LIVE,
) -> FloatCalibration:
    """Solve for what acts on the base from outside, and judge the result.

    Args:
        drifts: in order of time.
        arm: whose masses and inertias move.
        settings: what is known, and criteria.
        streams: what befell the streams that the drifts are from.
        source: of the drifts.
    """
    s, streams = settings or DriftSettings(), streams or Streams()
    known = joints_known(streams, arm)
    judged = [known, _long_enough(drifts, streams, s)]
    solvable = drifts and known.verdict == PASS
    result = solve(problem_of(drifts, arm, s)) if solvable else None
    if result:
        judged += _judged(result, s)
    verdict, reason = conclude(judged)
    data = [np.array(part) for drift in drifts for part in drift[2:]]
    span = drifts[0].start if drifts else 0, drifts[-1].end if drifts else 0
    every = np.concatenate(result.residuals) if result else np.full((1, 3), nan)
    rms = np.sqrt(np.mean(every**2, axis=0))
    torque, torque_deviation = result.hose_torque if result else (nan, nan)
    momenta, deviations = result.momenta if result else (np.empty((0, 3)), np.empty((0, 3)))
    return FloatCalibration(
        span[1], verdict, reason, tuple(judged),
        provenance(s, DriftSettings, data, source, *span), arm.name, to_yaml(arm), tuple(drifts),
        result.values if result else np.full(5, nan),
        result.covariance if result else np.full((5, 5), nan),
        torque, torque_deviation, momenta, deviations,
        sqrt(0.5 * float(rms[0] ** 2 + rms[1] ** 2)), float(rms[2]),
        result.minimum.linear.cost if result else nan,
        result.problem.degrees_of_freedom if result else 0,
    )  # fmt: skip


def _long_enough(drifts: Sequence[Drift], streams: Streams, s: DriftSettings) -> Stage:
    total = sum(drift.times[-1] for drift in drifts)
    reason = f"{total:.0f} s of drift, at least {s.least_time:g} s needed"
    if total >= s.least_time:
        return Stage("time", PASS, total, s.least_time, reason)
    if streams.refused:
        told = (f"{number} {kind}" for kind, number in streams.refused.items())
        reason += f"; samples refused: {', '.join(told)}"
    return Stage("time", NOT_EVALUATED, total, s.least_time, reason)


def _judged(result: DriftResult, s: DriftSettings) -> list[Stage]:
    minimum, problem = result.minimum, result.problem
    update = minimum.last_update if minimum.converged else inf
    words = f"{minimum.iterations} iterations"
    tilt = float(np.sqrt(np.diag(result.covariance)[:2]).max()) / GRAVITY
    torque = result.hose_torque[1]
    return [
        at_most("convergence", update, TOLERANCE, words, "no convergence"),
        by_chance(
            "fit", minimum.linear.cost, problem.degrees_of_freedom, s.min_probability,
            "something else moved the base, or it errs by more than assumed",
        ),
        at_most(
            "tilt", tilt, s.max_tilt,
            f"tilt known to {np.degrees(tilt):.2g} degrees (at most {np.degrees(s.max_tilt):.2g})",
            "drift for longer",
        ),
        at_most(
            "torque", torque, s.max_torque,
            f"hose torque known to {torque:.2g} N m (at most {s.max_torque:g})",
            "drift for longer",
        ),
    ]  # fmt: skip


def parameters(c: FloatCalibration) -> str:
    """What `dynamic` and `base_reaction` may be told, as a ROS parameter file.

    The first takes tilt and momentum as unknown within what was found, the second subtracts the
    tilt and takes its deviation as uncertain.
    """
    g, deviation = c.values[:2], c.deviations[:2]
    tilt = float(np.sqrt(np.max(g**2 + deviation**2))) / GRAVITY
    squares = np.mean(c.momenta**2 + c.momentum_deviations**2, axis=0)
    told = {
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
    nodes = {node: {"ros__parameters": values} for node, values in told.items()}
    return f"# From {c.provenance.source}: {c.reason}\n" + yaml.safe_dump(nodes, sort_keys=False)


def float_report(c: FloatCalibration) -> Report:
    """A float for people."""
    rows = [
        [f"tilt along {axis}", "deg", *_pair(np.degrees(c.values[k] / GRAVITY),
                                             np.degrees(c.deviations[k] / GRAVITY), ".6f")]
        for k, axis in enumerate("xy")
    ]  # fmt: skip
    rows.append(["mean torque of the hose", "N m",
                 *_pair(c.hose_torque, c.hose_torque_deviation, ".6f")])  # fmt: skip
    words = ("", "", "of it at rest", "resistance to turning", "resistance to moving")
    for k in (2, 3, 4):
        rows.append([words[k], c.units[k], *_pair(c.values[k], c.deviations[k], ".6f")])
    momenta = [
        [str(k + 1), f"{drift.times[-1]:.0f}",
         *(f"{v:.4f} ± {d:.4f}" for v, d in zip(value, deviation, strict=True))]
        for k, (drift, value, deviation) in enumerate(
            zip(c.drifts, c.momenta, c.momentum_deviations, strict=False))
    ]  # fmt: skip
    head = ["drift", "time [s]", "x [N s]", "y [N s]", "angular [N m s]"]
    tables = [
        Table("What acts on the base", ["", "unit", "estimate", "1 sigma"], rows, words=2),
        Table("Momentum at the start of each drift", head, momenta),
    ]
    title = f"Float of {c.arm}, {count(len(c.drifts), 'drift')}"
    return Report(title, c.verdict, c.reason, tables, origin(c), details=[stages(c)])


def _pair(value: float, deviation: float, form: str) -> list[str]:
    return [f"{value:{form}}", f"{deviation:{form}}"]
