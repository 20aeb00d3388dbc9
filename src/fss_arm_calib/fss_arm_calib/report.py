"""A calibration for people: a table, and a drawing of residuals and postures.

Both take a Calibration or a KinematicCalibration message alike, by attribute.
"""

from math import floor, log10
from os import PathLike
from typing import Any

import numpy as np
from rich.console import Console, Group
from rich.table import Table
from rich.text import Text

from fss_arm_model.description import Arm, kinematic_index, kinematic_names, paper_arm

from .kinematic import Floats

PAPER_POSITION_RESIDUAL = 0.015  # [m], section 4.1
PAPER_HEADING_RESIDUAL = float(np.radians(0.683))

_STYLE = {"pass": "bold green", "fail": "bold red", "not_evaluated": "bold yellow"}


def console() -> Console:
    """Where to print a table: wide enough for it if it is not a terminal."""
    terminal = Console()
    return terminal if terminal.is_terminal else Console(width=110)


def table(calibration: Any, truth: Arm | None = None) -> Group:
    """Parameters beside the paper's Tables 2-3 and, if known, the truth; residuals; the verdict.

    Args:
        calibration: a Calibration or a KinematicCalibration message.
        truth: the simulated arm.

    Returns:
        Something that rich prints.
    """
    c, n = calibration, _links(calibration)
    values, initial = np.asarray(c.values), np.asarray(c.initial)
    p = len(c.names)
    covariance = np.reshape(c.covariance, (p, p)) if len(c.covariance) else np.full((p, p), np.nan)
    deviations = np.sqrt(np.diag(covariance))
    paper = _parameters(paper_arm(), c.names) if n == paper_arm().n else np.full(p, np.nan)
    true = np.full(p, np.nan) if truth is None else _parameters(truth, c.names)

    parameters = Table(title=f"Kinematic calibration of {c.arm!r}", title_justify="left")
    parameters.add_column("parameter")
    parameters.add_column("unit")
    for name in ("Tables 2-3", "guess", *["truth"] * (truth is not None), "estimate", "± 1 sigma"):
        parameters.add_column(name, justify="right", style="bold" if name == "estimate" else "")
    if truth is not None:
        parameters.add_column("error / sigma", justify="right")
    for k, (name, unit) in enumerate(zip(c.names, c.units, strict=True)):
        columns = [paper, initial, *[true] * (truth is not None), values, deviations]
        row = [_number(column[k], unit) for column in columns]
        if truth is not None:
            row.append(_text(_difference(values[k], true[k], unit) / deviations[k], "+.2f"))
        parameters.add_row(_label(name, n), "deg" if unit == "rad" else unit, *row)

    residuals = Table(title="Standard deviation of the residuals", title_justify="left")
    for name in ("of the end effector's", "unit", "paper", "here", "assumed"):
        residuals.add_column(name, justify="left" if name[0] in "ou" else "right")
    for name, unit, *numbers in (
        ("position", "m", PAPER_POSITION_RESIDUAL, c.position_residual, c.position_deviation),
        ("heading", "rad", PAPER_HEADING_RESIDUAL, c.heading_residual, c.heading_deviation),
    ):
        row = [_number(number, unit) for number in numbers]
        residuals.add_row(name, "deg" if unit == "rad" else unit, *row)

    verdict = Text.assemble((c.verdict.replace("_", " "), _STYLE[c.verdict]), f": {c.reason}")
    origin = Text(f"by {c.provenance.software} from {c.provenance.source}", style="dim")
    return Group(parameters, residuals, verdict, origin)


def plot(calibration: Any, path: str | PathLike[str]) -> None:
    """Draw the arm at the observed postures with magnified residuals, and the residuals, as PNG.

    Raises:
        ValueError: there is no solution to draw.
        OSError: the file cannot be written.
    """
    from matplotlib.figure import Figure  # takes long to import, and only people need it

    c, n = calibration, _links(calibration)
    if not len(c.residuals):
        raise ValueError(f"no residuals to draw: {c.reason}")
    q, tip = np.reshape(c.q, (-1, n)), np.reshape(c.tip, (-1, 3))
    residuals = np.reshape(c.residuals, (-1, 3))
    figure = Figure(figsize=(14, 8), layout="constrained")
    axes: Any = figure.subplot_mosaic(
        [["arm", "x y"], ["arm", "heading"]], width_ratios=(1.25, 1.0)
    )
    position, heading = axes["x y"], axes["heading"]
    figure.suptitle(
        f"Kinematic calibration: {c.verdict.replace('_', ' ')}, {len(q)} observations",
        fontsize=14,
        fontweight="bold",
    )
    _draw_postures(axes["arm"], _joints(c, q), tip, residuals)
    number = np.arange(1, len(q) + 1)
    for k, (name, color) in enumerate((("x", "tab:blue"), ("y", "tab:orange"))):
        bars = number + 0.18 * (2 * k - 1)
        position.bar(bars, 1e3 * residuals[:, k], width=0.34, color=color, label=name)
    _finish(position, "position residual [mm]", 1e3 * np.array([
        c.position_residual, c.position_deviation, PAPER_POSITION_RESIDUAL]))  # fmt: skip
    heading.bar(number, np.degrees(residuals[:, 2]), width=0.5, color="tab:green")
    _finish(heading, "heading residual [deg]", np.degrees([
        c.heading_residual, c.heading_deviation, PAPER_HEADING_RESIDUAL]))  # fmt: skip
    heading.set_xlabel("observation")
    for part in (position, heading):
        part.set_xticks(number[:: max(1, len(number) // 20)])
    figure.savefig(path, format="png", dpi=110)


def _draw_postures(axes: Any, joints: Floats, tip: Floats, residuals: Floats) -> None:
    """The arm in the base's frame, (s, n + 1, 2), and residuals as arrows at its end."""
    from matplotlib import colormaps

    colors = colormaps["viridis"](np.linspace(0.0, 0.9, len(joints)))
    for k, (points, color) in enumerate(zip(joints, colors, strict=True)):
        axes.plot(*points.T, "-", color=color, linewidth=2.0, alpha=0.45, zorder=1)
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
    largest = float(np.max(np.linalg.norm(residuals, axis=1)))
    if largest == 0.0:
        return 1.0
    power = floor(log10(0.25 / largest))
    return max(m * 10.0**power for m in (1, 2, 5) if m * 10.0**power <= 0.25 / largest)


def _joints(calibration: Any, q: Floats) -> Floats:
    """Joints and end effector in the base's frame, (s, n + 1, 2)."""
    n = q.shape[1]
    v = dict(zip(calibration.names, np.asarray(calibration.values), strict=True))
    lengths = np.array([v.get(f"a_{i}", v.get("a")) for i in range(1, n + 1)], dtype=float)
    offsets = np.array([v.get(f"theta_0_{i}", v["theta_BJ1"]) for i in range(1, n + 1)])
    headings = np.cumsum(q + offsets, axis=1)
    links = lengths[:, None] * np.stack([np.cos(headings), np.sin(headings)], axis=-1)
    mount = np.broadcast_to([v["x_BJ1"], v["y_BJ1"]], (len(q), 1, 2))
    return np.concatenate([mount, mount + np.cumsum(links, axis=1)], axis=1)


def _links(calibration: Any) -> int:
    return sum(name.startswith("theta") for name in calibration.names)


def _parameters(arm: Arm, names: Any) -> Floats:
    """An arm's values of the named parameters; NaN for those it does not have."""
    values = arm.vector()[kinematic_index(arm.n)]
    known = dict(zip(kinematic_names(arm.n), values, strict=True))
    known["a"] = float(np.mean(values[: max(arm.n - 1, 1)]))
    return np.array([known.get(name, np.nan) for name in names])


def _label(name: str, n: int) -> str:
    return f"a_1 .. a_{n - 1}" if name == "a" else name


def _difference(value: float, true: float, unit: str) -> float:
    return float((value - true + np.pi) % (2 * np.pi) - np.pi if unit == "rad" else value - true)


def _number(value: float, unit: str) -> str:
    return _text(np.degrees(value), ".3f") if unit == "rad" else _text(value, ".4f")


def _text(value: float, form: str) -> str:
    return f"{value:{form}}" if np.isfinite(value) else "-"
