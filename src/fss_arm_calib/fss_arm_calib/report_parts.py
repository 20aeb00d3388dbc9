"""Parts that reports of every kind of calibration have."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from fss_arm_calib.estimation.least_squares import Floats
from fss_arm_calib.report import Table


def origin(c: Any) -> str:
    """Where a result is from, in words."""
    p = c.provenance
    return f"by {p.software} from {p.source}; SHA-256 of what was solved from {p.data_hash}"


def stages(c: Any) -> Table:
    """What the verdict is made of."""
    rows = [
        [s.name, s.verdict.replace("_", " "), s.reason, text(s.value, ".4g"), f"{s.threshold:.4g}"]
        for s in c.stages
    ]
    head = ["stage", "verdict", "reason", "value", "threshold"]
    return Table("What the verdict is made of", head, rows, words=3)


def streams(c: Any) -> Table:
    """Samples that were refused, by stream and reason, and the offset between the clocks."""
    rows: list[Sequence[str]] = [
        [kind, str(number)] for kind, number in zip(c.refused_kinds, c.refused, strict=True)
    ]
    if np.isfinite(c.time_offset):
        offset = f"{1e3 * c.time_offset:.2f} ± {1e3 * c.time_offset_deviation:.2f} ms"
        rows.append(["joints' stamps less motion capture's", offset])
    rows = rows or [["nothing to tell", ""]]
    return Table("Samples refused, and the clocks", ["what", ""], rows)


def correlation(covariance: Floats, labels: Sequence[str]) -> Any:
    """Drawing of the correlation matrix of estimated parameters; blank where there is none."""
    deviations = np.sqrt(np.diag(covariance))
    with np.errstate(divide="ignore", invalid="ignore"):
        matrix = covariance / np.outer(deviations, deviations)
    drawing = figure((0.62 * len(matrix) + 2.5, 0.55 * len(matrix) + 1.5))
    axes = drawing.subplots()
    image = axes.imshow(matrix, cmap="RdBu_r", vmin=-1.0, vmax=1.0)
    for (row, column), value in np.ndenumerate(matrix):
        color = "white" if abs(value) > 0.6 else "0.2"
        words = text(value, "+.2f")
        axes.text(column, row, words, ha="center", va="center", fontsize=8, color=color)
    axes.set_xticks(range(len(labels)), labels, rotation=45, ha="right")
    axes.set_yticks(range(len(labels)), labels)
    drawing.colorbar(image, shrink=0.8)
    return drawing


def influence(c: Any, lengths: Any, label: str) -> Any:
    """Drawing of what is off over leverage: on what much depends."""
    drawing = figure((10, 4.5))
    axes = drawing.subplots()
    kept = np.asarray(c.weights) > 0.0
    lengths, leverage = np.asarray(lengths), np.asarray(c.leverage)
    for chosen, color, words in ((kept, "tab:blue", "used"), (~kept, "tab:red", "rejected")):
        if chosen.any():
            axes.plot(leverage[chosen], lengths[chosen], "o", color=color, label=words)
    for k, place in enumerate(zip(leverage, lengths, strict=True)):
        axes.annotate(str(k + 1), place, (5, 4), textcoords="offset points", fontsize=9)
    for stage in c.stages:
        if stage.name == "outliers":
            axes.axhline(stage.threshold, color="tab:red", linestyle="--", linewidth=1.0,
                         label="outliers above")  # fmt: skip
    mean = float(np.sum(leverage)) / max(int(np.sum(kept)), 1)
    axes.axvline(mean, color="0.5", linestyle=":", label=f"mean leverage, {mean:.2f}")
    axes.set_xlim(0.0, 1.15 * max(float(leverage.max()), mean))
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("leverage")
    axes.set_ylabel(label)
    axes.grid(alpha=0.25)
    axes.legend(fontsize=9)
    return drawing


def figure(size: tuple[float, float]) -> Any:
    """An empty drawing of a size [inches]."""
    from matplotlib.figure import Figure  # takes long to import, and only people need it

    return Figure(figsize=size, layout="constrained")


def shown_unit(unit: str) -> str:
    """The unit that people read."""
    return "deg" if unit == "rad" else unit


def number(value: float, unit: str) -> str:
    """A value in the unit that people read."""
    if unit == "rad":
        return text(np.degrees(value), ".3f")
    return text(value, ".6f" if unit == "m/s^2" else ".4f")  # a table's tilt is small


def difference(value: float, true: float, unit: str) -> float:
    """Their difference, angles wrapped."""
    return float((value - true + np.pi) % (2 * np.pi) - np.pi if unit == "rad" else value - true)


def text(value: float, form: str) -> str:
    """A number, `-` if it is none."""
    return f"{value:{form}}" if np.isfinite(value) else "-"
