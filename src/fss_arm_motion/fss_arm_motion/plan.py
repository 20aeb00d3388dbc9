"""A plan: joint paths in time, the predicted motion of the base, and its uncertainty.

The base's pose follows from the conservation of momentum (fss_arm_model.base_motion). Its standard
deviation follows to first order from the covariances C of the arm's parameters p and of the
initial state s:

    sigma^2 = (dx/dp) C_p (dx/dp)^T + (dx/ds) C_s (dx/ds)^T
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fss_arm_model import clearance, layout
from fss_arm_model.arrays import Floats
from fss_arm_model.base_motion import base_pose_sensitivities
from fss_arm_model.clearance import body_name, links_and_base, sizes
from fss_arm_model.description import Arm
from fss_arm_model.extents import Extents
from fss_arm_model.free_floating import free_torques
from fss_arm_model.joint_path import Law, path, sampled
from fss_arm_model.momentum import momentum
from fss_arm_model.units import in_degrees
from fss_arm_motion.limits import KINDS, Limits
from fss_arm_motion.transcription import gaps

PREDICTION_STEP = 0.05  # of predicted poses [s]
BISECTIONS = 30  # of a prediction step, to find when the base turns back
PROBES_PER_SEGMENT = 40  # number of times in each segment at which limits are checked


#: Additional results of the kinds of plans, with units.
NOTES = {
    "least_possible": ("shortest time of the slowest joint by itself", "s"),
    "fastest_turn": ("turn of the base in the fastest motion", "rad"),
    "travel": ("length in joint space", "rad"),
    "length": ("length of the end effector's way", "m"),
    "error": ("largest distance of the end effector from its way", "m"),
    "deviation": ("largest deviation of the cubics from the ideal path", "rad"),
    "ratio": ("velocity ratio there", "m"),
    "ratio_before": ("velocity ratio where it begins", "m"),
    "rounds": ("rounds of the loop", ""),
}


class PlanError(ValueError):
    """There is no such plan; the message names the joint, the value and the limit."""


@dataclass(frozen=True)
class Start:
    """The initial state of a plan, and its uncertainty.

    Raises:
        PlanError: a joint is beyond its limits, or the number of joints is not the arm's.
    """

    arm: Arm
    q: Floats  # (n,) joint readings, at rest [rad]
    pose: Floats = field(default_factory=lambda: np.zeros(3))  # of the base [m, m, rad]
    momentum: Floats = field(default_factory=lambda: np.zeros(3))  # [N s, N s, N m s]
    limits: Limits = None  # type: ignore[assignment]  # of the arm by default
    covariance: Floats | None = None  # of Arm.vector(); None: taken as exact
    state_covariance: Floats | None = None  # (6, 6) of pose and momentum
    tracking: float = 0.0  # standard deviation of joints from their path [rad]

    def __post_init__(self) -> None:
        if self.limits is None:
            object.__setattr__(self, "limits", Limits.of(self.arm))
        object.__setattr__(self, "q", self.posture("q", self.q))

    def posture(self, name: str, q: Any) -> Floats:
        """Return readings (n,) as an array.

        Raises:
            PlanError: they are not n, or not within the limits.
        """
        q = np.asarray(q, dtype=float)
        if q.shape != (self.arm.n,):
            raise PlanError(
                f"{name} has {q.size} angles, expected {self.arm.n}, "
                f"as the arm {self.arm.name!r} has {self.arm.n} joints"
            )
        if not np.isfinite(q).all():
            raise PlanError(f"{name} is {in_degrees(q)}, expected finite angles")
        if problem := self.limits.outside(q):
            raise PlanError(f"{name}: {problem}")
        return q

    def gap(self, q: Floats) -> Floats:
        """Return the least gap between bodies that are not neighbours at q (..., n), (...) [m]."""
        return gaps(self.arm.vector(), q, self.limits.radii)

    def nearest(self, q: Floats) -> str:
        """Return the names of the two nearest such bodies at readings (n,)."""
        base, link = self.limits.radii
        pairs, around = list(links_and_base(q.size)), Extents(base_radius=base, link_radius=link)
        found = clearance.gaps(self.arm.vector(), [0.0, 0.0, 0.0, *q], pairs, sizes(around))
        return " and ".join(body_name(body, q.size) for body in pairs[int(np.argmin(found))])

    @property
    def L(self) -> float:
        """Angular momentum about the system's centre of mass [N m s]."""
        return float(self.momentum[2])

    @property
    def bodies(self) -> Floats:
        """Arm.vector() for base motion, with the rotors' share in the momentum, N J.

        Rotors carry N J (q'_1 + .. + q'_n). An inertia N J that turns with the last link represents
        them here. It also carries N J theta', a few 1e-5 of the total, which is not corrected.
        """
        p = self.arm.vector()
        p[layout.LINK_SIZE * self.arm.n + layout.LINK_INERTIA] += self.limits.rotor[1]
        return p


@dataclass(frozen=True)
class Prediction:
    """Predicted motion of the base."""

    times: Floats  # (k,) [s]
    pose: Floats  # (k, 3) x, y [m], heading [rad], not wrapped
    deviation: Floats  # (k, 3) standard deviation

    @property
    def turn(self) -> float:
        """Total turn of the base [rad]."""
        return float(self.pose[-1, 2] - self.pose[0, 2])

    @property
    def excursion(self) -> float:
        """Largest turn away from the initial heading [rad]."""
        return float(np.abs(self.pose[:, 2] - self.pose[0, 2]).max())


@dataclass(frozen=True)
class Plan:
    """A path in time for n joints, cubic between its m knots, and its effect on the base."""

    kind: str
    arguments: Mapping[str, Any]
    times: Floats  # (m,) from 0 [s]
    q: Floats  # (m, n) [rad]
    qd: Floats  # (m, n) [rad/s]; 0 at the first and the last
    prediction: Prediction
    used: Floats  # (3, n) largest share of each joint's rate, acceleration and torque
    notes: Mapping[str, float] = field(default_factory=dict)  # by the names of NOTES
    ended: str = ""  # reason why the motion is shorter than requested

    @property
    def duration(self) -> float:
        """Duration of the motion [s]."""
        return float(self.times[-1])

    @property
    def bound(self) -> str:
        """The limit that the motion comes closest to, and the share of it that it uses."""
        kind, joint = np.unravel_index(np.argmax(self.used), self.used.shape)
        name, share = KINDS[kind][0], self.used[kind, joint]
        return f"{name} of joint {joint + 1}, {100 * share:.0f} % of what plans may use"

    def at(self, t: Floats) -> tuple[Floats, Floats]:
        """Return angles and rates at times (k,), each (k, n)."""
        n = self.q.shape[1]
        return sampled([self.times] * n, list(self.q.T), list(self.qd.T))[0](t)


def probed(times: Floats, q: Floats, qd: Floats) -> tuple[Floats, Floats, Floats]:
    """Return angles, rates and accelerations along a path, both sides of each knot, (k, n)."""
    h = np.diff(times)[:, None, None]
    x = np.linspace(0.0, 1.0, PROBES_PER_SEGMENT)[:, None]
    q0, q1, v0, v1 = q[:-1, None], q[1:, None], h * qd[:-1, None], h * qd[1:, None]
    b, c = 3.0 * (q1 - q0) - 2.0 * v0 - v1, v0 + v1 - 2.0 * (q1 - q0)
    parts = (
        q0 + x * (v0 + x * (b + x * c)),
        (v0 + x * (2.0 * b + x * 3.0 * c)) / h,
        (2.0 * b + 6.0 * x * c) / h**2,
    )
    joints = q.shape[1]
    angles, rates, gains = (part.reshape(-1, joints) for part in parts)
    return angles, rates, gains


def stretch_to_limits(
    start: Start, times: Floats, q: Floats, qd: Floats
) -> tuple[Floats, Floats, Floats]:
    """Slow a path down as far as the limits need, and return its times, qd and shares used.

    Raises:
        PlanError: a joint would leave its limits between two knots, or no speed is slow enough
            because friction or the momentum alone need more than the drives give.
    """
    if problem := start.limits.outside(q):
        raise PlanError(problem)
    angles, rates, gains = probed(times, q, qd)
    if problem := start.limits.outside(angles):
        raise PlanError(problem)
    p, slower = start.arm.vector(), 1.0
    for _ in range(60):
        used = start.limits.used(p, angles, rates / slower, gains / slower**2, start.L).max(axis=0)
        if used.max() <= 1.0:
            return times * slower, qd / slower, used
        slower *= 1.0 + 1e-6 + max(used[0].max() - 1.0, 0.5 * (used[1:].max() - 1.0), 0.0)
    kind, joint = np.unravel_index(np.argmax(used), used.shape)
    raise PlanError(
        f"{KINDS[kind][0]} of joint {joint + 1} is {100 * used[kind, joint]:.0f} % of its limit "
        f"at any speed, with an angular momentum of {start.L:g} N m s"
    )


def turning_times(start: Start, law: Law, grid: Floats) -> Floats:
    """Return the times at which the base's rate changes sign, at most one between grid times."""

    def rate(t: Floats) -> Floats:
        q, qd = law(t)
        return free_torques(start.bodies, q, qd, np.zeros_like(q), start.L)[1]

    rates = rate(grid)
    k = np.flatnonzero(rates[:-1] * rates[1:] < 0.0)
    low, high, sign = grid[k], grid[k + 1], np.sign(rates[k])
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        before = sign * rate(middle) > 0.0
        low, high = np.where(before, middle, low), np.where(before, high, middle)
    return 0.5 * (low + high)


def predicted(start: Start, times: Floats, q: Floats, qd: Floats) -> Prediction:
    """Predict the base's motion under a path, also where the base turns back."""
    n = start.arm.n
    law, edges = sampled([times] * n, list(q.T), list(qd.T))
    marks = np.linspace(0.0, times[-1], 1 + min(400, max(2, round(times[-1] / PREDICTION_STEP))))
    marks = np.union1d(marks, turning_times(start, law, np.union1d(marks, edges)))
    state = np.concatenate([start.pose, start.momentum, np.zeros(2)])
    poses, J = base_pose_sensitivities(start.bodies, path(law, edges, marks), state)
    size, total = len(start.arm.vector()), np.zeros((len(marks), 3, 3))
    if start.covariance is not None:
        total += J[..., :size] @ start.covariance @ np.swapaxes(J[..., :size], 1, 2)
    if start.state_covariance is not None:
        by_state = J[..., size : size + 6]
        total += by_state @ start.state_covariance @ np.swapaxes(by_state, 1, 2)
    # The base reacts to a joint's tracking error, whatever the path.
    states = np.concatenate([poses, law(marks)[0]], axis=1)
    M = np.swapaxes(momentum(start.bodies, states[:, None], np.eye(3 + n)), 1, 2)
    way = np.linalg.solve(M[..., :3], M[..., 3:])
    total += start.tracking**2 * way @ np.swapaxes(way, 1, 2)
    deviation = np.sqrt(np.diagonal(total, axis1=1, axis2=2))
    return Prediction(marks, poses, deviation)


def finished(
    start: Start,
    kind: str,
    arguments: Mapping[str, Any],
    times: Floats,
    q: Floats,
    qd: Floats,
    notes: Mapping[str, float] | None = None,
    ended: str = "",
) -> Plan:
    """Return a plan through knots, slowed down as far as the limits between the knots need.

    Raises:
        PlanError: a limit cannot be kept.
    """
    qd = qd.copy()
    qd[[0, -1]] = 0.0  # except for rounding errors
    times, qd, used = stretch_to_limits(start, times, q, qd)
    angles = probed(times, q, qd)[0]
    gaps = start.gap(angles)
    if gaps.min() < min(start.limits.margin, gaps[0]):
        posture = angles[np.argmin(gaps)]
        raise PlanError(
            f"{start.nearest(posture)} come within {gaps.min():.3f} m of each other, joints at "
            f"{np.degrees(posture).round(1).tolist()} deg, expected {start.limits.margin:.3f} m "
            "or more"
        )
    prediction = predicted(start, times, q, qd)
    return Plan(kind, arguments, times, q, qd, prediction, used, notes or {}, ended)
