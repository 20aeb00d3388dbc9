"""Report of a kinematic calibration: tables and drawings."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import floor, log10
from typing import Any

import numpy as np

from fss_arm_calib.kinematic.solution import Solution
from fss_arm_calib.outcome import Outcome
from fss_arm_calib.report_parts import (
    common_figures,
    empty_figure,
    make_report,
    parameter_table,
    relative_errors,
    residual_table,
)
from fss_arm_calib.segments.rests import Observation
from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm, paper_arm
from fss_arm_model.estimation.noise import assumed_noise
from fss_arm_model.estimation.statistics import root_mean_square
from fss_arm_model.kinematics import joint_positions
from fss_arm_model.layout import kinematic_index, kinematic_names
from fss_arm_ros import palette
from fss_arm_ros.report import Figure, Report, Table

PAPER_RESIDUALS = (0.015, float(np.radians(0.683)))  # position [m] and heading, section 4.1


def kinematic_report(outcome: Outcome[Observation, Solution], truth: Arm | None = None) -> Report:
    """Report the result of a kinematic calibration, beside the true values if known."""
    o, labels = outcome, {"a": f"a_1 .. a_{outcome.arm.n - 1}"}
    names = [labels.get(name, name) for name in o.names]
    error = "normalized residual [deviations]"
    each, correlation = common_figures(o, "kinematic", "observation", error, names)
    drawn = Figure("kinematic_postures", "Postures and residuals", lambda: postures(o))
    tables = (_parameters(o, truth, labels), _residuals(o))
    details = (_observations(o),) if o.solution else ()
    title = f"Kinematic calibration of the arm '{o.arm.name}'"
    return make_report(title, o, tables, details, (drawn, correlation, each))


def _parameters(
    outcome: Outcome[Observation, Solution], truth: Arm | None, labels: Mapping[str, str]
) -> Table:
    """Tabulate the parameters beside the paper's Tables 2-3 and, if known, the true values."""
    e, paper = outcome.estimate, paper_arm()
    columns = {
        **({"Tables 2-3": _values(paper, e.names)} if outcome.arm.n == paper.n else {}),
        "guess": e.initial,
        **({"truth": _values(truth, e.names)} if truth else {}),
        "estimate": e.values,
        "± 1 sigma": e.deviations,
    }
    ratios = {"error / sigma": (relative_errors(e, columns["truth"]), "+.2f")} if truth else {}
    note, weak = "", list[int]()
    if found := outcome.solution:
        note = "amber: more than three times as uncertain as the end effector in one observation."
        one = dict(zip(("m", "rad"), found.problem.typical_deviations, strict=True))
        weak = [k for k, unit in enumerate(e.units) if not e.deviations[k] < 3 * one[unit]]
    table = parameter_table(outcome, columns, ratios, labels, note, weak)
    return replace(table, detailed=["Tables 2-3"])


def _residuals(outcome: Outcome[Observation, Solution]) -> Table:
    e, found = outcome.estimate, outcome.solution
    noise = found.noise if found else assumed_noise(outcome.settings)
    predicted = found.prediction.residuals if found else np.empty((0, 3))
    columns: dict[str, Sequence[float]] = {
        "paper": PAPER_RESIDUALS,
        "this result": (e.position_residual, e.heading_residual),
        "predicted": [root_mean_square(part) for part in (predicted[:, :2], predicted[:, 2])],
        "assumed error": _typical_deviations(outcome).tolist(),
    }
    note = (
        "predicted: held-out observations, by a solution without them; assumed error: of an "
        f"observation, {'as given' if noise.is_given.all() else f'estimated: {noise}'}."
    )
    return residual_table("end effector", columns, note)


def _typical_deviations(outcome: Outcome[Observation, Solution]) -> Floats:
    """Return the assumed deviations of positions and headings, (2,)."""
    found = outcome.solution
    if not found:
        return assumed_noise(outcome.settings).deviations
    return found.problem.typical_deviations


def _observations(outcome: Outcome[Observation, Solution]) -> Table:
    e, found, n = outcome.estimate, outcome.solution, outcome.arm.n
    held_out = found.held_out.tolist() if found else []
    rows = []
    for k, (o, residual) in enumerate(zip(outcome.used, e.residuals, strict=True)):
        states = [e.reasons[k], "held out for the prediction" * (k in held_out)]
        posture = (f"{angle:.2f}" for angle in np.degrees(o.q))
        pose = f"{o.tip[0]:.4f}", f"{o.tip[1]:.4f}", f"{np.degrees(o.tip[2]):.2f}"
        off = *(f"{1e3 * x:+.1f}" for x in residual[:2]), f"{np.degrees(residual[2]):+.3f}"
        fit = (f"{x[k]:.2f}" for x in (e.errors, e.leverage, e.weights))
        rows.append([str(k + 1), *posture, *pose, *off, *fit, "; ".join(filter(None, states))])
    head = ["", *(f"q_{i} [deg]" for i in range(1, n + 1)), "x [m]", "y [m]", "heading [deg]"]
    head += ["dx [mm]", "dy [mm]", "dheading [deg]", "normalized", "leverage", "weight", ""]
    note = (
        "Joint readings; pose of the end effector relative to the base; residual (observed minus "
        "predicted), its length in its standard deviations; leverage on its own prediction."
    )
    return Table("Observations", head, rows, note=note)


def _values(arm: Arm, names: Sequence[str]) -> Floats:
    """Return an arm's values of the named parameters; NaN for those it does not have."""
    values = arm.vector()[kinematic_index(arm.n)]
    known = dict(zip(kinematic_names(arm.n), values, strict=True))
    known["a"] = float(np.mean(values[: max(arm.n - 1, 1)]))
    known["theta_E"] = arm.theta_E
    return np.array([known.get(name, np.nan) for name in names])


def postures(outcome: Outcome[Observation, Solution]) -> Any:
    """Draw the arm at the observed postures with magnified residuals, and plot the residuals.

    Postures of rejected observations are dashed, without residuals, which would dwarf all others.
    """
    e = outcome.estimate
    errors = _typical_deviations(outcome)
    q, tip = np.array([o.q for o in outcome.used]), np.array([o.tip for o in outcome.used])
    residuals = np.where((e.weights > 0.0)[:, None], e.residuals, np.nan)
    drawing = empty_figure((14, 8))
    axes = drawing.subplot_mosaic([["arm", "x y"], ["arm", "heading"]], width_ratios=(1.25, 1.0))
    position, heading = axes["x y"], axes["heading"]
    verdict = f"{outcome.verdict.replace('_', ' ')}, {len(q)} observations"
    drawing.suptitle(f"Kinematic calibration: {verdict}", fontsize=14, fontweight="bold")
    _draw_postures(axes["arm"], _joints(outcome, q), tip, residuals)
    which = np.arange(1, len(q) + 1)
    for k, (name, color) in enumerate(zip("xy", palette.AXES, strict=True)):
        bars = which + 0.18 * (2 * k - 1)
        position.bar(bars, 1e3 * residuals[:, k], width=0.34, color=color, label=name)
    heading.bar(which, np.degrees(residuals[:, 2]), width=0.5, color=palette.DIFFERENCE)
    found_residuals = e.position_residual, e.heading_residual
    levels = np.array([found_residuals, errors, PAPER_RESIDUALS]) * (1e3, np.degrees(1.0))
    _finish(position, "position residual [mm]", levels[:, 0])
    _finish(heading, "heading residual [deg]", levels[:, 1])
    heading.set_xlabel("observation")
    for part in (position, heading):
        part.set_xticks(which[:: max(1, len(which) // 20)])
    return drawing


def _draw_postures(axes: Any, joints: Floats, tip: Floats, residuals: Floats) -> None:
    """Draw the arm in the base's frame, (s, n + 1, 2), with residuals as arrows at its tip."""
    from matplotlib import colormaps

    colors = colormaps["viridis"](np.linspace(0.0, 0.9, len(joints)))
    for k, (points, color) in enumerate(zip(joints, colors, strict=True)):
        style = "--" if np.isnan(residuals[k, 0]) else "-"
        axes.plot(*points.T, style, color=color, linewidth=2.0, alpha=0.45, zorder=1)
        axes.plot(*points[:-1].T, "o", color=color, markersize=4, alpha=0.7, zorder=2)
        away = points[-1] - points[-2]
        place = points[-1] + 0.06 * away / np.linalg.norm(away)
        axes.text(*place, str(k + 1), ha="center", va="center", fontsize=9, color=color)
    away = residuals[:, :2]
    scale = _magnification(away)
    label = f"position residual, {scale:g} times"
    axis_units = {"angles": "xy", "scale_units": "xy", "scale": 1.0}
    arrow = {"color": palette.DIFFERENCE, "width": 0.0035, "zorder": 3, "label": label}
    axes.quiver(*(tip[:, :2] - away).T, *(scale * away).T, **axis_units, **arrow)
    corners = 0.15 * np.array([[-1, 1, 1, -1], [-1, -1, 1, 1]])
    axes.fill(*corners, facecolor="0.9", edgecolor="0.4", zorder=0)
    for end, name in (((0.13, 0.0), "x"), ((0.0, 0.13), "y")):
        axes.annotate("", end, (0.0, 0.0), arrowprops={"arrowstyle": "->", "color": "0.2"})
        axes.annotate(name, end, color="0.2", fontsize=9)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_title("observed postures in the base's frame", fontsize=11)
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.grid(alpha=0.25)
    axes.legend(loc="best", fontsize=9)


def _finish(axes: Any, label: str, levels: Floats) -> None:
    """Draw the zero line and the standard deviations: estimated, assumed and the paper's."""
    found, assumed, paper = levels
    axes.axhline(0.0, color="0.3", linewidth=0.8)
    axes.axhspan(-assumed, assumed, color="0.92", zorder=0, label=f"± assumed sigma, {assumed:.3g}")
    for level, name, color, style in (
        (found, "standard deviation", "k", "--"),
        (paper, "paper's", palette.PREDICTED, ":"),
    ):
        axes.axhline(-level, color=color, linestyle=style, linewidth=1.0)
        words = f"± {name}, {level:.3g}"
        axes.axhline(level, color=color, linestyle=style, linewidth=1.0, label=words)
    axes.set_ylabel(label)
    axes.grid(axis="y", alpha=0.25)
    top = 1.45 * max(abs(limit) for limit in axes.get_ylim())
    axes.set_ylim(-top, top)
    axes.legend(ncols=3, fontsize=8, loc="upper center")


def _magnification(residuals: Floats) -> float:
    """Return 1, 2 or 5 times a power of ten that scales the largest residual to at most 0.25 m."""
    largest = float(np.nanmax(np.linalg.norm(residuals, axis=1)))
    if largest == 0.0:
        return 1.0
    power = floor(log10(0.25 / largest))
    return max(m * 10.0**power for m in (1, 2, 5) if m * 10.0**power <= 0.25 / largest)


def _joints(outcome: Outcome[Observation, Solution], q: Floats) -> Floats:
    """Return the positions of joints and end effector in the base's frame, (s, n + 1, 2)."""
    vector, n = outcome.arm.vector(), q.shape[1]
    index = dict(zip(kinematic_names(n), kinematic_index(n), strict=True))
    for name, value in zip(outcome.names, outcome.values, strict=True):
        chosen = [f"a_{i}" for i in range(1, n)] if name == "a" else [name]
        vector[[index[one] for one in chosen if one in index]] = value
    return joint_positions(vector, np.column_stack([np.zeros((len(q), 3)), q]))
