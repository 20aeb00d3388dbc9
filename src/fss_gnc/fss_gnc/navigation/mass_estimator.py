"""Estimation of the mass, centre of mass and inertia of a held body from momentum.

The held body turns with the last link. With its mass m, its centre of mass c in the last link's
frame and its inertia I about c, the inertia and the momentum of base, arm and body are

    H = H_arm + J' M J,   g = [H qd]_b,   M by m, S = R (c - tip) m and I + |S|^2 / m

about the base's origin. J is the tip's Jacobian. In the world's frame g is the momentum before the
grip, that of the arm plus that of the free body, plus the impulse of the valves since then. This
predicts the twist of the base,

    x'_b = H_bb^-1 (g - H_bm q'_m),

and m, c, I are the values that predict the measured twists best: nonlinear least squares, whose
unknowns are

    log m, c, log I, the thrust's gain, twists of base and of the free body before the grip,

each with a prior. Measurements enter on one side of the equation only, so noise cannot make a
parameter appear observable: what no motion has excited yet keeps the standard deviation of its
prior. Other pushes are modelled as a random walk of momentum, whose effect correlates all
predictions. A larger push, as of a leaking valve, would be mistaken for mass: the sum of squares
detects it (Bar-Shalom, Li, Kirubarajan 2001, 5.4).
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from fss_arm_model import layout
from fss_arm_model.arrays import Floats
from fss_arm_model.dynamics import inertia_matrix
from fss_arm_model.held import Target
from fss_arm_model.kinematics import tip_jacobian, tip_pose
from fss_arm_model.settings import NOT_NEGATIVE, POSITIVE, Settings, setting

LOG_MASS, C, LOG_INERTIA, GAIN, BASE, FREE = 0, slice(1, 3), 3, 4, slice(5, 8), slice(8, 11)
UNKNOWNS, BODY_UNKNOWNS = 11, 4
SPACING = 1.0  # initial spacing of samples; errors of a filtered twist last a quarter of that [s]
MAX_SAMPLES = 60  # largest number of samples; beyond it every other one is dropped
MAX_ITERATIONS = 20  # of the solver
STEP_TOLERANCE = 1e-3  # step below which the solver stops, in prior standard deviations
PRIOR_TWIST_SIGMA = 1.0  # prior standard deviation of the base's twist [m/s, m/s, rad/s]
MAX_RESIDUAL_SIGMA = 5.0  # of the sum of squares, as a quantile in Gaussian deviations
DIFFERENCE_STEP = 1e-5  # step of finite differences, in prior standard deviations


@dataclass(frozen=True)
class MassErrors(Settings):
    """Uncertainty of the body's prior, and random walk of the momentum."""

    mass_error: float = setting(
        0.7,
        "prior 1 sigma of the logarithm of the target's mass and inertia, about target_mass and "
        "target_inertia; 0.7: known to a factor of 2",
        check=POSITIVE,
    )
    com_error: float = setting(
        0.05,
        "prior 1 sigma of the target's centre of mass about its frame's origin, each axis",
        unit="m",
        check=POSITIVE,
    )
    momentum_walk: float = setting(
        0.003,
        "random walk of the momentum of base, arm and held target, when its mass is estimated",
        unit="N s/sqrt(s)",
        check=NOT_NEGATIVE,
    )
    angular_momentum_walk: float = setting(
        0.001,
        "random walk of their angular momentum, when the held target's inertia is estimated",
        unit="N m s/sqrt(s)",
        check=NOT_NEGATIVE,
    )


class MassProperties(NamedTuple):
    """Mass, centre of mass and inertia of a held body, with covariance."""

    values: Floats  # (4,) mass [kg], centre of mass in the last link's frame [m, m], inertia
    covariance: Floats  # (4, 4)

    @staticmethod
    def from_assumption(body: Target, place: Floats, errors: MassErrors) -> "MassProperties":
        """Return the prior of a body whose frame is at `place` (held.py) in the gripper."""
        e = errors
        found = MassProperties(
            np.array([body.mass, *place[:2], body.inertia]), np.eye(BODY_UNKNOWNS)
        )
        deviations = found.scale * (e.mass_error, e.com_error, e.com_error, e.mass_error)
        return found._replace(covariance=np.diag(deviations**2))

    @property
    def scale(self) -> Floats:
        """Scale of the values, (4,): the value for mass and inertia (log unknowns), otherwise 1."""
        return np.array([self.values[0], 1.0, 1.0, self.values[3]])

    @property
    def deviations(self) -> Floats:
        """Standard deviations of the values, (4,)."""
        found: Floats = np.sqrt(self.covariance.diagonal())
        return found

    @property
    def as_held_body(self) -> tuple[Target, Floats]:
        """Held body and its place (3,) in the last link's frame (held.py)."""
        mass, x, y, inertia = self.values.tolist()
        return Target(mass, inertia), np.array([x, y, 0.0])


class Sample(NamedTuple):
    """State of base and arm at one time, shortly before the grip or while the body is held."""

    t: float  # [s]
    q: Floats  # (3 + n,)
    qd: Floats  # (3 + n,)
    twist_covariance: Floats  # (3, 3) of the base
    rate_deviations: Floats  # (n,) 1 sigma of the joints' rates [rad/s]
    impulse: Floats  # (3,) of the valves since a common start: [N s] and about the world's origin


class FreeBody(NamedTuple):
    """Motion of the body before the grip."""

    tip: Floats  # (3,) pose that the last link's tip would have if it already held the body
    twist: Floats  # (3,) of the body at that point
    covariance: Floats  # (3, 3)

    @staticmethod
    def from_frame(
        p: Floats, place: Floats, pose: Floats, twist: Floats, covariance: Floats
    ) -> "FreeBody":
        """Return the body's motion from that of its frame, which will be at `place` in the gripper.

        Args:
            p: (8 + 6 n,) of base and arm.
            place: (3,) of the frame in the gripper (held.py).
            pose: (3,) of the frame.
            twist: (3,) of the frame.
            covariance: (3, 3) of the twist.
        """
        heading = pose[2] - place[2]
        offset = (layout.reach(p, layout.count(p)) - complex(*place[:2])) * np.exp(1j * heading)
        x, y = offset.real, offset.imag
        J = np.array([[1.0, 0.0, -y], [0.0, 1.0, x], [0.0, 0.0, 1.0]])
        at = pose + np.array([x, y, 0.0])
        at[2] = heading + p[layout.TIP_ANGLE]
        return FreeBody(at, J @ twist, J @ covariance @ J.T)


@dataclass
class MassEstimator:
    """Estimator of the mass properties of one body, from the grip on.

    Args:
        p: (8 + 6 n,) of base and arm alone.
        prior: mass properties known before the grip.
        earlier: samples of base and arm before the grip, in order.
        free: motion of the body before the grip, at any time.
        errors: random walk of the momentum.
        thrust_error: relative error of the valves' thrust.
    """

    p: Floats
    prior: MassProperties
    earlier: list[Sample]
    free: FreeBody
    errors: MassErrors = field(default_factory=MassErrors)
    thrust_error: float = 0.05
    samples: list[Sample] = field(default_factory=list)
    spacing: float = SPACING

    def __post_init__(self) -> None:
        mass, x, y, inertia = self.prior.values
        self._prior_mean = np.concatenate(
            [[np.log(mass), x, y, np.log(inertia), 1.0], self.earlier[0].qd[:3], self.free.twist]
        )
        scale = self.prior.scale
        covariance = self.prior.covariance / np.outer(scale, scale)
        self._prior_root = np.zeros((UNKNOWNS, UNKNOWNS))  # square root of the prior's covariance
        self._prior_root[:BODY_UNKNOWNS, :BODY_UNKNOWNS] = np.linalg.cholesky(covariance)
        self._prior_root[GAIN, GAIN] = max(self.thrust_error, 1e-9)
        self._prior_root[BASE, BASE] = PRIOR_TWIST_SIGMA * np.eye(3)
        self._prior_root[FREE, FREE] = np.linalg.cholesky(self.free.covariance)
        self._z = np.zeros(UNKNOWNS)  # in standard deviations from the prior mean
        self._covariance: Floats = np.eye(UNKNOWNS)
        self._residual_squares = 0.0  # sum of squared normalized residuals, the prior's included

    def add_sample(self, sample: Sample) -> None:
        """Add a sample of the held body, with errors independent of earlier samples."""
        self.samples.append(sample)
        if len(self.samples) > MAX_SAMPLES:
            self.samples, self.spacing = self.samples[::2], 2.0 * self.spacing

    def is_due(self, t: float) -> bool:
        """Return True if another sample is due at a time [s]."""
        return t >= (self.samples or self.earlier)[-1].t + self.spacing

    @property
    def is_consistent(self) -> bool:
        """True if chance can explain the residuals, by the quantile of Wilson and Hilferty."""
        dof = 3.0 * len(self.earlier + self.samples)
        variance = 2.0 / (9.0 * dof)
        return bool(
            self._residual_squares
            < dof * (1.0 - variance + MAX_RESIDUAL_SIGMA * variance**0.5) ** 3
        )

    def solve(self) -> MassProperties:
        """Estimate the mass properties from all samples, starting at the last solution."""
        self._solve()
        x = self._prior_mean + self._prior_root @ self._z
        covariance = self._prior_root @ self._covariance @ self._prior_root.T
        values = np.array([np.exp(x[LOG_MASS]), *x[C], np.exp(x[LOG_INERTIA])])
        found = MassProperties(values, covariance[:BODY_UNKNOWNS, :BODY_UNKNOWNS])
        return found._replace(covariance=found.covariance * np.outer(found.scale, found.scale))

    def _solve(self) -> None:
        """Run a damped Gauss-Newton (Levenberg-Marquardt) in prior standard deviations."""
        rows = _Rows(self.p, self.earlier, self.samples)
        whitening = self._whitening_matrix(rows)
        cost, residuals = self._cost(rows, whitening, self._z)
        damping = 1e-3
        for _ in range(MAX_ITERATIONS):
            J = np.stack(
                [
                    (self._residuals(rows, whitening, self._z + step) - residuals) / DIFFERENCE_STEP
                    for step in DIFFERENCE_STEP * np.eye(UNKNOWNS)
                ],
                axis=1,
            )
            information = J.T @ J + np.eye(UNKNOWNS)
            gradient = J.T @ residuals + self._z
            step = -np.linalg.solve(information + damping * np.eye(UNKNOWNS), gradient)
            next_cost, _ = self._cost(rows, whitening, self._z + step)
            if next_cost <= cost:
                self._z, damping = self._z + step, 0.1 * damping
                whitening = self._whitening_matrix(rows)
                cost, residuals = self._cost(rows, whitening, self._z)
            else:
                damping = max(10.0 * damping, 1e-3)
            if np.abs(step).max() < STEP_TOLERANCE:
                break
        self._residual_squares, self._covariance = cost, np.asarray(np.linalg.inv(information))

    def _cost(self, rows: "_Rows", whitening: Floats, z: Floats) -> tuple[float, Floats]:
        """Return cost and residuals (3 k,); infinite cost for masses that make H_b singular."""
        try:
            residuals = self._residuals(rows, whitening, z)
        except np.linalg.LinAlgError:
            return np.inf, np.full(rows.twist.size, np.inf)
        return float(residuals @ residuals + z @ z), residuals

    def _residuals(self, rows: "_Rows", whitening: Floats, z: Floats) -> Floats:
        """Return measured less predicted twists, in their standard deviations, (3 k,)."""
        x = self._prior_mean + self._prior_root @ z
        offset = rows.twist - self._predict_twists(rows, x)[0]
        found: Floats = whitening @ offset.ravel()
        return found

    def _predict_twists(self, rows: "_Rows", x: Floats) -> tuple[Floats, Floats, Floats]:
        """Return the base's predicted twists and their Jacobians.

        Returns:
            Twists (k, 3), Jacobians by momentum (k, 3, 3) and by the joints' rates (k, 3, n).
        """
        H = rows.inertia(x, self.place_of_tip)
        inverse = np.linalg.inv(H[:, :, :3])
        to_base = inverse @ rows.about_base
        by_joints = -inverse @ H[:, :, 3:]
        arm, body = self._initial_momenta(x)
        momentum = arm + rows.held[:, None] * body
        momentum = momentum + x[GAIN] * (rows.impulse - self.earlier[0].impulse)
        at = np.einsum("kij,kj->ki", to_base, momentum)
        return at + np.einsum("kij,kj->ki", by_joints, rows.rates), to_base, by_joints

    @property
    def place_of_tip(self) -> Floats:
        """Position of the tip in the last link's frame, (2,) [m]."""
        return np.array([layout.each(self.p, layout.LENGTH)[-1], 0.0])

    def _initial_momenta(self, x: Floats) -> tuple[Floats, Floats]:
        """Return the momenta before the grip about the world's origin.

        Returns:
            Momentum (3,) of base and arm, and momentum (3,) of the body.
        """
        q, qd = self.earlier[0].q, self.earlier[0].qd.copy()
        qd[:3] = x[BASE]
        arm = to_origin(q[:2], inertia_matrix(self.p, q)[:3] @ qd)
        tip = self.free.tip
        heading = tip[2] - self.p[layout.TIP_ANGLE]
        body = body_inertia(x, self.place_of_tip, np.array([heading]))[0] @ x[FREE]
        return arm, to_origin(tip[:2], body)

    def _whitening_matrix(self, rows: "_Rows") -> Floats:
        """Return the matrix that whitens the errors of all twists, (3 k, 3 k)."""
        k, e = len(rows.t), self.errors
        x = self._prior_mean + self._prior_root @ self._z
        _, to_base, by_joints = self._predict_twists(rows, x)
        walk = np.diag(np.square([e.momentum_walk, e.momentum_walk, e.angular_momentum_walk]))
        since = np.minimum.outer(rows.t, rows.t) - self.earlier[0].t
        walk_effect = to_base @ walk
        found = np.einsum("aij,ab,bkj->aibk", walk_effect, since, to_base)
        rate_noise = by_joints * rows.rate_noise[:, None, :]
        found[range(k), :, range(k)] += rows.covariance + rate_noise @ rate_noise.transpose(0, 2, 1)
        return np.linalg.inv(np.linalg.cholesky(found.reshape(3 * k, 3 * k)))


class _Rows:
    """Quantities of the samples that do not depend on the held body."""

    def __init__(self, p: Floats, earlier: list[Sample], later: list[Sample]) -> None:
        samples = earlier + later
        self.held = np.repeat([0.0, 1.0], [len(earlier), len(later)])
        q, qd = np.array([s.q for s in samples]), np.array([s.qd for s in samples])
        self.t = np.array([s.t for s in samples])
        self.twist, self.rates = qd[:, :3], qd[:, 3:]
        self.covariance = np.array([s.twist_covariance for s in samples])
        self.rate_noise = np.array([s.rate_deviations for s in samples])
        self.impulse = np.array([s.impulse for s in samples])
        self._arm, self._tip = inertia_matrix(p, q)[:, :3], tip_jacobian(p, q)
        self._headings = tip_pose(p, q)[:, 2] - p[layout.TIP_ANGLE]
        self.about_base = np.tile(np.eye(3), (len(q), 1, 1))  # of a momentum about the origin
        self.about_base[:, 2, 0], self.about_base[:, 2, 1] = q[:, 1], -q[:, 0]

    def inertia(self, x: Floats, tip: Floats) -> Floats:
        """Return the base's rows of H with the body x, (k, 3, 3 + n)."""
        body = self.held[:, None, None] * body_inertia(x, tip, self._headings)
        return self._arm + self._tip[:, :, :3].transpose(0, 2, 1) @ body @ self._tip


def body_inertia(x: Floats, tip: Floats, headings: Floats) -> Floats:
    """Return the inertia of a body about the tip, (k, 3, 3).

    Args:
        x: (4 or more,) log m, c and log I.
        tip: (2,) tip in the last link's frame.
        headings: (k,) of the last link.
    """
    mass, (u, v) = np.exp(x[LOG_MASS]), x[C] - tip
    S = mass * complex(u, v) * np.exp(1j * headings)
    M = np.zeros((len(headings), 3, 3))
    M[:, 0, 0] = M[:, 1, 1] = mass
    M[:, 0, 2] = M[:, 2, 0] = -S.imag
    M[:, 1, 2] = M[:, 2, 1] = S.real
    M[:, 2, 2] = np.exp(x[LOG_INERTIA]) + mass * (u * u + v * v)
    return M


def to_origin(at: Floats, momentum: Floats) -> Floats:
    """Return a momentum or impulse (3,) about a point `at` (2,) as one about the world's origin."""
    x, y, turn = momentum
    return np.array([x, y, turn + at[0] * y - at[1] * x])
