"""Estimation of a held body's mass properties; the truth is an independent point-mass model."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.stats import chi2

from fss_arm_model import layout
from fss_arm_model.description import paper_arm
from fss_arm_model.held import Target
from fss_arm_model.units import SECOND
from fss_gnc.navigation import EstimatorSettings, KnownInputs, Navigation
from fss_gnc.navigation.mass_estimator import (
    MAX_SAMPLES,
    SPACING,
    FreeBody,
    MassErrors,
    MassEstimator,
    MassProperties,
    Sample,
)
from fss_gnc.navigation.valve_faults import Faults

ARM = paper_arm()
P = ARM.vector()
POSTURE = np.array([0.95, 1.3, 1.36, -1.23])
PLACE = np.array([ARM.links[-1].a + 0.19, 0.0, np.pi])
ERRORS = MassErrors(momentum_walk=0.0, angular_momentum_walk=0.0)
PRIOR = MassProperties.from_assumption(Target(10.0, 0.25), PLACE, ERRORS)
TWIST_SIGMA = np.array([1e-3, 1e-3, 1e-3])  # [m/s, m/s, rad/s]
RATE_SIGMA = 5e-4  # of the joints [rad/s]
THRUST_ERROR = 0.05  # relative


@dataclass
class Body:
    """Four point masses: two pairs about the centre of mass, one along x and one along y."""

    mass: float
    com: complex
    inertia: float

    @property
    def points(self):
        r = np.sqrt(self.inertia / self.mass)
        return self.com + r * np.array([1, -1, 1j, -1j])


class Points:
    """Base, arm and held body as point masses; positions and momenta are sums over them."""

    def __init__(self, held):
        base = ARM.base
        self.bodies = [Body(base.mass, complex(*base.com), base.inertia)]
        self.bodies += [Body(k.mass, complex(k.g, k.lateral), k.inertia) for k in ARM.links]
        self.held = held

    def frames(self, q):
        """Return origin and direction of base and links."""
        found = [(complex(*q[:2]), np.exp(1j * q[2]))]
        x, y, turn = ARM.base.mount
        at, u = found[0][0] + complex(x, y) * found[0][1], found[0][1] * np.exp(1j * turn)
        for link, angle in zip(ARM.links, q[3:], strict=True):
            u = u * np.exp(1j * (link.theta_0 + angle))
            found.append((at, u))
            at = at + link.a * u
        return found

    def matrix(self, q, include_held=True):
        """Return the matrix (3, 3 + n) from rates to the momentum about the world's origin."""
        frames = self.frames(q)
        bodies = list(zip(self.bodies, frames, range(ARM.n + 1), strict=True))
        bodies += [(self.held, frames[-1], ARM.n)] if include_held else []
        at = np.array([origin + u * body.points for body, (origin, u), _ in bodies])
        masses = np.array([[body.mass / 4] for body, *_ in bodies])
        number = np.array([[k] for *_, k in bodies])
        moves = [np.ones_like(at), 1j * np.ones_like(at)]
        moves += [1j * (at - pivot) * (number >= k) for k, (pivot, _) in enumerate(frames)]
        P_ = [(masses * v).sum() for v in moves]
        L = [(masses * (np.conj(at) * v).imag).sum() for v in moves]
        return np.array([np.real(P_), np.imag(P_), L])

    def free_momentum(self, q, twist, at):
        """Return the momentum of the free body that moves with the twist of its point `at`."""
        origin, u = self.frames(q)[-1]
        points = origin + u * self.held.points
        v = complex(*twist[:2]) + 1j * twist[2] * (points - at)
        m = self.held.mass / 4
        P_ = m * v.sum()
        return np.array([P_.real, P_.imag, m * (np.conj(points) * v).imag.sum()])

    def base_twist(self, q, rates, momentum):
        """Return the twist of the base for a total momentum and joint rates."""
        A = self.matrix(q)
        return np.linalg.solve(A[:, :3], momentum - A[:, 3:] @ rates)


def joints(t, moving):
    """Return angles and rates of the joints: at rest for 2 s, then swinging."""
    s, w = max(t - 2.0, 0.0), np.array([0.5, 0.7, 0.6, 0.9])
    size = moving * np.array([0.3, -0.25, 0.3, 0.25])
    return POSTURE + size * (1.0 - np.cos(w * s)), size * w * np.sin(w * s)


def wrench(t):
    """Return the commanded wrench in the base's axes; it starts at 8 s."""
    if t < 8.0:
        return np.zeros(3)
    return np.array([[0.2, 0.0, 0.03], [0.0, 0.2, -0.03], [-0.2, 0.0, 0.02]])[int(t / 2.0) % 3]


def make_estimator(truth, rng, gain=1.0, last=20, still=False, leak=(0.0, 0.0, 0.0)):
    """Return an estimator with samples of the body `truth` (4,) over `last` seconds after the grip.

    If `still`, nothing moves, but measurements are noisy. A leak is an unknown force and torque in
    the world's axes [N, N, N m].
    """
    leak = np.array(leak)
    mass, x, y, inertia = truth
    points, moving = Points(Body(mass, complex(x, y), inertia)), 0.0 if still else 1.0
    q = np.array([*rng.uniform(-0.5, 0.5, 2), 0.4, *POSTURE])
    qd = np.concatenate([rng.uniform(-0.01, 0.01, 3), 0.1 * rng.standard_normal(4)])
    twist = np.append(rng.uniform(-0.03, 0.03, 2), rng.choice([-1, 1]) * rng.uniform(0.05, 0.2))
    qd, twist = moving * qd, moving * twist
    origin, u = points.frames(q)[-1]
    tip = origin + ARM.links[-1].a * u
    covariance = np.diag(TWIST_SIGMA**2)

    def measured(qd):
        return qd + np.append(TWIST_SIGMA, np.full(len(qd) - 3, RATE_SIGMA)) * rng.standard_normal(
            len(qd)
        )

    def sample(t, q, qd, impulse):
        return Sample(t, q, measured(qd), covariance, np.full(4, RATE_SIGMA), impulse)

    pose = np.array([tip.real, tip.imag, np.angle(u) + P[layout.TIP_ANGLE]])
    free = FreeBody(pose, measured(twist), covariance)
    before = sample(0.0, q, qd, np.zeros(3))
    estimate = MassEstimator(P, PRIOR, [before], free, ERRORS, THRUST_ERROR)
    start = points.matrix(q, include_held=False) @ qd + points.free_momentum(q, twist, tip)

    def rate(t, y):
        q_m, rates = joints(t, moving)
        state = np.concatenate([y[:3], q_m])
        force = moving * wrench(t)
        pushed = complex(force[0], force[1]) * np.exp(1j * y[2])
        about = force[2] + y[0] * pushed.imag - y[1] * pushed.real
        twist = points.base_twist(state, rates, start + gain * y[3:] + leak * t)
        return np.concatenate([twist, [pushed.real, pushed.imag, about]])

    y = np.concatenate([q[:3], np.zeros(3)])
    for t in np.arange(1.0, last + 1):
        y = solve_ivp(rate, (t - 1.0, t), y, rtol=1e-6, atol=1e-8).y[:, -1]
        q_m, rates = joints(t, moving)
        state = np.concatenate([y[:3], q_m])
        twist = points.base_twist(state, rates, start + gain * y[3:] + leak * t)
        estimate.add_sample(sample(t, state, np.append(twist, rates), y[3:].copy()))
    return estimate


def draw_body(rng):
    """Draw a body from the prior."""
    mass, inertia = np.array([10.0, 0.25]) * np.exp(0.7 * rng.standard_normal(2))
    x, y = PLACE[:2] + 0.05 * rng.standard_normal(2)
    return np.array([mass, x, y, inertia])


@pytest.mark.parametrize("targets", [15, pytest.param(50, marks=pytest.mark.slow)])
def test_estimates_are_consistent(targets):
    off, nees, shares = [], [], []
    for seed in range(targets):
        rng = np.random.default_rng(seed)
        truth = draw_body(rng)
        estimate = make_estimator(truth, rng, 1.0 + THRUST_ERROR * rng.standard_normal())
        found = estimate.solve()
        assert estimate.is_consistent
        apart = found.values - truth
        off.append(apart / found.deviations)
        nees.append(apart @ np.linalg.solve(found.covariance, apart) / 4)
        shares.append(found.deviations / np.array([truth[0], 1.0, 1.0, truth[3]]))
    low, high = chi2.ppf([0.005, 0.995], 4 * targets) / (4 * targets)
    assert low < np.mean(nees) < high
    assert np.abs(off).max() < 3.0
    assert (np.median(shares, axis=0) < [0.05, 0.01, 0.01, 0.3]).all()


def test_leaking_valve_is_not_mistaken_for_mass():
    truth = [10.0, *PLACE[:2], 0.25]
    estimate = make_estimator(truth, np.random.default_rng(4), last=8, leak=(0.1, 0.1, 0.0))
    estimate.solve()
    assert not estimate.is_consistent


def test_unobserved_parameters_keep_their_prior_deviation():
    """Noise must not count as motion, as it would in a regression on measured twists."""
    rng = np.random.default_rng(3)
    found = make_estimator([10.0, *PLACE[:2], 0.25], rng, still=True).solve()
    relative = found.deviations / [found.values[0], 1.0, 1.0, found.values[3]]
    np.testing.assert_allclose(relative, [0.7, 0.05, 0.05, 0.7], rtol=0.1)


def test_motion_reduces_all_deviations():
    truth = np.array([20.0, PLACE[0] + 0.05, 0.03, 0.5])
    first, last = (
        make_estimator(truth, np.random.default_rng(5), last=seconds).solve().deviations / truth
        for seconds in (2, 20)
    )
    assert (last < first).all()


def test_payload_without_a_grip_is_estimated_from_its_motion():
    truth = np.array([20.0, PLACE[0] + 0.05, 0.03, 0.5])
    estimate = make_estimator(truth, np.random.default_rng(6), last=40)
    unknown = estimate.free._replace(twist=np.zeros(3), covariance=np.eye(3))
    found = replace(estimate, free=unknown).solve()
    assert (np.abs(found.values - truth) < 3.0 * found.deviations).all()
    assert found.deviations[0] < 2.0


@pytest.mark.parametrize("truth", [(20.0, 0.05, 0.03, 0.5), (6.0, -0.03, -0.03, 0.15)])
def test_navigation_estimates_a_payload_without_markers(truth):
    mass, x, y, inertia = truth
    truth = np.array([mass, PLACE[0] + x, y, inertia])
    rng, points = np.random.default_rng(1), Points(Body(mass, complex(*truth[1:3]), inertia))
    navigation, found = Navigation(ARM, body=Target(10.0, 0.25)), None

    def rate(t, pose):
        q, rates = joints(t, 1.0)
        return points.base_twist(np.concatenate([pose, q]), rates, np.zeros(3))

    times = np.arange(0.0, 40.0, 0.02)
    poses = solve_ivp(rate, (0.0, 40.0), [0.1, -0.2, 0.4], t_eval=times, rtol=1e-6, atol=1e-8).y.T
    for k, (t, pose) in enumerate(zip(times, poses, strict=True)):
        now = round((100.0 + t) * SECOND)
        for i, joint in enumerate(zip(*joints(t, 1.0), strict=True) if k % 5 == 0 else ()):
            navigation.add_joint_reading(i, now, *joint)
        navigation.base.update_rate(now, rate(t, pose)[2] + 1e-3 * rng.standard_normal())
        navigation.base.update_pose(now, *(pose + [2e-4, 2e-4, 1e-3] * rng.standard_normal(3)))
        navigation.set_gripper(t >= 1.0)
        navigation.predict(now)
        found = navigation.estimate_mass(now) or found
    assert (np.abs(found.values - truth) < 3.0 * found.deviations).all()
    assert found.deviations[0] < 0.12 * mass


def test_estimate_is_the_prior_of_the_next_one():
    truth = np.array([20.0, PLACE[0] + 0.05, 0.03, 0.5])
    first = make_estimator(truth, np.random.default_rng(8)).solve()
    later = make_estimator(truth, np.random.default_rng(9), still=True)
    then = replace(later, prior=first).solve()
    np.testing.assert_allclose(then.deviations, first.deviations, rtol=0.05)
    np.testing.assert_allclose(then.values, first.values, rtol=0.05)


def test_new_mass_keeps_the_joint_readings():
    inputs, now = KnownInputs(P), 100 * SECOND
    for i, q in enumerate(POSTURE):
        inputs.add_joint_reading(i, now, q, 0.0, 0.0)
    before = inputs.mean_accelerations([now, now + SECOND // 20])[1]
    inputs.set_parameters(P)
    np.testing.assert_array_equal(inputs.mean_accelerations([now, now + SECOND // 20])[1], before)


def test_open_times_end_at_the_next_command():
    inputs = KnownInputs(P, EstimatorSettings(valve_delay=0.0))
    at, ms = 100 * 10**9, 10**6
    inputs.add_pulses(at, [0.08, *[0.0] * 7])
    inputs.add_pulses(at + 50 * ms, [0.0, 0.02, *[0.0] * 6])  # which closes the first
    open_times = inputs.open_times(at - ms, at + 100 * ms)
    np.testing.assert_allclose(open_times[:3], [0.05, 0.02, 0.0], atol=1e-12)
    parts = inputs.open_times(at, at + 30 * ms) + inputs.open_times(at + 30 * ms, at + 100 * ms)
    np.testing.assert_allclose(parts, open_times)
    inputs.set_valve_faults(Faults(open=frozenset({5}), closed=frozenset({0})))
    open_times = inputs.open_times(at, at + 100 * ms)
    np.testing.assert_allclose(open_times[[0, 1, 5]], [0.0, 0.02, 0.1], atol=1e-12)


def test_every_other_sample_is_dropped_when_there_are_too_many():
    estimate = make_estimator([10.0, *PLACE[:2], 0.25], np.random.default_rng(7), last=3)
    for t in np.arange(4.0, 1.5 * MAX_SAMPLES):
        if estimate.is_due(t):
            estimate.add_sample(estimate.samples[-1]._replace(t=t))
    assert len(estimate.samples) <= MAX_SAMPLES
    assert estimate.spacing == 2.0 * SPACING
