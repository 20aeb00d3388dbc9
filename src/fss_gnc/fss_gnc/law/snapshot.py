"""Inputs of a law at one time, from the newest message of each topic."""

from math import cos, sin
from typing import NamedTuple

import numpy as np

from fss_arm_model.arrays import Floats
from fss_arm_model.units import SECOND
from fss_gnc.latest import Latest, body_at
from fss_gnc.law.contract import VALVES, Flags, Inputs
from fss_gnc.reference import Body, Path, Reference

MAX_AGE = 0.5  # largest age of the states of base, target and joints [s]
MAX_TRAJECTORY_AGE = 1.0  # time for which base/trajectory is valid after it was received [s]
MAX_TELEMETRY_AGE = 2.0  # largest age of a report that a board is armed [s]


class ValveHealth(NamedTuple):
    """Valves that do not follow their commands, (8,) each."""

    stuck_open: Flags
    stuck_closed: Flags


class Snapshot:
    """Newest states and reference; base, target and joints are extrapolated to a common time.

    Without a valid base/trajectory, the reference is the base's pose at the first step without
    one, at rest.

    Args:
        joints: number of joints.
        period: nominal time between two steps [s].
    """

    def __init__(self, joints: int, period: float) -> None:
        self.n, self.period = joints, period
        self.base = Latest[Body]("base/state", MAX_AGE)
        self.covariance = np.zeros((6, 6))  # of the base's pose and twist in the world
        self.joints = Latest[Floats]("arm/joint_states", MAX_AGE)  # (3, n) q, qd, effort
        self.target = Latest[Body]("target/state", MAX_AGE)
        #: Time at which the path starts [ns], and the path; None: the valves stay closed.
        self.trajectory = Latest[tuple[int, Path | None]]("base/trajectory", MAX_TRAJECTORY_AGE)
        self.valves_armed = Latest[bool]("base/telemetry", MAX_TELEMETRY_AGE)
        self.links_armed = [
            Latest[bool](f"link_{i}/telemetry", MAX_TELEMETRY_AGE) for i in range(1, joints + 1)
        ]
        self.health = ValveHealth(np.zeros(VALVES, dtype=bool), np.zeros(VALVES, dtype=bool))
        self.propellant: float | None = None  # [kg]
        self._hold: Reference | None = None
        self._start: int | None = None  # time of the first inputs [ns]

    def problem(self, now: int) -> str:
        """Return why there are no inputs at `now` [ns]; empty if there are."""
        trajectory = self.trajectory.valid_value(now)
        coasting = "base/trajectory has no points" if trajectory and not trajectory[1] else ""
        return self.base.problem(now) or self.joints.problem(now) or coasting

    def disarmed(self, now: int) -> str:
        """Return which boards do not report that they are armed, for a status; empty: none."""
        links = [str(i) for i, one in enumerate(self.links_armed, 1) if not one.valid_value(now)]
        found = [] if self.valves_armed.valid_value(now) else ["the base's board"]
        found += [f"links {', '.join(links)}"] if links else []
        return f"; disarmed: {' and '.join(found)}" if found else ""

    def at(self, now: int) -> Inputs | None:
        """Return the inputs at `now` [ns]; None: base or joints are unknown, or the base coasts."""
        base, target, joints = body_at(self.base, now), body_at(self.target, now), self.joints.value
        if self.trajectory.valid_value(now):
            self._hold = None
        if self.problem(now) or base is None or joints is None:
            return None
        self._start = now if self._start is None else self._start
        reference = self._reference(base, now)
        q, qd, _ = joints
        return Inputs(
            joints=self.n,
            time=(now - self._start) / SECOND,
            period=self.period,
            base_pose=base.pose,
            base_twist=base.twist,
            base_covariance=self.covariance.ravel(),
            base_age=self.base.age(now),
            joint_angles=q + self.joints.age(now) * qd,
            joint_rates=qd,
            reference_pose=reference.pose,
            reference_twist=reference.twist,
            reference_acceleration=reference.acceleration,
            valves_armed=bool(self.valves_armed.valid_value(now)),
            joints_armed=np.array([bool(one.valid_value(now)) for one in self.links_armed]),
            valves_stuck_open=self.health.stuck_open,
            valves_stuck_closed=self.health.stuck_closed,
            target_pose=target and target.pose,
            target_twist=target and target.twist,
            propellant=self.propellant,
        )

    def _reference(self, base: Body, now: int) -> Reference:
        if (trajectory := self.trajectory.valid_value(now)) and trajectory[1]:
            return trajectory[1].at((now - trajectory[0]) / SECOND)
        self._hold = self._hold or Reference.at_rest(base.pose)
        return self._hold


def world_covariance(pose_covariance: Floats, twist_covariance: Floats, heading: float) -> Floats:
    """Return the covariance (6, 6) of pose and twist in the world's axes; m, rad, m/s, rad/s.

    Pose and twist are taken as uncorrelated.

    Args:
        pose_covariance: (3, 3) of the pose in the world.
        twist_covariance: (3, 3) of the twist along the body's axes.
        heading: of the body [rad].
    """
    c, s = cos(heading), sin(heading)
    to_world = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    whole = np.zeros((6, 6))
    whole[:3, :3], whole[3:, 3:] = pose_covariance, to_world @ twist_covariance @ to_world.T
    return whole
