"""Stop base, arm and held target, with references that joints and valves can follow.

Before and after the base brakes, the base coasts for a while with the valves closed. A push that is
measured then comes from a leaking valve, and not from a wrong mass of the held target.
"""

import numpy as np

from fss_arm_model.arrays import Floats
from fss_arm_model.held import Target, payload_pose, with_payload
from fss_gnc.guidance.abort import JOINT_REST_RATE, Abort, JointStop
from fss_gnc.guidance.activity import Commands, Craft, HeldBody, Observation, Outcome
from fss_gnc.guidance.mission_monitor import MissionMonitor
from fss_gnc.guidance.stopping import Grip, braking, grip_of
from fss_gnc.reference import Path

REST_TIME = 2.0  # time for which everything must be at rest [s]
COAST_TIME = 2.5  # time of coasting, valves closed, before and after the braking [s]


class Detumble:
    """Activity that stops base, arm and held target.

    Args:
        craft: base and arm.
        monitor: limits of the mission that it ends; None: it is a mission by itself.
    """

    def __init__(self, craft: Craft, monitor: MissionMonitor | None = None) -> None:
        self.craft = craft
        self.settings = settings = craft.settings
        self.p = craft.arm.vector()
        torques = np.array([link.drive.max_torque for link in craft.arm.links])
        self.joints = JointStop(settings.torque_share * torques)
        self.monitor = monitor or MissionMonitor(craft)
        self.abort: Abort | None = None
        self.twist = np.full(3, np.nan)  # of the base
        self._path: Path | None = None
        self._grip: Grip | None = None  # None: nothing is held, or the held body is not known yet
        self._used_estimate: HeldBody | None = None  # estimate that p contains
        self._start = self._last_motion = np.nan
        self._joint_rest_start, self._coast_start = np.inf, np.inf  # [s]

    def tolerates(self, obs: Observation) -> bool:
        """Return True: it aborts by itself, or continues, if base or joints are unknown."""
        return True

    def step(self, obs: Observation) -> Commands:
        """Return the commands until the next step."""
        if np.isnan(self._start):
            self._start = self._last_motion = obs.t
        if self.abort is None:
            reason = self.monitor.abort_reason(
                obs, self._path, "detumble", self.settings.detumble_timeout, self._start
            )
            if reason:
                self.cancel(reason)
        if self.abort is not None:
            return self.abort.step(obs)
        q, qd = obs.floating_state
        self.twist = qd[:3]
        if obs.holds and obs.held_body is not None and obs.held_body is not self._used_estimate:
            self._use_held_body(*obs.held_body)
            self._used_estimate = obs.held_body
            self._path = self._path if self._is_at_rest(qd) else None  # planned for another mass
        elif obs.holds and obs.target is not None and self._grip is None:
            self._use_held_body(self.settings.target, payload_pose(self.p, q, obs.target.pose))
        rates = self.joints.rates(self.p, obs, self._grip)
        if not rates.any() and np.abs(qd[3:]).max() < JOINT_REST_RATE:
            self._joint_rest_start = min(self._joint_rest_start, obs.t)
        if self._path is None and obs.t >= self._joint_rest_start + COAST_TIME:
            # The joints no longer move the base: its twist is what the valves must remove.
            self._path = braking(self.p, q, qd, self.settings, obs.t)
        if self._path is None or not self._is_at_rest(qd):
            self._last_motion = obs.t
        if (
            self._path is not None
            and obs.t - max(self._last_motion, self._path.end_time) >= REST_TIME
        ):
            self._coast_start = min(self._coast_start, obs.t)
        if obs.t < self._coast_start:
            return Commands("detumble", self._path, rates)
        if obs.unknown_push:
            self.cancel("an unknown force pushes the base")
            return self.step(obs)
        is_done = obs.t - self._coast_start >= COAST_TIME
        return Commands("detumble", None, rates, outcome=Outcome(True) if is_done else None)

    def _use_held_body(self, body: Target, place: Floats) -> None:
        self.p = with_payload(self.craft.arm.vector(), body, place)
        self._grip = grip_of(self.settings, body, place)
        self.monitor.use_held_body(self.p, place)

    def cancel(self, reason: str) -> None:
        """Abort the mission."""
        self.abort = self.abort or Abort(self.craft, reason)

    interrupt = cancel

    def _is_at_rest(self, qd: Floats) -> bool:
        s = self.settings
        return bool(
            np.hypot(*qd[:2]) < s.rest_speed
            and abs(qd[2]) < s.rest_turn_rate
            and np.abs(qd[3:]).max() < JOINT_REST_RATE
        )
