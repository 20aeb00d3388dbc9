"""Abort of a mission: valves closed, joints at rest, and a drift without collision.

The thrusters are used for one purpose only. If base and arm would drift into target or vehicle, or
to the table's edge, within the horizon, a short push gives them the safe motion that needs the
least push. The joints stop first, because stopping them changes the drift. The thrusters are not
used while the base is unknown, or while it is unknown whether the gripper holds the target. They
may be used once both are known again.

Joints that no longer send readings are assumed to rest at their last angles after a while,
because links stop without commands; this does not apply while a target is held. Joints with
readings slow down within their torque limits, and those of the grip. The gripper keeps a held
target, which would otherwise tumble beside the arm. If it holds none, it opens.

If a valve does not close, no drift is safe. The base then comes to rest at a place with free space
around it, and is held there until the gas is used up. That is known from the tank's sensor, or else
from the valves no longer holding the base.
"""

import numpy as np

from fss_arm_model.arrays import Floats
from fss_arm_model.held import payload_pose, with_payload
from fss_gnc.guidance.activity import Commands, Craft, Observation, Outcome
from fss_gnc.guidance.drift import Drift, DriftPredictor
from fss_gnc.guidance.limits import min_duration
from fss_gnc.guidance.stopping import Grip, braking, grip_of, joint_stop_time
from fss_gnc.reference import Body, Path, Reference, pose_error

SAFE_DRIFT_TIME = 3.0  # time with a safe drift and joints at rest before the abort ends [s]
UNKNOWN_STATE_TIMEOUT = 30.0  # longest time without a known base [s]
JOINT_REST_RATE = 0.01  # rate below which a joint is at rest [rad/s]
JOINT_STOP_MARGIN = 2.0  # extra time for joints to stop; silent joints count as stopped then [s]
EMPTY_TANK_MASS = 5e-4  # mass of propellant below which the valves have no effect [kg]
LEAK_CHECK_PERIOD = 60.0  # time to hold the base until the valve leak is checked again [s]


class Abort:
    """Activity that aborts a mission.

    If it is requested as its own mission, it succeeds if the drift is safe.

    Args:
        craft: base and arm.
        reason: why it aborts.
        requested: True if the operator requested it, False if it ends another mission.
    """

    def __init__(self, craft: Craft, reason: str, requested: bool = False) -> None:
        self.p, self.reason, self.requested = craft.arm.vector(), reason, requested
        self.settings = settings = craft.settings
        self.torques = settings.torque_share * np.array(
            [link.drive.max_torque for link in craft.arm.links]
        )
        self.joints = JointStop(self.torques)
        self.drift: Drift | None = None
        self._push: Path | None = None
        self._thrust_until = -np.inf  # until when it pushes or holds the base [s]
        self._valve_leaks = False
        self._hold_lost = False  # True if the valves no longer hold the base at its place
        self._held_place: Floats | None = None  # place of the target in the gripper (held.py)
        self._grip: Grip | None = None  # None: the held body is not known yet
        self._last_known = self._unsafe_until = np.nan  # [s]; NaN: not yet
        self._last_joint_reading = np.nan  # time of the last joint readings, or of the start [s]

    def tolerates(self, obs: Observation) -> bool:
        """Return True: it aborts by itself, or continues, if base or joints are unknown."""
        return True

    def step(self, obs: Observation) -> Commands:
        """Return the commands until the next step."""
        if np.isnan(self._last_known):
            self._last_known = self._unsafe_until = self._last_joint_reading = obs.t
        if obs.holds and self._held_place is None:
            self._use_held_body(obs)
        rates = self.joints.rates(self.p, obs, self._grip)
        path, outcome = self._plan_path(obs), self._outcome(obs)
        return Commands("abort", path, rates, obs.keep_gripper, reason=self.reason, outcome=outcome)

    def cancel(self, reason: str) -> None:
        """Ignore a cancel request, because nothing is safer than the abort."""

    interrupt = cancel

    @property
    def safe(self) -> bool:
        """True if no collision is predicted within the horizon, as far as that is known."""
        return self.drift is not None and self.drift.safe

    @property
    def target_clearance(self) -> float:
        """Least distance to the target within the horizon [m]; NaN if there is no target."""
        known = self.drift is not None and np.isfinite(self.drift.target)
        return self.drift.target if self.drift is not None and known else np.nan

    def _use_held_body(self, obs: Observation) -> None:
        """Add the held body to the last link: as navigation measured it, else as described."""
        if obs.held_body is not None:
            body, self._held_place = obs.held_body
        elif obs.target is not None and obs.base is not None and obs.q is not None:
            body, q = self.settings.target, np.concatenate([obs.base.pose, obs.q])
            self._held_place = payload_pose(self.p, q, obs.target.pose)
        else:
            return
        self.p = with_payload(self.p, body, self._held_place)
        self._grip = grip_of(self.settings, body, self._held_place)

    def _plan_path(self, obs: Observation) -> Path | None:
        q_m = obs.last_q if obs.q is None and not obs.holds else obs.q
        if obs.base is None or q_m is None or obs.holds is None:
            self._push, self._thrust_until = None, -np.inf
            return None
        self._last_known = obs.t
        self._last_joint_reading = self._last_joint_reading if obs.q is None else obs.t
        qd_m = np.zeros(q_m.size) if obs.qd is None else obs.qd
        q, qd = np.concatenate([obs.base.pose, q_m]), np.concatenate([obs.base.twist, qd_m])
        target = None if obs.holds else obs.target
        held_place = self._held_place if obs.holds else None
        drifting = DriftPredictor(self.p, self.settings, held_place, obs.others)
        if np.isnan(obs.propellant) and self._valve_leaks and self._push is not None:
            error = pose_error(obs.base.pose, self._push.at(obs.t).pose)
            is_far = float(np.hypot(*error[:2])) > self.settings.max_offset
            self._hold_lost = self._hold_lost or (is_far and obs.t > self._push.end_time)
        has_gas = not (self._hold_lost or obs.propellant <= EMPTY_TANK_MASS)
        if obs.t < self._thrust_until and has_gas:
            if self._valve_leaks and self._push is not None and obs.t > self._push.end_time:
                self._move_to_refuge(drifting, obs.t, q, target)
            self._unsafe_until = obs.t
            return self._push
        if (
            np.abs(qd_m).max() > JOINT_REST_RATE
            and obs.t < self.joints.end_time + JOINT_STOP_MARGIN
        ):
            return None
        if obs.q is None and obs.t < self._last_joint_reading + JOINT_STOP_MARGIN:
            return None
        self.drift, self._push = drifting.predict(q, qd, target), None
        self._valve_leaks = has_gas and (bool(obs.open_valves) or obs.unknown_push)
        if self._valve_leaks:
            self._push = braking(self.p, q, qd, self.settings, obs.t)
            self._thrust_until = self._push.end_time + LEAK_CHECK_PERIOD
        elif has_gas and not self.drift.safe:
            push = drifting.plan_push(q, qd, target)
            if push.safe or not np.allclose(push.twist, qd[:3], atol=2e-3):
                self._push = braking(self.p, q, qd, self.settings, obs.t, push.twist)
                self._thrust_until = self._push.end_time
        if self._push is not None:
            self._unsafe_until = obs.t
        return self._push

    def _move_to_refuge(
        self, drifting: DriftPredictor, t: float, q: Floats, target: Body | None
    ) -> None:
        """Move on from the place where the base is held, if it cannot stay there."""
        assert self._push is not None
        reference = Reference.at_rest(self._push.knots[-1, 0])
        goal = drifting.find_refuge(np.concatenate([reference.pose, q[3:]]), target)
        if not np.array_equal(goal, reference.pose):
            duration = min_duration(self.settings, reference, goal)
            self._push = Path.between(reference, goal, t, t + duration)
            self._thrust_until = max(self._thrust_until, self._push.end_time)

    def _outcome(self, obs: Observation) -> Outcome | None:
        if obs.qd is not None and np.abs(obs.qd).max() > JOINT_REST_RATE:
            self._unsafe_until = max(self._unsafe_until, obs.t - 0.5 * SAFE_DRIFT_TIME)
        if obs.t - self._last_known > UNKNOWN_STATE_TIMEOUT:
            return Outcome(
                False, f"{self.reason}; valves closed: state of base, joints or gripper unknown"
            )
        if obs.t - self._unsafe_until < SAFE_DRIFT_TIME or self.drift is None or obs.base is None:
            return None
        if self._hold_lost:
            return Outcome(False, f"{self.reason}; the valves no longer hold the base")
        if not self.drift.safe:
            distances = f"{self.drift.edge:.2f} m from the table's edge"
            if np.isfinite(self.drift.target):
                distances = f"{distances} and {self.drift.target:.2f} m from the target"
            if np.isfinite(self.drift.vehicles):
                distances = f"{distances} and {self.drift.vehicles:.2f} m from another vehicle"
            horizon = f"{self.settings.drift_horizon:g} s"
            return Outcome(False, f"{self.reason}; the base drifts to {distances} within {horizon}")
        return Outcome(self.requested, self.reason)


class JointStop:
    """Joint motion that slows down within torque limits (n,) [N m] and the grip's, then holds.

    If the grip becomes known only while the joints slow down, they start again with its limits.
    """

    def __init__(self, torques: Floats) -> None:
        self.torques = torques
        self._start: tuple[float, float, Floats] | None = None  # start, duration and initial rates
        self._has_grip = False  # True if the duration is that for a known grip

    @property
    def end_time(self) -> float:
        """Time at which the joints rest [s]; infinite before they start to slow down."""
        return np.inf if self._start is None else self._start[0] + self._start[1]

    def rates(self, p: Floats, obs: Observation, grip: Grip | None = None) -> Floats:
        """Return the rates of the joints now [rad/s]; they start with the present rates."""
        if obs.q is None or obs.qd is None:
            return np.zeros(self.torques.size)
        is_late_grip = grip is not None and not self._has_grip and obs.t < self.end_time
        if self._start is None or is_late_grip:
            self._has_grip = grip is not None
            twist = np.zeros(3) if obs.base is None else obs.base.twist
            pose = np.zeros(3) if obs.base is None else obs.base.pose
            q, qd = np.concatenate([pose, obs.q]), np.concatenate([twist, obs.qd])
            self._start = obs.t, joint_stop_time(p, q, qd, self.torques, grip), np.array(obs.qd)
        start, duration, rates = self._start
        return rates * max(0.0, 1.0 - (obs.t - start) / duration)
