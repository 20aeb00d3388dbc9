"""Planning of the approach to the stand-off from the fixture (approach_trajectory.py).

The fixture turns with the target. Times of arrival are tried, earliest first. At each, the side is
the one that the fixture then faces. Both directions around the target and several orders of moving
inward and around are tried. The first trajectory is chosen that the valves can produce and that
stays on the table and outside the keep-out zone. It must also do so for a while if all thrust ends
at any point on it (passive safety, as for a visiting vehicle: Fehse, Automated Rendezvous and
Docking of Spacecraft, 2003, section 4.4). It must be clear of other vehicles.
"""

from collections.abc import Iterator, Sequence
from itertools import chain
from math import pi

import numpy as np

from fss_arm_model import layout
from fss_arm_model.arrays import Floats
from fss_arm_model.clearance import gaps, sizes, with_edge, with_target
from fss_arm_model.dynamics import inverse_dynamics
from fss_arm_model.planar import wrap
from fss_gnc.guidance.approach_trajectory import (
    RAMP_TIME,
    ApproachTrajectory,
    RigidCraft,
    Timing,
    propagate_coast,
)
from fss_gnc.guidance.mission_settings import MissionSettings
from fss_gnc.guidance.other_vehicles import (
    MIN_HORIZON,
    Conflict,
    OtherVehicle,
    conflicts,
    outline,
)

MAX_DURATION = 150.0  # of a planned approach [s]


class Planner:
    """Planner of approach trajectories.

    Args:
        p: Arm.vector(), with the present masses.
        settings: of the missions.
    """

    def __init__(self, p: Floats, settings: MissionSettings) -> None:
        self.p, self.settings, self.target = p, settings, settings.target
        n = (p.size - layout.BASE_SIZE) // layout.LINK_SIZE
        self._pairs = np.array([*with_target(n), *with_edge(n)], dtype=float)
        min_gaps = settings.keep_out - settings.target_radius
        self._min_gaps = np.array([min_gaps] * (n + 2) + [settings.approach_edge_gap] * (n + 2))
        self._sizes = sizes(settings, settings.target_radius, settings.gripper_length)

    def standoff_distance(self) -> float:
        """Return the end effector's distance from the target's centre after the approach [m]."""
        return float(abs(complex(*self.target.fixture[:2]))) + self.settings.stand_off

    def fixture_direction(self, heading: float) -> float:
        """Return the fixture's direction from the target's centre, at a target heading [rad]."""
        return heading + float(np.angle(complex(*self.target.fixture[:2])))

    def valve_load(self, q: Floats, qd: Floats, qdd: Floats) -> Floats:
        """Return the share of the valves' authority that the base's motion needs, (k,)."""
        w = inverse_dynamics(self.p, q, qd, qdd)[..., :3]
        return valve_load(w, q[..., 2], self.settings)

    def plan(self, q: Floats, qd: Floats, state: Floats, lead: float) -> ApproachTrajectory | None:
        """Return the quickest trajectory of `search`; None if there is none."""
        return next(
            (trajectory for trajectory in self.search(q, qd, state, lead) if trajectory), None
        )

    def search(
        self,
        q: Floats,
        qd: Floats,
        state: Floats,
        lead: float,
        others: Sequence[OtherVehicle] = (),
    ) -> Iterator[ApproachTrajectory | None]:
        """Yield feasible trajectories of base and arm, the quickest first; None for a failed try.

        Args:
            q: (3 + n,) state; its joints are held.
            qd: (3 + n,) rate of the state; the joints' rates are ignored.
            state: (2, 3) pose and twist of the target.
            lead: time from the end of a trajectory until the fixture faces the arm [s].
            others: the other vehicles at the start.
        """
        body = RigidCraft(self.p, q[3:])
        drift = np.array([*state[1, :2], 0.0])
        relative_pose = np.array([*(q[:2] - state[0, :2]), q[2]])
        initial = body.polar(relative_pose, qd[:3] - drift)
        if initial is None:
            return
        cancels = (True, False) if self.settings.cancel_momentum else (False,)
        for trajectory in chain.from_iterable(
            self._candidates(body, *initial, state, lead, each) for each in cancels
        ):
            yield (
                trajectory
                if self._is_feasible(trajectory)
                and self._is_clear(trajectory, state)
                and not self.conflicts(trajectory, 0.0, state, others, self.settings.vehicle_gap)
                else None
            )

    def _candidates(
        self,
        body: RigidCraft,
        initial: Floats,
        rate: Floats,
        state: Floats,
        lead: float,
        cancels_momentum: bool,
    ) -> Iterator[ApproachTrajectory]:
        distance = self.standoff_distance()
        outer = max(float(initial[0]), distance)
        timings = (
            Timing((0.0, 1.0)), Timing((0.0, 0.6), 0.45, outer), Timing((0.3, 1.0), 0.5, distance),
            Timing((0.0, 0.6), 0.4, outer + 0.3), Timing((0.1, 0.8), 0.2, outer + 0.1),
        )  # fmt: skip
        t = RAMP_TIME if cancels_momentum else 6.0
        final_rate, lag = np.zeros(3), 0.0
        while t < MAX_DURATION:
            facing = self.fixture_direction(float(state[0, 2] + state[1, 2] * (t + lead)))
            if cancels_momentum:
                # The final motion leads to the side where the fixture is while the arm reaches.
                lag = lead * body.canceling_rates(distance, facing, self.target, state)[1]
                final_rate = body.canceling_rates(distance, facing - lag, self.target, state)
            shorter = wrap(facing - initial[1])
            for turn in (shorter, shorter - np.copysign(2.0 * pi, shorter)):
                side = float(initial[1] + turn)
                end = np.array([distance, side - lag, -lead * final_rate[2]])
                for timing in timings:
                    yield ApproachTrajectory(body, initial, rate, end, t, timing, side, final_rate)
            t += max(1.0, 0.05 * t)

    def _is_feasible(self, trajectory: ApproachTrajectory) -> bool:
        points = trajectory.points(np.linspace(0.0, trajectory.duration, 25))
        q, qd, qdd = (self._with_joints(rows, trajectory) for rows in points)
        qd[:, 3:] = qdd[:, 3:] = 0.0
        return bool(self.valve_load(q, qd, qdd).max() <= self.settings.authority)

    def _is_clear(self, trajectory: ApproachTrajectory, state: Floats) -> bool:
        t = np.linspace(0.0, trajectory.duration, 40)[1:]
        relative = trajectory.points(t)
        drift = np.array([*state[1, :2], 0.0])
        target = state[0, :2] + t[:, None] * state[1, :2]
        pose = relative.pose + np.column_stack([target, np.zeros(t.size)])
        # A gap that is too small at the start must not become smaller.
        min_gaps = np.minimum(
            self._min_gaps, self.gaps_at(np.concatenate([pose[0], trajectory.body.q_m]), state[0])
        )
        if (self.gaps_along(pose, trajectory.body, target) < min_gaps - 1e-3).any():
            return False
        for ahead in np.array([0.25, 0.5, 0.75, 1.0]) * self.settings.coast:
            later = propagate_coast(pose, relative.twist + drift, trajectory.body.com, ahead)
            later_target = target + ahead * state[1, :2]
            if (
                self.gaps_along(later, trajectory.body, later_target) < np.minimum(min_gaps, 0.02)
            ).any():
                return False
        return True

    def conflicts(
        self,
        trajectory: ApproachTrajectory,
        since: float,
        state: Floats,
        others: Sequence[OtherVehicle],
        margin: float,
    ) -> list[Conflict]:
        """Return the conflicts with other vehicles of the rest of a trajectory.

        Args:
            trajectory: the approach.
            since: time since its start [s].
            state: (2, 3) pose and twist of the target now.
            others: the other vehicles.
            margin: smallest gap [m].
        """
        if not others:
            return []
        ahead = np.linspace(0.0, max(trajectory.duration - since, MIN_HORIZON), 40)
        target = state[0, :2] + ahead[:, None] * state[1, :2]
        pose = trajectory.points(since + ahead).pose + np.column_stack([target, np.zeros(40)])
        own = outline(self.p, trajectory.body.q_m, self.settings)
        return conflicts(own, ahead, pose, others, margin)

    def gaps_at(self, q: Floats, target: Floats) -> Floats:
        """Return the gaps of all bodies to target and edge, (g,)."""
        return np.asarray(gaps(self.p, q, self._pairs, self._sizes, target[:2]))

    def gaps_along(self, pose: Floats, body: RigidCraft, target: Floats) -> Floats:
        """Return the gaps with the base at poses (k, 3) and the target at (k, 2), (k, g)."""
        q = np.column_stack([pose, np.broadcast_to(body.q_m, (len(pose), body.q_m.size))])
        return np.asarray(gaps(self.p, q, self._pairs, self._sizes, target))

    @staticmethod
    def _with_joints(rows: Floats, trajectory: ApproachTrajectory) -> Floats:
        joints = np.broadcast_to(trajectory.body.q_m, (len(rows), trajectory.body.q_m.size))
        return np.column_stack([rows, joints])


def valve_load(wrench: Floats, heading: Floats, settings: MissionSettings) -> Floats:
    """Return the share of the valves' authority that wrenches (..., 3) in world axes need, (...).

    Four valves of thrust T and lever l push along each axis. Together they can produce

        |f_x|, |f_y| <= 2 T,   |f_x| + |f_y| + |tau| / l <= 4 T
    """
    force = (wrench[..., 0] + 1j * wrench[..., 1]) * np.exp(-1j * heading) / settings.thrust
    x, y = np.abs(force.real), np.abs(force.imag)
    torque = np.abs(wrench[..., 2]) / (settings.thrust * settings.lever)
    return np.asarray(np.maximum(0.5 * np.maximum(x, y), 0.25 * (x + y + torque)))
