"""Base reaction: a prediction that restarts with each motion, and its results at one time."""

from bisect import bisect_right
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import inf, isfinite

import numpy as np

from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_model.dynamics import bias, inertia_matrix, inverse_dynamics, kinetic_energy
from fss_arm_model.momentum import momentum, system_com
from fss_arm_model.units import SECOND
from fss_gnc.navigation import BodyState

from ..settings import ReactionSettings
from .joints import Joint, JointMotion, joint_motion
from .prediction import Anchor, Prediction, fit_drift

_MAX_HISTORY = 5 * SECOND  # of measured base states
_MAX_GAP = 60 * SECOND  # longer gaps without complete data end a prediction
_MIN_DRIFT, _MAX_DRIFT = SECOND // 2, 2 * SECOND  # duration of a drift fitted for a prediction [ns]
_MOMENTUM_WINDOW = 30.0  # time over which the slope of the momentum is fitted [s]


@dataclass(frozen=True)
class Reaction:
    """Base reaction at one time; vectors are x, y, heading or along x, y, about z. NaN: unknown."""

    t: int  # [ns]
    anchor: int  # start of the prediction [ns]
    predicted: Floats  # pose of the base (3,)
    predicted_deviation: Floats
    measured: Floats
    measured_deviation: Floats
    twist: Floats  # measured
    momentum: Floats  # of the system, angular about its centre of mass (3,) [N s, N s, N m s]
    momentum_deviation: Floats
    momentum_drift: Floats  # (3,) [N, N, N m]
    kinetic_energy: float  # [J]
    force: Floats  # of the base on link 1 at the first joint, (2,) [N]
    torque: float  # of the base on link 1 about the first joint [N m]
    torque_measured: float  # link 1's sensor [N m]
    q: Floats  # (n,) joint readings [rad]
    com: Floats  # (2,) centre of mass of the system [m]
    is_disturbed: bool  # True if thrusters have fired since the start of the prediction's fit

    @property
    def difference(self) -> Floats:
        """Measured minus predicted pose, (3,); NaN if it is not due to the arm alone."""
        return np.full(3, np.nan) if self.is_disturbed else self.measured - self.predicted


class BaseReaction:
    """Estimator of the base reaction from the motion of joints and base.

    It returns a Reaction for times at which both are known.

    Args:
        arm: description used by predictions.
        covariance: (8 + 6 n, 8 + 6 n) covariance of Arm.vector(); None: known exactly.
        settings: thresholds.
    """

    def __init__(
        self, arm: Arm, covariance: Floats | None = None, settings: ReactionSettings | None = None
    ) -> None:
        self.settings = settings or ReactionSettings()
        self.tilt = np.array(self.settings.tilt)
        self.half_step = int(self.settings.half_difference * SECOND)
        self.joints = [Joint() for _ in range(arm.n)]
        self.base_states: deque[BodyState] = deque()
        self.momenta: deque[tuple[float, Floats]] = deque()
        self.t = -1
        self.thrust_end = -inf  # end of the last thruster pulse [ns]
        self.resting_since = -1
        self.candidate: Anchor | None = None
        self.set_arm(arm, covariance)

    def set_arm(self, arm: Arm, covariance: Floats | None = None) -> None:
        """Use another description for predictions, from the next rest on."""
        self.p = arm.vector()
        size = len(self.p)
        self.covariance = np.zeros((size, size)) if covariance is None else covariance
        self.prediction: Prediction | None = None
        self.momenta.clear()

    def add_reading(self, i: int, t: int, q: float, qd: float, effort: float) -> bool:
        """Add a reading of joint i (0 to n - 1) at t [ns]; return False if it is not newer."""
        if t - self.t > _MAX_GAP:
            self.prediction, self.candidate, self.resting_since = None, None, -1
            self.joints[i].drop_before(t - _MAX_HISTORY)
        return self.joints[i].add(t, q, qd, effort)

    def add_base_state(self, state: BodyState) -> None:
        """Add a measured state of the base."""
        self.base_states.append(state)
        while self.base_states[0].t < state.t - _MAX_HISTORY:
            self.base_states.popleft()

    def add_thrust(self, t: int, on_times: Sequence[float]) -> None:
        """Store when thrusters fire, from t [ns] on for times [s]: predictions do not include it.

        A command with a time that is not finite is ignored, as the board rejects it.
        """
        if all(map(isfinite, on_times)) and max(on_times) > 0.0:
            self.thrust_end = max(self.thrust_end, t + round(max(on_times) * SECOND))

    def is_moving(self) -> bool:
        """Return True if a joint moves, according to the newest readings."""
        return any(j.qd and abs(j.qd[-1]) > self.settings.motion_threshold for j in self.joints)

    def last_known_time(self) -> int:
        """Return the last time at which joints and base are known [ns]; -1: none."""
        if not self.base_states or not all(joint.t for joint in self.joints):
            return -1
        return min(
            min(joint.t[-1] for joint in self.joints) - self.half_step, self.base_states[-1].t
        )

    def due(self, period: int) -> Iterator[Reaction]:
        """Yield the reaction every `period` [ns] up to the last known time; skip gaps over 1 s."""
        until = self.last_known_time()
        if until - self.t > SECOND:
            times = [until]
        else:
            times = list(range(self.t + period, until + 1, period))
        yield from filter(None, map(self.advance, times))

    def advance(self, t: int) -> Reaction | None:
        """Return the reaction at t [ns], which must increase and not exceed last_known_time().

        None: t is not later, the base is unknown at t, or there is no prediction yet.
        """
        if t <= self.t:
            return None
        self.t = t
        measured = self._interpolate_base(t)
        if measured is None:  # no pose of the base at that time
            return None
        at_rest = not any(
            joint.is_moving(t, self.settings.motion_threshold) for joint in self.joints
        )
        if at_rest:
            self.resting_since = t if self.resting_since < 0 else self.resting_since
            self.candidate = self._fit_drift(t) or self.candidate
        if self.candidate and (self.prediction is None or not at_rest):
            self.prediction = Prediction(self.p, self.candidate, self.tilt)
        if not at_rest:
            self.candidate, self.resting_since = None, -1
        if self.prediction is None:
            self._drop_old_readings(t)
            return None
        motion = joint_motion(self.joints, min(t, self.prediction.t), self.half_step)
        self.prediction.advance(t, motion)
        self._drop_old_readings(t)
        return self._compute(measured, motion, self.prediction)

    def _drop_old_readings(self, t: int) -> None:
        """Drop the readings that no time after t [ns] needs."""
        for joint in self.joints:
            joint.drop_before(t - max(SECOND, self.half_step))

    def _interpolate_base(self, t: int) -> BodyState | None:
        """Return the base state at t, interpolated between neighbours; None: none before t."""
        k = bisect_right(self.base_states, t, key=lambda e: e.t) - 1
        if k < 0:
            return None
        before, after = self.base_states[k], self.base_states[min(k + 1, len(self.base_states) - 1)]
        w = (t - before.t) / max(after.t - before.t, 1)
        pose = (1.0 - w) * before.extrapolate_to(t).pose + w * after.extrapolate_to(t).pose
        return before._replace(t=t, pose=pose, twist=(1.0 - w) * before.twist + w * after.twist)

    def _fit_drift(self, t: int) -> Anchor | None:
        """Return the fit of the base's drift since the arm rests; None: the drift is too short."""
        s = self.settings
        start = max(self.resting_since, t - _MAX_DRIFT)
        drift = [state for state in self.base_states if start <= state.t <= t]
        if len({state.t for state in drift}) < 3 or t - start < _MIN_DRIFT:
            return None
        times = np.array([(state.t - t) * 1e-9 for state in drift])
        q = np.array([joint.q[joint.last_index(t)] for joint in self.joints])
        return fit_drift(self.p, t, times, np.array([e.pose for e in drift]), q, s, self.tilt)

    def _compute(
        self, measured: BodyState, motion: JointMotion, prediction: Prediction
    ) -> Reaction:
        s, p, t, n = self.settings, self.p, measured.t, len(self.joints)
        q, qd = motion.at(t - self.half_step, t, t + self.half_step)
        state = np.concatenate([measured.pose, q[1]])
        rate = np.concatenate([measured.twist, qd[1]])
        P = momentum(p, state, rate)
        by_rate = np.column_stack([momentum(p, state, row) for row in np.eye(3 + n)[:3]])
        # Without external force the base's acceleration follows from the joint accelerations.
        H, h = inertia_matrix(p, state), bias(p, state, rate)
        qdd = (qd[2] - qd[0]) / (2.0 * s.half_difference)
        base = -np.linalg.solve(H[:3, :3], H[:3, 3:] @ qdd + h[:3])
        tau = inverse_dynamics(p, state, rate, np.concatenate([base, qdd]))
        first = self.joints[0]
        fit_start = prediction.anchor.t - _MAX_DRIFT
        return Reaction(
            t,
            prediction.anchor.t,
            prediction.pose,
            prediction.deviation(self.covariance, s.tilt_deviation),
            measured.pose,
            np.sqrt(measured.pose_variance),
            measured.twist,
            P,
            np.sqrt(by_rate**2 @ measured.twist_variance),
            self._momentum_slope(t * 1e-9, P),
            float(kinetic_energy(p, state, rate)),
            _force(p, state, rate, base),
            float(tau[3]),
            first.effort[first.last_index(t)],
            q[1],
            system_com(p, state),
            self.thrust_end > fit_start,
        )

    def _momentum_slope(self, now: float, P: Floats) -> Floats:
        """Add the momentum P; return its slope within the window. NaN: fewer than 3 values."""
        self.momenta.append((now, P))
        while self.momenta[0][0] < now - _MOMENTUM_WINDOW:
            self.momenta.popleft()
        if len(self.momenta) < 3:
            return np.full(3, np.nan)
        times = np.array([t for t, _ in self.momenta])
        times -= times.mean()
        return times @ np.array([P for _, P in self.momenta]) / (times @ times)


def _force(p: Floats, state: Floats, rate: Floats, acceleration: Floats) -> Floats:
    """Return the base's force on link 1: minus mass times acceleration of its centre of mass."""
    mass, com = p[0], complex(p[2], p[3])
    turn = complex(np.cos(state[2]), np.sin(state[2]))
    a = complex(*acceleration[:2]) + complex(-(rate[2] ** 2), acceleration[2]) * com * turn
    return -mass * np.array([a.real, a.imag])
