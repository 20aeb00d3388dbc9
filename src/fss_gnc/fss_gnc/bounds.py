"""Bounds of the numbers in goals, references and plans.

A number beyond its bound raises ValueError with one line: its field, its value, what was expected.
"""

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from fss_arm_model.arrays import Floats
from fss_arm_model.units import SECOND
from fss_gnc.reference import Path

MAX_HEADING = 1000.0  # [rad], 159 turns; headings are wrapped
MAX_DURATION = 86_400.0  # [s], one day
MAX_TWIST = (1.0, 1.0, 3.0)  # motion capture rejects a faster base [m/s, m/s, rad/s]
MAX_ACCELERATION = (1.0, 1.0, 3.0)  # [m/s^2, m/s^2, rad/s^2]
BRAKING_TIME = 3.0  # time for which a moving reference may be beyond the table's edge [s]
ROUNDING_TOLERANCE = 1e-9  # for interpolated numbers

UNITS = (("m", "m", "rad"), ("m/s", "m/s", "rad/s"), ("m/s^2", "m/s^2", "rad/s^2"))
FIELDS = (("x", "y", "heading"), *2 * (("linear.x", "linear.y", "angular.z"),))
POINT_FIELDS = ("transforms[0]", "velocities[0]", "accelerations[0]")


def check(name: str, value: float, low: float, high: float, unit: str) -> float:
    """Return the value if it lies within its bounds."""
    if not low <= value <= high:  # NaN, too
        raise ValueError(f"{name} is {value:g} {unit}, expected {low:g} to {high:g} {unit}")
    return float(value)


def check_all(values: Floats, limits: Floats, field: Callable[..., tuple[str, str]]) -> None:
    """Raise ValueError for the first value whose magnitude is above its limit.

    Args:
        values: of any shape.
        limits: of the same shape.
        field: function that returns name and unit of a value, given its indices.
    """
    beyond = np.argwhere(~(np.abs(values) <= limits + ROUNDING_TOLERANCE))
    if len(beyond):
        index = tuple(beyond[0].tolist())
        name, unit = field(*index)
        check(name, float(values[index]), -float(limits[index]), float(limits[index]), unit)


def check_duration(name: str, value: float) -> float:
    """Return a duration [s] if it is not negative and at most one day."""
    return check(name, value, 0.0, MAX_DURATION, "s")


def check_poses(name: str, values: npt.ArrayLike, table: Sequence[float]) -> Floats:
    """Return poses on the table as rows.

    Args:
        name: of the field.
        values: (3 k,) x, y [m] and heading [rad] of each pose in turn.
        table: its sides along x and y [m], about the origin.

    Returns:
        (k, 3)
    """
    return _rows(name, values, _pose_limits(table), UNITS[0])


def check_pose(name: str, values: npt.ArrayLike, table: Sequence[float]) -> Floats:
    """Return one pose (3,) on the table; arguments as of `check_poses`."""
    if (count := np.size(values)) != 3:
        raise ValueError(f"{name} has {count} numbers, expected 3: x, y [m] and heading [rad]")
    return np.asarray(check_poses(name, values, table)[0])


def check_twists(name: str, values: npt.ArrayLike) -> Floats:
    """Return twists (3 k,) that a base can have as rows (k, 3) [m/s, m/s, rad/s]."""
    return _rows(name, values, np.array(MAX_TWIST), UNITS[1])


def check_knot_times(name: str, values: npt.ArrayLike, step: float) -> Floats:
    """Return times (k,) [s] if they increase by more than `step` from 0 on, within a day."""
    times = np.array(values, dtype=float)
    for k, value in enumerate(times.tolist()):
        check_duration(f"{name}[{k}]", value)
    too_close = np.flatnonzero(np.diff(times) <= step)
    if too_close.size:
        k = int(too_close[0]) + 1
        minimum = times[k - 1] + step
        raise ValueError(f"{name}[{k}] is {times[k]:g} s, expected more than {minimum:g} s")
    return times


def check_stamp(stamp: int, now: int, end: float, timeout: float) -> None:
    """Raise ValueError if a path is too far in the future or in the past.

    Args:
        stamp: time from which the times of its points count [ns]; 0: none is given.
        now: present time [ns].
        end: time of its last point [s].
        timeout: longest time until its stamp, and since its last point [s].
    """
    if not stamp:
        raise ValueError("header.stamp is 0, expected the start time of the points")
    ahead = (stamp - now) / SECOND
    if ahead > timeout:
        raise ValueError(
            f"header.stamp is {ahead:.1f} s in the future, expected at most {timeout:g} s"
        )
    if (elapsed := -ahead - end) > timeout:
        raise ValueError(f"the last point was {elapsed:.1f} s ago, expected at most {timeout:g} s")


def check_reference(path: Path, table: Sequence[float]) -> None:
    """Raise ValueError if a reference leaves the table or moves faster than a base can.

    The reference of a base that cannot stop before the edge is beyond the edge while the base
    brakes. So a moving reference may be beyond the edge by its speed times BRAKING_TIME.

    Args:
        path: of the base, from base/trajectory.
        table: its sides along x and y [m], about the origin.
    """
    last = len(path.times) - 1
    for k in (0, last):
        check_duration(f"points[{k}].time_from_start", float(path.times[k]))
    _check_states(path.knots, table, lambda k, d: f"points[{k}].{POINT_FIELDS[d]}.")
    times, states = (
        values[:-1] for values in path.sample_segments(float(path.times[0]))
    )  # end: at rest
    _check_states(states[:, :2], table, lambda k, _: f"reference at {times[k]:g} s, ")


def _check_states(states: Floats, table: Sequence[float], name: Callable[[int, int], str]) -> None:
    state_limits = np.array([_pose_limits(table), MAX_TWIST, MAX_ACCELERATION])
    limits = np.tile(state_limits[: states.shape[1]], (len(states), 1, 1))
    if states.shape[1] > 1:
        limits[:, 0, :2] += BRAKING_TIME * np.abs(states[:, 1, :2])
    check_all(states, limits, lambda k, d, i: (name(k, d) + FIELDS[d][i], UNITS[d][i]))


def _rows(name: str, values: npt.ArrayLike, limits: Floats, units: Sequence[str]) -> Floats:
    rows = np.array(values, dtype=float).reshape(-1, 3)
    limits = np.broadcast_to(limits, rows.shape)
    check_all(rows, limits, lambda k, i: (f"{name}[{3 * k + i}]", units[i]))
    return rows


def _pose_limits(table: Sequence[float]) -> Floats:
    return np.array([0.5 * table[0], 0.5 * table[1], MAX_HEADING])
