"""The description of the arm and its base: all hardware data that other modules use.

SI units and radians throughout; `g`, the distance from joint to centre of mass, follows from the
stored `a` and `b` (a = g + b). A description is checked when it is created, so every existing
object is valid.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from .arrays import Floats
from .description_fields import (
    DescriptionError,
    as_count,
    as_instance,
    as_name,
    as_names,
    as_nonzero,
    as_number,
    as_numbers,
    as_positive,
    as_rows,
    as_serial,
    as_sign,
    as_time,
    check_fields,
    error_context,
    rule,
)

MAX_LINKS = 12


def check_count(links: Sequence[Any]) -> None:
    """Raise DescriptionError if there are too few or too many links."""
    if not 1 <= len(links) <= MAX_LINKS:
        raise DescriptionError("links", len(links), f"1 to {MAX_LINKS} links")


def _chain(value: Any) -> "tuple[Link, ...]":
    links = tuple(value)
    if not all(isinstance(link, Link) for link in links):
        raise TypeError
    return links


@dataclass(frozen=True)
class Drive:
    """A link's servo, with q = direction * counts * 2 pi / counts_per_turn, and its limits."""

    counts_per_turn: int = field(
        default=240_000, metadata=rule(as_count, about="encoder counts a turn of the joint")
    )
    direction: int = field(
        default=1, metadata=rule(as_sign, about="1 if counts grow counter-clockwise, else -1")
    )
    torque_constant: float = field(
        default=0.8, metadata=rule(as_positive, "N m/A", "joint torque per motor current")
    )
    max_current: float = field(default=2.25, metadata=rule(as_positive, "A"))
    max_torque: float = field(default=1.8, metadata=rule(as_positive, "N m", "at the joint"))
    max_velocity: float = field(default=1.0, metadata=rule(as_positive, "rad/s"))
    max_acceleration: float = field(default=2.0, metadata=rule(as_positive, "rad/s^2"))

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True)
class TorqueSensor:
    """A link's torque sensor: torque = gain * (counts - zero)."""

    gain: float = field(default=2.1 / 2**23, metadata=rule(as_nonzero, "N m per count"))
    zero: float = field(default=0.0, metadata=rule(as_number, "counts", "reading without load"))

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True)
class Link:
    """One link, along x from its joint to the next joint (for the last link: to the tip)."""

    a: float = field(metadata=rule(as_positive, "m", "from this joint to the next"))
    theta_0: float = field(metadata=rule(as_number, "rad", "true joint angle at encoder reading 0"))
    mass: float = field(metadata=rule(as_positive, "kg"))
    inertia: float = field(metadata=rule(as_positive, "kg m^2", "about the link's centre of mass"))
    b: float = field(metadata=rule(as_number, "m", "from the centre of mass to the next joint"))
    lateral: float = field(
        default=0.0,
        metadata=rule(as_number, "m", "centre of mass to the left of the link's line"),
    )
    q_min: float = field(
        default=-math.pi / 2, metadata=rule(as_number, "rad", "lowest encoder angle")
    )
    q_max: float = field(
        default=math.pi / 2, metadata=rule(as_number, "rad", "highest encoder angle")
    )
    drive: Drive = field(
        default_factory=Drive, metadata=rule(as_instance(Drive), expected="a drive")
    )
    torque_sensor: TorqueSensor = field(
        default_factory=TorqueSensor,
        metadata=rule(as_instance(TorqueSensor), expected="a torque sensor"),
    )
    serial: int = field(
        default=0, metadata=rule(as_serial, about="number of the physical link; 0: not known")
    )

    def __post_init__(self) -> None:
        check_fields(self)
        if not self.q_min < self.q_max:
            raise DescriptionError("q_max", self.q_max, f"more than q_min = {self.q_min!r} [rad]")

    @property
    def g(self) -> float:
        """Distance from this joint to the centre of mass along the link [m]: a - b."""
        return self.a - self.b


@dataclass(frozen=True)
class Base:
    """The spacecraft simulator in the base frame, as the motion capture system reports it."""

    mass: float = field(metadata=rule(as_positive, "kg"))
    inertia: float = field(metadata=rule(as_positive, "kg m^2", "about the base's centre of mass"))
    com: tuple[float, float] = field(
        default=(0.0, 0.0),
        metadata=rule(as_numbers(2), "m", "centre of mass (x, y)", "two finite numbers (x, y) [m]"),
    )
    mount: tuple[float, float, float] = field(
        default=(0.0, 0.0, 0.0),
        metadata=rule(
            as_numbers(3),
            "m, m, rad",
            "first joint (x_BJ1, y_BJ1, theta_BJ1)",
            "three finite numbers (x_BJ1 [m], y_BJ1 [m], theta_BJ1 [rad])",
        ),
    )

    def __post_init__(self) -> None:
        check_fields(self)

    def vector(self) -> Floats:
        """Return the parameters of a base without an arm, (8,), as the start of Arm.vector()."""
        return np.array([self.mass, self.inertia, *self.com, *self.mount, 0.0])


@dataclass(frozen=True)
class Known:
    """Covariance of calibrated values of a description, by name, and the time of their data.

    Names are those of fss_arm_model.parameters, and theta_E. Without data, begin and end are 0.
    """

    names: tuple[str, ...] = field(default=(), metadata=rule(as_names))
    covariance: tuple[tuple[float, ...], ...] = field(
        default=(), metadata=rule(as_rows, about="row by row, in the units of the values")
    )
    begin: int = field(default=0, metadata=rule(as_time, "ns", "of the data, since 1970"))
    end: int = field(default=0, metadata=rule(as_time, "ns"))

    def __post_init__(self) -> None:
        check_fields(self)
        C, size = np.array(self.covariance), len(self.names)
        if len(C) != size:
            raise DescriptionError(
                "covariance", f"of {len(C)} values", f"of {size} values as names"
            )
        if size and not ((C == C.T).all() and (np.diag(C) >= 0.0).all()):
            expected = "a symmetric matrix whose diagonal is 0 or more"
            raise DescriptionError("covariance", self.covariance, expected)

    @classmethod
    def of(cls, names: Sequence[str], covariance: Floats) -> "Known":
        """Return an object with a covariance (p, p), made symmetric."""
        return cls(tuple(names), (0.5 * (covariance + covariance.T)).tolist())

    def covariance_of(self, names: Sequence[str], deviations: Floats) -> Floats:
        """Return the covariance (p, p) of parameters; unknown ones use their deviations (p,)."""
        C = np.diag(np.square(deviations))
        known = [k for k, name in enumerate(names) if name in self.names]
        index = [self.names.index(names[k]) for k in known]
        if known:
            C[known] = C[:, known] = 0.0
            C[np.ix_(known, known)] = np.array(self.covariance)[np.ix_(index, index)]
        return C

    def updated(self, names: Sequence[str], covariance: Floats) -> "Known":
        """Return a copy with a new covariance (p, p) of `names`, independent of all others."""
        others = [name for name in self.names if name not in names]
        others_covariance = self.covariance_of(others, np.zeros(len(others)))
        C = np.zeros((len(others) + len(names),) * 2)
        C[: len(others), : len(others)], C[len(others) :, len(others) :] = (
            others_covariance,
            covariance,
        )
        return replace(Known.of([*others, *names], C), begin=self.begin, end=self.end)

    def only(self, names: Sequence[str]) -> "Known":
        """Return a copy with the covariance of those of `names` that it has."""
        kept = [name for name in names if name in self.names]
        found = Known.of(kept, self.covariance_of(kept, np.zeros(len(kept))))
        return replace(found, begin=self.begin, end=self.end)

    def during(self, begin: int, end: int) -> "Known":
        """Return a copy that also depends on data of a period [ns]; 0: no data."""
        if not (self.end and end):
            return replace(self, begin=begin, end=end) if end else self
        return replace(self, begin=min(begin, self.begin), end=max(end, self.end))


@dataclass(frozen=True)
class Arm:
    """A base and the n links it carries, in order from the base."""

    name: str = field(metadata=rule(as_name))
    base: Base = field(metadata=rule(as_instance(Base), expected="a base"))
    links: tuple[Link, ...] = field(metadata=rule(_chain, expected="a list of links"))
    theta_E: float = field(  # noqa: N815 (the paper's symbol)
        default=0.0,
        metadata=rule(as_number, "rad", "end-effector subject against the last link"),
    )
    known: Known = field(
        default=Known(), metadata=rule(as_instance(Known), expected="names and their covariance")
    )

    def __post_init__(self) -> None:
        check_fields(self)
        check_count(self.links)
        if self.links[0].theta_0 != 0.0:
            raise DescriptionError(
                "link 1: theta_0", self.links[0].theta_0, "0, as theta_BJ1 takes its place"
            )

        serials = [link.serial for link in self.links if link.serial]
        if len(set(serials)) < len(serials):
            raise DescriptionError("serials of the links", serials, "each once")

    @property
    def n(self) -> int:
        """Number of links."""
        return len(self.links)

    def vector(self) -> Floats:
        """Return the parameters that the kernels take, (8 + 6 n,).

        m_0, I_0, com_x, com_y, x_BJ1, y_BJ1, theta_BJ1, theta_E, then for each link
        a, theta_0, mass, inertia, g, lateral.
        """
        numbers = [*self.base.vector()[:-1], self.theta_E]
        for k in self.links:
            numbers += [k.a, k.theta_0, k.mass, k.inertia, k.g, k.lateral]
        return np.array(numbers)

    def with_kinematics(self, values: npt.ArrayLike) -> "Arm":
        """Return the arm with other kinematic parameters, (2 n + 2,), ordered as kinematic_names.

        Raises:
            DescriptionError: a value is invalid, for example a length that is not positive.
        """
        xi = np.asarray(values, dtype=float).tolist()
        if len(xi) != 2 * self.n + 2:
            raise DescriptionError("kinematic parameters", xi, f"{2 * self.n + 2} numbers")
        offsets = [0.0, *xi[self.n : 2 * self.n - 1]]
        links = []
        for i, link in enumerate(self.links):
            with error_context(f"link {i + 1}"):
                links.append(replace(link, a=xi[i], theta_0=offsets[i]))
        with error_context("base"):
            base = replace(self.base, mount=tuple(xi[-3:]))
        return replace(self, base=base, links=tuple(links))


def joint_names(n: int) -> list[str]:
    """Return the names of joints 1 to n in messages and bags."""
    return [f"joint_{i}" for i in range(1, n + 1)]


def paper_arm() -> Arm:
    """Return the arm of Tables 2-4 of the paper, with a base of 10 kg and 0.25 kg m^2 (assumed)."""
    offsets = [0.0, 5.801, -3.402, -1.391]
    lengths = [(0.3825, 0.191)] * 3 + [(0.3351, 0.168)]
    links = tuple(
        Link(a=a, theta_0=math.radians(offset), mass=2.88, inertia=0.034, b=b)
        for offset, (a, b) in zip(offsets, lengths, strict=True)
    )
    base = Base(mass=10.0, inertia=0.25, mount=(0.2058, 0.0155, math.radians(18.211)))
    return Arm(name="paper", base=base, links=links)
