"""Base, arm and what it holds come to rest, by references that joints and valves can follow."""

import numpy as np
import numpy.typing as npt

from fss_arm_model.held import hold, with_held
from fss_gnc.guidance.abort import Abort, Stopping
from fss_gnc.guidance.activity import Craft, Ended, Orders, Seen
from fss_gnc.guidance.mission_settings import MissionSettings
from fss_gnc.guidance.rest import braking
from fss_gnc.guidance.watch import Watch
from fss_gnc.reference import Path

Floats = npt.NDArray[np.float64]

ARM_STILL = 0.01  # rate of a joint below which the base is slowed down [rad/s]
CALM = 2.0  # for which all must be still [s]


class Detumble:
    """The activity.

    Args:
        craft: whose base and arm.
        settings: of the missions.
        begin: when, by the activity's time [s].
    """

    blind = True

    def __init__(self, craft: Craft, settings: MissionSettings, begin: float = 0.0) -> None:
        self.craft, self.settings, self.begin = craft, settings, begin
        self.p = craft.arm.vector()
        torques = np.array([link.drive.max_torque for link in craft.arm.links])
        self.joints = Stopping(settings.torque_share * torques)
        self.watch = Watch(craft, settings)
        self.abort: Abort | None = None
        self._path: Path | None = None
        self._held = False
        self._moving = begin

    def step(self, seen: Seen) -> Orders:
        """Orders now."""
        if self.abort is None:
            reason = self.watch.reason(seen, self._path, self.settings.detumble_timeout, self.begin)
            if reason:
                self.cancel(reason, seen.t)
        if self.abort is not None:
            return self.abort.step(seen)
        q, qd = seen.floating
        if seen.holds and seen.target is not None and not self._held:
            place = hold(self.p, q, seen.target.pose)
            self.p, self._held = with_held(self.p, self.settings.target, place), True
        rates = self.joints.rates(self.p, seen)
        if self._path is None and not rates.any() and np.abs(qd[3:]).max() < ARM_STILL:
            # What the joints give the base ends with their motion; the rest is momentum.
            self._path = braking(self.p, q, qd, self.settings, seen.t)
        if self._path is None or not self._is_still(qd):
            self._moving = seen.t
        over = self._path is not None and seen.t - max(self._moving, self._path.end) >= CALM
        return Orders("detumble", self._path, rates, ended=Ended(True) if over else None)

    def cancel(self, reason: str, t: float | None = None) -> None:
        """Abort."""
        begin = self.begin if t is None else t
        self.abort = self.abort or Abort(self.craft, self.settings, reason, begin)

    def _is_still(self, qd: Floats) -> bool:
        s = self.settings
        return bool(
            np.hypot(*qd[:2]) < s.still
            and abs(qd[2]) < s.turning_still
            and np.abs(qd[3:]).max() < s.turning_still
        )
