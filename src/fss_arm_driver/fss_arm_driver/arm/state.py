"""Last reports of the links, and joint states extrapolated to a common time."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import nan
from typing import Any, NamedTuple

from fss_arm_driver.protocol import NO_TORQUE, State
from fss_arm_driver.scale import Scale
from fss_arm_model.units import SECOND

PATH_SHIFT = 16  # of the path's number in LinkTelemetry.path


@dataclass(frozen=True)
class LinkState:
    """Last report of one link."""

    received: int  # time of reception, in a clock that is never set [ns]
    measured: int  # in the time of day [ns]
    q: float  # [rad]
    qd: float  # [rad/s]
    effort: float  # of the torque sensor [N m]; NaN: unknown
    armed: bool
    referenced: bool
    following: bool
    broken: bool
    path: int  # number of the newest path that it holds; 0: none


def link_state(message: Any, scale: Scale, measured: int, received: int) -> LinkState:
    """Convert a LinkTelemetry to SI units."""
    flags = message.flags
    known = message.torque_age < NO_TORQUE
    return LinkState(
        received,
        measured,
        scale.position(message.position),
        scale.velocity(message.velocity),
        scale.torque(message.torque) if known else nan,
        message.armed,
        bool(flags & State.REFERENCED),
        bool(flags & State.FOLLOWING),
        bool(flags & State.BROKEN),
        message.path >> PATH_SHIFT,
    )


class Joints(NamedTuple):
    """States of all joints at one time, (n) each."""

    q: list[float]  # [rad]
    qd: list[float]  # [rad/s]
    effort: list[float]  # [N m]


def extrapolate(links: Mapping[int, LinkState], n: int, at: int, max_age: float) -> Joints | str:
    """Extrapolate all joints to a time by their rates, or return why that is not possible.

    Args:
        links: last reports by number; links without a report are missing.
        n: number of links.
        at: the time [ns].
        max_age: longest extrapolation [s].
    """
    q, qd, effort = [], [], []
    for i in range(1, n + 1):
        link = links.get(i)
        if link is None:
            return f"link {i} has sent no telemetry yet"
        if not link.referenced:
            return f"link {i} is not referenced"
        if (age := (at - link.measured) / SECOND) > max_age:
            return f"link {i} was measured {age:.2f} s ago, at most {max_age:g} s"
        q.append(link.q + link.qd * age)
        qd.append(link.qd)
        effort.append(link.effort)
    return Joints(q, qd, effort)
