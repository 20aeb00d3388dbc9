"""Figure of a rehearsed capture: the mission from above, and its time histories."""

from typing import Any

import numpy as np

from fss_arm_model.description import Arm
from fss_arm_model.kinematics import joint_positions
from fss_arm_ros import palette
from fss_rehearsal.capture_flight import TARGET, Flight


def plot(arm: Arm, flight: Flight) -> Any:
    """Draw the mission from above, and momentum and motion over time."""
    from matplotlib.figure import Figure as Drawing

    figure = Drawing(figsize=(13.0, 9.0), layout="constrained")
    grid = figure.add_gridspec(4, 2, width_ratios=(1.5, 1.0))
    above = figure.add_subplot(grid[:, 0])
    above.set(xlim=(-2, 2), ylim=(-2, 2), aspect="equal", xlabel="x [m]", ylabel="y [m]")
    above.set_title("from above; pale: start, medium: capture, dark: end")
    k = int(np.argmax(flight.holds)) if flight.holds.any() else len(flight.time) - 1
    for i, shade in ((0, 0.35), (k, 0.65), (len(flight.time) - 1, 1.0)):
        draw_scene(above, arm, flight.q[i], flight.target[i], shade)
    above.plot(
        *flight.planned[:, :2].T, color=palette.PREDICTED, lw=3, alpha=0.4, label="base, planned"
    )
    above.plot(*flight.q[:, :2].T, color=palette.MEASURED, ls=":", lw=1, label="base")
    above.plot(*flight.target[:, :2].T, color=palette.TARGET, ls=":", lw=1, label="target")
    above.legend(loc="upper left")
    panels: tuple[tuple[str, list[tuple[str, Any]]], ...] = (
        (
            "rotation rate\n[deg/s]",
            [
                ("base", np.degrees(flight.qd[:, 2])),
                ("target", np.degrees(flight.target_twist[:, 2])),
            ],
        ),
        (
            "joint angle\n[deg]",
            [(f"joint {j}", np.degrees(flight.q[:, 2 + j])) for j in range(1, arm.n + 1)],
        ),
        (
            "momentum about\nthe origin [N m s]",
            [
                ("all bodies", flight.momentum[:, 2]),
                ("initial, and\nby thrusters", flight.momentum[0, 2] + flight.impulse[:, 2]),
            ],
        ),
    )
    for row, (quantity, lines) in enumerate(panels):
        panel = figure.add_subplot(grid[row, 1])
        for name, values in lines:
            panel.plot(flight.time, values, lw=1, label=name)
        panel.set(xlim=flight.time[[0, -1]], xlabel="time [s]", ylabel=quantity)
        panel.legend(fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
        panel.grid(alpha=0.25)
    starts = [since for since, _ in flight.phases]
    ends = [*starts[1:], flight.time[-1]]
    panel = figure.add_subplot(grid[3, 1])
    for (since, phase), end in zip(flight.phases, ends, strict=True):
        panel.barh(phase, end - since, left=since, color=palette.STATIC)
    panel.invert_yaxis()
    panel.tick_params(axis="y", labelsize=8)
    panel.set(xlim=flight.time[[0, -1]], xlabel="time [s]", ylabel="phase")
    return figure


def draw_scene(axes: Any, arm: Arm, q: np.ndarray, target: np.ndarray, shade: float) -> None:
    """Draw base, arm and target at one time."""
    square = 0.135 * np.array([1 + 1j, -1 + 1j, -1 - 1j, 1 - 1j, 1 + 1j])
    for (x, y, heading), colour in ((q[:3], palette.MEASURED), (target, palette.TARGET)):
        corners = complex(x, y) + square * np.exp(1j * heading)
        axes.plot(corners.real, corners.imag, color=colour, alpha=shade)
    fixture = complex(*target[:2]) + complex(*TARGET.fixture[:2]) * np.exp(1j * target[2])
    pin = [target[0], fixture.real], [target[1], fixture.imag]
    axes.plot(*pin, color=palette.TARGET, lw=1, alpha=shade)
    joints = joint_positions(arm.vector(), q)
    axes.plot(*joints.T, "o-", color=palette.MEASURED, ms=4, alpha=shade)
    axes.plot([q[0], joints[0, 0]], [q[1], joints[0, 1]], color=palette.MEASURED, alpha=shade)
