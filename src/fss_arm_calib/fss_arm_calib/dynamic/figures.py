"""Drawings of a dynamic calibration."""

from typing import Any

import numpy as np
import numpy.typing as npt

from fss_arm_calib.dynamic.solution import Solution
from fss_arm_calib.estimation.least_squares import Floats
from fss_arm_calib.outcome import Outcome
from fss_arm_calib.report_figures import figure
from fss_arm_calib.segments.maneuvers import Maneuver


def _edges(outcome: Outcome[Maneuver, Solution]) -> npt.NDArray[np.int64]:
    """Where each maneuver's rows of residuals begin, and the end."""
    return np.cumsum([0, *(len(one.marks) for one in outcome.used)])


def _by_maneuver(outcome: Outcome[Maneuver, Solution]) -> list[Floats]:
    """Residuals of each maneuver, (m, 3)."""
    return np.split(outcome.estimate.residuals, _edges(outcome)[1:-1])


def motion(outcome: Outcome[Maneuver, Solution]) -> Any:
    """How far each maneuver moved the base, from its first pose to its last."""
    measured, predicted = [], []
    for one, residual in zip(outcome.used, _by_maneuver(outcome), strict=True):
        poses = np.array(one.poses)
        measured.append(poses[-1] - poses[0])
        predicted.append(measured[-1] - (residual[-1] - residual[0]))
    seen, expected = np.array(measured), np.array(predicted)
    drawing = figure((14, 5))
    for axes, column, label, scale in zip(
        drawing.subplots(1, 3), (0, 1, 2), ("x [mm]", "y [mm]", "heading [deg]"),
        (1e3, 1e3, np.degrees(1.0)), strict=True,
    ):  # fmt: skip
        ends = scale * np.array([min(seen[:, column].min(), 0.0), max(seen[:, column].max(), 0.0)])
        axes.plot(ends, ends, "-", color="0.6", linewidth=1.0)
        axes.plot(scale * expected[:, column], scale * seen[:, column], "o", markersize=5)
        for k, place in enumerate(
            zip(scale * expected[:, column], scale * seen[:, column], strict=True)
        ):
            if np.isfinite(place).all():
                axes.annotate(str(k + 1), place, (5, 3), textcoords="offset points", fontsize=8)
        axes.set_title(f"change of {label.split()[0]}", fontsize=11)
        axes.set_xlabel(f"predicted {label}")
        axes.set_ylabel(f"measured {label}")
        axes.grid(alpha=0.25)
    return drawing


def residuals(outcome: Outcome[Maneuver, Solution]) -> Any:
    """Of each pose of each maneuver, maneuvers side by side."""
    rows, edges = outcome.estimate.residuals, _edges(outcome)
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
