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
from dataclasses import replace
from itertools import islice

import numpy as np

from fss_arm_model.arrays import Floats
from fss_arm_model.guard.guard import Guard, GuardError
from fss_arm_model.held import Approach, approach, combined_momentum
from fss_arm_model.planar import wrap
from fss_gnc.guidance.abort import Abort
from fss_gnc.guidance.activity import Commands, Craft, Observation, Outcome
from fss_gnc.guidance.approach import Planner
from fss_gnc.guidance.approach_trajectory import FINAL_MOTION_TIME, ApproachTrajectory
from fss_gnc.guidance.budget import Budget
from fss_gnc.guidance.detumble import Detumble
from fss_gnc.guidance.drift import DriftPredictor
from fss_gnc.guidance.mission_monitor import BRAKING_TIME, MissionMonitor
from fss_gnc.guidance.other_vehicles import MONITORED_SHARE, facing_announced_plan, gives_way
from fss_gnc.guidance.reach import Reach
from fss_gnc.guidance.stopping import braking, joint_stop_time
from fss_gnc.reference import Body, Path, pose_error

REFERENCE_TIMES = np.linspace(0.0, 2.0, 9)  # of the published reference, from now on [s]
SETTLING_TIME = 3.0  # time with everything known and joints at rest before the search starts [s]
CANDIDATES_PER_STEP = 24  # trajectories tried per step, which must be quick
MAX_SEARCH_TIME = 6.0  # longest search; after it the initial state is outdated [s]
MIN_REPLAN_INTERVAL = 2.0  # time on a trajectory before another one is searched for [s]
MAX_POSITION_ERROR, MAX_HEADING_ERROR = 0.03, 0.05  # at the start of the reach [m], [rad]
MAX_SPEED_ERROR, MAX_TURN_RATE_ERROR = 0.008, 0.008  # then [m/s], [rad/s]
MAX_FACING_ANGLE = 0.25  # largest error of the fixture's angle when the reach starts [rad]
MAX_LEAD_ANGLE = 1.1  # largest angle that the fixture turns in the lead [rad]
POSTURE_RATE = 0.15  # largest rate of joints that move to the posture of the approach [rad/s]
NEAR_LIMIT = 0.05  # distance of a joint to its limit that is reported [rad]
LOST_ANGLE, LOST_DISTANCE = 1.4, 0.35  # errors beyond which a reach is abandoned [rad], [m]
REPLAN_CUTOFF = 5.0  # time before the end of a trajectory in which no other is searched for [s]
GRIP_REPORT_TIME = 0.5  # longest time from closed fingers until their state is known [s]
FIXTURE_WAIT_TIMEOUT = 25.0  # longest wait for the fixture, before another side is chosen [s]


class Capture:
    """Activity that captures a tumbling target.

    Args:
        craft: base and arm.
        detumble: whether to stop the motion after the grip.
    """

    def __init__(self, craft: Craft, detumble: bool = True) -> None:
        self.craft, self.detumbles = craft, detumble
        self.settings = settings = craft.settings
        self.p, self.target = craft.arm.vector(), settings.target
        self.reach = Reach(craft.arm, settings)
        self.planner, self.monitor = Planner(self.p, settings), MissionMonitor(craft)
        self.guard = Guard(craft.arm, settings)
        self.phase, self.phase_start, self.attempts = "wait", 0.0, 0
        self.missed = ""  # how the last reach ended, if it missed the fixture
        self.fixture_error: Approach | None = None
        self.posture: Floats | None = None  # joint angles held in the approach
        self.following_rates = np.zeros(craft.arm.n)  # of the joints, after the fixture [rad/s]
        self.follow_up: Detumble | Abort | None = None
        self.captured = False
        self.momentum = np.full(3, np.nan)  # total, when the valves close; a grip keeps it
        self._trajectory: tuple[float, ApproachTrajectory] | None = None  # with its start time
        self._search_start, self._last_motion = -np.inf, 0.0
        self._search: Iterator[ApproachTrajectory | None] | None = None
        self._path: Path | None = None

    def tolerates(self, obs: Observation) -> bool:
        """Return True: it aborts by itself, or continues, if base or joints are unknown."""
        return True

    def step(self, obs: Observation) -> Commands:
        """Return the commands until the next step."""
        if self.follow_up is None:
            reason = self._abort_reason(obs)
            if reason:
                self.cancel(reason)
        if self.follow_up is not None:
            return self._adopt_phase(self.follow_up.step(obs))
        if obs.holds and obs.base is not None and obs.q is not None:
            return self._finish_grip(obs)
        if obs.base is None or obs.q is None or obs.target is None:
            self._last_motion = obs.t
            return Commands("wait", close_gripper=obs.keep_gripper)
        q, qd = obs.floating_state
        state = np.array([obs.target.pose, obs.target.twist])
        self.fixture_error = approach(self.p, q, qd, self.target, state)
        handlers = {
            "wait": self._wait,
            "approach": self._approach,
            "reach": self._reach,
            "grip": self._reach,
        }
        commands = handlers[self.phase](obs, q, qd, state)
        if self.missed and self.phase in ("wait", "approach") and not commands.reason:
            return replace(commands, reason=self.missed)
        return commands

    def cancel(self, reason: str) -> None:
        """Abort the mission."""
        if isinstance(self.follow_up, Detumble):
            self.follow_up.cancel(reason)
        elif self.follow_up is None:
            self.follow_up = Abort(self.craft, reason)
            self.phase = "abort"

    interrupt = cancel

    def _adopt_phase(self, commands: Commands) -> Commands:
        self.phase = commands.phase
        return commands

    def _enter_phase(self, phase: str, t: float) -> None:
        self.phase, self.phase_start = phase, t

    def _abort_reason(self, obs: Observation) -> str:
        s = self.settings
        timeouts = {
            "wait": s.wait_timeout,
            "approach": s.approach_timeout,
            "reach": s.reach_timeout + 5.0,
            "grip": s.grip_timeout + s.grip_closing_time + 5.0,
        }
        if obs.target is None and self.phase != "wait" and not obs.holds:
            return "target/state is not known"
        if obs.holds is None and self.phase in ("reach", "grip"):
            return "gripper/state is not known"
        states = {"base/state": obs.base, "arm/joint_states": obs.q, "target/state": obs.target}
        unknown = " and ".join(topic for topic, state in states.items() if state is None)
        if self.phase == "wait" and unknown and not obs.open_valves:
            timed_out = obs.t - self.phase_start > s.wait_timeout
            reasons = f" ({', '.join(obs.unknown)})" if obs.unknown else ""
            words = f"{unknown} not known within {s.wait_timeout:g} s{reasons}"
            return words if timed_out else ""
        return self.monitor.abort_reason(
            obs, self._path, self.phase, timeouts[self.phase], self.phase_start
        )

    def _wait(self, obs: Observation, q: Floats, qd: Floats, state: Floats) -> Commands:
        self._path = None
        if self.posture is None:
            self.posture = (
                np.array(self.settings.posture) if self.settings.posture else q[3:].copy()
            )
        at_posture = np.abs(q[3:] - self.posture).max() < 0.02 and np.abs(qd[3:]).max() < 0.01
        self._last_motion = self._last_motion if at_posture else obs.t
        if obs.t >= self._last_motion + SETTLING_TIME:
            self._search_trajectory(obs, q, qd, state)
        return Commands("wait", None, self._posture_rates(q), obs.keep_gripper)

    def _search_trajectory(self, obs: Observation, q: Floats, qd: Floats, state: Floats) -> None:
        """Search for a trajectory, a few tries per step.

        It starts from the state of base, arm and target at the start of the search.
        """
        t = obs.t
        if self._search is None or t > self._search_start + MAX_SEARCH_TIME:
            assert self.posture is not None
            state_at_posture = np.concatenate([q[:3], self.posture])
            self._search_start = t
            lead = self._lead(state)
            self._search = self.planner.search(state_at_posture, qd, state, lead, obs.others)
        for trajectory in islice(self._search, CANDIDATES_PER_STEP):
            if trajectory is not None:
                self._trajectory, self._search = (self._search_start, trajectory), None
                if self.phase != "approach":
                    self._enter_phase("approach", t)
                return

    def _posture_rates(self, q: Floats) -> Floats:
        """Return rates that move the joints to the posture of the approach, and hold them there."""
        if self.posture is None:
            return np.zeros(q.size - 3)
        rate = min(POSTURE_RATE, self.settings.joint_rate)
        return np.clip(0.5 * (self.posture - q[3:]), -rate, rate)

    def _approach(self, obs: Observation, q: Floats, qd: Floats, state: Floats) -> Commands:
        assert self._trajectory is not None
        start, trajectory = self._trajectory
        self._path = path_relative_to_target(trajectory, start, obs.t, REFERENCE_TIMES, state)
        remaining = start + trajectory.duration - obs.t
        lead = max(remaining, 0.0) + self._lead(state)
        has_turned = abs(self._facing_angle(state, trajectory, lead)) > MAX_FACING_ANGLE
        in_the_way = self._vehicle_in_the_way(obs, state)
        if self.follow_up is not None:
            return self._adopt_phase(self.follow_up.step(obs))
        can_replan = remaining > REPLAN_CUTOFF and obs.t > start + MIN_REPLAN_INTERVAL
        if can_replan and (has_turned or in_the_way):
            # The target's rotation or another vehicle's motion has changed.
            self._search_trajectory(obs, q, qd, state)
        elif remaining <= 0.0:
            is_late = bool(trajectory.final_rate.any()) and -remaining > FINAL_MOTION_TIME
            self._start_reach_if_ready(obs, q, qd, state, trajectory, is_late)
        return Commands(
            "approach",
            self._path,
            self._posture_rates(q),
            obs.keep_gripper,
            keep_out=self.settings.keep_out,
            fixture_distance=self.fixture_error.distance if self.fixture_error else np.nan,
            reason=f"gives way to {in_the_way}" if in_the_way else "",
            plan=path_relative_to_target(
                trajectory, start, obs.t, np.arange(0.0, max(remaining, 2.0) + 1.0), state
            ),
        )

    def _vehicle_in_the_way(self, obs: Observation, state: Floats) -> str:
        """Return the vehicle that the approach must give way to; abort if it comes too near."""
        assert self._trajectory is not None
        start, trajectory = self._trajectory
        margin = MONITORED_SHARE * self.settings.vehicle_gap
        others = facing_announced_plan(obs.others)
        found = self.planner.conflicts(trajectory, obs.t - start, state, others, margin)
        for conflict in found:
            if gives_way(conflict, BRAKING_TIME):
                name = conflict.vehicle.name
                if conflict.ahead < BRAKING_TIME:
                    self.cancel(f"{name} would be {conflict.gap:.2f} m away")
                return name
        return ""

    def _start_reach_if_ready(
        self,
        obs: Observation,
        q: Floats,
        qd: Floats,
        state: Floats,
        trajectory: ApproachTrajectory,
        is_late: bool,
    ) -> None:
        """Start the reach, or search for another trajectory if the fixture has passed by.

        It is late once the final motion that cancels the momentum has ended.
        """
        assert self._path is not None
        reference = self._path.at(obs.t)
        error, twist_error = pose_error(q[:3], reference.pose), qd[:3] - reference.twist
        is_ready = np.hypot(*error[:2]) < MAX_POSITION_ERROR and abs(error[2]) < MAX_HEADING_ERROR
        is_ready &= (
            np.hypot(*twist_error[:2]) < MAX_SPEED_ERROR
            and abs(twist_error[2]) < MAX_TURN_RATE_ERROR
        )
        spin = float(state[1, 2])
        facing = self._facing_angle(state, trajectory, self._lead(state))
        if is_late:
            self._search_trajectory(obs, q, qd, state)
        elif is_ready and abs(facing) < MAX_FACING_ANGLE:
            self.attempts += 1
            self._path = None
            self.reach.set_momentum(q, qd)
            self.momentum = combined_momentum(self.p, q, qd, self.target, state)
            self._enter_phase("reach", obs.t)
        elif abs(facing) > MAX_FACING_ANGLE:
            missed = facing * spin < 0.0 or abs(facing) > FIXTURE_WAIT_TIMEOUT * abs(spin)
            if missed:
                self._search_trajectory(obs, q, qd, state)

    def _lead(self, state: Floats) -> float:
        """Return the time from the start of the reach until the fixture faces the arm [s]."""
        return min(self.settings.lead, MAX_LEAD_ANGLE / max(abs(float(state[1, 2])), 1e-9))

    def _facing_angle(self, state: Floats, trajectory: ApproachTrajectory, ahead: float) -> float:
        """Return the angle that the fixture must still turn to face the arm, a time ahead [s]."""
        direction = self.planner.fixture_direction(float(state[0, 2] + ahead * state[1, 2]))
        return float(wrap(trajectory.side - direction))

    def _reach(self, obs: Observation, q: Floats, qd: Floats, state: Floats) -> Commands:
        """Move the arm to the fixture and close the gripper; the arm follows while it closes.

        The joints then keep their rates until it is known whether the gripper holds the fixture.
        """
        assert self.fixture_error is not None
        s, error, closing = self.settings, self.fixture_error, self.settings.grip_closing_time
        # The fixture should stay near while the fingers close.
        speed = min(s.grip_speed, s.grip_distance / closing) if closing else s.grip_speed
        is_near = error.distance < s.grip_distance and abs(error.angle) < s.grip_angle
        is_lost = abs(error.angle) > LOST_ANGLE or error.distance > LOST_DISTANCE
        timeout = s.reach_timeout if self.phase == "reach" else s.grip_timeout + closing
        if is_lost or obs.t - self.phase_start > timeout:
            self.missed = self._miss_reason(q, obs.t, error.distance, error.angle)
            self._retreat(obs.t)
        elif self.phase == "reach" and is_near and error.speed < speed:
            self._enter_phase("grip", obs.t)
        closed_for = obs.t - self.phase_start - closing if self.phase == "grip" else -np.inf
        if not 0.0 < closed_for < GRIP_REPORT_TIME:  # corrections would strain closed fingers
            self.following_rates = self.reach.rates(q, qd, state)
        rates = self._collision_free_rates(self.following_rates, q, qd, state)
        return Commands(
            self.phase,
            None,
            rates,
            self.phase == "grip",
            s.keep_out,
            fixture_distance=error.distance,
        )

    def _miss_reason(self, q: Floats, t: float, distance: float, angle: float) -> str:
        """Return how far the fixture was at the end of a reach, and which joint was at a limit."""
        limits = np.array([(link.q_min, link.q_max) for link in self.craft.arm.links])
        room = np.abs(q[3:, None] - limits).min(axis=1)
        joint = int(room.argmin())
        limited = f", joint {joint + 1} at its limit" if room[joint] < NEAR_LIMIT else ""
        return (
            f"{self.phase} {self.attempts} of {self.settings.attempts} missed after "
            f"{t - self.phase_start:.1f} s: fixture {distance:.3f} m and "
            f"{abs(np.degrees(angle)):.0f} deg away{limited}"
        )

    def _retreat(self, t: float) -> None:
        """Back off with open gripper, to try another approach."""
        if self.attempts >= self.settings.attempts:
            self.cancel(f"target not captured in {self.attempts} attempts; {self.missed}")
            return
        self._trajectory, self._search = None, None
        self._enter_phase("wait", t)

    def _collision_free_rates(self, rates: Floats, q: Floats, qd: Floats, state: Floats) -> Floats:
        """Return the rates, scaled down until no link hits target or base; zero if that fails."""
        for scale in (1.0, 0.5, 0.25):
            try:
                self.guard.check_command(
                    q[3:],
                    qd[3:],
                    0.2,
                    velocity=scale * rates,
                    base=q[:3],
                    twist=qd[:3],
                    target=state,
                )
            except GuardError:
                continue
            return scale * rates
        return np.zeros(rates.size)

    def _finish_grip(self, obs: Observation) -> Commands:
        self.captured = True
        if not self.detumbles:
            at_rest = np.zeros(self.craft.arm.n)
            return self._adopt_phase(Commands("done", None, at_rest, outcome=Outcome(True)))
        self._path = None
        self.follow_up = Detumble(self.craft, self.monitor)
        return self._adopt_phase(self.follow_up.step(obs))


def load_kernels(craft: Craft) -> None:
    """Load the kernels of the guidance in advance, because that takes long."""
    p, s, n = craft.arm.vector(), craft.settings, craft.arm.n
    q, zero = np.array([-1.0, -1.0, 0.0, *n * [0.3]]), np.zeros(3 + n)
    target = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.1]])
    Budget(craft).update(Observation(0.0, Body(*target), Body(*target), q[3:], zero[3:]))
    Guard(craft.arm, s)
    next(Planner(p, s).search(q, zero, target, s.lead), None)
    DriftPredictor(p, s).plan_push(q, zero, Body(*target))
    braking(p, q, zero, s, 0.0)
    joint_stop_time(p, q, zero, np.ones(n))
    approach(p, q, zero, s.target, target)
    reach = Reach(craft.arm, s)
    reach.set_momentum(q, zero)
    reach.rates(q, zero, target)


def path_relative_to_target(
    trajectory: ApproachTrajectory, start: float, t: float, ahead: Floats, state: Floats
) -> Path:
    """Return the path in the world of an approach, which is relative to the drifting target.

    Args:
        trajectory: the approach.
        start: time of its start [s].
        t: present time [s].
        ahead: (k,) times of the path's knots from now [s].
        state: (2, 3) pose and twist of the target.
    """
    points = trajectory.points(t - start + ahead)
    drift = np.array([*state[1, :2], 0.0])
    pose = points.pose + np.array([*state[0, :2], 0.0]) + ahead[:, None] * drift
    return Path(t + ahead, np.stack([pose, points.twist + drift, points.acceleration], axis=1))
