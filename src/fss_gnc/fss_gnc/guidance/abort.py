"""An end that is safe: valves closed, joints held, and a drift that meets nothing.

The thrusters are used for one thing only: if base and arm as they drift would meet the target or
the table's edge within the horizon, a short push gives them the least other motion that does not.
As the joints come to rest they change that drift, so they do so first. Without knowledge of the
base, or of whether the gripper holds the target, the thrusters are not used at all; once both are
known again, they may be. Joints that are not heard any more are taken to rest where they were last,
after a while, as links hold when nobody commands them, unless a target is held, too; those that are
heard slow down within their torques. A target that is held stays so: let go, it would tumble beside
the arm; one that is not is let go.

Where a valve does not close, no drift is safe: the base comes to rest, with room about it, and is
held there until the gas is spent: by what the tank tells, or else until the valves hold it no more.
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

QUIET = 3.0  # for which the drift must be safe, joints at rest, before it is over [s]
PATIENCE = 30.0  # without knowing the base [s]
STILL = 0.01  # of a joint [rad/s]
LATE = 2.0  # that joints may take longer to rest than they should, or once they are not heard [s]
EMPTY = 5e-4  # of propellant, with which the valves move nothing any more [kg]
HOLD = 60.0  # at a place with room, until it is tried again whether a valve leaks [s]


class Abort:
    """The activity. Requested as a mission of its own, it ends well if the drift is safe.

    Args:
        craft: base and arm.
        reason: why it aborts.
        asked: whether it was requested for itself, and is not the end of another mission.
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
        self._busy = -np.inf  # until when it is pushed, or held [s]
        self._leaks = False  # a valve
        self._gone = False  # the base, from where it is held: the valves do not hold it any more
        self._held: Floats | None = None  # place of the target in the gripper (held.py)
        self._known = self._quiet = np.nan  # since when; NaN: it has not begun
        self._heard = np.nan  # when the joints were last, or it began [s]

    def step(self, seen: Seen) -> Orders:
        """Orders now."""
        if np.isnan(self._known):
            self._known = self._quiet = self._heard = seen.t
        rates = self.joints.rates(self.p, seen)
        path, ended = self._path(seen), self._end(seen)
        return Orders("abort", path, rates, seen.keeping, reason=self.reason, ended=ended)

    def cancel(self, reason: str) -> None:
        """Go on all the same: there is nothing safer."""

    @property
    def safe(self) -> bool:
        """Whether nothing will be hit within the horizon, as far as that is known."""
        return self.drift is not None and self.drift.safe

    @property
    def target_clearance(self) -> float:
        """Least distance to the target within the horizon [m]; NaN: there is none."""
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
        """Move on from where the base is held, if it cannot stay there."""
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
    """Joints that slow down within torques (n,) [N m], and then hold."""

    def __init__(self, torques: Floats) -> None:
        self.torques = torques
        self._from: tuple[float, float, Floats] | None = None  # when, how long, rates then

    @property
    def end(self) -> float:
        """When they rest [s]; infinite: they have not begun to slow down."""
        return np.inf if self._from is None else self._from[0] + self._from[1]

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
