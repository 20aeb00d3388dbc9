"""An end that is safe: valves closed, joints held, and a drift that meets nothing.

The thrusters are used for one thing only: if base and arm as they drift would meet the target or
the table's edge within the horizon, a short push gives them the least other motion that does not.
Without knowledge of the base, they are not used at all; once it is known again, they may be. The
joints slow down within their torques. A target that is held stays so: let go, it would tumble
beside the arm; one that is not is let go.
"""

import numpy as np
import numpy.typing as npt

from fss_arm_model.held import hold, with_held
from fss_gnc.guidance.activity import Craft, Ended, Orders, Seen
from fss_gnc.guidance.drift import Drift, Drifting
from fss_gnc.guidance.rest import braking, slowing
from fss_gnc.reference import Path

Floats = npt.NDArray[np.float64]

QUIET = 3.0  # for which the drift must be safe, joints at rest, before it is over [s]
PATIENCE = 30.0  # without knowing the base [s]
STILL = 0.01  # of a joint [rad/s]


class Abort:
    """The activity; asked for as such, it ends well if what drifts is safe.

    Args:
        craft: whose base and arm.
        reason: why.
        asked: for itself, and not as the end of something else.
    """

    blind = True

    def __init__(self, craft: Craft, reason: str, asked: bool = False) -> None:
        self.p, self.reason, self.asked = craft.arm.vector(), reason, asked
        self.settings = settings = craft.settings
        self.torques = settings.torque_share * np.array(
            [link.drive.max_torque for link in craft.arm.links]
        )
        self.joints = Stopping(self.torques)
        self.drift: Drift | None = None
        self._push: Path | None = None
        self._held = False
        self._known = self._quiet = np.nan  # since when; NaN: it has not begun

    def step(self, seen: Seen) -> Orders:
        """Orders now."""
        if np.isnan(self._known):
            self._known = self._quiet = seen.t
        rates = self.joints.rates(self.p, seen)
        close = None if seen.holds is None else bool(seen.holds)
        return Orders("abort", self._path(seen), rates, close, ended=self._end(seen))

    def cancel(self, reason: str) -> None:
        """It goes on: there is nothing safer."""

    @property
    def safe(self) -> bool:
        """Whether what drifts meets nothing within the horizon, as far as it is known."""
        return self.drift is not None and self.drift.safe

    @property
    def target_clearance(self) -> float:
        """Least distance to the target within the horizon [m]; NaN: there is none."""
        known = self.drift is not None and np.isfinite(self.drift.target)
        return self.drift.target if self.drift is not None and known else np.nan

    def _path(self, seen: Seen) -> Path | None:
        if seen.base is None or seen.q is None:
            self._push = None
            return None
        self._known = seen.t
        q, qd = seen.floating
        if seen.holds and seen.target is not None and not self._held:
            self._held = True
            place = hold(self.p, q, seen.target.pose)
            self.p = with_held(self.p, self.settings.target, place)
        if self._push is not None and seen.t < self._push.end:
            self._quiet = seen.t
            return self._push
        target = None if seen.holds else seen.target
        drifting = Drifting(self.p, self.settings)
        self.drift, self._push = drifting.as_is(q, qd, target), None
        if self.drift.safe:
            return None
        self._quiet = seen.t
        away = drifting.away(q, qd, target)
        if not away.safe and np.allclose(away.twist, qd[:3], atol=2e-3):
            return None
        self._push = braking(self.p, q, qd, self.settings, seen.t, away.twist)
        return self._push

    def _end(self, seen: Seen) -> Ended | None:
        if seen.qd is not None and np.abs(seen.qd).max() > STILL:
            self._quiet = max(self._quiet, seen.t - 0.5 * QUIET)
        if seen.t - self._known > PATIENCE:
            return Ended(False, f"{self.reason}; the base is not known, valves closed")
        if seen.t - self._quiet < QUIET or self.drift is None or seen.base is None:
            return None
        return Ended(self.asked and self.drift.safe, self.reason)


class Stopping:
    """Joints that slow down within torques (n,) [N m], and then hold."""

    def __init__(self, torques: Floats) -> None:
        self.torques = torques
        self._from: tuple[float, float, Floats] | None = None  # when, how long, rates then

    def rates(self, p: Floats, seen: Seen) -> Floats:
        """Of the joints now [rad/s]."""
        if seen.q is None or seen.qd is None:
            return np.zeros(self.torques.size)
        if self._from is None:
            twist = np.zeros(3) if seen.base is None else seen.base.twist
            pose = np.zeros(3) if seen.base is None else seen.base.pose
            q, qd = np.concatenate([pose, seen.q]), np.concatenate([twist, seen.qd])
            self._from = seen.t, slowing(p, q, qd, self.torques), np.array(seen.qd)
        begin, duration, rates = self._from
        return rates * max(0.0, 1.0 - (seen.t - begin) / duration)
