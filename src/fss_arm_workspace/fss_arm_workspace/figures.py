"""Figures 6, 7 and 8 of the paper, and their data."""

from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from fss_arm_model.arrays import Floats
from fss_arm_model.description_file import to_yaml
from fss_arm_model.kinematics import joint_positions
from fss_arm_model.momentum import system_com
from fss_arm_ros import palette
from fss_arm_workspace.analysis import Analysis
from fss_arm_workspace.manipulability.measure import FIXED, FLOATING, ellipsoid, jacobian, measure
from fss_arm_workspace.straight_path.paths import Paths
from fss_arm_workspace.straight_path.trace import REASONS

_REASON_COLORS = (palette.STATIC, palette.PREDICTED, palette.DANGER, palette.MEASURED)
_BASE_SIDE = 0.3  # side of the simulator as drawn [m]
_ELLIPSE_SCALE = 0.25  # scale of ellipsoids as drawn [m per m/rad]


def draw(
    analysis: Analysis, straight: Mapping[str, Paths], folder: str | PathLike[str]
) -> list[Path]:
    """Write figure_6 (if there are maps), figure_7 and figure_8 as PNG and SVG; return their paths.

    Raises:
        OSError: a file cannot be written.
    """
    # Imported here because only this function needs it, and the import takes a second.
    from matplotlib.figure import Figure

    written = []
    figures = [
        ("figure_6", (11.0, 5.2), _maps),
        ("figure_7", (8.0, 7.4), _straight),
        ("figure_8", (11.0, 4.0), _ellipsoids),
    ]
    for name, size, draw_figure in figures if analysis.maps else figures[1:]:
        figure = Figure(figsize=size, layout="constrained")
        draw_figure(figure, analysis, straight)
        for kind in ("png", "svg"):
            path = Path(folder) / f"{name}.{kind}"
            figure.savefig(path, dpi=150)
            written.append(path)
    return written


def save(analysis: Analysis, straight: Mapping[str, Paths], path: str | PathLike[str]) -> None:
    """Write all results as .npz; arrays of points are x, y [m].

    Raises:
        OSError: the file cannot be written.
    """
    a = analysis
    data: dict[str, Any] = {
        "arm": to_yaml(a.arm),
        "limits": a.limits,
        "radius": a.radius,
        "radius_deviation": a.radius_deviation,
        "reach": a.reach,
        "area": a.region.area,
    }
    for k, (points, deviation) in enumerate(a.boundary):
        data[f"boundary_{k}"] = _pairs(points)
        data[f"boundary_{k}_deviation"] = deviation
    for name, found in a.maps.items():
        data[f"largest_w_{name}"], data[f"largest_w_{name}_deviation"] = a.largest_w[name]
        data[f"map_{name}"], data[f"map_{name}_q"] = found.w, found.q
        data["map_corner"], data["map_cell"] = (found.grid.x, found.grid.y), found.grid.cell
    for name, paths in straight.items():
        key = f"straight_{name.replace(' ', '_')}"
        data[key] = _pairs(paths.ends)
        data[f"{key}_direction"], data[f"{key}_distance"] = paths.direction, paths.distance
        data[f"{key}_reason"] = np.array(REASONS)[paths.reason]
        data["start"] = paths.start
        data[f"{key}_last"], data[f"{key}_grazes"] = paths.last, paths.grazes
    np.savez_compressed(path, **data)


def _pairs(points: Any) -> Floats:
    return np.stack([points.real, points.imag], axis=-1)


def _maps(figure: Any, a: Analysis, straight: Mapping[str, Paths]) -> None:
    """Draw Figure 6: fixed vehicle workspace and largest manipulability, on both kinds of base."""
    from matplotlib.colors import PowerNorm

    panels = figure.subplots(1, 2)
    largest = max(float(np.nanmax(found.w)) for found in a.maps.values())  # one scale for both
    norm = PowerNorm(0.5, 0.0, largest)
    for axes, (name, found) in zip(panels, a.maps.items(), strict=True):
        grid = found.grid
        extent = (grid.x, grid.x + grid.width * grid.cell, grid.y, grid.y + grid.height * grid.cell)
        image = axes.imshow(found.w, origin="lower", extent=extent, norm=norm)
        for points, _ in a.boundary:
            closed = np.append(points, points[:1])
            axes.plot(closed.real, closed.imag, "k-", linewidth=1.2)
        _arm(axes, a, np.concatenate([np.zeros(3), straight["fixed"].start[3:]]))
        axes.set_title(f"{name} base: largest w of all postures", fontsize=10)
        axes.margins(0.02)
        axes.autoscale()
        _frame(axes, "base's frame")
    figure.colorbar(image, ax=panels, label="w = sqrt(det(J Jᵀ)) [m²]", shrink=0.85)
    worst = max(float(deviation.max(initial=0.0)) for _, deviation in a.boundary)
    known = f", boundary known to {1e3 * worst:.1f} mm (1 sigma)" if worst > 0.0 else ""
    figure.suptitle(f"Fixed vehicle workspace, {a.region.area:.3f} m²{known}", fontsize=11)


def _straight(figure: Any, a: Analysis, straight: Mapping[str, Paths]) -> None:
    """Draw Figure 7: straight-path workspace, with the reason why each path ends."""
    axes = figure.subplots()
    styles = {"fixed": "k--", "floating": "k-", "zero reaction": "k:"}
    for base, paths in straight.items():
        ends = np.append(paths.ends, paths.ends[:1])
        label = f"{base}{' base' if base != 'zero reaction' else ''}: {paths.area:.3f} m²"
        axes.plot(ends.real, ends.imag, styles[base], linewidth=1.2, label=label)
    floating = straight["floating"]
    axes.fill(floating.ends.real, floating.ends.imag, color=palette.MEASURED, alpha=0.12)
    for number, (reason, color) in enumerate(zip(REASONS, _REASON_COLORS, strict=True)):
        ends = floating.ends[floating.reason == number]
        if ends.size:
            axes.plot(ends.real, ends.imag, ".", color=color, markersize=4, label=f"ends: {reason}")
    com = system_com(a.arm.vector(), floating.start)
    turn = np.linspace(0.0, 2.0 * np.pi, 200)
    axes.plot(
        com[0] + a.radius * np.cos(turn),
        com[1] + a.radius * np.sin(turn),
        color=palette.TIP,
        linewidth=1.0,
        label=f"maximum reachable: R = {a.radius:.3f} m",
    )
    axes.plot(*com, "+", color=palette.TIP, markersize=10)
    _arm(axes, a, floating.start)
    axes.legend(fontsize=8, loc="lower left")
    axes.set_title(f"Straight-path workspace, rule: {floating.redundancy}", fontsize=11)
    _frame(axes, "world")


def _ellipsoids(figure: Any, a: Analysis, straight: Mapping[str, Paths]) -> None:
    """Draw Figure 8: manipulability ellipsoids on a fixed and on a floating base."""
    n = a.arm.n
    bent = np.full((3, n), [[0.35], [0.8], [1.2]]).clip(a.limits[:, 0], a.limits[:, 1])
    bent[:, 0] = (-0.5 * bent[:, 0] * (n - 1)).clip(*a.limits[0])
    turn = np.linspace(0.0, 2.0 * np.pi, 100)
    circle = np.stack([np.cos(turn), np.sin(turn)])
    for axes, q in zip(figure.subplots(1, 3), bent, strict=True):
        state = np.concatenate([np.zeros(3), q])
        _arm(axes, a, state)
        tip = joint_positions(a.arm.vector(), state)[-1]
        for kind, color, name in (
            (FIXED, palette.STATIC, "fixed"),
            (FLOATING, palette.TIP, "floating"),
        ):
            radii, directions = ellipsoid(jacobian(a.arm, q, kind))
            line = tip[:, None] + _ELLIPSE_SCALE * directions.T @ (
                radii[:, None] * circle[: len(radii)]
            )
            label = f"{name}: w = {float(measure(a.arm, q, kind)):.3f} m²"
            axes.plot(*line, color=color, label=label)
        detail = axes.inset_axes((0.66, 0.02, 0.32, 0.3), xticks=[], yticks=[])
        detail.plot(*line, color=color)  # on a floating base the ellipsoid is smaller
        detail.plot(*tip, "k.", markersize=3)
        detail.set_aspect("equal", adjustable="datalim")
        detail.set_title("floating, enlarged", fontsize=7, pad=2)
        reach = 1.15 * float(sum(link.a for link in a.arm.links))
        axes.set_xlim(-0.3, a.arm.base.mount[0] + reach)
        axes.set_ylim(-0.6 * reach, 0.6 * reach)
        axes.legend(fontsize=8, loc="upper left")
        axes.set_title("q = " + ", ".join(f"{x:.0f}°" for x in np.degrees(q)), fontsize=9)
        _frame(axes, "base's frame")
    figure.suptitle(
        f"Manipulability ellipsoids, drawn at {_ELLIPSE_SCALE:g} m per m/rad", fontsize=11
    )


def _arm(axes: Any, a: Analysis, state: Floats) -> None:
    """Draw base, links and tip."""
    joints = joint_positions(a.arm.vector(), state)
    turn = complex(np.cos(state[2]), np.sin(state[2]))
    corners = 0.5 * _BASE_SIDE * np.array([1 + 1j, -1 + 1j, -1 - 1j, 1 - 1j, 1 + 1j]) * turn
    corners += complex(state[0], state[1])
    axes.plot(corners.real, corners.imag, color=palette.STATIC, linewidth=1.0)
    axes.plot(joints[:, 0], joints[:, 1], "-", color=palette.STATIC, linewidth=2.0)
    axes.plot(joints[:-1, 0], joints[:-1, 1], "o", color="white", markeredgecolor=palette.STATIC)
    axes.plot(*joints[-1], "k.", markersize=5)


def _frame(axes: Any, frame: str) -> None:
    axes.set_aspect("equal")
    axes.set_xlabel(f"x [m], {frame}")
    axes.set_ylabel("y [m]")
    axes.grid(alpha=0.2)
