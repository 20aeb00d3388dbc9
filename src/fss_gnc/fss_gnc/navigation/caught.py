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
from fss_arm_model.dynamics import inertia_matrix
from fss_arm_model.held import Target
from fss_arm_model.kernels import Floats
from fss_arm_model.kinematics import tip_jacobian, tip_pose
from fss_arm_model.settings import NOT_NEGATIVE, POSITIVE, Settings, setting

LOG_M, C, LOG_I, GAIN, BASE, FREE = 0, slice(1, 3), 3, 4, slice(5, 8), slice(8, 11)
UNKNOWNS, OF_BODY = 11, 4
SPACING = 1.0  # initial spacing of samples; errors of a filtered twist last a quarter of that [s]
MOST = 60  # largest number of samples; beyond it every other one is dropped
ITERATIONS, SETTLED = 20, 1e-3  # of the solver; step below which it stops, in standard deviations
VAGUE = 1.0  # prior standard deviation of the base's twist [m/s, m/s, rad/s]
CHANCE = 5.0  # a sum of squares as unlikely as this many deviations of a Gaussian is still accepted
STEP = 1e-5  # step of finite differences, in prior standard deviations


@dataclass(frozen=True)
class CaughtErrors(Settings):
    """Uncertainty of the body's prior, and random walk of the momentum."""

    mass_error: float = setting(
        0.7, "relative error of the target's mass and of its inertia, 1 sigma of the logarithm",
        check=POSITIVE,
    )  # fmt: skip
    com_error: float = setting(
        0.05, "standard deviation of the target's centre of mass from its frame's origin", unit="m",
        check=POSITIVE,
    )  # fmt: skip
    push: float = setting(
        0.003, "random walk of the momentum, by what else pushes", unit="N sqrt(s)",
        check=NOT_NEGATIVE,
    )  # fmt: skip
    twisting: float = setting(
        0.001, "random walk of the angular momentum", unit="N m sqrt(s)", check=NOT_NEGATIVE
    )


class MassProperties(NamedTuple):
    """Mass, centre of mass and inertia of a held body, with covariance."""

    values: Floats  # (4,) mass [kg], centre of mass in the last link's frame [m, m], inertia
    covariance: Floats  # (4, 4)

    @staticmethod
    def assumed(body: Target, place: Floats, errors: CaughtErrors) -> "MassProperties":
        """Return the prior of a body whose frame is at `place` (held.py) in the gripper."""
        e = errors
        found = MassProperties(np.array([body.mass, *place[:2], body.inertia]), np.eye(OF_BODY))
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
    def held(self) -> tuple[Target, Floats]:
        """The held body and its place (3,) in the last link's frame (held.py)."""
        mass, x, y, inertia = self.values.tolist()
        return Target(mass, inertia), np.array([x, y, 0.0])


class Sample(NamedTuple):
    """State of base and arm at one time, shortly before the grip or while the body is held."""

    t: float  # [s]
    q: Floats  # (3 + n,)
    qd: Floats  # (3 + n,)
    base: Floats  # (3, 3) covariance of the base's twist
    joints: Floats  # (n,) deviations of the joints' rates [rad/s]
    impulse: Floats  # (3,) of the valves since a common start: [N s] and about the world's origin


class FreeBody(NamedTuple):
    """Motion of the body before the grip."""

    tip: Floats  # (3,) pose that the last link's tip would have if it already held the body
    twist: Floats  # (3,) of the body at that point
    covariance: Floats  # (3, 3)

    @staticmethod
    def of(p: Floats, place: Floats, pose: Floats, twist: Floats, covariance: Floats) -> "FreeBody":
        """Return the body's motion from that of its frame, which will be at `place` in the gripper.

        Args:
            p: (8 + 6 n,) of base and arm.
            place: (3,) of the frame in the gripper (held.py).
            pose: (3,) of the frame.
            twist: (3,) of the frame.
            covariance: (3, 3) of the twist.
        """
        heading = pose[2] - place[2]
        apart = (layout.reach(p, layout.count(p)) - complex(*place[:2])) * np.exp(1j * heading)
        x, y = apart.real, apart.imag
        J = np.array([[1.0, 0.0, -y], [0.0, 1.0, x], [0.0, 0.0, 1.0]])
        at = pose + np.array([x, y, 0.0])
        at[2] = heading + p[layout.TIP_ANGLE]
        return FreeBody(at, J @ twist, J @ covariance @ J.T)


@dataclass
class Caught:
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
    errors: CaughtErrors = field(default_factory=CaughtErrors)
    thrust_error: float = 0.05
    samples: list[Sample] = field(default_factory=list)
    spacing: float = SPACING

    def __post_init__(self) -> None:
        mass, x, y, inertia = self.prior.values
        self._known = np.concatenate([
            [np.log(mass), x, y, np.log(inertia), 1.0], self.earlier[0].qd[:3], self.free.twist,
        ])  # fmt: skip
        scale = self.prior.scale
        covariance = self.prior.covariance / np.outer(scale, scale)
        self._root = np.zeros((UNKNOWNS, UNKNOWNS))  # square root of the prior's covariance
        self._root[:OF_BODY, :OF_BODY] = np.linalg.cholesky(covariance)
        self._root[GAIN, GAIN] = max(self.thrust_error, 1e-9)
        self._root[BASE, BASE] = VAGUE * np.eye(3)
        self._root[FREE, FREE] = np.linalg.cholesky(self.free.covariance)
        self._z = np.zeros(UNKNOWNS)  # in standard deviations from the prior mean
        self._covariance: Floats = np.eye(UNKNOWNS)
        self._squares = 0.0  # sum of squared normalized residuals, the prior's included

    def take(self, sample: Sample) -> None:
        """Add a sample of the held body, with errors independent of earlier samples."""
        self.samples.append(sample)
        if len(self.samples) > MOST:
            self.samples, self.spacing = self.samples[::2], 2.0 * self.spacing

    def is_due(self, t: float) -> bool:
        """Return True if another sample is due at a time [s]."""
        return t >= (self.samples or self.earlier)[-1].t + self.spacing

    @property
    def explained(self) -> bool:
        """True if chance can explain the residuals, by the quantile of Wilson and Hilferty."""
        free = 3.0 * len(self.earlier + self.samples)
        spread = 2.0 / (9.0 * free)
        return bool(self._squares < free * (1.0 - spread + CHANCE * spread**0.5) ** 3)

    def solve(self) -> MassProperties:
        """Estimate the mass properties from all samples, starting at the last solution."""
        self._solve()
        x = self._known + self._root @ self._z
        covariance = self._root @ self._covariance @ self._root.T
        values = np.array([np.exp(x[LOG_M]), *x[C], np.exp(x[LOG_I])])
        found = MassProperties(values, covariance[:OF_BODY, :OF_BODY])
        return found._replace(covariance=found.covariance * np.outer(found.scale, found.scale))

    def _solve(self) -> None:
        """Run a damped Gauss-Newton (Levenberg-Marquardt) in prior standard deviations."""
        rows = _Rows(self.p, self.earlier, self.samples)
        white = self._correlations(rows)
        cost, off = self._cost(rows, white, self._z)
        damping = 1e-3
        for _ in range(ITERATIONS):
            J = np.stack([
                (self._off(rows, white, self._z + step) - off) / STEP
                for step in STEP * np.eye(UNKNOWNS)
            ], axis=1)  # fmt: skip
            information = J.T @ J + np.eye(UNKNOWNS)
            slope = J.T @ off + self._z
            step = -np.linalg.solve(information + damping * np.eye(UNKNOWNS), slope)
            tried, off_then = self._cost(rows, white, self._z + step)
            if tried <= cost:
                self._z, cost, off, damping = self._z + step, tried, off_then, 0.1 * damping
                white = self._correlations(rows)
                cost, off = self._cost(rows, white, self._z)
            else:
                damping = max(10.0 * damping, 1e-3)
            if np.abs(step).max() < SETTLED:
                break
        self._squares, self._covariance = cost, np.asarray(np.linalg.inv(information))

    def _cost(self, rows: "_Rows", white: Floats, z: Floats) -> tuple[float, Floats]:
        off = self._off(rows, white, z)
        return float(off @ off + z @ z), off

    def _off(self, rows: "_Rows", white: Floats, z: Floats) -> Floats:
        """Return measured less predicted twists, in their standard deviations, (3 k,)."""
        x = self._known + self._root @ z
        apart = rows.twist - self._predicted(rows, x)[0]
        found: Floats = white @ apart.ravel()
        return found

    def _predicted(self, rows: "_Rows", x: Floats) -> tuple[Floats, Floats, Floats]:
        """Return the base's predicted twists and their Jacobians.

        Returns:
            Twists (k, 3), Jacobians by momentum (k, 3, 3) and by the joints' rates (k, 3, n).
        """
        H = rows.inertia(x, self.place_of_tip)
        inverse = np.linalg.inv(H[:, :, :3])
        to_base = inverse @ rows.about_base
        by_joints = -inverse @ H[:, :, 3:]
        arm, body = self._before(x)
        momentum = arm + rows.held[:, None] * body
        momentum = momentum + x[GAIN] * (rows.impulse - self.earlier[0].impulse)
        at = np.einsum("kij,kj->ki", to_base, momentum)
        return at + np.einsum("kij,kj->ki", by_joints, rows.rates), to_base, by_joints

    @property
    def place_of_tip(self) -> Floats:
        """Position of the tip in the last link's frame, (2,) [m]."""
        return np.array([layout.each(self.p, layout.LENGTH)[-1], 0.0])

    def _before(self, x: Floats) -> tuple[Floats, Floats]:
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

    def _correlations(self, rows: "_Rows") -> Floats:
        """Return the matrix that whitens the errors of all twists, (3 k, 3 k)."""
        k, e = len(rows.t), self.errors
        x = self._known + self._root @ self._z
        _, to_base, by_joints = self._predicted(rows, x)
        walk = np.diag(np.square([e.push, e.push, e.twisting]))
        since = np.minimum.outer(rows.t, rows.t) - self.earlier[0].t
        moved = to_base @ walk
        found = np.einsum("aij,ab,bkj->aibk", moved, since, to_base)
        loose = by_joints * rows.loose[:, None, :]
        found[range(k), :, range(k)] += rows.covariance + loose @ loose.transpose(0, 2, 1)
        return np.linalg.inv(np.linalg.cholesky(found.reshape(3 * k, 3 * k)))


class _Rows:
    """Quantities of the samples that do not depend on the held body."""

    def __init__(self, p: Floats, earlier: list[Sample], later: list[Sample]) -> None:
        samples = earlier + later
        self.held = np.repeat([0.0, 1.0], [len(earlier), len(later)])
        q, qd = np.array([s.q for s in samples]), np.array([s.qd for s in samples])
        self.t = np.array([s.t for s in samples])
        self.twist, self.rates = qd[:, :3], qd[:, 3:]
        self.covariance = np.array([s.base for s in samples])
        self.loose = np.array([s.joints for s in samples])
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
    mass, (u, v) = np.exp(x[LOG_M]), x[C] - tip
    S = mass * complex(u, v) * np.exp(1j * headings)
    M = np.zeros((len(headings), 3, 3))
    M[:, 0, 0] = M[:, 1, 1] = mass
    M[:, 0, 2] = M[:, 2, 0] = -S.imag
    M[:, 1, 2] = M[:, 2, 1] = S.real
    M[:, 2, 2] = np.exp(x[LOG_I]) + mass * (u * u + v * v)
    return M


def to_origin(at: Floats, momentum: Floats) -> Floats:
    """Return a momentum or impulse (3,) about a point `at` (2,) as one about the world's origin."""
    x, y, turn = momentum
    return np.array([x, y, turn + at[0] * y - at[1] * x])
