"""Straight-path workspace: the region that the tip reaches along straight lines (Fig. 7).

From a start state without momentum the tip moves along a line, until a joint limit leaves no
motion, all joints but one are at their limits, a singularity is met or the table ends. The result
depends on how the redundancy is resolved: see redundancy.py for the rules.
"""

from dataclasses import dataclass, replace
from math import inf, pi
from typing import Any

import numpy as np
import numpy.typing as npt

from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_model.kinematics import tip_pose
from fss_arm_model.settings import (
    FINITE,
    NOT_NEGATIVE,
    POSITIVE,
    SettingError,
    Settings,
    one_of,
    setting,
)
from fss_arm_model.units import angle_beyond
from fss_arm_workspace.regions.fixed import checked_limits, joint_limits
from fss_arm_workspace.straight_path.redundancy import BASES, RULES
from fss_arm_workspace.straight_path.trace import STOPPING_RATE, LineOptions, trace

FIXED, FLOATING, ZERO_REACTION = BASES
MINIMUM_NORM, AWAY_FROM_LIMITS, WEIGHTED = RULES

GRAZING_RATE_SHARE = 0.5  # peak rate of a grazing path, as share of the stopping rate
GRAZING_DISTANCE = 5e-3  # from the stop to the singularity of a grazing path, at least [m]


_PATH_FIELDS = ("direction", "distance", "reason", "last", "grazes")  # one row a path in Paths


@dataclass(frozen=True)
class PathSettings(Settings):
    """Settings of straight paths on any base: how they are followed, and where they end.

    Raises:
        SettingError: a setting is invalid.
    """

    redundancy: str = setting(
        AWAY_FROM_LIMITS, "redundancy resolution on straight paths", check=one_of(*RULES)
    )
    gain: float = setting(
        5.0,
        "motion of a joint at its limit towards the middle of its range, per metre of path, for "
        "`away from limits`; 0: none",
        unit="rad/m",
        check=NOT_NEGATIVE,
    )
    table_corners: tuple[float, ...] = setting(
        (-2.0, -2.0, 2.0, 2.0),
        "corners of the table in the world: x_min, y_min, x_max, y_max",
        unit="m",
        check=FINITE,
        size=4,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not np.less(self.table_corners[:2], self.table_corners[2:]).all():
            corners = self.table_corners
            raise SettingError(
                f"table_corners is {corners} m, expected low x, low y, high x, high y"
            )


@dataclass(frozen=True)
class Rules(PathSettings):
    """Settings of straight paths on one kind of base."""

    base: str = setting(FLOATING, "kind of base for straight paths", check=one_of(*BASES))
    step: float = setting(2e-3, "maximum step along a straight path", unit="m", check=POSITIVE)


@dataclass(frozen=True)
class Paths:
    """Set of k straight paths from one start."""

    start: Floats  # (3 + n,) state: the base's pose and joint readings
    redundancy: str  # rule that resolved the redundancy
    tip: complex  # start of the paths, in the world [m]
    direction: Floats  # (k,) in the world [rad]
    distance: Floats  # (k,) [m]
    reason: npt.NDArray[np.intp]  # (k,) index in trace.REASONS
    last: Floats  # (k, 3 + n) state at the end
    grazes: npt.NDArray[np.bool_]  # (k,) True: the distance depends on the stopping rate

    @property
    def ends(self) -> npt.NDArray[np.complex128]:
        """Ends of the paths, in the world [m], complex (k,)."""
        return self.tip + self.distance * np.exp(1j * self.direction)

    @property
    def area(self) -> float:
        """Area [m^2] of the polygon of the ends, which are in the order of their directions."""
        ends = self.ends - self.tip
        return float(0.5 * (ends.conj() * np.roll(ends, -1)).imag.sum())

    def __getitem__(self, index: npt.NDArray[Any]) -> "Paths":
        return replace(self, **{name: getattr(self, name)[index] for name in _PATH_FIELDS})


def arch(arm: Arm) -> Floats:
    """Return a start state: base in the table's middle, joints bent by up to 45 deg, tip ahead.

    The joints turn by at most three quarters of a circle in total, so that the tip of a long arm
    stays on the table. The first joint turns back by half the bends of the others. Each joint stays
    out of the outer eighths of its range, where paths would end at once.
    """
    bend = min(pi / 4, 1.5 * pi / max(arm.n - 1, 1))
    q = np.full(3 + arm.n, bend)
    q[:3], q[3] = 0.0, -(arm.n - 1) * bend / 2.0
    low, high = joint_limits(arm).T
    q[3:] = q[3:].clip(low + (high - low) / 8.0, high - (high - low) / 8.0)
    return q


def straight_paths(
    arm: Arm,
    start: npt.ArrayLike,
    direction: npt.ArrayLike,
    rules: Rules | None = None,
    limits: npt.ArrayLike | None = None,
) -> Paths:
    """Follow straight lines from a start state (3 + n,) in directions (k,) [rad, world].

    Args:
        arm: the arm.
        start: start state.
        direction: direction of each path.
        rules: settings of the paths.
        limits: lowest and highest joint readings, (n, 2) [rad]; the arm's by default.

    Raises:
        ValueError: the start lies outside the limits or the table, or shapes do not fit.
    """
    rules = rules or Rules()
    direction = np.atleast_1d(np.asarray(direction, dtype=float))
    start, bounds, tip, options = _prepare(arm, start, direction, rules, limits)
    last, result = trace(arm.vector(), start, bounds, options)
    length, reason, peak, remaining = np.moveaxis(result, -1, 0)
    grazes = (peak > GRAZING_RATE_SHARE * STOPPING_RATE) | (remaining > GRAZING_DISTANCE)
    return Paths(start, rules.redundancy, tip, direction, length, reason.astype(int), last, grazes)


def straight_workspace(
    arm: Arm,
    start: npt.ArrayLike,
    rules: Rules | None = None,
    limits: npt.ArrayLike | None = None,
    *,
    count: int = 360,
    tolerance: float = 0.01,
    min_gap: float = 1e-4,
) -> Paths:
    """Compute straight paths in all directions, with more of them where the boundary is not smooth.

    A gap between two directions is halved as long as the length of the path between differs by more
    than the tolerance from the mean of the two, down to min_gap: there the boundary jumps.

    Args:
        arm: the arm.
        start: start state, (3 + n,).
        rules: settings of the paths.
        limits: lowest and highest joint readings, (n, 2) [rad]; the arm's by default.
        count: initial number of directions.
        tolerance: tolerance of the boundary between directions [m].
        min_gap: gap between directions that is not halved further [rad].

    Returns:
        The paths in the order of their directions, from 0 to 2 pi.

    Raises:
        ValueError: as straight_paths.
    """
    paths = straight_paths(arm, start, np.linspace(0.0, 2.0 * pi, count + 1)[:-1], rules, limits)
    gaps = np.ones(count, dtype=bool)
    while gaps.any():
        after = np.append(paths.direction[1:], paths.direction[0] + 2.0 * pi)
        index = np.flatnonzero(gaps & (after - paths.direction > min_gap))
        if not index.size:
            break
        middle = 0.5 * (paths.direction[index] + after[index])
        new = straight_paths(arm, start, middle, rules, limits)
        mean = 0.5 * (paths.distance[index] + np.roll(paths.distance, -1)[index])
        rough = np.abs(new.distance - mean) > tolerance
        refined = new[rough]
        open_gaps = np.zeros(len(paths.direction), dtype=bool)
        open_gaps[index[rough]] = True
        order = np.argsort(np.concatenate([paths.direction, refined.direction]), kind="stable")
        paths = concatenate(paths, refined)[order]
        gaps = np.concatenate([open_gaps, np.ones(len(refined.direction), dtype=bool)])[order]
    return paths


def _prepare(
    arm: Arm, start: npt.ArrayLike, direction: Floats, rules: Rules, limits: npt.ArrayLike | None
) -> tuple[Floats, Floats, complex, LineOptions]:
    """Return start, limits, the tip's start position, and the options of the lines.

    Raises:
        ValueError: the start lies outside the limits or the table, or shapes do not fit.
    """
    start = np.asarray(start, dtype=float)
    if start.shape != (3 + arm.n,) or not np.isfinite(start).all():
        raise ValueError(f"start is {start.tolist()}, expected {3 + arm.n} finite numbers")
    bounds = checked_limits(arm, limits)
    for i, (q, (low, high)) in enumerate(zip(start[3:], bounds, strict=True), 1):
        if not low <= q <= high:
            raise ValueError(f"joint {i} starts at {angle_beyond(q, low, high)}")
    x, y, _ = tip_pose(arm.vector(), start)
    low_x, low_y, high_x, high_y = rules.table_corners
    if not (low_x <= x <= high_x and low_y <= y <= high_y):
        raise ValueError(f"the tip starts at ({x:.4g}, {y:.4g}) m, expected on the table")
    direction_vector = np.stack([np.cos(direction), np.sin(direction)], axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        room = (
            np.where(direction_vector > 0.0, [high_x - x, high_y - y], [low_x - x, low_y - y])
            / direction_vector
        )
    room = np.where(np.abs(direction_vector) > 1e-12, room, inf).min(axis=-1)
    dx, dy = direction_vector.T
    options = LineOptions(
        dx, dy, BASES.index(rules.base), RULES.index(rules.redundancy), rules.gain, rules.step, room
    )
    return start, bounds, complex(x, y), options


def concatenate(one: Paths, other: Paths) -> Paths:
    """Concatenate two sets of paths."""
    parts: dict[str, Any] = {
        name: np.concatenate([getattr(one, name), getattr(other, name)]) for name in _PATH_FIELDS
    }
    return replace(one, **parts)
