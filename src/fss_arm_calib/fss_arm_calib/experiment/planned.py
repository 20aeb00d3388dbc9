"""Planned maneuvers, each a sequence of straight moves in joint space, and the file of a plan."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from fss_arm_model.arrays import Floats
from fss_arm_model.files import ContentError, read_yaml
from fss_arm_model.joint_path import Law
from fss_arm_model.straight_moves import PAUSE, batch_law, moves_law


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


def plan_law(plan: Sequence[Planned]) -> tuple[Law, Floats]:
    """Return the law and edges of several maneuvers as one batch; padded edges are 0."""
    return batch_law([one.waypoints for one in plan], [one.durations for one in plan])


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
