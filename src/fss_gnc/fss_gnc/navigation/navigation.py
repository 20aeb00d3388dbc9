"""Navigation of base and target together.

Motion capture may swap the two, and the gripper of one may hold the other.
"""

from collections import deque
from collections.abc import Iterable, Sequence
from functools import partial
from math import expm1, hypot

import numpy as np
import numpy.typing as npt

from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_model.held import Target, payload_pose, payload_state, with_payload
from fss_arm_model.kinematics import tip_jacobian, tip_pose
from fss_arm_model.planar import wrap
from fss_arm_model.thrusters import THRUSTER_COUNT
from fss_arm_model.units import SECOND

from .body_filter import GATE_SIGMA, BodyFilter, BodyState, NoInputs, Pose
from .inputs import KnownInputs
from .mass_estimator import SPACING, FreeBody, MassErrors, MassEstimator, MassProperties, Sample
from .settings import EstimatorSettings, TargetErrors
from .valve_faults import Faults, Moment, ValveFaults

TIP_POSE_TOLERANCE = 0.05, 0.15  # of a pose that counts as the end effector's [m], [rad]
MAX_POSE_GAP = SECOND // 5  # longest time without a pose before the arm's is used [ns]
# Change of twists by a grip or a release, 1 sigma [m/s], [rad/s]. The speed stays below the default
# of `max_speed_deviation`, so that base and target are known when guidance learns of the grip.
GRIP_SIGMA = 0.04, 0.2
HELD_TWIST_WALK = 0.05, 0.2  # random walk of a held target's twist [m/s/sqrt(s)], [rad/s/sqrt(s)]
GRIP_DELAY = SECOND // 2  # longest delay of a grip's message, and settling time [ns]
MAX_EARLIER_SAMPLES = 20  # samples stored before a grip, GRIP_DELAY apart
MAX_ESTIMATE_GAP = 2 * SECOND  # after a longer gap the impulses of the valves are unknown [ns]
PLACE_GAIN = 0.05  # of the correction of the held target's place by its measured pose

#: Number of a joint, from 1, q [rad], qd [rad/s] and effort.
JointReadings = Iterable[tuple[int, float, float, float]]


class _TargetInputs(NoInputs):
    """Inputs of the target, which the arm accelerates while the gripper holds it."""

    def __init__(self, errors: TargetErrors) -> None:
        super().__init__(errors)
        self.is_held = False
        held_noise = np.diag(
            np.square([HELD_TWIST_WALK[0], HELD_TWIST_WALK[0], HELD_TWIST_WALK[1]])
        )
        self._held_noise = np.zeros((1, 3)), held_noise[None]

    def mean_accelerations(self, times: Sequence[int]) -> tuple[Floats, Floats]:
        """Return zero acceleration; the noise is larger while the target is held."""
        return self._held_noise if self.is_held else super().mean_accelerations(times)


class Navigation:
    """Filters of base and target.

    A pose is rejected if it fits another body, as when motion capture swaps base and target. It is
    reported under that body's name and not used.

    Args:
        arm: description of the arm.
        settings: errors of sensors and inputs.
        target_errors: errors of the target's poses, and its process noise.
        body: assumed mass and inertia of the target.
        errors: uncertainty of the assumed mass and inertia, and random walk of the momentum.
    """

    def __init__(
        self,
        arm: Arm,
        settings: EstimatorSettings | None = None,
        target_errors: TargetErrors | None = None,
        body: Target | None = None,
        errors: MassErrors | None = None,
    ) -> None:
        self.settings, self.assumed_body = settings or EstimatorSettings(), body or Target()
        self.p = arm.vector()
        self.inputs = KnownInputs(self.p, self.settings)
        target_errors, s = target_errors or TargetErrors(), self.settings
        self._target_inputs = _TargetInputs(target_errors)
        self.base = BodyFilter(s, self.inputs, partial(self._other_body, "target"), s)
        self.target = BodyFilter(
            target_errors, self._target_inputs, partial(self._other_body, "base"), s
        )
        self.place: Floats | None = None  # place of the target in the gripper; None: it is not held
        self.errors = errors or MassErrors()
        self.mass_estimator: MassEstimator | None = None
        self.mass_properties: MassProperties | None = (
            None  # of the held body; None: not estimated yet
        )
        self._gripped = 0  # time of the grip's message [ns]
        self._earlier_samples: deque[tuple[int, Sample, BodyState | None]] = deque(
            maxlen=MAX_EARLIER_SAMPLES
        )
        self.valves = ValveFaults(self.settings.thrust_error)
        # Impulses of each valve, as commanded and if always open, and until when they count [ns].
        self._impulse_sum, self._impulse_end = np.zeros((2, THRUSTER_COUNT, 3)), -MAX_ESTIMATE_GAP

    @property
    def holds(self) -> bool:
        """True if the gripper holds the target."""
        return self._target_inputs.is_held

    def set_arm(self, arm: Arm) -> None:
        """Use a new description of the arm, as after a calibration."""
        self.p = arm.vector()
        if self.mass_estimator:
            self.mass_estimator.p = self.p
        self._update_parameters()

    def add_joint_readings(self, t: int, readings: JointReadings) -> None:
        """Process readings at t [ns]; those of joints that the arm lacks are ignored."""
        for i, q, qd, _ in readings:
            if 1 <= i <= self.inputs.n:
                self.add_joint_reading(i - 1, t, q, qd)

    def add_joint_reading(self, i: int, t: int, q: float, qd: float) -> None:
        """Process a reading q [rad], qd [rad/s] of joint i, from 0, at t [ns]."""
        omega = self.base.state().twist[2] if self.base.events else 0.0
        since = self.inputs.add_joint_reading(i, t, q, qd, float(omega))
        if since is not None:
            self.base.recompute_since(since)

    def add_pulses(self, t: int, on_times: npt.ArrayLike) -> bool:
        """Process on-times (8,) [s] sent to the valves at t [ns]; return False if ignored."""
        accepted = self.inputs.add_pulses(t, on_times)
        if accepted:
            self.base.recompute_since(t)
        return accepted

    def recent_mixups(self, t: int) -> list[tuple[str, str]]:
        """Return pairs of bodies (name, other): one was measured at the other's pose within 1 s."""
        bodies = ("base", self.base), ("target", self.target)
        return [
            (name, body.last_mixup[1])
            for name, body in bodies
            if body.last_mixup and t - body.last_mixup[0] < SECOND
        ]

    def update_target_pose(self, t: int, x: float, y: float, heading: float) -> bool:
        """Update with a pose [m, m, rad] of the target at t [ns]; return True if accepted."""
        accepted = self.target.update_pose(t, x, y, heading)
        if accepted and self.holds and not self.base.lost_reason(t):
            place = payload_pose(self.p, self._state(t)[0], (x, y, heading))
            if self.place is None:
                self.place = place
                self._update_parameters()
            else:
                error = place - self.place
                error[2] = wrap(error[2])
                self.place = self.place + PLACE_GAIN * error
        return accepted

    def set_gripper(self, holds: bool) -> None:
        """Process the gripper's report that it holds the target, or does not."""
        if holds == self.holds:
            return
        self._target_inputs.is_held, self.place, self._gripped = holds, None, self.base.t
        self.mass_estimator = self.mass_properties = None
        self.valves.reset()
        for body in (self.base, self.target):
            body.add_push(body.t, *GRIP_SIGMA)
        self._update_parameters()

    def predict(self, t: int) -> None:
        """Predict to t [ns]; a held target without new poses moves with the gripper."""
        self.base.predict(t)
        is_outdated = t - self.target.last_pose_time > MAX_POSE_GAP
        if self.place is not None and is_outdated and not self.base.lost_reason(t):
            x, y, heading = payload_state(self.p, *self._state(t), self.place)[0].tolist()
            self.target.update_held_pose(t, (x, y, heading))
        if not self.target.lost_reason(t):  # an unknown one starts again with its next pose
            self.target.predict(t)

    def estimate_mass(self, t: int) -> MassProperties | None:
        """Estimate the mass properties of the held body at t [ns]; None unless they are new."""
        if not self._is_known(t) or (self.holds and t < self._gripped + GRIP_DELAY):
            return None
        if (
            not self.holds
            and self._earlier_samples
            and t < self._earlier_samples[-1][0] + GRIP_DELAY
        ):
            return None
        sample = self._sample(t)
        if not self.holds:
            free = self.target.events and not self.target.lost_reason(t)
            state = self.target.state().extrapolate_to(t) if free else None
            self._earlier_samples.append((t, sample, state))
            return None
        if self.mass_estimator is None:
            self.mass_estimator = self._start_mass_estimator(t, sample)
        if not self.mass_estimator.is_due(sample.t):
            return None
        self.mass_estimator.add_sample(sample)
        estimate = self.mass_estimator.solve()
        if not self.mass_estimator.is_consistent:  # no mass explains the motion: keep the last one
            return None
        self.mass_properties = estimate
        self._update_parameters()
        return self.mass_properties

    def detect_valve_faults(self, t: int) -> Faults | None:
        """Detect faulty valves at t [ns]; return None unless the known faults have changed."""
        known, place = self.valves.faults, self.place
        p, mass_error = self.p, 0.0
        if self.holds and place is not None:  # as assumed: a leak may look like mass
            p = with_payload(p, self.assumed_body, place)
            mass_error = self.assumed_body.mass * expm1(self.errors.mass_error)
        if not self._is_known(t) or (self.holds and place is None):
            self.valves.reset()
        elif self.valves.is_due(t / SECOND):
            self.valves.update(p, Moment(self._sample(t), *self._impulses(t)), mass_error)
        faults = self.valves.faults
        if faults == known:
            return None
        if faults[:2] != known[:2]:
            self.inputs.set_valve_faults(faults)
            # The faulty valve may have been mistaken for mass.
            self.mass_estimator = self.mass_properties = None
            self._update_parameters()
        return faults

    def _is_known(self, t: int) -> bool:
        """Return True if momentum is known at t [ns]; after a gap, the stored samples are reset."""
        if not self.base.events or self.base.lost_reason(t) or not self.inputs.joints_are_recent(t):
            return False
        if t > self._impulse_end + MAX_ESTIMATE_GAP:
            self._impulse_end, self.mass_estimator = t - GRIP_DELAY, None
            self._earlier_samples.clear()
            self.valves.reset()
        return True

    def _impulses(self, t: int) -> Floats:
        """Return the impulse of each valve until t [ns], about the world's origin, (2, 8, 3).

        The first row is for the commanded on-times, the second for valves that are always open.
        """
        base = self.base.state()

        def impulses(start: int, end: int) -> Floats:
            x, y, heading = base.extrapolate_to((start + end) // 2).pose.tolist()
            fx, fy, torque = self.inputs.valves.T
            force = (fx + 1j * fy) * np.exp(1j * heading)
            each = np.stack([force.real, force.imag, torque + x * force.imag - y * force.real], -1)
            durations = (
                self.inputs.open_times(start, end),
                np.full(THRUSTER_COUNT, (end - start) / SECOND),
            )
            found: Floats = np.stack(durations)[:, :, None] * each
            return found

        until = max(t - GRIP_DELAY, self._impulse_end)  # later commands may still arrive
        self._impulse_sum = self._impulse_sum + impulses(self._impulse_end, until)
        self._impulse_end = until
        return self._impulse_sum + impulses(until, t)

    def _sample(self, t: int) -> Sample:
        """Return the state of base and arm at t [ns], with the impulse of the valves."""
        q, qd = self._state(t)
        return Sample(
            t / SECOND,
            q,
            qd,
            self.base.state().covariance[3:, 3:],
            self.inputs.joint_rate_deviations(),
            self._impulses(t)[0].sum(axis=0),
        )

    def _start_mass_estimator(self, t: int, sample: Sample) -> MassEstimator:
        """Start the estimate of the held body from the samples before the grip.

        There are no samples of a payload before its grip. If base or joints were unknown for a
        while, the last estimate is the prior.
        """
        known = [each for each in self._earlier_samples if each[0] <= self._gripped - GRIP_DELAY]
        self._earlier_samples.clear()
        place, state = self.place, known[-1][2] if known else None
        earlier = [each[1] for each in known[:: -round(SPACING * SECOND / GRIP_DELAY)]][::-1]
        if place is None:  # the target has no markers
            x, y, heading = self.assumed_body.fixture
            offset = np.exp(-1j * heading) * complex(x, y)  # from it to the tip, seen from the tip
            place = payload_pose(self.p, sample.q, tip_pose(self.p, sample.q))
            place = place + np.array([offset.real, offset.imag, 0.0])
        if state is None:
            tip, J = tip_pose(self.p, sample.q), tip_jacobian(self.p, sample.q)
            free = FreeBody(tip, J @ sample.qd, np.eye(3))
        else:
            free = FreeBody.from_frame(
                self.p, place, state.pose, state.twist, state.covariance[3:, 3:]
            )
        prior = self.mass_properties or MassProperties.from_assumption(
            self.assumed_body, place, self.errors
        )
        thrust_error = self.settings.thrust_error
        return MassEstimator(self.p, prior, earlier or [sample], free, self.errors, thrust_error)

    def _update_parameters(self) -> None:
        p = self.p
        if self.mass_properties is not None:
            p = with_payload(p, *self.mass_properties.as_held_body)
        elif self.place is not None:
            p = with_payload(p, self.assumed_body, self.place)
        self.inputs.set_parameters(p)

    def _state(self, t: int) -> tuple[Floats, Floats]:
        """Return the state of base and joints at t [ns], and its rate, (3 + n,) each."""
        base = self.base.state().extrapolate_to(t)
        q, qd = self.inputs.joints_at(t)
        return np.concatenate([base.pose, q]), np.concatenate([base.twist, qd])

    def _other_body(self, name: str, t: int, pose: Pose, within: float) -> str:
        """Return the name of the other body at a pose; empty if there is none."""
        other = self.target if name == "target" else self.base
        if other.events and other.distance(t, pose) <= GATE_SIGMA:
            x, y = other.state().extrapolate_to(t).pose[:2].tolist()
            if hypot(pose[0] - x, pose[1] - y) < within:
                return name
        if self.base.events and self.inputs.all_joints_read:
            x, y, heading = tip_pose(self.p, self._state(t)[0]).tolist()
            heading_error = wrap(pose[2] - heading)
            distance, heading_tolerance = TIP_POSE_TOLERANCE
            is_near = hypot(pose[0] - x, pose[1] - y) < min(distance, within)
            if is_near and abs(heading_error) < heading_tolerance:
                return "end effector"
        return ""
