"""Stop base, arm and held target, with references that joints and valves can follow.

Before and after the base brakes, the base coasts for a while with the valves closed. A push that is
measured then comes from a leaking valve, and not from a wrong mass of the held target.
"""

import numpy as np
import numpy.typing as npt

from fss_arm_model.held import hold, with_held
from fss_gnc.guidance.abort import Abort, Stopping
from fss_gnc.guidance.activity import Craft, Ended, Held, Orders, Seen
from fss_gnc.guidance.rest import braking
from fss_gnc.guidance.watch import Watch
from fss_gnc.reference import Path

Floats = npt.NDArray[np.float64]

ARM_STILL = 0.01  # rate of a joint below which the base is slowed down [rad/s]
CALM = 2.0  # time for which everything must be at rest [s]
LEFT = 2.5  # time of coasting, valves closed, before and after the braking [s]


class Detumble:
    """Activity that stops base, arm and held target.

    Args:
        craft: whose base and arm.
    """

    blind = True

    def __init__(self, craft: Craft) -> None:
        self.craft = craft
        self.settings = settings = craft.settings
        self.p = craft.arm.vector()
        torques = np.array([link.drive.max_torque for link in craft.arm.links])
        self.joints = Stopping(settings.torque_share * torques)
        self.watch = Watch(craft)
        self.abort: Abort | None = None
        self.twist = np.full(3, np.nan)  # of the base
        self._path: Path | None = None
        self._held = False
        self._known: Held | None = None  # held target as measured
        self._begun = self._moving = np.nan
        self._resting, self._left = np.inf, np.inf  # start of the joints' rest, start of coasting

    def step(self, seen: Seen) -> Orders:
        """Return the orders for now."""
        if np.isnan(self._begun):
            self._begun = self._moving = seen.t
        if self.abort is None:
            reason = self.watch.reason(
                seen, self._path, "detumble", self.settings.detumble_timeout, self._begun
            )
            if reason:
                self.cancel(reason)
        if self.abort is not None:
            return self.abort.step(seen)
        q, qd = seen.floating
        self.twist = qd[:3]
        if seen.holds and seen.held is not None and seen.held is not self._known:
            self.p, self._held = with_held(self.craft.arm.vector(), *seen.held), True
            self._known = seen.held
            self._path = self._path if self._is_still(qd) else None  # planned for another mass
        elif seen.holds and seen.target is not None and not self._held:
            place = hold(self.p, q, seen.target.pose)
            self.p, self._held = with_held(self.p, self.settings.target, place), True
        rates = self.joints.rates(self.p, seen)
        if not rates.any() and np.abs(qd[3:]).max() < ARM_STILL:
            self._resting = min(self._resting, seen.t)
        if self._path is None and seen.t >= self._resting + LEFT:
            # The joints' effect on the base ended with their motion; the rest is momentum.
            self._path = braking(self.p, q, qd, self.settings, seen.t)
        if self._path is None or not self._is_still(qd):
            self._moving = seen.t
        if self._path is not None and seen.t - max(self._moving, self._path.end) >= CALM:
            self._left = min(self._left, seen.t)
        if seen.t < self._left:
            return Orders("detumble", self._path, rates)
        if seen.pushed:
            self.cancel("something pushes that is not known")
        over = seen.t - self._left >= LEFT
        return Orders("detumble", None, rates, ended=Ended(True) if over else None)

    def cancel(self, reason: str) -> None:
        """Abort the mission."""
        self.abort = self.abort or Abort(self.craft, reason)

    def _is_still(self, qd: Floats) -> bool:
        s = self.settings
        return bool(
            np.hypot(*qd[:2]) < s.still
            and abs(qd[2]) < s.turning_still
            and np.abs(qd[3:]).max() < s.turning_still
        )
