"""Figures of a dynamic calibration."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from fss_arm_calib.dynamic.solution import Solution
from fss_arm_calib.outcome import Outcome
from fss_arm_calib.report_figures import empty_figure
from fss_arm_calib.segments.maneuvers import Maneuver
from fss_arm_model.arrays import Floats
from fss_arm_model.base_motion import base_poses
from fss_arm_ros import palette

DRAWN_POSES = 100  # number of predicted poses drawn for a maneuver
MANEUVER_GAP = 2.0  # gap drawn between two maneuvers [s]
SCALES = (1e3, 1e3, float(np.degrees(1.0)))  # to mm, mm, deg
STYLES: tuple[dict[str, Any], ...] = (
    {"color": palette.PREDICTED, "linewidth": 1.5},
    {"color": palette.MEASURED, "markersize": 7, "zorder": 3},
)


def _edges(outcome: Outcome[Maneuver, Solution]) -> npt.NDArray[np.int64]:
    """Return the index of each maneuver's first row of residuals, and the number of rows."""
    return np.cumsum([0, *(len(one.marks) for one in outcome.used)])


def draw_motion(outcome: Outcome[Maneuver, Solution]) -> Any:
    """Plot the base's pose in each maneuver: measured at its marks, predicted throughout."""
    drawing = empty_figure((14, 9))
    axes = drawing.subplots(3, 1, sharex=True)
    begin, middles = 0.0, []
    for number, one, times, predicted in _predictions(outcome):
        measured = np.array(one.poses) - predicted[0]
        places = begin + times - times[0], begin + np.array(one.marks) - times[0]
        for column, axis in enumerate(axes):
            for k, style in enumerate(("-", ".")):
                poses = (predicted - predicted[0], measured)[k]
                axis.plot(places[k], SCALES[column] * poses[:, column], style, **STYLES[k])
            axis.axvline(places[0][-1] + 0.5 * MANEUVER_GAP, color="0.85", linewidth=0.8)
        middles.append((begin + 0.5 * np.ptp(times), str(number)))
        begin = places[0][-1] + MANEUVER_GAP
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
    vector, states = problem.vector(x), iter(problem.states(x))
    for number, (one, kept) in enumerate(
        zip(outcome.used, outcome.solution.kept, strict=True), start=1
    ):
        if kept:
            times = np.union1d(one.marks, np.linspace(one.marks[0], one.marks[-1], DRAWN_POSES))
            yield number, one, times, base_poses(vector, one.path_at(times), next(states))


def draw_residuals(outcome: Outcome[Maneuver, Solution]) -> Any:
    """Plot the residual of each pose, with the maneuvers side by side."""
    rows, edges = outcome.estimate.residuals, _edges(outcome)
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
