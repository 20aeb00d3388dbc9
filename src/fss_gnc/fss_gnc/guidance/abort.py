"""Abort of a mission: valves closed, joints at rest, and a drift without collision.

The thrusters are used for one purpose only. If base and arm would drift into the target or to the
table's edge within the horizon, a short push gives them the safe motion that needs the least push.
The joints stop first, because stopping them changes the drift. The thrusters are not used while the
base is unknown, or while it is unknown whether the gripper holds the target. They may be used once
both are known again.

Joints that no longer send readings are assumed to rest at their last angles after a while,
because links stop without commands; this does not apply while a target is held. Joints with
readings slow down within their torque limits. The gripper keeps a held target, which would
otherwise tumble beside the arm. If it holds none, it opens.

If a valve does not close, no drift is safe. The base then comes to rest at a place with free space
around it, and is held there until the gas is used up. That is known from the tank's sensor, or else
from the valves no longer holding the base.
"""

import numpy as np
import numpy.typing as npt

from fss_arm_model.held import hold, with_held
from fss_gnc.guidance.activity import Craft, Ended, Orders, Seen
from fss_gnc.guidance.base_motion import least_duration
from fss_gnc.guidance.drift import Drift, Drifting
from fss_gnc.guidance.rest import braking, slowing
from fss_gnc.reference import Body, Path, Reference, off

Floats = npt.NDArray[np.float64]

QUIET = 3.0  # time for which the drift must be safe, joints at rest, before the abort ends [s]
PATIENCE = 30.0  # longest time without a known base [s]
STILL = 0.01  # rate below which a joint is at rest [rad/s]
LATE = 2.0  # extra time for joints to stop, and time until silent joints count as stopped [s]
EMPTY = 5e-4  # mass of propellant below which the valves have no effect [kg]
HOLD = 60.0  # time at rest at a place, until it is checked again whether a valve leaks [s]


class Abort:
    """Activity that aborts a mission.

    If it is requested as its own mission, it succeeds if the drift is safe.

    Args:
        craft: base and arm.
        reason: why it aborts.
        asked: True if it was requested itself, and is not the end of another mission.
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
        self._busy = -np.inf  # until when it pushes or holds the base [s]
        self._leaks = False  # True if a valve leaks
        self._gone = False  # True if the valves no longer hold the base at its place
        self._held: Floats | None = None  # place of the target in the gripper (held.py)
        self._known = self._quiet = np.nan  # since when; NaN: not yet
        self._heard = np.nan  # time of the last joint readings, or of the start [s]

    def step(self, seen: Seen) -> Orders:
        """Return the orders for now."""
        if np.isnan(self._known):
            self._known = self._quiet = self._heard = seen.t
        rates = self.joints.rates(self.p, seen)
        path, ended = self._path(seen), self._end(seen)
        return Orders("abort", path, rates, seen.keeping, reason=self.reason, ended=ended)

    def cancel(self, reason: str) -> None:
        """Ignore a cancel request, because nothing is safer than the abort."""

    @property
    def safe(self) -> bool:
        """True if no collision is predicted within the horizon, as far as that is known."""
        return self.drift is not None and self.drift.safe

    @property
    def target_clearance(self) -> float:
        """Least distance to the target within the horizon [m]; NaN if there is no target."""
        known = self.drift is not None and np.isfinite(self.drift.target)
        return self.drift.target if self.drift is not None and known else np.nan

    def _path(self, seen: Seen) -> Path | None:
        q_m = seen.last_q if seen.q is None and not seen.holds else seen.q
        if seen.base is None or q_m is None or seen.holds is None:
            self._push, self._busy = None, -np.inf
            return None
        self._known = seen.t
        self._heard = self._heard if seen.q is None else seen.t
        qd_m = np.zeros(q_m.size) if seen.qd is None else seen.qd
        q, qd = np.concatenate([seen.base.pose, q_m]), np.concatenate([seen.base.twist, qd_m])
        if seen.holds and seen.target is not None and self._held is None:
            self._held = hold(self.p, q, seen.target.pose)
            self.p = with_held(self.p, self.settings.target, self._held)
        target = None if seen.holds else seen.target
        drifting = Drifting(self.p, self.settings, self._held if seen.holds else None)
        if np.isnan(seen.propellant) and self._leaks and self._push is not None:
            apart = off(seen.base.pose, self._push.at(seen.t).pose)
            far = float(np.hypot(*apart[:2])) > self.settings.max_offset
            self._gone = self._gone or (far and seen.t > self._push.end)
        gas = not (self._gone or seen.propellant <= EMPTY)
        if seen.t < self._busy and gas:
            if self._leaks and self._push is not None and seen.t > self._push.end:
                self._make_room(drifting, seen.t, q, target)
            self._quiet = seen.t
            return self._push
        if np.abs(qd_m).max() > STILL and seen.t < self.joints.end + LATE:
            return None
        if seen.q is None and seen.t < self._heard + LATE:
            return None
        self.drift, self._push = drifting.as_is(q, qd, target), None
        self._leaks = gas and (bool(seen.open_valves) or seen.pushed)
        if self._leaks:
            self._push = braking(self.p, q, qd, self.settings, seen.t)
            self._busy = self._push.end + HOLD
        elif gas and not self.drift.safe:
            away = drifting.away(q, qd, target)
            if away.safe or not np.allclose(away.twist, qd[:3], atol=2e-3):
                self._push = braking(self.p, q, qd, self.settings, seen.t, away.twist)
                self._busy = self._push.end
        if self._push is not None:
            self._quiet = seen.t
        return self._push

    def _make_room(self, drifting: Drifting, t: float, q: Floats, target: Body | None) -> None:
        """Move on from the place where the base is held, if it cannot stay there."""
        assert self._push is not None
        here = Reference.at_rest(self._push.knots[-1, 0])
        goal = drifting.refuge(np.concatenate([here.pose, q[3:]]), target)
        if not np.array_equal(goal, here.pose):
            lasts = least_duration(self.settings, here, goal)
            self._push = Path.between(here, goal, t, t + lasts)
            self._busy = max(self._busy, self._push.end)

    def _end(self, seen: Seen) -> Ended | None:
        if seen.qd is not None and np.abs(seen.qd).max() > STILL:
            self._quiet = max(self._quiet, seen.t - 0.5 * QUIET)
        if seen.t - self._known > PATIENCE:
            return Ended(False, f"{self.reason}; base, joints or gripper not known, valves closed")
        if seen.t - self._quiet < QUIET or self.drift is None or seen.base is None:
            return None
        if self._gone:
            return Ended(False, f"{self.reason}; the valves do not hold the base any more")
        if not self.drift.safe:
            near = f"{self.drift.edge:.2f} m from the table's edge"
            if np.isfinite(self.drift.target):
                near = f"{near} and {self.drift.target:.2f} m from the target"
            horizon = f"{self.settings.drift_horizon:g} s"
            return Ended(False, f"{self.reason}; it drifts to within {near} in {horizon}")
        return Ended(self.asked, self.reason)


class Stopping:
    """Joint motion that slows down within torque limits (n,) [N m], and then holds."""

    def __init__(self, torques: Floats) -> None:
        self.torques = torques
        self._from: tuple[float, float, Floats] | None = None  # start, duration and initial rates

    @property
    def end(self) -> float:
        """Time at which the joints rest [s]; infinite before they start to slow down."""
        return np.inf if self._from is None else self._from[0] + self._from[1]

    def rates(self, p: Floats, seen: Seen) -> Floats:
        """Return the rates of the joints now [rad/s]."""
        if seen.q is None or seen.qd is None:
            return np.zeros(self.torques.size)
        if self._from is None:
            twist = np.zeros(3) if seen.base is None else seen.base.twist
            pose = np.zeros(3) if seen.base is None else seen.base.pose
            q, qd = np.concatenate([pose, seen.q]), np.concatenate([twist, seen.qd])
            self._from = seen.t, slowing(p, q, qd, self.torques), np.array(seen.qd)
        begin, duration, rates = self._from
        return rates * max(0.0, 1.0 - (seen.t - begin) / duration)
