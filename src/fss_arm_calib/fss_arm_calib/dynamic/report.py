"""The report of a dynamic calibration, from its published messages alone.

What Calibration and Maneuver call the same passes as well, by attribute.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from fss_arm_calib.dynamic.parameters import Choice, values
from fss_arm_calib.estimation.least_squares import Floats
from fss_arm_calib.report import Figure, Report, Table
from fss_arm_calib.report_parts import (
    correlation,
    difference,
    figure,
    influence,
    number,
    origin,
    shown_unit,
    stages,
    streams,
    text,
)
from fss_arm_model.description import Arm, from_yaml, paper_arm

PAPER_HEADING_RESIDUAL = float(np.radians(1.54))  # section 4.2


def dynamic_report(
    calibration: Any, truth: Arm | None = None, maneuvers: Sequence[Any] = ()
) -> Report:
    """Tell a DynamicCalibration.

    Args:
        calibration: the message.
        truth: the simulated arm, to compare with.
        maneuvers: those published with it; without them the base's motion is not drawn.
    """
    c = calibration
    used = [one for one in maneuvers if one.used]
    figures = [
        Figure("dynamic_residuals", "Residuals of the base's poses", lambda: residuals(c)),
        Figure(
            "dynamic_maneuvers",
            "Each maneuver",
            lambda: influence(c, c.prediction_errors, "error predicted from others [deviations]"),
        ),
        Figure(
            "dynamic_correlation",
            "Correlation of the parameters",
            lambda: correlation(_square(c, c.covariance), c.names),
        ),
    ]
    if used:
        title = "Base motion, predicted and measured"
        figures.insert(0, Figure("dynamic_motion", title, lambda: motion(c, used)))
    solved = len(c.residuals) > 0
    return Report(
        title=f"Dynamic calibration of {c.arm}",
        verdict=c.verdict,
        reason=c.reason,
        tables=(_parameters(c, truth), _combinations(c), _residual_table(c)),
        origin=origin(c),
        figures=figures if solved else (),
        details=(
            stages(c),
            *([_maneuvers(c), _directions(c), _bias(c)] if solved else []),
            streams(c),
        ),
        texts={"Settings": c.provenance.parameters, "Description it began from": c.guess},
    )


def _square(c: Any, matrix: Any) -> Floats:
    p = len(c.names)
    return np.reshape(matrix, (p, p)) if len(matrix) else np.full((p, p), np.nan)


def _values(arm: Arm, names: Sequence[str]) -> Floats:
    """An arm's values of the named parameters, averaged where several share one."""

    def value(name: str) -> float:
        try:
            return float(np.mean(values(arm)[Choice.of(name, arm.n).indices]))
        except ValueError:  # of the table, or of a link that the arm does not have
            return np.nan

    return np.array([value(name) for name in names])


def _parameters(c: Any, truth: Arm | None) -> Table:
    """Beside the paper's Table 4 and, if known, the truth."""
    n, p, known = from_yaml(c.guess).n, len(c.names), truth is not None
    paper = _values(paper_arm(), c.names) if n == paper_arm().n else np.full(p, np.nan)
    true = np.full(p, np.nan) if truth is None else _values(truth, c.names)
    random = np.sqrt(np.diag(_square(c, c.random_covariance)))
    share = c.prior_share if len(c.prior_share) else np.full(p, np.nan)
    rows = []
    for k, (name, unit) in enumerate(zip(c.names, c.units, strict=True)):
        columns = [paper, c.initial, *[true] * known, c.values, c.deviations, random]
        row = [f"{name}, at its bound" if name in c.at_bound else name, shown_unit(unit)]
        row += [number(column[k], unit) for column in columns]
        row.append(text(100.0 * share[k], ".0f"))
        if known:
            row.append(text(difference(c.values[k], true[k], unit) / c.deviations[k], "+.2f"))
        rows.append(row)
    head = [
        "parameter", "unit", "Table 4", "guess", *["truth"] * known, "estimate", "± 1 sigma",
        "random", "prior [%]", *["error / sigma"] * known,
    ]  # fmt: skip
    note = (
        "random: the deviation without the uncertainty of what is assumed; prior: how much of the "
        "value is from what was known beforehand."
    )
    return Table("Parameters", head, rows, words=2, note=note)


def _combinations(c: Any) -> Table:
    rows = [
        [name, unit, number(value, unit), number(deviation, unit), number(before, unit)]
        for name, unit, value, deviation, before in zip(
            c.combinations, c.combination_units, c.combination_values, c.combination_deviations,
            c.combination_before, strict=True,
        )
    ]  # fmt: skip
    head = ["combination", "unit", "estimate", "± 1 sigma", "± before"]
    note = (
        "All that motion depends on when base and kinematics are known: m = sum m_k, "
        "S_j = m_j g_j + a_j sum m_k, K_j = I_j + m_j g_j² + a_j² sum m_k, k > j."
    )
    return Table("What motion can tell of the links", head, rows, words=2, note=note)


def _residual_table(c: Any) -> Table:
    rows = [
        ["position", "m", "-", number(c.position_residual, "m")],
        [
            "heading", "deg", number(PAPER_HEADING_RESIDUAL, "rad"),
            number(c.heading_residual, "rad"),
        ],
    ]  # fmt: skip
    head = ["of the base's", "unit", "paper", "here"]
    return Table("Standard deviation of the residuals", head, rows, words=2)


def _maneuvers(c: Any) -> Table:
    rows = [
        [str(k + 1), *(text(value, "+.3f") for value in momentum), f"{c.leverage[k]:.2f}",
         text(c.prediction_errors[k], ".2f"), f"{c.weights[k]:.2f}", c.reasons[k]]
        for k, momentum in enumerate(np.reshape(c.momenta, (-1, 3)))
    ]  # fmt: skip
    head = ["", "p_x [N s]", "p_y [N s]", "L [N m s]", "leverage", "error", "weight", ""]
    note = (
        "Momentum at the start; error of the maneuver predicted from the others, in its deviations."
    )
    return Table("Maneuvers", head, rows, note=note)


def _directions(c: Any) -> Table:
    """Combinations of parameters, those that the data say least of first."""
    rows = [
        [kind, words, text(gain, ".3g")]
        for gain, kind, words in sorted(
            zip(c.direction_gains, c.direction_kinds, c.directions, strict=True)
        )
    ]
    note = "By how much the data alone narrow what was known beforehand."
    head = ["to the data", "combination", "gain"]
    return Table("What these maneuvers see", head, rows, words=2, note=note)


def _bias(c: Any) -> Table:
    """What wrong assumptions do, the parameter's deviations being the unit."""
    bias = np.reshape(c.bias, (len(c.names), len(c.assumed))) / np.asarray(c.deviations)[:, None]
    rows = [
        [name, *(text(value, "+.2f") for value in row)]
        for name, row in zip(c.names, bias, strict=True)
    ]
    note = "Shift of each value, in its deviations, if an assumed one is 1 sigma higher in truth."
    return Table("Bias by what was assumed", ["", *c.assumed], rows, note=note)


def _by_maneuver(c: Any) -> list[Floats]:
    """Residuals of each maneuver, (m, 3)."""
    return np.split(np.reshape(c.residuals, (-1, 3)), np.cumsum(c.marks)[:-1])


def motion(c: Any, maneuvers: Sequence[Any]) -> Any:
    """How far each maneuver moved the base, from its first pose to its last."""
    measured, predicted = [], []
    for one, residual in zip(maneuvers, _by_maneuver(c), strict=True):
        poses = np.reshape(one.poses, (-1, 3))
        measured.append(poses[-1] - poses[0])
        predicted.append(measured[-1] - (residual[-1] - residual[0]))
    seen, told = np.array(measured), np.array(predicted)
    drawing = figure((14, 5))
    for axes, column, label, scale in zip(
        drawing.subplots(1, 3), (0, 1, 2), ("x [mm]", "y [mm]", "heading [deg]"),
        (1e3, 1e3, np.degrees(1.0)), strict=True,
    ):  # fmt: skip
        ends = scale * np.array([min(seen[:, column].min(), 0.0), max(seen[:, column].max(), 0.0)])
        axes.plot(ends, ends, "-", color="0.6", linewidth=1.0)
        axes.plot(scale * told[:, column], scale * seen[:, column], "o", markersize=5)
        for k, place in enumerate(
            zip(scale * told[:, column], scale * seen[:, column], strict=True)
        ):
            if np.isfinite(place).all():
                axes.annotate(str(k + 1), place, (5, 3), textcoords="offset points", fontsize=8)
        axes.set_title(f"change of {label.split()[0]}", fontsize=11)
        axes.set_xlabel(f"predicted {label}")
        axes.set_ylabel(f"measured {label}")
        axes.grid(alpha=0.25)
    return drawing


def residuals(c: Any) -> Any:
    """Of each pose of each maneuver, maneuvers side by side."""
    rows = np.reshape(c.residuals, (-1, 3))
    edges = np.concatenate([[0], np.cumsum(c.marks)])
    drawing = figure((14, 6))
    position, heading = drawing.subplots(2, 1, sharex=True)
    which = np.arange(len(rows)) + 0.5
    for column, (name, color) in enumerate((("x", "tab:blue"), ("y", "tab:orange"))):
        position.plot(which, 1e3 * rows[:, column], ".", color=color, label=name)
    heading.plot(which, np.degrees(rows[:, 2]), ".", color="tab:green")
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
