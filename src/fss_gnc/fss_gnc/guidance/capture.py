"""Capture of a tumbling target, phase by phase.

wait      until base, arm and target are known, and there is a free trajectory
approach  along it, joints held, and stay before the target until the fixture is about to face
reach     valves closed, so that momentum stays; the arm moves the gripper to the fixture
grip      the gripper closes, the arm continues to follow the fixture
detumble  the target is held, everything comes to rest
done
abort     from any of them
"""

from collections.abc import Iterator
from itertools import islice

import numpy as np
import numpy.typing as npt

from fss_arm_model.guard.guard import Guard, GuardError
from fss_arm_model.held import Approach, approach, momentum_of_both
from fss_arm_model.planar import wrap
from fss_gnc.guidance.abort import Abort
from fss_gnc.guidance.activity import Craft, Ended, Orders, Seen
from fss_gnc.guidance.approach import Planner, Points, Way
from fss_gnc.guidance.detumble import Detumble
from fss_gnc.guidance.drift import Drifting
from fss_gnc.guidance.reach import Reach
from fss_gnc.guidance.rest import braking, slowing
from fss_gnc.guidance.watch import Watch
from fss_gnc.reference import Body, Path, off

Floats = npt.NDArray[np.float64]

AHEAD = np.linspace(0.0, 2.0, 9)  # times of the published reference [s]
SETTLED = 3.0  # time with everything known and joints at rest before the search starts [s]
TRIES = 24  # trajectories tried per step, which must be quick
LONGEST = 6.0  # longest search; after it the initial state is outdated [s]
RETRY = 2.0  # time on a trajectory before another one is searched for [s]
NEAR, STRAIGHT = 0.03, 0.05  # largest error at the stand-off when the reach starts [m], [rad]
SLOW, SLOW_TURN = 0.008, 0.008  # largest error of the twist then [m/s], [rad/s]
FACING = 0.25  # largest error of the fixture's angle when the reach starts [rad]
LOST_ANGLE, LOST_DISTANCE = 1.2, 0.35  # errors beyond which a reach is abandoned [rad], [m]
LATE = 5.0  # time before the end of a trajectory in which no other is searched for [s]
PATIENCE = 25.0  # longest wait for the fixture, before another side is chosen [s]


class Capture:
    """Activity that captures a tumbling target.

    Args:
        craft: whose base and arm.
        detumble: whether to stop the motion after the grip.
    """

    blind = True

    def __init__(self, craft: Craft, detumble: bool = True) -> None:
        self.craft, self.detumbles = craft, detumble
        self.settings = settings = craft.settings
        self.p, self.target = craft.arm.vector(), settings.target
        self.guide = Reach(craft.arm, settings)
        self.planner, self.watch = Planner(self.p, settings), Watch(craft)
        self.guard = Guard(craft.arm, settings)
        self.phase, self.since, self.attempts = "wait", 0.0, 0
        self.met: Approach | None = None
        self.posture: Floats | None = None  # joint angles held in the approach
        self.after: Detumble | Abort | None = None
        self.captured = False
        self.momentum = np.full(3, np.nan)  # total, when the valves close; a grip keeps it
        self._way: tuple[float, Way] | None = None  # start of the trajectory, and the trajectory
        self._sought, self._moved = -np.inf, 0.0
        self._search: Iterator[Way | None] | None = None
        self._path: Path | None = None

    def step(self, seen: Seen) -> Orders:
        """Return the orders for now."""
        if self.after is None:
            reason = self._reason(seen)
            if reason:
                self.cancel(reason)
        if self.after is not None:
            return self._told(self.after.step(seen))
        if seen.holds and seen.base is not None and seen.q is not None:
            return self._grasped(seen)
        if seen.base is None or seen.q is None or seen.target is None:
            self._moved = seen.t
            return Orders("wait", close=seen.keeping)
        q, qd = seen.floating
        state = np.array([seen.target.pose, seen.target.twist])
        self.met = approach(self.p, q, qd, self.target, state)
        act = {"wait": self._wait, "approach": self._approach, "reach": self._reach,
               "grip": self._reach}  # fmt: skip
        return act[self.phase](seen, q, qd, state)

    def cancel(self, reason: str) -> None:
        """Abort the mission."""
        if isinstance(self.after, Detumble):
            self.after.cancel(reason)
        elif self.after is None:
            self.after = Abort(self.craft, reason)
            self.phase = "abort"

    def _told(self, orders: Orders) -> Orders:
        self.phase = orders.phase
        return orders

    def _begin(self, phase: str, t: float) -> None:
        self.phase, self.since = phase, t

    def _reason(self, seen: Seen) -> str:
        s = self.settings
        timeouts = {
            "wait": s.wait_timeout, "approach": s.approach_timeout, "reach": s.reach_timeout + 5.0,
            "grip": s.grip_timeout + 5.0,
        }  # fmt: skip
        if seen.target is None and self.phase != "wait" and not seen.holds:
            return "target/state is not known"
        if seen.holds is None and self.phase in ("reach", "grip"):
            return "gripper/state is not known"
        known = seen.base is not None and seen.q is not None and seen.target is not None
        if self.phase == "wait" and not known and not seen.open_valves:
            late = seen.t - self.since > s.wait_timeout
            return "base, arm or target are not known" if late else ""
        return self.watch.reason(seen, self._path, self.phase, timeouts[self.phase], self.since)

    def _wait(self, seen: Seen, q: Floats, qd: Floats, state: Floats) -> Orders:
        self._path = None
        if self.posture is None:
            self.posture = (
                np.array(self.settings.posture) if self.settings.posture else q[3:].copy()
            )
        is_there = np.abs(q[3:] - self.posture).max() < 0.02 and np.abs(qd[3:]).max() < 0.01
        self._moved = self._moved if is_there else seen.t
        if seen.t >= self._moved + SETTLED:
            self._seek(seen.t, q, qd, state)
        return Orders("wait", None, self._still(q), seen.keeping)

    def _seek(self, t: float, q: Floats, qd: Floats, state: Floats) -> None:
        """Search for a trajectory, a few tries per step.

        It starts from the state of base, arm and target at the start of the search.
        """
        if self._search is None or t > self._sought + LONGEST:
            assert self.posture is not None
            held = np.concatenate([q[:3], self.posture])
            self._sought = t
            self._search = self.planner.search(held, qd, state, self.settings.lead)
        for way in islice(self._search, TRIES):
            if way is not None:
                self._way, self._search = (self._sought, way), None
                if self.phase != "approach":
                    self._begin("approach", t)
                return

    def _still(self, q: Floats) -> Floats:
        """Return rates that move the joints to the posture of the approach, and hold them there."""
        if self.posture is None:
            return np.zeros(q.size - 3)
        return np.clip(0.5 * (self.posture - q[3:]), -0.15, 0.15)

    def _approach(self, seen: Seen, q: Floats, qd: Floats, state: Floats) -> Orders:
        assert self._way is not None
        begin, way = self._way
        points = way.points(seen.t - begin + AHEAD)
        self._path = on_target(points, seen.t, state)
        left = begin + way.duration - seen.t
        facing = self._facing(state, way, max(left, 0.0) + self.settings.lead)
        if left > LATE and abs(facing) > FACING and seen.t > begin + RETRY:
            self._seek(seen.t, q, qd, state)  # the target's rotation has changed
        elif left <= 0.0:
            self._arrived(seen, q, qd, state, way)
        return Orders(
            "approach", self._path, self._still(q), seen.keeping, keep_out=self.settings.keep_out,
            fixture_distance=self.met.distance if self.met else np.nan,
        )  # fmt: skip

    def _arrived(self, seen: Seen, q: Floats, qd: Floats, state: Floats, way: Way) -> None:
        assert self._path is not None
        now = self._path.at(seen.t)
        apart, moving = off(q[:3], now.pose), qd[:3] - now.twist
        there = np.hypot(*apart[:2]) < NEAR and abs(apart[2]) < STRAIGHT
        there &= np.hypot(*moving[:2]) < SLOW and abs(moving[2]) < SLOW_TURN
        spin = float(state[1, 2])
        ahead = self._facing(state, way, self.settings.lead)
        if there and abs(ahead) < FACING:
            self.attempts += 1
            self._path = None
            self.guide.begin(q, qd)
            self.momentum = momentum_of_both(self.p, q, qd, self.target, state)
            self._begin("reach", seen.t)
        elif abs(ahead) > FACING:
            late = ahead * spin < 0.0 or abs(ahead) > PATIENCE * abs(spin)
            if late:
                self._seek(seen.t, q, qd, state)

    def _facing(self, state: Floats, way: Way, ahead: float) -> float:
        """Return the angle that the fixture must still turn to face the arm, a time ahead [s]."""
        side = self.planner.side(float(state[0, 2] + ahead * state[1, 2]))
        return float(wrap(way.end[1] - side))

    def _reach(self, seen: Seen, q: Floats, qd: Floats, state: Floats) -> Orders:
        """Move the arm to the fixture and close the gripper; the arm follows while it closes."""
        assert self.met is not None
        s, met = self.settings, self.met
        near = met.distance < s.grip_distance and abs(met.angle) < s.grip_angle
        lost = abs(met.angle) > LOST_ANGLE or met.distance > LOST_DISTANCE
        timeout = s.reach_timeout if self.phase == "reach" else s.grip_timeout
        if lost or seen.t - self.since > timeout:
            self._retreat(seen.t)
        elif self.phase == "reach" and near and met.speed < s.grip_speed:
            self._begin("grip", seen.t)
        rates = self._guarded(self.guide.rates(q, state), q, qd, state)
        return Orders(
            self.phase, None, rates, self.phase == "grip", s.keep_out, fixture_distance=met.distance
        )

    def _retreat(self, t: float) -> None:
        """Back off with open gripper, to try another approach."""
        if self.attempts >= self.settings.attempts:
            self.cancel(f"not captured in {self.attempts} reaches")
            return
        self._way, self._search = None, None
        self._begin("wait", t)

    def _guarded(self, rates: Floats, q: Floats, qd: Floats, state: Floats) -> Floats:
        """Return the rates, scaled down until no link hits target or base; zero if that fails."""
        for share in (1.0, 0.5, 0.25):
            try:
                self.guard.check_command(
                    q[3:], qd[3:], 0.2, velocity=share * rates, base=q[:3], twist=qd[:3],
                    target=state,
                )  # fmt: skip
            except GuardError:
                continue
            return share * rates
        return np.zeros(rates.size)

    def _grasped(self, seen: Seen) -> Orders:
        self.captured = True
        if not self.detumbles:
            at_rest = np.zeros(self.craft.arm.n)
            return self._told(Orders("done", None, at_rest, ended=Ended(True)))
        self._path = None
        self.after = Detumble(self.craft)
        return self._told(self.after.step(seen))


def load(craft: Craft) -> None:
    """Load the kernels of the missions in advance, because that takes long."""
    p, s, n = craft.arm.vector(), craft.settings, craft.arm.n
    q, rest = np.array([-1.0, -1.0, 0.0, *n * [0.3]]), np.zeros(3 + n)
    target = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.1]])
    Guard(craft.arm, s)
    next(Planner(p, s).search(q, rest, target, s.lead), None)
    Drifting(p, s).away(q, rest, Body(*target))
    braking(p, q, rest, s, 0.0)
    slowing(p, q, rest, np.ones(n))
    approach(p, q, rest, s.target, target)
    reach = Reach(craft.arm, s)
    reach.begin(q, rest)
    reach.rates(q, target)


def on_target(points: Points, t: float, state: Floats) -> Path:
    """Return a path in the world of points given relative to the drifting target.

    Args:
        points: seen from the target, at the times AHEAD after t.
        t: present time [s].
        state: (2, 3) pose and twist of the target.
    """
    drift = np.array([*state[1, :2], 0.0])
    pose = points.pose + np.array([*state[0, :2], 0.0]) + AHEAD[:, None] * drift
    return Path(t + AHEAD, np.stack([pose, points.twist + drift, points.acceleration], axis=1))
