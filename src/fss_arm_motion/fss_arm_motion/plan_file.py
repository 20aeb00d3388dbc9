"""Write plans to files and read them back: YAML, SI units."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_model.description_file import to_yaml
from fss_arm_model.files import ContentError, read_yaml
from fss_arm_motion.plan import Plan, PlanError, Prediction, Start, predicted

VERSION = 1
DIGITS = 9  # significant digits of a written number

HEAD = """\
# A planned motion of the arm: cubic between the knots. SI units and radians.
# arm: the description that it was planned for. base: its predicted pose (x, y, heading) over time,
# with 1 sigma. start: the base's pose and the momentum (x, y, angular) that were assumed.
"""


@dataclass(frozen=True)
class Stored:
    """A plan from a file, with the arm and the start that it was planned for."""

    arm: str  # its name
    digest: str  # of its description
    pose: Floats  # (3,) of the base at the start
    momentum: Floats  # (3,)
    plan: Plan


def digest(arm: Arm) -> str:
    """Return a digest that identifies a description."""
    return hashlib.sha256(to_yaml(arm).encode()).hexdigest()[:16]


def _to_builtin(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return _to_builtin(value.tolist())
    if isinstance(value, list | tuple):
        return [_to_builtin(one) for one in value]
    if isinstance(value, Mapping):
        return {key: _to_builtin(one) for key, one in value.items()}
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value


def written(start: Start, plan: Plan) -> str:
    """Return the plan as YAML."""
    base = plan.prediction
    content = {
        "version": VERSION,
        "arm": {"name": start.arm.name, "digest": digest(start.arm)},
        "kind": plan.kind,
        "arguments": plan.arguments,
        "ended": plan.ended,
        "notes": plan.notes,
        "start": {"pose": start.pose, "momentum": start.momentum},
        "knots": {"time": plan.times, "q": plan.q, "qd": plan.qd},
        "used": plan.used,
        "base": {"time": base.times, "pose": base.pose, "deviation": base.deviation},
    }
    return HEAD + str(
        yaml.safe_dump(_to_builtin(content), sort_keys=False, default_flow_style=None)
    )


class _Part:
    """An entry of a file, with its name for error messages."""

    def __init__(self, name: str, value: Any) -> None:
        self.name, self.value = name, value

    def __getitem__(self, key: str) -> "_Part":
        if not isinstance(self.value, dict):
            raise ContentError(self.name, self.value, f"entries, one of them {key}")
        return _Part(f"{self.name}: {key}" if self.name else key, self.value.get(key))

    def of(self, kind: type[Any], expected: str) -> Any:
        if not isinstance(self.value, kind):
            raise ContentError(self.name, self.value, expected)
        return self.value

    def array(self, *shape: int) -> Floats:
        """Return finite numbers of a shape; -1: any length."""
        expected = f"finite numbers of shape ({', '.join('k' if s < 0 else str(s) for s in shape)})"
        try:
            a = np.array(self.value, dtype=float)
        except (TypeError, ValueError):
            raise ContentError(self.name, self.value, expected) from None
        fits = len(a.shape) == len(shape)
        fits = fits and all(s in (-1, m) for s, m in zip(shape, a.shape, strict=True))
        if not fits or not np.isfinite(a).all():
            raise ContentError(self.name, self.value, expected)
        return a


def parsed(source: str | Path) -> Stored:
    """Read a plan from a text, or from a file if `source` is a Path.

    Raises:
        OSError: the file cannot be read.
        ContentError: it is not a valid plan; the message names the entry.
    """
    part = _Part("", read_yaml(source))
    if (version := part["version"].value) != VERSION:
        raise ContentError("version", version, str(VERSION))
    times = part["knots"]["time"].array(-1)
    if len(times) < 2 or times[0] != 0.0 or not (np.diff(times) > 0.0).all():
        raise ContentError("knots: time", times.tolist(), "two or more, ascending from 0")
    q = part["knots"]["q"].array(len(times), -1)
    qd = part["knots"]["qd"].array(*q.shape)
    if np.any(qd[[0, -1]]):
        raise ContentError("knots: qd", qd[-1].tolist(), "0 at the first and the last knot")
    marks = part["base"]["time"].array(-1)
    base = Prediction(
        marks,
        part["base"]["pose"].array(len(marks), 3),
        part["base"]["deviation"].array(len(marks), 3),
    )
    plan = Plan(
        part["kind"].of(str, "a kind of plan"),
        part["arguments"].of(dict, "entries"),
        times,
        q,
        qd,
        base,
        part["used"].array(3, q.shape[1]),
        part["notes"].of(dict, "entries"),
        part["ended"].of(str, "a text"),
    )
    return Stored(
        part["arm"]["name"].of(str, "a name"),
        part["arm"]["digest"].of(str, "a text"),
        part["start"]["pose"].array(3),
        part["start"]["momentum"].array(3),
        plan,
    )


def plan_from_file(path: Path, start: Start, tolerance: float) -> Plan:
    """Return a stored plan, with the base's motion predicted from its present state.

    Args:
        path: of the file.
        start: present state.
        tolerance: maximum distance of a joint from the plan's start [rad].

    Raises:
        OSError: the file cannot be read.
        ContentError: it is not a valid plan.
        PlanError: the plan is for another arm, or starts elsewhere.
    """
    plan = parsed(path).plan
    if plan.q.shape[1] != len(start.q):
        raise PlanError(f"{path} is for {plan.q.shape[1]} joints, the arm has {len(start.q)}")
    distance = np.abs(plan.q[0] - start.q)
    if distance.max() > tolerance:
        i = int(distance.argmax())
        raise PlanError(
            f"joint {i + 1} is at {np.degrees(start.q[i]):.2f} deg, {path} starts at "
            f"{np.degrees(plan.q[0][i]):.2f} deg"
        )
    prediction = predicted(start, plan.times, plan.q, plan.qd)
    return replace(plan, prediction=prediction, notes={}, ended="")
