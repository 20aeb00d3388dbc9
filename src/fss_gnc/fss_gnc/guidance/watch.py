"""Limits that abort a mission, checked in every step."""

import numpy as np

from fss_gnc.guidance.activity import Craft, Seen
from fss_gnc.guidance.drift import Drifting
from fss_gnc.reference import Path, off

STOPPED = 6.0  # time in which the valves stop the base [s]
PATIENCE = 0.3  # time for which a torque may exceed its limit [s]
UNNAMED = 8.0  # time to balance an unknown push, as of a valve that does not open [s]


class Watch:
    """Monitor of the limits of one mission."""

    def __init__(self, craft: Craft) -> None:
        self.settings = settings = craft.settings
        self.drifting = Drifting(craft.arm.vector(), settings)
        self._had = np.nan  # propellant at the start [kg]
        self._strained: float | None = None  # since when a torque exceeds its limit [s]
        self._pushed = np.inf  # since when there is an unknown push [s]

    def reason(
        self, seen: Seen, path: Path | None, phase: str, timeout: float, since: float
    ) -> str:
        """Return why the mission must be aborted; empty if it need not be.

        Args:
            seen: state now.
            path: reference of the base; None: it drifts.
            phase: name of the present phase.
            timeout: longest duration of the phase [s].
            since: start of the phase [s].
        """
        s = self.settings
        if seen.open_valves:
            return f"valve {' and '.join(map(str, seen.open_valves))} does not close"
        if seen.base is None:
            return "base/state is not known"
        if seen.q is None or seen.qd is None:
            return "arm/joint_states are not known"
        if seen.t - since > timeout:
            return f"the phase {phase} took more than {timeout:g} s"
        q, qd = seen.floating
        target = None if seen.target is None or seen.holds else seen.target.pose
        edge, apart = self.drifting.clearances(q, target)
        if edge < s.least_edge:
            return f"{edge:.3f} m from the table's edge, at least {s.least_edge:g} m expected"
        if apart < s.least_target:
            return f"{apart:.3f} m from the target, at least {s.least_target:g} m expected"
        self._pushed = min(self._pushed, seen.t) if seen.pushed else np.inf
        if path is not None:
            if seen.t - self._pushed > UNNAMED:
                return "something pushes that is not known"
            x, y, turned = off(seen.base.pose, path.at(seen.t).pose).tolist()
            distance, turn = np.hypot(x, y), abs(turned)
            if distance > s.max_offset or turn > s.max_turn:
                return f"{distance:.3f} m and {np.degrees(turn):.1f} deg off the reference"
            ahead = self.drifting.as_is(q, qd, None, STOPPED)
            if ahead.edge < 0.0:
                return f"drifting, it would touch the table's edge within {STOPPED:g} s"
        return self._spent(seen) or self._strain(seen)

    def _spent(self, seen: Seen) -> str:
        self._had = seen.propellant if np.isnan(self._had) else self._had
        used = self._had - seen.propellant
        if used > self.settings.max_propellant:
            return f"{1e3 * used:.1f} g of propellant used"
        return ""

    def _strain(self, seen: Seen) -> str:
        if seen.effort is None:
            return ""
        torques = np.nan_to_num(np.abs(seen.effort))
        joint = int(torques.argmax())
        torque = float(torques[joint])
        if torque <= self.settings.max_torque:
            self._strained = None
        elif self._strained is None:
            self._strained = seen.t
        elif seen.t - self._strained > PATIENCE:
            most = self.settings.max_torque
            return f"{torque:.2f} N m at joint {joint + 1}, at most {most:g} N m expected"
        return ""
