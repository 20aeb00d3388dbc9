"""Draw a plan: postures on the table, joints, shares of their limits, and the base."""

from os import PathLike
from typing import Any

import numpy as np

from fss_arm_model.arrays import Floats
from fss_arm_model.kinematics import joint_positions
from fss_arm_motion.limits import KINDS
from fss_arm_motion.plan import Plan, PlanError, Start, predicted, probed
from fss_arm_motion.point_to_point import MIN_DISTANCE, straight
from fss_arm_motion.tip_path import TipPath, way_of
from fss_arm_ros import palette

STROBES = 9
JOINTS, SHARES = palette.LINKS, palette.LINKS[3:6]
BASE, MOVE, WAY = palette.PREDICTED, palette.STATIC, palette.TIP


def draw(start: Start, plan: Plan, path: str | PathLike[str]) -> None:
    """Write the figure; the suffix of the file name determines its format.

    Raises:
        OSError: it cannot be written.
        ValueError: this format is not supported.
    """
    # Imported here because it takes a second, and nothing else needs it.
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.5, 6.4), layout="constrained")
    grid = figure.add_gridspec(3, 2, width_ratios=(1.15, 1.0), height_ratios=(1.1, 1.0, 1.1))
    table = figure.add_subplot(grid[:, 0])
    joints = figure.add_subplot(grid[0, 1])
    shares = figure.add_subplot(grid[1, 1], sharex=joints)
    heading = figure.add_subplot(grid[2, 1], sharex=joints)
    _strobes(figure, table, start, plan)
    _joints(joints, plan)
    _shares(shares, start, plan)
    _heading(heading, start, plan)
    for axes in (table, joints, shares, heading):
        axes.grid(color="0.92", linewidth=0.8)
        axes.set_axisbelow(True)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
    for axes in (joints, shares):
        axes.tick_params(labelbottom=False)
    heading.set_xlabel("time [s]")
    figure.suptitle(title(plan), fontsize=11.5, x=0.012, ha="left")
    figure.savefig(path, dpi=120)


def title(plan: Plan) -> str:
    """Return a summary of the plan."""
    turn = plan.prediction
    words = f"{plan.kind.replace('_', ' ')}: {plan.duration:.2f} s, {len(plan.times)} knots, "
    words += f"base turns by {_angle(turn.turn)}, {_angle(turn.excursion)} at most on the way"
    return f"{words}\n{plan.ended}" if plan.ended else words


def _angle(x: float) -> str:
    """Return an angle in degrees, with suitable precision."""
    deg = float(np.degrees(x))
    return f"{deg:.1f}°" if abs(deg) >= 1.0 else f"{deg:.3f}°".replace("-0.000", "0.000")


def _strobes(figure: Any, axes: Any, start: Start, plan: Plan) -> None:
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import ListedColormap, Normalize

    colors = ListedColormap(colormaps["viridis_r"](np.linspace(0.15, 1.0, 256)))
    p = start.arm.vector()
    marks = plan.prediction.times
    q = plan.at(marks)[0]
    places = joint_positions(p, np.concatenate([plan.prediction.pose, q], axis=1))
    axes.plot(*places[:, -1].T, color=WAY, linewidth=1.6, zorder=3, label="end effector")
    for k in np.linspace(0, len(marks) - 1, STROBES).astype(int):
        color = colors(marks[k] / marks[-1])
        ends = k in (0, len(marks) - 1)
        _arm(axes, plan.prediction.pose[k], places[k], color, 1.0 if ends else 0.55, start)
    if plan.kind == "tip_path" and plan.arguments["frame"] == "world":
        way = way_of(start, TipPath(**{**plan.arguments, **_tuples(plan)}))
        line = way.curve(np.linspace(0.0, 1.0, 200))
        axes.plot(line[:, 0], line[:, 1], "k:", linewidth=1.2, zorder=4, label="asked for")
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.06)
    axes.set_xlabel("x [m], world")
    axes.set_ylabel("y [m]")
    axes.legend(loc="upper left", fontsize=9, frameon=False)
    bar = figure.colorbar(
        ScalarMappable(Normalize(0.0, plan.duration), colors),
        ax=axes,
        location="bottom",
        shrink=0.6,
        aspect=40,
        pad=0.02,
    )
    bar.set_label("time [s]")
    bar.outline.set_visible(False)


def _tuples(plan: Plan) -> dict[str, Any]:
    return {k: tuple(v) for k, v in plan.arguments.items() if isinstance(v, list)}


def _arm(axes: Any, pose: Floats, places: Floats, color: Any, alpha: float, start: Start) -> None:
    from matplotlib.patches import Circle

    radius = start.limits.radii[0]
    axes.add_patch(
        Circle(
            (pose[0], pose[1]),
            radius,
            facecolor="none",
            edgecolor=color,
            alpha=alpha,
            linewidth=1.3,
        )
    )
    nose = pose[:2] + radius * np.array([np.cos(pose[2]), np.sin(pose[2])])
    axes.plot(*np.array([pose[:2], nose]).T, color=color, alpha=alpha, linewidth=1.3)
    axes.plot(*places.T, color=color, alpha=alpha, linewidth=2.6, solid_capstyle="round")
    axes.plot(*places[:-1].T, "o", color="white", markeredgecolor=color, alpha=alpha, markersize=4)


def _joints(axes: Any, plan: Plan) -> None:
    t = np.linspace(0.0, plan.duration, 400)
    q = np.degrees(plan.at(t)[0])
    for i in range(q.shape[1]):
        color = JOINTS[i % len(JOINTS)]
        axes.plot(t, q[:, i], color=color, linewidth=1.6, label=f"{i + 1}")
        axes.plot(plan.times, np.degrees(plan.q[:, i]), "o", color=color, markersize=3)
    axes.set_ylabel("joints [deg]")
    _legend(axes, q.shape[1])


def _shares(axes: Any, start: Start, plan: Plan) -> None:
    angles, rates, gains = probed(plan.times, plan.q, plan.qd)
    used = start.limits.used(start.arm.vector(), angles, rates, gains, start.L).max(axis=-1)
    h, x = np.diff(plan.times), np.linspace(0.0, 1.0, len(used) // (len(plan.times) - 1))
    t = (plan.times[:-1, None] + h[:, None] * x).ravel()
    for k, (name, _) in enumerate(KINDS):
        axes.plot(t, 100.0 * used[:, k], color=SHARES[k], linewidth=1.3, label=name)
    axes.axhline(100.0, color="0.4", linewidth=0.8, linestyle="--")
    axes.set_ylim(0.0, 112.0)
    axes.set_ylabel("of what plans\nmay use [%]")
    _legend(axes, len(KINDS))


def _heading(axes: Any, start: Start, plan: Plan) -> None:
    base = plan.prediction
    turn = np.degrees(base.pose[:, 2] - base.pose[0, 2])
    sigma = np.degrees(base.deviation[:, 2])
    if sigma.any():
        axes.fill_between(
            base.times,
            turn - sigma,
            turn + sigma,
            color=BASE,
            alpha=0.15,
            linewidth=0,
            label="± 1 sigma",
        )
    axes.plot(base.times, turn, color=BASE, linewidth=1.6, label="this motion")
    if np.abs(plan.q[-1] - plan.q[0]).max() > MIN_DISTANCE:
        try:
            h, q, qd = straight(start, [plan.q[0], plan.q[-1]], 6)
            move = predicted(start, np.append(0.0, np.cumsum(h)), q, qd)
            move_turn = np.degrees(move.pose[:, 2] - move.pose[0, 2])
            axes.plot(
                move.times * plan.duration / move.times[-1],
                move_turn,
                color=MOVE,
                linewidth=1.3,
                linestyle="--",
                label="straight move between the same postures",
            )
        except PlanError:  # no straight move to compare with
            pass
    axes.set_ylabel("base [deg]")
    _legend(axes, 3)


def _legend(axes: Any, columns: int) -> None:
    """Draw the legend above the axes, where there are no lines."""
    axes.legend(
        ncols=columns,
        fontsize=8.5,
        frameon=False,
        loc="lower right",
        bbox_to_anchor=(1.0, 0.98),
        borderpad=0.1,
        handlelength=1.6,
        columnspacing=1.4,
    )
