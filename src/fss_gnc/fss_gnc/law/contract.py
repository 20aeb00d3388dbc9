"""Inputs and outputs of a control law: the only definition of names, shapes and units.

The C structures of a law in a shared library (`header.py`) and the messages between the node and
the law's process are derived from these two dataclasses. In a structure an array over the joints
has MAX_JOINTS elements, a bool is an int32, and before an optional quantity `x` there is an int32
`x_valid`.
"""
# ruff: noqa: RUF009 (quantity returns a field)

from collections.abc import Iterator
from dataclasses import Field, dataclass, field, fields
from typing import Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from fss_arm_model import thrusters

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
Contract = TypeVar("Contract", "Inputs", "Outputs")

MAX_JOINTS = 12
VALVES = thrusters.THRUSTER_COUNT
JOINTS = -1  # size of an array with one element for each joint
POSE_UNIT, TWIST_UNIT = "m, m, rad", "m/s, m/s, rad/s"
ACCELERATION_UNIT = "m/s^2, m/s^2, rad/s^2"
KINDS: dict[type, np.dtype[Any]] = {
    float: np.dtype(np.float64),
    int: np.dtype(np.int32),
    bool: np.dtype(np.int32),
}


class LawError(Exception):
    """A law cannot be loaded, or has failed; the message states why."""


def quantity(about: str, unit: str = "", size: int = 0, kind: type = float, **default: Any) -> Any:
    """Create a field of the contract.

    Args:
        about: meaning of the quantity.
        unit: unit, of each element if there are several.
        size: number of elements; 0: a scalar.
        kind: float, int or bool.
        default: default=None if the quantity is optional.
    """
    return field(metadata={"about": about, "unit": unit, "size": size, "kind": kind}, **default)


@dataclass(frozen=True)
class Inputs:
    """Inputs of a law, all at one time. Poses and twists are in the world's axes."""

    joints: int = quantity("number of joints n", kind=int)
    time: float = quantity("time since the law's first step", "s")
    period: float = quantity("nominal time between two steps", "s")
    base_pose: Floats = quantity("x, y, heading of the base", POSE_UNIT, 3)
    base_twist: Floats = quantity("velocity of the base", TWIST_UNIT, 3)
    base_covariance: Floats = quantity("of base_pose and base_twist, 6 x 6 row by row", "", 36)
    base_age: float = quantity("age of the base's state, over which it is extrapolated", "s")
    joint_angles: Floats = quantity("readings of the joints", "rad", JOINTS)
    joint_rates: Floats = quantity("rates of the joints", "rad/s", JOINTS)
    reference_pose: Floats = quantity("desired pose of the base", POSE_UNIT, 3)
    reference_twist: Floats = quantity("desired velocity", TWIST_UNIT, 3)
    reference_acceleration: Floats = quantity("desired acceleration", ACCELERATION_UNIT, 3)
    valves_armed: bool = quantity("the base's valves may open", kind=bool)
    joints_armed: Flags = quantity("the joint may move", "", JOINTS, bool)
    valves_stuck_open: Flags = quantity("the valve does not close", "", VALVES, bool)
    valves_stuck_closed: Flags = quantity("the valve does not open", "", VALVES, bool)
    target_pose: Floats | None = quantity("x, y, heading", POSE_UNIT, 3, default=None)
    target_twist: Floats | None = quantity("velocity", TWIST_UNIT, 3, default=None)
    propellant: float | None = quantity("remaining mass of gas", "kg", default=None)


@dataclass(frozen=True)
class Outputs:
    """Commands of a law; None: not commanded. At most one for the base, and one for the joints."""

    wrench: Floats | None = quantity(
        "mean force along the base's axes, torque about its origin", "N, N, N m", 3, default=None
    )
    valve_on_times: Floats | None = quantity(
        "time for which each valve opens now", "s", VALVES, default=None
    )
    joint_positions: Floats | None = quantity("desired angles", "rad", JOINTS, default=None)
    joint_velocities: Floats | None = quantity("desired rates", "rad/s", JOINTS, default=None)
    joint_currents: Floats | None = quantity("motor currents", "A", JOINTS, default=None)
    gripper_closed: bool | None = quantity("1 closes, 0 opens it", kind=bool, default=None)

    def __post_init__(self) -> None:
        """Check that the commands do not contradict each other.

        Raises:
            ValueError: two commands of the base or of the joints are given.
        """
        for names in (BASE_COMMANDS, JOINT_COMMANDS):
            given = [name for name in names if getattr(self, name) is not None]
            if len(given) > 1:
                raise ValueError(f"{' and '.join(given)} are given, expected at most one of them")

    def require_finite(self) -> None:
        """Raise ValueError if a number is NaN or infinite; the message names the command."""
        for name in (*BASE_COMMANDS, *JOINT_COMMANDS):
            value = getattr(self, name)
            if value is not None and not np.isfinite(value).all():
                raise ValueError(f"{name} is {np.asarray(value).tolist()}, expected finite numbers")


BASE_COMMANDS = "wrench", "valve_on_times"
JOINT_COMMANDS = "joint_positions", "joint_velocities", "joint_currents"


class Member(NamedTuple):
    """Member of a C structure."""

    name: str
    dtype: np.dtype[Any]
    size: int  # 0: a scalar
    comment: str


def members(kind: type) -> Iterator[Member]:
    """Yield the members of the C structure of Inputs or Outputs, in order."""
    for f in fields(kind):
        about, unit, size = (f.metadata[key] for key in ("about", "unit", "size"))
        if f.default is None:
            yield Member(f"{f.name}_valid", KINDS[bool], 0, f"1 if {f.name} is given")
        comment = f"{about} [{unit}]" if unit else about
        kept = MAX_JOINTS if size == JOINTS else size
        yield Member(f.name, KINDS[f.metadata["kind"]], kept, comment)


def structure(kind: type) -> np.dtype[Any]:
    """Return the layout in memory of the C structure of Inputs or Outputs."""
    rows = [(m.name, m.dtype, (m.size,) if m.size else ()) for m in members(kind)]
    return np.dtype(rows, align=True)


STRUCTURES = {kind: structure(kind) for kind in (Inputs, Outputs)}


def to_record(value: Inputs | Outputs, joints: int) -> npt.NDArray[Any]:
    """Return a value as its C structure, (), for an arm with n = `joints`.

    Raises:
        ValueError: an array has another size than the contract states.
        TypeError: a value is not numeric.
    """
    record = np.zeros((), STRUCTURES[type(value)])
    for f in fields(value):
        given, size = getattr(value, f.name), _size(f, joints)
        if f.default is None:
            record[f"{f.name}_valid"] = given is not None
        if given is None:
            continue
        expected = (size,) if size else ()
        if np.shape(given) != expected:
            raise ValueError(f"{f.name} has shape {np.shape(given)}, expected {expected}")
        if size:
            record[f.name][:size] = given
        else:
            record[f.name] = given
    return record


def from_record(kind: type[Contract], record: npt.NDArray[Any], joints: int) -> Contract:
    """Return a value from its C structure.

    Raises:
        ValueError: it is contradictory.
    """
    values: dict[str, Any] = {}
    for f in fields(kind):
        if f.default is None and not record[f"{f.name}_valid"]:
            continue
        size, of = _size(f, joints), f.metadata["kind"]
        value = record[f.name]
        values[f.name] = value[:size].astype(of) if size else of(value)
    return kind(**values)


def _size(f: "Field[Any]", joints: int) -> int:
    """Return the number of elements of a quantity; 0: a scalar."""
    size: int = f.metadata["size"]
    return joints if size == JOINTS else size
