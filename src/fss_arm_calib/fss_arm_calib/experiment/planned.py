"""Planned maneuvers, and the file format of a plan.

A maneuver is a sequence of straight moves in joint space. Each move is from rest to rest, with the
trapezoidal speed profile of the drives.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_model.files import ContentError, read_yaml
from fss_arm_model.free_floating import free_torques
from fss_arm_model.joint_path import Law

RAMP_SHARE = 1.0 / 3.0  # share of a move's time for acceleration, and the same for deceleration
PAUSE = 0.5  # time between two moves of a maneuver, to detect that the arm has arrived [s]
TORQUE_SHARE = 0.7  # share of the drives' torque that a plan may use; the rest is for control


class NoManeuver(ValueError):  # noqa: N818
    """Error raised if no maneuver satisfies the conditions."""


@dataclass(frozen=True)
class Planned:
    """Planned maneuver."""

    kind: str
    waypoints: Floats  # (w + 1, n) joint readings, the first is the start [rad]
    durations: Floats  # (w,) duration of each move [s]

    @cached_property
    def length(self) -> float:
        """Duration of the maneuver [s]."""
        return float(self.durations.sum() + PAUSE * (len(self.durations) - 1))

    def law(self) -> tuple[Law, Floats]:
        """Return angles and rates as a function of time, and the edges of its smooth parts."""
        return moves_law(self.waypoints, self.durations)


def moves_law(waypoints: Floats, durations: Floats) -> tuple[Law, Floats]:
    """Return angles and rates of successive moves over time, and the edges of smooth parts.

    The moves are between waypoints (..., w + 1, n) [rad], with durations (..., w) [s]. An infinite
    duration is padding of a batch.
    """
    way, real = np.diff(waypoints, axis=-2), np.isfinite(durations)
    begins = np.cumsum(durations + PAUSE, axis=-1)
    begins = np.concatenate([np.zeros_like(begins[..., :1]), begins[..., :-1]], axis=-1)
    n, first = way.shape[-1], np.arange(durations[..., 0].size).reshape(*durations.shape[:-1], 1)

    def law(t: Floats) -> tuple[Floats, Floats]:
        k = first * durations.shape[-1]  # index of the current move in the batch
        for begin in np.moveaxis(begins[..., 1:], -1, 0):
            k = k + (t >= begin[..., None])
        k = np.broadcast_to(k, t.shape)
        duration, step = durations.ravel()[k], way.reshape(-1, n)[k]
        s, rate, _ = speed_profile((t - begins.ravel()[k]) / duration)
        rate = rate / duration
        place = waypoints.reshape(-1, n)[k + first]
        return place + step * s[..., None], step * rate[..., None]

    corners = np.array([0.0, RAMP_SHARE, 1.0 - RAMP_SHARE, 1.0])
    spans = np.where(real, durations, 0.0)[..., None] * corners
    edges = np.where(real, begins, 0.0)[..., None] + spans
    return law, edges.reshape(*durations.shape[:-1], -1)


def batch_law(plan: Sequence[Planned]) -> tuple[Law, Floats]:
    """Return the law and edges of several maneuvers as one batch; padded edges are 0."""
    counts = np.array([len(one.durations) for one in plan])
    k = np.arange(counts.max() + 1)
    durations = np.full((len(plan), counts.max()), inf)
    durations[k[:-1] < counts[:, None]] = np.concatenate([one.durations for one in plan])
    rows = np.minimum(k, counts[:, None])
    knots = [one.waypoints[row] for one, row in zip(plan, rows, strict=True)]
    return moves_law(np.array(knots), durations)


def speed_profile(x: Floats) -> tuple[Floats, Floats, Floats]:
    """Return position (0 to 1), rate and acceleration of a move at the share x of its time."""
    x = np.clip(x, 0.0, 1.0)
    top = 1.0 / (1.0 - RAMP_SHARE)
    y = np.minimum(x, 1.0 - x)
    ramp = y < RAMP_SHARE
    way = np.where(ramp, 0.5 * top / RAMP_SHARE * y**2, top * (y - 0.5 * RAMP_SHARE))
    rate = np.where(ramp, top / RAMP_SHARE * y, top)
    acceleration = np.where(ramp, np.where(x < 0.5, top / RAMP_SHARE, -top / RAMP_SHARE), 0.0)
    return np.where(x < 0.5, way, 1.0 - way), rate, acceleration


def speed_limited_duration(arm: Arm, way: Floats) -> Floats:
    """Return the least time of moves by `way` (..., n), limited by speed and acceleration [s]."""
    top = 1.0 / (1.0 - RAMP_SHARE)
    speeds = np.array([link.drive.max_velocity for link in arm.links])
    gains = np.array([link.drive.max_acceleration for link in arm.links])
    speed = np.max(top * np.abs(way) / speeds, axis=-1)
    gain = np.max(top / RAMP_SHARE * np.abs(way) / gains, axis=-1)
    return np.maximum(np.maximum(speed, np.sqrt(gain)), 0.1)


def torque_limited_duration(arm: Arm, begin: Floats, end: Floats) -> Floats:
    """Return the least time of moves (..., n), also limited by the drives' torque, (...) [s].

    Without momentum, the torques of a path scale with the inverse square of its duration.
    """
    limits = TORQUE_SHARE * np.array(
        [link.drive.torque_constant * link.drive.max_current for link in arm.links]
    )
    s, rate, acceleration = (x[:, None] for x in speed_profile(np.linspace(0.0, 1.0, 31) + 1e-9))
    q, way = begin[..., None, :], (end - begin)[..., None, :]
    torques = free_torques(arm.vector(), q + s * way, rate * way, acceleration * way)[0]
    least = speed_limited_duration(arm, end - begin)
    return np.asarray(np.maximum(least, np.sqrt(np.max(np.abs(torques) / limits, axis=(-2, -1)))))


def plan_to_yaml(plan: Sequence[Planned], promised: Mapping[str, float] | None = None) -> str:
    """Write a plan for `experiment`, with the promised deviations for a later report."""
    rows = []
    for one in plan:
        q, durations = np.round(one.waypoints, 6), np.round(one.durations, 3)
        rows.append({"kind": one.kind, "q": q.tolist(), "durations": durations.tolist()})
    head = "# Maneuvers: joint readings, starting with the first posture [rad]; durations [s].\n"
    given: dict[str, Any] = {"maneuvers": rows}
    if promised:
        given["promised"] = {name: float(f"{x:.4g}") for name, x in promised.items()}
    return head + yaml.safe_dump(given, sort_keys=False, default_flow_style=None)


def read_plan(path: str | Path, n: int) -> list[Planned]:
    """Read a plan for n joints from a file of `plan_to_yaml`; ContentError: it is none."""
    given = read_yaml(Path(path))
    rows = given.get("maneuvers") if isinstance(given, dict) else None
    try:
        plan = [
            Planned(str(row["kind"]), np.array(row["q"], float), np.array(row["durations"], float))
            for row in rows or ()
        ]
    except (TypeError, KeyError, ValueError):
        plan = []
    if not plan:
        expected = "rows of kind, q and durations, as written by `design`"
        raise ContentError(f"{path}: maneuvers", rows, expected)
    for k, one in enumerate(plan, 1):
        if one.waypoints.shape != (len(one.durations) + 1, n) or not (one.durations > 0.0).all():
            given = f"q of {one.waypoints.shape}, {len(one.durations)} durations"
            expected = f"q of (w + 1, {n}) and w durations above 0"
            raise ContentError(f"{path}: maneuver {k}", given, expected)
    return plan
