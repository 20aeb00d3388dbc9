"""What the arm does to its base: predicted from momentum conservation, beside what was measured.

Before each motion the base's pose and twist are fitted to its drift while the arm rested; from
there the prediction of Eq. 6 follows the joints alone, with the momentum it began with, until the
next motion. A known tilt of the table pulls. The band holds the calibration's covariance, the
fit's and the tilt's.
"""

from bisect import bisect_right
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fss_arm_model.base_motion import base_pose_sensitivities, path, sampled
from fss_arm_model.description import Arm
from fss_arm_model.dynamics import bias, inertia_matrix, inverse_dynamics, kinetic_energy
from fss_arm_model.momentum import momentum, system_com
from fss_arm_model.units import GRAVITY

from .base_filter import Estimate
from .settings import ReactionSettings

Floats = npt.NDArray[np.float64]

_SECOND = 1_000_000_000  # [ns]
_KEPT = 5 * _SECOND  # of the past
_LOST = 60 * _SECOND  # without a moment of which all is known: a prediction ends


class Anchor(NamedTuple):
    """Where a prediction begins."""

    t: int  # [ns]
    pose: Floats  # (3,)
    momentum: Floats  # (3,), angular about the system's centre of mass
    covariance: Floats  # (6, 6) of both
    by_parameter: Floats  # (3, 8 + 6 n) derivatives of the momentum


@dataclass(frozen=True)
class Reaction:
    """One moment; vectors are x, y, heading or along x, y and about z. NaN: not known."""

    t: int  # [ns]
    anchor: int  # when the prediction began [ns]
    predicted: Floats  # pose of the base (3,)
    predicted_deviation: Floats
    measured: Floats
    measured_deviation: Floats
    twist: Floats  # measured
    momentum: Floats  # of the whole, angular about its centre of mass (3,) [N s, N s, N m s]
    momentum_deviation: Floats
    momentum_drift: Floats  # (3,) [N, N, N m]
    kinetic_energy: float  # [J]
    force: Floats  # of the base on link 1 at the first joint, (2,) [N]
    torque: float  # of the base on link 1 about the first joint [N m]
    torque_measured: float  # link 1's sensor [N m]
    q: Floats  # (n,) joint readings [rad]
    com: Floats  # (2,) centre of mass of the whole [m]


class _Joint:
    """One joint's newest readings."""

    def __init__(self) -> None:
        self.t: list[int] = []
        self.q: list[float] = []
        self.qd: list[float] = []
        self.effort: list[float] = []

    def add(self, t: int, q: float, qd: float, effort: float) -> bool:
        if self.t and t <= self.t[-1]:
            return False
        for series, value in zip(
            (self.t, self.q, self.qd, self.effort), (t, q, qd, effort), strict=True
        ):
            series.append(value)  # type: ignore[attr-defined]
        return True

    def forget(self, until: int) -> None:
        k = bisect_right(self.t, until) - 1
        if k > 64:
            for series in (self.t, self.q, self.qd, self.effort):
                del series[:k]

    def since(self, begin: int) -> slice:
        return slice(max(bisect_right(self.t, begin) - 1, 0), None)


class BaseReaction:
    """Follows the joints and the base, and gives a Reaction whenever all of them are known.

    Args:
        arm: the description that predictions rest on.
        covariance: (8 + 6 n, 8 + 6 n) of Arm.vector(); None: known exactly.
        settings: thresholds.
    """

    def __init__(
        self, arm: Arm, covariance: Floats | None = None, settings: ReactionSettings | None = None
    ) -> None:
        self.settings = settings or ReactionSettings()
        self.tilt = GRAVITY * np.array(self.settings.tilt)  # acceleration down the table
        self.joints = [_Joint() for _ in range(arm.n)]
        self.past: deque[Estimate] = deque()
        self.momenta: deque[tuple[float, Floats]] = deque()
        self.t = -1
        self.resting_since = -1
        self.candidate: Anchor | None = None
        self.describe(arm, covariance)

    def describe(self, arm: Arm, covariance: Floats | None = None) -> None:
        """Predict with another description from the next rest on."""
        self.p = arm.vector()
        self.mass = inertia_matrix(self.p, np.zeros(3 + arm.n))[0, 0]
        size = len(self.p)
        self.covariance = np.zeros((size, size)) if covariance is None else covariance
        self.anchor: Anchor | None = None
        self.momenta.clear()

    def joint(self, i: int, t: int, q: float, qd: float, effort: float) -> bool:
        """Take a reading of joint i (0 to n - 1) at t [ns]; False if it is not newer."""
        if t - self.t > _LOST:
            self.anchor, self.candidate, self.resting_since = None, None, -1
            self.joints[i].forget(t - _KEPT)
        return self.joints[i].add(t, q, qd, effort)

    def base(self, estimate: Estimate) -> None:
        """Take the base's measured motion."""
        self.past.append(estimate)
        while self.past[0].t < estimate.t - _KEPT:
            self.past.popleft()

    def moving(self) -> bool:
        """Whether a joint moves, by its newest reading."""
        return any(j.qd and abs(j.qd[-1]) > self.settings.still for j in self.joints)

    def known_until(self) -> int:
        """The last moment of which all is known [ns]; -1: none."""
        if not self.past or not all(joint.t for joint in self.joints):
            return -1
        centre = int(self.settings.half_difference * _SECOND)
        return min(min(joint.t[-1] for joint in self.joints) - centre, self.past[-1].t)

    def advance(self, t: int) -> Reaction | None:
        """The reaction at t [ns], later than before and not after known_until()."""
        if t <= self.t:
            return None
        self.t = t
        measured = self._measured(t)
        if measured is None:  # the base was not seen then
            return None
        still = self._still(t)
        if still:
            self.resting_since = t if self.resting_since < 0 else self.resting_since
            self.candidate = self._drift(t) or self.candidate
        begins = self.candidate if self.anchor is None or not still else None
        law, edges = self._law(begins.t if begins else min(t, self.at if self.anchor else t))
        if begins:
            self._begin(begins)
        if not still:
            self.candidate, self.resting_since = None, -1
        if self.anchor is None:
            return None
        self._predict(t, law, edges)
        for joint in self.joints:
            joint.forget(t - max(_SECOND, int(self.settings.half_difference * _SECOND)))
        return self._reaction(t, measured, law)

    def _measured(self, t: int) -> Estimate | None:
        """The motion at t, between the estimates around it."""
        k = bisect_right(self.past, t, key=lambda e: e.t) - 1
        if k < 0:
            return None
        before, after = self.past[k], self.past[min(k + 1, len(self.past) - 1)]
        w = (t - before.t) / max(after.t - before.t, 1)
        pose = (1.0 - w) * before.at(t).pose + w * after.at(t).pose
        return before._replace(t=t, pose=pose, twist=(1.0 - w) * before.twist + w * after.twist)

    def _law(self, begin: int):  # type: ignore[no-untyped-def]
        """The joints' motion, in seconds from `begin`, before which accelerations need some."""
        self.origin = begin
        before = begin - int(self.settings.half_difference * _SECOND)
        parts = [joint.since(before) for joint in self.joints]
        return sampled(
            [(np.array(j.t[k]) - begin) * 1e-9 for j, k in zip(self.joints, parts, strict=True)],
            [np.array(j.q[k]) for j, k in zip(self.joints, parts, strict=True)],
            [np.array(j.qd[k]) for j, k in zip(self.joints, parts, strict=True)],
        )

    def _still(self, t: int) -> bool:
        """Whether each joint's readings around t show no motion."""
        for joint in self.joints:
            k = bisect_right(joint.t, t)
            if any(abs(qd) > self.settings.still for qd in joint.qd[max(k - 1, 0) : k + 1]):
                return False
        return True

    def _drift(self, t: int) -> Anchor | None:
        """The system's centre of mass on a straight line, turning evenly, since the arm rests."""
        s, p = self.settings, self.p
        begin = max(self.resting_since, t - int(s.longest_drift * _SECOND))
        poses = np.array([e.pose for e in self.past if begin <= e.t <= t])
        times = np.array([(e.t - t) * 1e-9 for e in self.past if begin <= e.t <= t])
        if len(poses) < 3 or t - begin < s.shortest_drift * _SECOND:
            return None
        q = np.array([joint.q[bisect_right(joint.t, t) - 1] for joint in self.joints])
        states = np.column_stack([poses, np.tile(q, (len(poses), 1))])
        com = system_com(p, states)
        X = np.column_stack([np.ones_like(times), times])
        com = com - 0.5 * times[:, None] ** 2 * self.tilt
        line, slope = np.linalg.lstsq(X, np.column_stack([com, poses[:, 2]]), rcond=None)[0]
        turn = line[2] - poses[-1, 2]
        lever = complex(*(com[-1] - poses[-1, :2])) * complex(np.cos(turn), np.sin(turn))
        pose = line - [lever.real, lever.imag, 0.0]
        state = np.concatenate([pose, q])
        # Filtered poses are smoother than those the filter is fed; these give the deviations.
        of_pose = np.diag([s.position_error, s.position_error, s.heading_error]) ** 2
        to_com = np.array([[1.0, 0.0, -lever.imag], [0.0, 1.0, lever.real], [0.0, 0.0, 1.0]])
        rates = np.zeros((3, len(state)))
        rates[:, :3] = np.linalg.inv(to_com).T  # of the base, for each rate of the centre of mass
        by_rate = momentum(p, state, rates).T
        J = np.block([[np.eye(3), np.zeros((3, 3))], [np.zeros((3, 3)), by_rate @ to_com]])
        rate = np.concatenate([np.linalg.solve(to_com, slope), np.zeros(len(q))])
        return Anchor(
            t,
            pose,
            by_rate @ slope,
            J @ np.kron(np.linalg.inv(X.T @ X), of_pose) @ J.T,
            _by_parameter(p, state, rate),
        )

    def _begin(self, anchor: Anchor) -> None:
        """Predict anew from an anchor."""
        self.anchor, self.at = anchor, anchor.t
        self.state = np.concatenate([anchor.pose, anchor.momentum, self.tilt])
        # Derivatives of the predicted pose by the parameters, and by the anchor's two parts.
        self.by_parameter = np.zeros((3, len(self.p)))
        self.by_pose, self.by_momentum = np.eye(3), np.zeros((3, 3))
        self.by_tilt = np.zeros((3, 2))

    def _predict(self, t: int, law, edges: Floats) -> None:  # type: ignore[no-untyped-def]
        """Go on with the prediction until t."""
        assert self.anchor
        if t <= self.at:
            return
        marks = [(self.at - self.origin) * 1e-9, (t - self.origin) * 1e-9]
        poses, J = base_pose_sensitivities(self.p, path(law, edges, marks), self.state)
        step, size = J[1], len(self.p)
        onward, gained = step[:, size : size + 3], self.mass * (self.at - self.anchor.t) * 1e-9
        by_gained = gained * step[:, size + 3 : size + 5]
        self.by_tilt = onward @ self.by_tilt + by_gained + step[:, size + 6 :]
        self.by_parameter = onward @ self.by_parameter + step[:, :size]
        self.by_momentum = onward @ self.by_momentum + step[:, size + 3 : size + 6]
        self.by_pose = onward @ self.by_pose
        self.state[:3] = poses[1]
        self.state[3:5] += self.mass * self.tilt * (t - self.at) * 1e-9
        self.at = t

    def _deviation(self) -> Floats:
        assert self.anchor
        by_begin = np.hstack([self.by_pose, self.by_momentum])
        by_parameter = self.by_parameter + self.by_momentum @ self.anchor.by_parameter
        covariance = by_begin @ self.anchor.covariance @ by_begin.T
        covariance += by_parameter @ self.covariance @ by_parameter.T
        covariance += (GRAVITY * self.settings.tilt_deviation) ** 2 * self.by_tilt @ self.by_tilt.T
        return np.sqrt(np.diag(covariance))

    def _reaction(self, t: int, measured: Estimate, law) -> Reaction:  # type: ignore[no-untyped-def]
        assert self.anchor
        s, p, n = self.settings, self.p, len(self.joints)
        now = (t - self.origin) * 1e-9
        q, qd = law(np.array([now - s.half_difference, now, now + s.half_difference]))
        state = np.concatenate([measured.pose, q[1]])
        rate = np.concatenate([measured.twist, qd[1]])
        P = momentum(p, state, rate)
        by_rate = np.column_stack([momentum(p, state, row) for row in np.eye(3 + n)[:3]])
        self.momenta.append((t * 1e-9, P))
        while self.momenta[0][0] < t * 1e-9 - s.drift_window:
            self.momenta.popleft()
        # Without external force the base's acceleration follows from the joints'.
        H, h = inertia_matrix(p, state), bias(p, state, rate)
        qdd = (qd[2] - qd[0]) / (2.0 * s.half_difference)
        base = -np.linalg.solve(H[:3, :3], H[:3, 3:] @ qdd + h[:3])
        tau = inverse_dynamics(p, state, rate, np.concatenate([base, qdd]))
        first = self.joints[0]
        k = max(bisect_right(first.t, t) - 1, 0)
        return Reaction(
            t,
            self.anchor.t,
            self.state[:3].copy(),
            self._deviation(),
            measured.pose,
            np.sqrt(measured.pose_variance),
            measured.twist,
            P,
            np.sqrt(by_rate**2 @ measured.twist_variance),
            self._slope(),
            float(kinetic_energy(p, state, rate)),
            self._force(state, rate, base),
            float(tau[3]),
            first.effort[k],
            q[1],
            system_com(p, state),
        )

    def _force(self, state: Floats, rate: Floats, acceleration: Floats) -> Floats:
        """On the base's centre of mass acts what link 1 answers: minus the force on the link."""
        mass, com = self.p[0], complex(self.p[2], self.p[3])
        turn = complex(np.cos(state[2]), np.sin(state[2]))
        a = complex(*acceleration[:2]) + complex(-(rate[2] ** 2), acceleration[2]) * com * turn
        return -mass * np.array([a.real, a.imag])

    def _slope(self) -> Floats:
        if len(self.momenta) < 3:
            return np.full(3, np.nan)
        times = np.array([t for t, _ in self.momenta])
        times -= times.mean()
        return times @ np.array([P for _, P in self.momenta]) / (times @ times)


def _by_parameter(p: Floats, q: Floats, qd: Floats) -> Floats:
    """Derivatives of the momentum by the parameters, (3, 8 + 6 n); at most cubic in them."""
    step = 1e-4 * np.eye(len(p))
    up, down = (momentum(p + side * step, q, qd) for side in (1.0, -1.0))
    return ((up - down) / 2e-4).T
