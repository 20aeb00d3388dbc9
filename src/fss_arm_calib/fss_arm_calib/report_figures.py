"""Drawings shared by the reports of several kinds of calibration."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from fss_arm_calib.outcome import Outcome
from fss_arm_calib.report import Figure
from fss_arm_calib.report_tables import format_number
from fss_arm_model.arrays import Floats
from fss_arm_ros import palette


def common_figures(
    outcome: Outcome[Any, Any], kind: str, noun: str, label: str, names: Sequence[str] = ()
) -> tuple[Figure, Figure]:
    """Return the figures of all kinds: the influence of each datum, and the correlation matrix.

    Args:
        outcome: the outcome.
        kind: kind of calibration.
        noun: name of a datum.
        label: name of its error.
        names: names of the parameters to show, by default their own.
    """
    o = outcome
    return (
        Figure(f"{kind}_{noun}s", f"Each {noun}", lambda: draw_influence(o, label)),
        Figure(
            f"{kind}_correlation",
            "Correlation of the parameters",
            lambda: draw_correlation(o.covariance, names or o.names),
        ),
    )


def draw_correlation(covariance: Floats, labels: Sequence[str]) -> Any:
    """Draw the correlation matrix of the estimated parameters; cells are blank if not known."""
    deviations = np.sqrt(np.diag(covariance))
    with np.errstate(divide="ignore", invalid="ignore"):
        matrix = covariance / np.outer(deviations, deviations)
    drawing = empty_figure((0.62 * len(matrix) + 2.5, 0.55 * len(matrix) + 1.5))
    axes = drawing.subplots()
    image = axes.imshow(matrix, cmap="RdBu_r", vmin=-1.0, vmax=1.0)
    for (row, column), value in np.ndenumerate(matrix):
        color = "white" if abs(value) > 0.6 else "0.2"
        words = format_number(value, "+.2f")
        axes.text(column, row, words, ha="center", va="center", fontsize=8, color=color)
    axes.set_xticks(range(len(labels)), labels, rotation=45, ha="right")
    axes.set_yticks(range(len(labels)), labels)
    drawing.colorbar(image, shrink=0.8)
    return drawing


def draw_influence(outcome: Outcome[Any, Any], label: str) -> Any:
    """Draw the error of each datum over its leverage, i.e. its influence on the estimate."""
    drawing = empty_figure((10, 4.5))
    axes = drawing.subplots()
    e = outcome.estimate
    kept, leverage = e.weights > 0.0, e.leverage
    for chosen, color, words in (
        (kept, palette.MEASURED, "used"),
        (~kept, palette.DANGER, "rejected"),
    ):
        if chosen.any():
            axes.plot(leverage[chosen], e.errors[chosen], "o", color=color, label=words)
    for k, place in enumerate(zip(leverage, e.errors, strict=True)):
        axes.annotate(str(k + 1), place, (5, 4), textcoords="offset points", fontsize=9)
    for check in outcome.checks:
        if check.name == "outliers":
            axes.axhline(
                check.threshold,
                color=palette.DANGER,
                linestyle="--",
                linewidth=1.0,
                label="outliers above",
            )
    mean = float(np.sum(leverage)) / max(int(np.sum(kept)), 1)
    axes.axvline(mean, color="0.5", linestyle=":", label=f"mean leverage, {mean:.2f}")
    axes.set_xlim(0.0, 1.15 * max(float(leverage.max()), mean))
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("leverage")
    axes.set_ylabel(label)
    axes.grid(alpha=0.25)
    axes.legend(fontsize=9)
    return drawing


def empty_figure(size: tuple[float, float]) -> Any:
    """Return an empty drawing of a size [inches]."""
    from matplotlib.figure import Figure  # slow to import, and needed only for reports

    return Figure(figsize=size, layout="constrained")
