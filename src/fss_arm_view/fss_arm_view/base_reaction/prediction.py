"""Prediction of the base's pose from its drift and the joints' motion, with its deviation."""

from typing import NamedTuple

import numpy as np

from fss_arm_model.arrays import Floats
from fss_arm_model.base_motion import base_pose_sensitivities
from fss_arm_model.dynamics import inertia_matrix
from fss_arm_model.momentum import momentum, system_com
from fss_arm_model.units import GRAVITY
from fss_gnc.navigation import SensorErrors

from .joints import JointMotion


class Anchor(NamedTuple):
    """Initial state of a prediction."""

    t: int  # [ns]
    pose: Floats  # (3,) x, y [m], heading [rad]
    momentum: Floats  # (3,) [N s, N s, N m s], angular about the system's centre of mass
    covariance: Floats  # (6, 6) covariance of pose and momentum
    by_parameter: Floats  # (3, 8 + 6 n) derivatives of the momentum


def fit_drift(
    p: Floats, t: int, times: Floats, poses: Floats, q: Floats, errors: SensorErrors, tilt: Floats
) -> Anchor:
    """Fit the drift of the base while the arm rests; return the initial state of a prediction.

    Apart from the acceleration by the tilt, the system's centre of mass moves on a straight line
    and the heading changes at a constant rate.

    Args:
        p: (8 + 6 n,) Arm.vector().
        t: start of the prediction [ns].
        times: (m,) times of the poses relative to t [s]; m >= 3.
        poses: (m, 3) poses of the base.
        q: (n,) angles of the resting joints [rad].
        errors: standard deviations of the poses.
        tilt: (2,) slope of the table [rad], along which the system accelerates.
    """
    states = np.column_stack([poses, np.tile(q, (len(poses), 1))])
    com = system_com(p, states) - 0.5 * times[:, None] ** 2 * (GRAVITY * tilt)
    X = np.column_stack([np.ones_like(times), times])
    line, slope = np.linalg.lstsq(X, np.column_stack([com, poses[:, 2]]), rcond=None)[0]
    turn = line[2] - poses[-1, 2]
    lever = complex(*(com[-1] - poses[-1, :2])) * complex(np.cos(turn), np.sin(turn))
    pose = line - [lever.real, lever.imag, 0.0]
    state = np.concatenate([pose, q])
    # Filtered poses are smoother than the filter's input; the input's errors give the deviations.
    pose_covariance = (
        np.diag([errors.position_error, errors.position_error, errors.heading_error]) ** 2
    )
    to_com = np.array([[1.0, 0.0, -lever.imag], [0.0, 1.0, lever.real], [0.0, 0.0, 1.0]])
    rates = np.zeros((3, len(state)))
    rates[:, :3] = np.linalg.inv(to_com).T  # base rates for unit rates of the centre of mass
    by_rate = momentum(p, state, rates).T
    J = np.block([[np.eye(3), np.zeros((3, 3))], [np.zeros((3, 3)), by_rate @ to_com]])
    rate = np.concatenate([np.linalg.solve(to_com, slope), np.zeros(len(q))])
    return Anchor(
        t,
        pose,
        by_rate @ slope,
        J @ np.kron(np.linalg.inv(X.T @ X), pose_covariance) @ J.T,
        _by_parameter(p, state, rate),
    )


def _by_parameter(p: Floats, q: Floats, qd: Floats) -> Floats:
    """Return the derivatives of the momentum by the parameters, (3, 8 + 6 n).

    The momentum is at most cubic in the parameters.
    """
    step = 1e-4 * np.eye(len(p))
    above, below = (momentum(p + side * step, q, qd) for side in (1.0, -1.0))
    return ((above - below) / 2e-4).T


class Prediction:
    """Prediction of the base's pose from an anchor on, with its derivatives.

    Args:
        p: (8 + 6 n,) Arm.vector().
        anchor: initial state.
        tilt: (2,) slope of the table [rad].
    """

    def __init__(self, p: Floats, anchor: Anchor, tilt: Floats) -> None:
        self.p, self.anchor, self.t = p, anchor, anchor.t
        self.weight = inertia_matrix(p, np.zeros(3 + (len(p) - 8) // 6))[0, 0] * GRAVITY  # [N]
        self.tilt = tilt
        self.state = np.concatenate([anchor.pose, anchor.momentum, GRAVITY * tilt])
        # Derivatives of the pose by the parameters, by the anchor's pose and momentum, by the tilt.
        self.by_parameter = np.zeros((3, len(p)))
        self.by_pose, self.by_momentum = np.eye(3), np.zeros((3, 3))
        self.by_tilt = np.zeros((3, 2))

    @property
    def pose(self) -> Floats:
        """Pose at t, (3,)."""
        return self.state[:3].copy()

    def advance(self, t: int, motion: JointMotion) -> None:
        """Advance the prediction to t [ns], if that is later."""
        if t <= self.t:
            return
        poses, J = base_pose_sensitivities(self.p, motion.path(self.t, t), self.state)
        step, size = J[1], len(self.p)
        transition = step[:, size : size + 3]
        momentum_change = (
            self.weight * (self.t - self.anchor.t) * 1e-9 * step[:, size + 3 : size + 5]
        )
        self.by_tilt = transition @ self.by_tilt + momentum_change + GRAVITY * step[:, size + 6 :]
        self.by_parameter = transition @ self.by_parameter + step[:, :size]
        self.by_momentum = transition @ self.by_momentum + step[:, size + 3 : size + 6]
        self.by_pose = transition @ self.by_pose
        self.state[:3] = poses[1]
        self.state[3:5] += self.weight * self.tilt * (t - self.t) * 1e-9
        self.t = t

    def deviation(self, covariance: Floats, tilt_deviation: float) -> Floats:
        """Return the standard deviations of the pose, (3,).

        Args:
            covariance: (8 + 6 n, 8 + 6 n) covariance of Arm.vector().
            tilt_deviation: standard deviation of the tilt along each axis [rad].
        """
        by_anchor = np.hstack([self.by_pose, self.by_momentum])
        by_parameter = self.by_parameter + self.by_momentum @ self.anchor.by_parameter
        total = by_anchor @ self.anchor.covariance @ by_anchor.T
        total += by_parameter @ covariance @ by_parameter.T
        total += tilt_deviation**2 * self.by_tilt @ self.by_tilt.T
        return np.sqrt(np.diag(total))
