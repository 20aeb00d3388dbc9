"""Limits that abort a mission, checked in every step."""

import numpy as np

from fss_arm_model.arrays import Floats
from fss_gnc.guidance.activity import Craft, Observation, tracking_problem
from fss_gnc.guidance.drift import DriftPredictor
from fss_gnc.reference import Path, pose_error

BRAKING_TIME = 6.0  # time in which the valves stop the base [s]
MAX_OVERLOAD_TIME = 0.3  # time for which a torque may exceed its limit [s]
UNKNOWN_PUSH_TIMEOUT = 8.0  # longest unknown push, as of a valve that does not open [s]


class MissionMonitor:
    """Monitor of the limits of one mission."""

    def __init__(self, craft: Craft) -> None:
        self.settings = settings = craft.settings
        self.predictor = DriftPredictor(craft.arm.vector(), settings)
        self._initial_propellant = np.nan  # propellant at the start [kg]
        self._overload_start: float | None = None  # since when a torque exceeds its limit [s]
        self._push_start = np.inf  # since when there is an unknown push [s]

    def use_held_body(self, p: Floats, place: Floats) -> None:
        """Include a held target in the predictions.

        Args:
            p: (8 + 6 n,) Arm.vector(), with the held target.
            place: (3,) of the target in the last link's frame (held.py).
        """
        self.predictor = DriftPredictor(p, self.settings, place)

    def abort_reason(
        self, obs: Observation, path: Path | None, phase: str, timeout: float, phase_start: float
    ) -> str:
        """Return why the mission must be aborted; empty if it need not be.

        Args:
            obs: state now.
            path: reference of the base; None: it drifts.
            phase: name of the present phase.
            timeout: longest duration of the phase [s].
            phase_start: start of the phase [s].
        """
        s = self.settings
        if obs.open_valves:
            return f"valve {' and '.join(map(str, obs.open_valves))} does not close"
        if obs.base is None:
            return "base/state is not known"
        if obs.q is None or obs.qd is None:
            return "arm/joint_states are not known"
        if obs.t - phase_start > timeout:
            return f"phase {phase} took longer than its timeout of {timeout:g} s"
        q, qd = obs.floating_state
        target = None if obs.target is None or obs.holds else obs.target.pose
        edge_gap, target_gap = self.predictor.clearances(q, target)
        if edge_gap < s.min_edge_gap:
            return f"table's edge is {edge_gap:.4f} m away, expected at least {s.min_edge_gap:g} m"
        if target_gap < s.min_target_gap:
            return f"target is {target_gap:.4f} m away, expected at least {s.min_target_gap:g} m"
        self._push_start = min(self._push_start, obs.t) if obs.unknown_push else np.inf
        if path is not None:
            if obs.t - self._push_start > UNKNOWN_PUSH_TIMEOUT:
                return "an unknown force pushes the base"
            offset = pose_error(obs.base.pose, path.at(obs.t).pose)
            if problem := tracking_problem(obs, offset, s):
                return problem
            drift = self.predictor.predict(q, qd, None, BRAKING_TIME)
            if drift.edge < 0.0:
                return f"base would drift into the table's edge within {BRAKING_TIME:g} s"
        return self._propellant_problem(obs) or self._torque_problem(obs)

    def _propellant_problem(self, obs: Observation) -> str:
        if np.isnan(self._initial_propellant):
            self._initial_propellant = obs.propellant
        used = self._initial_propellant - obs.propellant
        if used > self.settings.max_propellant:
            limit = 1e3 * self.settings.max_propellant
            return f"{1e3 * used:.1f} g of propellant used, expected at most {limit:g} g"
        return ""

    def _torque_problem(self, obs: Observation) -> str:
        if obs.effort is None:
            return ""
        torques = np.nan_to_num(np.abs(obs.effort))
        joint = int(torques.argmax())
        torque = float(torques[joint])
        if torque <= self.settings.max_torque:
            self._overload_start = None
        elif self._overload_start is None:
            self._overload_start = obs.t
        elif obs.t - self._overload_start > MAX_OVERLOAD_TIME:
            limit = self.settings.max_torque
            return (
                f"torque of joint {joint + 1} is {torque:.2f} N m, expected at most {limit:g} N m"
            )
        return ""
