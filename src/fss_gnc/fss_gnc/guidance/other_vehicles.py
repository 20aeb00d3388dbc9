"""Other vehicles on the table: predicted motion, and the gap between it and a motion of the base.

The extent of a vehicle is its outline, a convex polygon around base, arm and held target with the
present joint angles, which moves with the base. The gap between two outlines is

    gap = max_u (min_w <u, w> - max_v <u, v>)

over the normals u of all sides, the vertices v of the outline with that side and the vertices w of
the other. It never exceeds their distance, because a line that separates two outlines proves that
they are at least that far apart, and is their distance unless two corners face each other.

A vehicle that drifts keeps its twist. One that follows a plan keeps to it, with its present offset
from it. A silent vehicle may do both, and its uncertainty grows with the time since its last state,
because its plan may change.

Right of way: the vehicle that comes first in the list. A vehicle that cannot give way, because it
holds its place or drifts, has it before all others. Silence changes nothing: a silent vehicle may
still receive, and if each gave way to the other, neither would move as predicted. For the same
reason, the growth does not count against an announced plan that the silent vehicle must give way
to: its own changes keep clear of that plan.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from fss_arm_model.arrays import Complexes, Floats
from fss_arm_model.extents import Extents
from fss_arm_model.held import payload_positions
from fss_arm_model.kinematics import joint_positions
from fss_arm_model.units import SECOND
from fss_gnc.reference import Body, Path

SIDES = 24  # of an outline
DIRECTIONS = np.exp(2j * np.pi * np.arange(SIDES) / SIDES)
SILENCE = 2.0  # age of a state or plan after which it is not continued [s]
SPEED_DEVIATION = 0.002  # standard deviation of the speed of a silent vehicle [m/s]
SIGMAS = 3.0  # standard deviations of a position that a vehicle keeps clear of
SHRINK_TOLERANCE = 1e-3  # allowed decrease of a gap that is too small already [m]
MIN_HORIZON = 10.0  # of a prediction [s]
MAX_PLAN_DURATION = 120.0  # longest announced plan [s]
MAX_SAMPLES = 240  # of a prediction, at first one per second
MONITORED_SHARE = 0.5  # of the gap for which a motion is planned; below it the motion is changed
POSE_SPACING = 2.0  # between the poses of an announced plan [s]
REACTION_TIME = 3.0  # extra time to stop before a vehicle that does not give way [s]


def outline(
    p: Floats,
    q_m: Floats,
    extents: Extents,
    held: Floats | None = None,
    held_radius: float = 0.0,
) -> Complexes:
    """Return the outline of base and arm in the base's axes, (SIDES,), counter-clockwise.

    Args:
        p: (8 + 6 n,) Arm.vector().
        q_m: (n,) joint angles.
        extents: radii of base and links.
        held: (3,) place of a held target in the last link's frame (held.py); None: none is held.
        held_radius: its radius [m].
    """
    q = np.concatenate([np.zeros(3), q_m])
    joints = joint_positions(p, q)
    places = [0j, *(joints @ [1.0, 1j])]
    radii = [extents.base_radius, *len(joints) * [extents.link_radius]]
    if held is not None:
        places.append(complex(*payload_positions(p, q, held)))
        radii.append(held_radius)
    reach = np.real(np.conj(DIRECTIONS) * np.array(places)[:, None]) + np.array(radii)[:, None]
    h, turn = reach.max(axis=0), 2.0 * np.pi / SIDES
    corner = (np.roll(h, -1) - h * np.cos(turn)) / np.sin(turn)  # along the side of direction u
    return np.asarray(DIRECTIONS * (h + 1j * corner))


def normals(outline: Complexes) -> Complexes:
    """Return the outward unit normals of the sides of an outline, (k,)."""
    sides = np.roll(outline, -1) - outline
    lengths = np.abs(sides)
    return np.asarray(-1j * sides[lengths > 0.0] / lengths[lengths > 0.0])


def outline_gap(one: Complexes, poses: Floats, other: Complexes, other_poses: Floats) -> Floats:
    """Return the gap between two outlines at poses (m, 3), (m,) [m]; negative: they overlap."""
    return np.maximum(
        _separation(one, poses, other, other_poses), _separation(other, other_poses, one, poses)
    )


def _separation(one: Complexes, poses: Floats, other: Complexes, other_poses: Floats) -> Floats:
    """Return the largest gap along the normals of the first outline's sides, (m,) [m]."""
    u = normals(one)
    h = np.real(np.conj(u)[:, None] * one).max(axis=1)
    between = (other_poses - poses)[:, :2] @ [1.0, 1j]
    seen = between[:, None] + other * np.exp(1j * other_poses[:, 2:])
    seen = seen * np.exp(-1j * poses[:, 2:])  # vertices of the other in the axes of the first
    along = seen.real[:, None] * u.real[:, None] + seen.imag[:, None] * u.imag[:, None]
    return np.asarray((along.min(axis=-1) - h).max(axis=1))


class Prediction(NamedTuple):
    """Predicted motion of a vehicle."""

    poses: Floats  # (m, 3)
    deviation: Floats  # (m,) standard deviation of the position [m]


@dataclass(frozen=True)
class OtherVehicle:
    """Another vehicle as last received."""

    name: str
    precedes: bool  # True if it comes before this vehicle in the list
    body: Body  # last state
    outline: Complexes  # vertices in its base's axes, counter-clockwise [m]
    age: float = 0.0  # of the state [s]
    deviation: float = 0.0  # standard deviation of its position [m]
    speed_deviation: float = 0.0  # and of its speed [m/s]
    plan: Path | None = None  # by the time from now; None: it drifts
    growth: float = SPEED_DEVIATION  # of its deviation while it is silent [m/s]

    @property
    def is_silent(self) -> bool:
        """True if no state has arrived for a while."""
        return self.age > SILENCE

    @property
    def can_give_way(self) -> bool:
        """True if it follows a plan that it can change; a silent vehicle may do so as well."""
        return self.plan is not None and self.plan.end_time > 0.0

    @property
    def must_give_way(self) -> bool:
        """True if it must change its plan in a conflict, and not this vehicle."""
        return self.can_give_way and not self.precedes

    def predict(self, ahead: Floats) -> list[Prediction]:
        """Return each motion that it may make, at times from now (m,) [s]."""
        since = (self.age + ahead)[:, None]
        growth = self.growth * since[:, 0] if self.is_silent else np.zeros(len(ahead))
        found = []
        if self.plan is not None:
            offset = self.body.pose - self.plan.at(-self.age).pose
            offset[2] = np.remainder(offset[2] + np.pi, 2.0 * np.pi) - np.pi
            poses = self.plan.states(ahead)[:, 0] + offset
            found.append(Prediction(poses, np.hypot(self.deviation, growth)))
        if self.plan is None or self.is_silent:
            drift = np.hypot(self.speed_deviation * since[:, 0], growth)
            poses = self.body.pose + since * self.body.twist
            found.append(Prediction(poses, np.hypot(self.deviation, drift)))
        return found


class Conflict(NamedTuple):
    """Approach to another vehicle that is too close."""

    vehicle: OtherVehicle
    ahead: float  # time from now at which the gap first becomes too small [s]
    gap: float  # smallest gap [m]


def gap_excess(
    own: Complexes, ahead: Floats, poses: Floats, other: OtherVehicle, margin: float
) -> tuple[Floats, Floats]:
    """Return the gap to another vehicle, and its excess over the required gap, (m,) each [m].

    A gap that is too small at the start must not become smaller. Where the vehicles are far from
    each other, the gap is that of discs around them.

    Args:
        own: outline of this vehicle.
        ahead: (m,) times from now [s]; the first is 0.
        poses: (m, 3) of its base then.
        other: the other vehicle.
        margin: smallest gap to where it is within SIGMAS standard deviations [m].
    """
    gaps, excesses = [], []
    radii = np.abs(own).max() + np.abs(other.outline).max()
    for other_poses, deviation in other.predict(ahead):
        needed = margin + SIGMAS * deviation
        gap = np.hypot(*(other_poses - poses)[:, :2].T) - radii  # at least
        near = gap < needed
        near[0] = True
        gap[near] = outline_gap(own, poses[near], other.outline, other_poses[near])
        needed = np.minimum(needed, gap[0] - SHRINK_TOLERANCE)
        gaps.append(gap)
        excesses.append(gap - needed)
    return np.min(gaps, axis=0), np.min(excesses, axis=0)


def conflicts(
    own: Complexes, ahead: Floats, poses: Floats, others: Iterable[OtherVehicle], margin: float
) -> list[Conflict]:
    """Return a conflict with each vehicle that a motion comes too close to, the first one first.

    Args:
        own: outline of this vehicle.
        ahead: (m,) times from now [s].
        poses: (m, 3) of its base then.
        others: the other vehicles.
        margin: smallest gap [m].
    """
    found = []
    for other in others:
        gap, excess = gap_excess(own, ahead, poses, other, margin)
        if (close := np.flatnonzero(excess < 0.0)).size:
            found.append(Conflict(other, float(ahead[close[0]]), float(gap.min())))
    return sorted(found, key=lambda conflict: conflict.ahead)


def path_conflicts(
    own: Complexes, path: Path, t: float, others: Sequence[OtherVehicle], margin: float
) -> list[Conflict]:
    """Return the conflicts of a path from its time t on, and of staying at its end.

    The prediction covers the path and the plans of all others.
    """
    ends = [other.plan.end_time for other in others if other.plan is not None]
    horizon = max(path.end_time - t, MIN_HORIZON, *ends)
    ahead = np.linspace(0.0, horizon, min(int(np.ceil(horizon)), MAX_SAMPLES) + 1)
    return conflicts(own, ahead, path.states(t + ahead)[:, 0], others, margin)


def gives_way(conflict: Conflict, stopping_time: float = 0.0) -> bool:
    """Return True if this vehicle must resolve a conflict; otherwise the other one does.

    Args:
        conflict: the conflict.
        stopping_time: that this vehicle needs to come to rest [s]; it also brakes when a vehicle
            that should give way has not done so in time.
    """
    return not conflict.vehicle.must_give_way or conflict.ahead < stopping_time


def facing_announced_plan(others: Iterable[OtherVehicle]) -> tuple[OtherVehicle, ...]:
    """Return the vehicles as they move beside a plan that was announced to them.

    Those that must give way to it do not grow uncertain while they are silent.
    """
    return tuple(replace(one, growth=0.0) if one.must_give_way else one for one in others)


def announced(path: Path, t: float) -> Path:
    """Return a path from its time t on in the announced form: poses by the time from now."""
    length = min(max(path.end_time - t, 0.0), MAX_PLAN_DURATION)
    ahead = np.linspace(0.0, length, int(np.ceil(length / POSE_SPACING)) + 1)
    return Path(ahead, path.states(t + ahead)[:, :1])


class VehicleTrack:
    """Newest state, plan and outline that another vehicle has published.

    Args:
        name: of the vehicle.
        precedes: True if it comes before this vehicle in the list.
    """

    def __init__(self, name: str, precedes: bool) -> None:
        self.name, self.precedes = name, precedes
        self.outline: Complexes | None = None
        self._state: tuple[int, Body, float, float] | None = None  # with its stamp [ns]
        self._plan: tuple[int, Path | None] = (0, None)  # with its stamp, the origin of its times

    def store_state(self, stamp: int, body: Body, deviation: float, speed_deviation: float) -> None:
        """Store a state [ns] with standard deviations of position [m] and speed [m/s]."""
        self._state = stamp, body, deviation, speed_deviation

    def store_plan(self, stamp: int, path: Path | None) -> None:
        """Store a plan by the time since its stamp [ns]; None: the vehicle drifts."""
        self._plan = stamp, path

    def predicted(self, now: int) -> OtherVehicle | None:
        """Return the vehicle at `now` [ns]; None until its state and outline are known."""
        if self._state is None or self.outline is None:
            return None
        stamp, body, deviation, speed_deviation = self._state
        age = (now - stamp) / SECOND
        since, plan = (now - self._plan[0]) / SECOND, self._plan[1]
        if plan is not None and since > SILENCE and age <= SILENCE:
            plan = None  # its guidance has ended, so that its valves are closed
        if plan is not None:
            plan = Path(plan.times - since, plan.knots)
        return OtherVehicle(
            self.name, self.precedes, body, self.outline, age, deviation, speed_deviation, plan
        )
