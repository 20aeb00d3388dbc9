"""The report of a kinematic calibration, from its published message alone.

A Calibration passes as well, by attribute.
"""

from math import floor, log10
from typing import Any

import numpy as np

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
from fss_arm_model.description import Arm, from_yaml, kinematic_index, kinematic_names, paper_arm
from fss_arm_model.kinematics import joint_positions

PAPER_POSITION_RESIDUAL = 0.015  # [m], section 4.1
PAPER_HEADING_RESIDUAL = float(np.radians(0.683))


def kinematic_report(calibration: Any, truth: Arm | None = None) -> Report:
    """Tell a KinematicCalibration.

    Args:
        calibration: the message.
        truth: the simulated arm, to compare with.
    """
    c = calibration
    labels = [_label(name, from_yaml(c.guess).n) for name in c.names]
    figures = (
        Figure("kinematic_postures", "Postures and residuals", lambda: postures(c)),
        Figure(
            "kinematic_correlation",
            "Correlation of the parameters",
            lambda: correlation(_covariance(c), labels),
        ),
        Figure(
            "kinematic_observations",
            "Each observation",
            lambda: influence(c, c.normalized_residuals, "normalized residual [deviations]"),
        ),
    )
    return Report(
        title=f"Kinematic calibration of {c.arm}",
        verdict=c.verdict,
        reason=c.reason,
        tables=(_parameters(c, truth), _residuals(c)),
        origin=origin(c),
        figures=figures if len(c.residuals) else (),
        details=(stages(c), *([_observations(c)] if len(c.residuals) else []), streams(c)),
        texts={"Settings": c.provenance.parameters, "Description it began from": c.guess},
    )


def _parameters(c: Any, truth: Arm | None) -> Table:
    """Beside the paper's Tables 2-3 and, if known, the truth."""
    n, p = from_yaml(c.guess).n, len(c.names)
    values, initial = np.asarray(c.values), np.asarray(c.initial)
    deviations = np.sqrt(np.diag(_covariance(c)))
    paper = _values(paper_arm(), c.names) if n == paper_arm().n else np.full(p, np.nan)
    true = np.full(p, np.nan) if truth is None else _values(truth, c.names)
    known = truth is not None
    rows = []
    for k, (name, unit) in enumerate(zip(c.names, c.units, strict=True)):
        columns = [paper, initial, *[true] * known, values, deviations]
        row = [_label(name, n), shown_unit(unit)]
        row += [number(column[k], unit) for column in columns]
        if known:
            row.append(text(difference(values[k], true[k], unit) / deviations[k], "+.2f"))
        rows.append(row)
    head = ["parameter", "unit", "Tables 2-3", "guess", *["truth"] * known, "estimate", "± 1 sigma"]
    return Table("Parameters", [*head, *["error / sigma"] * known], rows, words=2)


def _residuals(c: Any) -> Table:
    rows = [
        [name, shown_unit(unit), *(number(value, unit) for value in values)]
        for name, unit, *values in (
            ("position", "m", PAPER_POSITION_RESIDUAL, c.position_residual,
             c.held_out_position_residual, c.position_deviation),
            ("heading", "rad", PAPER_HEADING_RESIDUAL, c.heading_residual,
             c.held_out_heading_residual, c.heading_deviation),
        )
    ]  # fmt: skip
    head = ["of the end effector's", "unit", "paper", "here", "predicted", "assumed"]
    note = "predicted: of observations held out, by a solution without them."
    return Table("Standard deviation of the residuals", head, rows, words=2, note=note)


def _observations(c: Any) -> Table:
    q, tip, residuals = _shaped(c)
    n = q.shape[1]
    rows = []
    for k in range(len(q)):
        states = [c.reasons[k]] if c.reasons[k] else []
        states += ["held out for the prediction"] if k in list(c.held_out) else []
        rows.append([
            str(k + 1),
            *(f"{angle:.2f}" for angle in np.degrees(q[k])),
            *(f"{x:.4f}" for x in tip[k, :2]), f"{np.degrees(tip[k, 2]):.2f}",
            *(f"{1e3 * x:+.1f}" for x in residuals[k, :2]), f"{np.degrees(residuals[k, 2]):+.3f}",
            f"{c.normalized_residuals[k]:.2f}", f"{c.leverage[k]:.2f}", f"{c.weights[k]:.2f}",
            "; ".join(states),
        ])  # fmt: skip
    head = [
        "", *(f"q_{i} [deg]" for i in range(1, n + 1)), "x [m]", "y [m]", "heading [deg]",
        "dx [mm]", "dy [mm]", "dheading [deg]", "normalized", "leverage", "weight", "",
    ]  # fmt: skip
    note = (
        "Joint readings; the end effector seen from the base; observed minus predicted, and its "
        "length in its own deviations; the observation's share in its own prediction."
    )
    return Table("Observations", head, rows, note=note)


def postures(c: Any) -> Any:
    """The arm at the observed postures with magnified residuals, and the residuals.

    Postures whose observation was rejected are dashed; their residuals would dwarf all others.
    """
    q, tip, residuals = _shaped(c)
    kept = np.asarray(c.weights) > 0.0
    residuals = np.where(kept[:, None], residuals, np.nan)
    drawing = figure((14, 8))
    axes = drawing.subplot_mosaic([["arm", "x y"], ["arm", "heading"]], width_ratios=(1.25, 1.0))
    position, heading = axes["x y"], axes["heading"]
    drawing.suptitle(
        f"Kinematic calibration: {c.verdict.replace('_', ' ')}, {len(q)} observations",
        fontsize=14,
        fontweight="bold",
    )
    _draw_postures(axes["arm"], _joints(c, q), tip, residuals)
    which = np.arange(1, len(q) + 1)
    for k, (name, color) in enumerate((("x", "tab:blue"), ("y", "tab:orange"))):
        bars = which + 0.18 * (2 * k - 1)
        position.bar(bars, 1e3 * residuals[:, k], width=0.34, color=color, label=name)
    _finish(position, "position residual [mm]", 1e3 * np.array([
        c.position_residual, c.position_deviation, PAPER_POSITION_RESIDUAL]))  # fmt: skip
    heading.bar(which, np.degrees(residuals[:, 2]), width=0.5, color="tab:green")
    _finish(heading, "heading residual [deg]", np.degrees([
        c.heading_residual, c.heading_deviation, PAPER_HEADING_RESIDUAL]))  # fmt: skip
    heading.set_xlabel("observation")
    for part in (position, heading):
        part.set_xticks(which[:: max(1, len(which) // 20)])
    return drawing


def _draw_postures(axes: Any, joints: Floats, tip: Floats, residuals: Floats) -> None:
    """The arm in the base's frame, (s, n + 1, 2), and residuals as arrows at its end, if any."""
    from matplotlib import colormaps

    colors = colormaps["viridis"](np.linspace(0.0, 0.9, len(joints)))
    for k, (points, color) in enumerate(zip(joints, colors, strict=True)):
        style = "--" if np.isnan(residuals[k, 0]) else "-"
        axes.plot(*points.T, style, color=color, linewidth=2.0, alpha=0.45, zorder=1)
        axes.plot(*points[:-1].T, "o", color=color, markersize=4, alpha=0.7, zorder=2)
        away = points[-1] - points[-2]
        axes.annotate(
            str(k + 1), points[-1] + 0.06 * away / np.linalg.norm(away),
            ha="center", va="center", fontsize=9, color=color, fontweight="bold",
        )  # fmt: skip
    scale = _magnification(residuals[:, :2])
    axes.quiver(
        *(tip[:, :2] - residuals[:, :2]).T, *(scale * residuals[:, :2]).T,
        angles="xy", scale_units="xy", scale=1.0, color="tab:red", width=0.0035, zorder=3,
        label=f"position residual, {scale:g} times",
    )  # fmt: skip
    size = 0.15
    axes.fill(size * np.array([-1, 1, 1, -1]), size * np.array([-1, -1, 1, 1]),
              facecolor="0.9", edgecolor="0.4", zorder=0)  # fmt: skip
    for direction, name in (((1.0, 0.0), "x"), ((0.0, 1.0), "y")):
        axes.annotate("", np.multiply(direction, 0.13), (0.0, 0.0),
                      arrowprops={"arrowstyle": "->", "color": "0.2"})  # fmt: skip
        axes.annotate(name, np.multiply(direction, 0.13), color="0.2", fontsize=9)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_title("observed postures in the base's frame", fontsize=11)
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.grid(alpha=0.25)
    axes.legend(loc="best", fontsize=9)


def _finish(axes: Any, label: str, levels: Floats) -> None:
    """Zero line, standard deviations found, assumed and the paper's."""
    found, assumed, paper = levels
    axes.axhline(0.0, color="0.3", linewidth=0.8)
    axes.axhspan(-assumed, assumed, color="0.92", zorder=0, label=f"± assumed sigma, {assumed:.3g}")
    for sign in (-1.0, 1.0):
        axes.axhline(sign * found, color="k", linestyle="--", linewidth=1.0,
                     label=f"± standard deviation, {found:.3g}" if sign > 0 else None)  # fmt: skip
        axes.axhline(sign * paper, color="tab:purple", linestyle=":", linewidth=1.3,
                     label=f"± paper's, {paper:.3g}" if sign > 0 else None)  # fmt: skip
    axes.set_ylabel(label)
    axes.grid(axis="y", alpha=0.25)
    top = 1.45 * max(abs(limit) for limit in axes.get_ylim())
    axes.set_ylim(-top, top)
    axes.legend(ncols=3, fontsize=8, loc="upper center")


def _magnification(residuals: Floats) -> float:
    """A round factor, 1, 2 or 5 times a power of ten, that makes the largest about 0.25 m."""
    largest = float(np.nanmax(np.linalg.norm(residuals, axis=1)))
    if largest == 0.0:
        return 1.0
    power = floor(log10(0.25 / largest))
    return max(m * 10.0**power for m in (1, 2, 5) if m * 10.0**power <= 0.25 / largest)


def _shaped(c: Any) -> tuple[Floats, Floats, Floats]:
    """Readings (s, n), poses (s, 3) and residuals (s, 3)."""
    tip = np.reshape(c.tip, (-1, 3))
    return np.reshape(c.q, (len(tip), -1)), tip, np.reshape(c.residuals, (-1, 3))


def _covariance(c: Any) -> Floats:
    p = len(c.names)
    return np.reshape(c.covariance, (p, p)) if len(c.covariance) else np.full((p, p), np.nan)


def _joints(c: Any, q: Floats) -> Floats:
    """Joints and end effector in the base's frame, (s, n + 1, 2)."""
    vector, n = from_yaml(c.guess).vector(), q.shape[1]
    index = dict(zip(kinematic_names(n), kinematic_index(n), strict=True))
    for name, value in zip(c.names, c.values, strict=True):
        chosen = [f"a_{i}" for i in range(1, n)] if name == "a" else [name]
        vector[[index[one] for one in chosen if one in index]] = value
    return joint_positions(vector, np.column_stack([np.zeros((len(q), 3)), q]))


def _values(arm: Arm, names: Any) -> Floats:
    """An arm's values of the named parameters; NaN for those it does not have."""
    values = arm.vector()[kinematic_index(arm.n)]
    known = dict(zip(kinematic_names(arm.n), values, strict=True))
    known["a"] = float(np.mean(values[: max(arm.n - 1, 1)]))
    known["theta_E"] = arm.theta_E
    return np.array([known.get(name, np.nan) for name in names])


def _label(name: str, n: int) -> str:
    return f"a_1 .. a_{n - 1}" if name == "a" else name
