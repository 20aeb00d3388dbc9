"""Report of a dynamic calibration: tables and drawings."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fss_arm_calib.dynamic.problem import TILT
from fss_arm_calib.dynamic.solution import Solution
from fss_arm_calib.outcome import Outcome
from fss_arm_calib.report_parts import (
    common_figures,
    empty_figure,
    format_number,
    format_value,
    make_report,
    mask_undetermined,
    parameter_table,
    relative_errors,
    residual_table,
)
from fss_arm_calib.segments.maneuvers import Maneuver
from fss_arm_model.arrays import Floats
from fss_arm_model.base_motion import base_poses
from fss_arm_model.choice import Choice
from fss_arm_model.description import Arm, paper_arm
from fss_arm_model.files import ContentError, read_yaml
from fss_arm_model.parameters import values
from fss_arm_ros import palette
from fss_arm_ros.report import Figure, Report, Table

# Section 4.2: of a turn, the difference of two headings.
PAPER_HEADING_RESIDUAL = float(np.radians(1.54) / np.sqrt(2.0))
DRAWN_POSES = 100  # number of predicted poses drawn for a maneuver
MANEUVER_GAP = 2.0  # gap drawn between two maneuvers [s]
SCALES = np.array([1e3, 1e3, np.degrees(1.0)])  # to mm, mm, deg


def dynamic_report(
    outcome: Outcome[Maneuver, Solution], truth: Arm | None = None, tilt: Sequence[float] = ()
) -> Report:
    """Report the result of a dynamic calibration, beside the true values if known.

    `tilt` is the true acceleration (2,) of a free body down the table [m/s^2]; (): not known.
    """
    o, found = outcome, outcome.solution
    figures = (
        Figure("dynamic_motion", "Base motion, predicted and measured", lambda: draw_motion(o)),
        Figure("dynamic_residuals", "Residuals of the base's poses", lambda: draw_residuals(o)),
        *common_figures(o, "dynamic", "maneuver", "error predicted from others [deviations]"),
    )
    residuals = {
        "paper": (np.nan, PAPER_HEADING_RESIDUAL),
        "this result": (o.estimate.position_residual, o.estimate.heading_residual),
    }
    tables = (
        _parameter_table(o, truth, tilt),
        _combination_table(o),
        residual_table("base", residuals),
    )
    makers = _maneuver_table, _direction_table, _bias_table
    details = [make(o, found) for make in makers] if found else []
    return make_report(
        f"Dynamic calibration of the arm '{o.arm.name}'", o, tables, details, figures
    )


def _parameter_values(arm: Arm, names: Sequence[str]) -> Floats:
    """Return an arm's values of the named parameters, averaged where several share one."""

    def value(name: str) -> float:
        try:
            return float(np.mean(values(arm)[Choice.of(name, arm.n).indices]))
        except ValueError:  # a parameter of the table, or of a link that the arm does not have
            return np.nan

    return np.array([value(name) for name in names])


def _true_values(truth: Arm, tilt: Sequence[float], names: Sequence[str]) -> Floats:
    """Return the true values of the named parameters of arm and table; NaN if not known."""
    known = dict(zip(TILT, tilt, strict=False))
    rows = zip(names, _parameter_values(truth, names), strict=True)
    return np.array([known.get(name, value) for name, value in rows])


def _read_promised(plan: str) -> Mapping[str, float]:
    """Return the standard deviations that a plan of `design` promised, by name."""
    found = read_yaml(Path(plan))
    if not isinstance(found, dict) or "maneuvers" not in found:
        raise ContentError(f"plan {plan}", found, "maneuvers, as `design` writes them")
    given = found.get("promised", {})
    if not isinstance(given, dict) or not all(isinstance(x, float | int) for x in given.values()):
        raise ContentError(f"plan {plan}: promised", given, "deviations by name")
    return given


def _parameter_table(
    outcome: Outcome[Maneuver, Solution], truth: Arm | None, tilt: Sequence[float]
) -> Table:
    """Tabulate the parameters beside the paper's Table 4 and, if known, the true values."""
    e, paper = outcome.estimate, paper_arm()
    r = outcome.solution.result if outcome.solution else None
    share = mask_undetermined(e, r.prior_share if r else e.deviations)
    known = 1.0 if outcome.arm.n == paper.n else np.nan
    columns = {
        "Table 4": known * _parameter_values(paper, e.names),
        "guess": e.initial,
        **({"truth": _true_values(truth, tilt, e.names)} if truth else {}),
        "estimate": e.values,
    }
    if plan := outcome.settings.plan:
        promised = _read_promised(plan)
        columns["promised ±"] = np.array([promised.get(name, np.nan) for name in e.names])
    columns["± 1 sigma"] = e.deviations
    columns["random"] = mask_undetermined(e, np.sqrt(np.diag(r.random)) if r else e.deviations)
    ratios = {"prior [%]": (100.0 * share, ".0f")}
    if truth:
        ratios["error / sigma"] = relative_errors(e, columns["truth"]), "+.2f"
    note = (
        "random: the deviation without the uncertainty of assumed parameters; prior: share of the "
        "value from prior knowledge; amber: mostly from prior knowledge, or not determined."
    )
    weak = [k for k, deviation in enumerate(e.deviations) if share[k] > 0.5 or np.isinf(deviation)]
    table = parameter_table(outcome, columns, ratios, note=note, weak=weak)
    return replace(table, detailed=["Table 4", "random", "prior [%]"])


def _combination_table(outcome: Outcome[Maneuver, Solution]) -> Table:
    rows = [
        [c.name, c.unit, *(format_value(x, c.unit) for x in (c.value, c.deviation, c.before))]
        for c in (outcome.solution.combinations if outcome.solution else ())
    ]
    head = ["combination", "unit", "estimate", "± 1 sigma", "± before"]
    note = (
        "The motion depends only on these if base and kinematics are known. With c_j = a_j - b_j "
        "and M_j the mass of all links after link j: m is the sum of all masses, "
        "S_j = m_j c_j + a_j M_j, K_j = I_j + m_j c_j² + a_j² M_j."
    )
    return Table("Link parameters that motion determines", head, rows, words=2, note=note)


def _maneuver_table(outcome: Outcome[Maneuver, Solution], found: Solution) -> Table:
    e = outcome.estimate
    rows = []
    for k, momentum in enumerate(found.momenta):
        numbers = [format_number(value, "+#.4g") for value in momentum]
        numbers += [format_number(x[k], ".2f") for x in (e.leverage, e.errors, e.weights)]
        rows.append([str(k + 1), *numbers, e.reasons[k]])
    head = ["maneuver", "p_x [N s]", "p_y [N s]", "L [N m s]", "leverage", "error", "weight", ""]
    note = (
        "Momentum at the start, in the world's axes, L about the common centre of mass; error of "
        "the maneuver predicted from the others, in its standard deviations."
    )
    return Table("Maneuvers", head, rows, note=note)


def _direction_table(outcome: Outcome[Maneuver, Solution], found: Solution) -> Table:
    """Tabulate the combinations of parameters, least observed first."""
    rows = [
        [one.kind, one.text(outcome.names), format_number(one.gain, ".3g")]
        for one in sorted(found.directions, key=lambda one: one.gain)
    ]
    note = (
        "Least visible first. Parameters in units of their prior deviation; gain: prior deviation "
        "over that from the data alone; below 1 the prior says more than the data."
    )
    head = ["visibility", "combination", "gain"]
    return Table("Visibility of combinations of parameters", head, rows, words=2, note=note)


def _bias_table(outcome: Outcome[Maneuver, Solution], found: Solution) -> Table:
    """Tabulate the bias by wrong assumptions, in standard deviations of the parameters."""
    bias = found.result.bias / outcome.deviations[:, None]
    rows = [
        [name, *(format_number(value, "+.2f") if abs(value) >= 0.005 else "" for value in row)]
        for name, row in zip(outcome.names, bias, strict=True)
    ]
    note = (
        "Shift of each estimate, in its standard deviations, if an assumed parameter is truly 1 "
        "sigma higher than described; empty: below 0.005, or the estimate is not determined."
    )
    head = ["", *found.result.assumed_names]
    return Table("Bias due to assumed parameters", head, rows, note=note)


def draw_motion(outcome: Outcome[Maneuver, Solution]) -> Any:
    """Plot the base's pose in each maneuver: measured at its marks, predicted throughout."""
    drawing = empty_figure((14, 9))
    axes = drawing.subplots(3, 1, sharex=True)
    begin, middles = 0.0, []
    for number, one, times, predicted in _predictions(outcome):
        t, marks = begin + times - times[0], begin + np.array(one.marks) - times[0]
        path, seen = (SCALES * (poses - predicted[0]) for poses in (predicted, np.array(one.poses)))
        for k, axis in enumerate(axes):
            axis.plot(t, path[:, k], color=palette.PREDICTED, linewidth=1.5)
            axis.plot(marks, seen[:, k], ".", color=palette.MEASURED, markersize=7, zorder=3)
            axis.axvline(t[-1] + 0.5 * MANEUVER_GAP, color="0.85", linewidth=0.8)
        middles.append((begin + 0.5 * np.ptp(times), str(number)))
        begin = t[-1] + MANEUVER_GAP
    for axis, label in zip(axes, ("x [mm]", "y [mm]", "heading [deg]"), strict=True):
        axis.set_ylabel(f"change of {label}")
        axis.grid(axis="y", alpha=0.25)
    words = "predicted", "measured"
    drawing.legend(axes[0].lines[:2], words, loc="outside upper right", ncols=2)
    axes[2].set_xlim(-0.5 * MANEUVER_GAP, begin - 0.5 * MANEUVER_GAP)
    axes[2].set_xticks(*zip(*middles, strict=True))
    axes[2].set_xlabel(f"maneuver, each over its time; all together {begin:.0f} s")
    return drawing


def _predictions(
    outcome: Outcome[Maneuver, Solution],
) -> Iterator[tuple[int, Maneuver, Floats, Floats]]:
    """Yield each kept maneuver with its number, times (k,) [s] and predicted poses (k, 3)."""
    if outcome.solution is None:
        return
    problem, x = outcome.solution.result.problem, outcome.solution.result.minimum.x
    vector, kept = problem.vector(x), np.flatnonzero(outcome.solution.kept).tolist()
    for k, state in zip(kept, problem.states(x), strict=True):
        one = outcome.used[k]
        times = np.union1d(one.marks, np.linspace(one.marks[0], one.marks[-1], DRAWN_POSES))
        yield k + 1, one, times, base_poses(vector, one.path_at(times), state)


def draw_residuals(outcome: Outcome[Maneuver, Solution]) -> Any:
    """Plot the residual of each pose, with the maneuvers side by side."""
    rows, counts = outcome.estimate.residuals, [len(one.marks) for one in outcome.used]
    edges = np.cumsum([0, *counts])  # index of each maneuver's first row, and number of rows
    drawing = empty_figure((14, 6))
    position, heading = drawing.subplots(2, 1, sharex=True)
    which = np.arange(len(rows)) + 0.5
    for column, (name, color) in enumerate(zip("xy", palette.AXES, strict=True)):
        position.plot(which, 1e3 * rows[:, column], ".", color=color, label=name)
    heading.plot(which, np.degrees(rows[:, 2]), ".", color=palette.DIFFERENCE)
    for axes, label in ((position, "position residual [mm]"), (heading, "heading residual [deg]")):
        axes.axhline(0.0, color="0.3", linewidth=0.8)
        for edge in edges[1:-1]:
            axes.axvline(edge, color="0.85", linewidth=0.8)
        axes.set_ylabel(label)
        axes.grid(axis="y", alpha=0.25)
    position.legend(loc="upper right")
    heading.set_xticks(0.5 * (edges[1:] + edges[:-1]), range(1, len(edges)))
    heading.set_xlim(0, edges[-1])
    heading.set_xlabel("maneuver, its poses side by side")
    return drawing
