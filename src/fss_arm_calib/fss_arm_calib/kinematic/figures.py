"""Figures of a kinematic calibration."""

from math import floor, log10
from typing import Any

import numpy as np

from fss_arm_calib.estimation.noise import assumed_noise
from fss_arm_calib.kinematic.solution import Solution
from fss_arm_calib.outcome import Outcome
from fss_arm_calib.report_figures import empty_figure
from fss_arm_calib.segments.rests import Observation
from fss_arm_model.arrays import Floats
from fss_arm_model.kinematics import joint_positions
from fss_arm_model.layout import kinematic_index, kinematic_names
from fss_arm_ros import palette

PAPER_POSITION_RESIDUAL = 0.015  # [m], section 4.1
PAPER_HEADING_RESIDUAL = float(np.radians(0.683))


def postures(outcome: Outcome[Observation, Solution]) -> Any:
    """Draw the arm at the observed postures with magnified residuals, and plot the residuals.

    Postures whose observation was rejected are dashed. Their residuals are not shown, because
    they would dwarf all others.
    """
    e, found = outcome.estimate, outcome.solution
    errors = (found.noise if found else assumed_noise(outcome.settings)).deviations
    q, tip = np.array([o.q for o in outcome.used]), np.array([o.tip for o in outcome.used])
    residuals = np.where((e.weights > 0.0)[:, None], e.residuals, np.nan)
    drawing = empty_figure((14, 8))
    axes = drawing.subplot_mosaic([["arm", "x y"], ["arm", "heading"]], width_ratios=(1.25, 1.0))
    position, heading = axes["x y"], axes["heading"]
    drawing.suptitle(
        f"Kinematic calibration: {outcome.verdict.replace('_', ' ')}, {len(q)} observations",
        fontsize=14,
        fontweight="bold",
    )
    _draw_postures(axes["arm"], _joints(outcome, q), tip, residuals)
    which = np.arange(1, len(q) + 1)
    for k, (name, color) in enumerate(zip("xy", palette.AXES, strict=True)):
        bars = which + 0.18 * (2 * k - 1)
        position.bar(bars, 1e3 * residuals[:, k], width=0.34, color=color, label=name)
    _finish(
        position,
        "position residual [mm]",
        1e3 * np.array([e.position_residual, errors[0], PAPER_POSITION_RESIDUAL]),
    )
    heading.bar(which, np.degrees(residuals[:, 2]), width=0.5, color=palette.DIFFERENCE)
    _finish(
        heading,
        "heading residual [deg]",
        np.degrees([e.heading_residual, errors[1], PAPER_HEADING_RESIDUAL]),
    )
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
        axes.annotate(
            str(k + 1),
            points[-1] + 0.06 * away / np.linalg.norm(away),
            ha="center",
            va="center",
            fontsize=9,
            color=color,
            fontweight="bold",
        )
    scale = _magnification(residuals[:, :2])
    axes.quiver(
        *(tip[:, :2] - residuals[:, :2]).T,
        *(scale * residuals[:, :2]).T,
        angles="xy",
        scale_units="xy",
        scale=1.0,
        color=palette.DIFFERENCE,
        width=0.0035,
        zorder=3,
        label=f"position residual, {scale:g} times",
    )
    size = 0.15
    axes.fill(size * np.array([-1, 1, 1, -1]), size * np.array([-1, -1, 1, 1]),
              facecolor="0.9", edgecolor="0.4", zorder=0)  # fmt: skip
    for direction, name in (((1.0, 0.0), "x"), ((0.0, 1.0), "y")):
        axes.annotate(
            "",
            np.multiply(direction, 0.13),
            (0.0, 0.0),
            arrowprops={"arrowstyle": "->", "color": "0.2"},
        )
        axes.annotate(name, np.multiply(direction, 0.13), color="0.2", fontsize=9)
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
    for sign in (-1.0, 1.0):
        axes.axhline(
            sign * found,
            color="k",
            linestyle="--",
            linewidth=1.0,
            label=f"± standard deviation, {found:.3g}" if sign > 0 else None,
        )
        axes.axhline(
            sign * paper,
            color=palette.PREDICTED,
            linestyle=":",
            linewidth=1.3,
            label=f"± paper's, {paper:.3g}" if sign > 0 else None,
        )
    axes.set_ylabel(label)
    axes.grid(axis="y", alpha=0.25)
    top = 1.45 * max(abs(limit) for limit in axes.get_ylim())
    axes.set_ylim(-top, top)
    axes.legend(ncols=3, fontsize=8, loc="upper center")


def _magnification(residuals: Floats) -> float:
    """Return a round factor that scales the largest residual to at most 0.25 m.

    The factor is 1, 2 or 5 times a power of ten.
    """
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
