"""Estimation of a held body's mass properties; the truth moves by conservation of momentum."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.stats import chi2

from fss_arm_model import layout
from fss_arm_model.description import paper_arm
from fss_arm_model.dynamics import inertia_matrix
from fss_arm_model.held import Target, with_payload
from fss_arm_model.kinematics import tip_pose
from fss_arm_model.units import SECOND
from fss_gnc.navigation import KnownInputs, Navigation
from fss_gnc.navigation.mass_estimator import (
    MAX_SAMPLES,
    SPACING,
    FreeBody,
    MassErrors,
    MassEstimator,
    MassProperties,
    Sample,
)

ARM = paper_arm()
P = ARM.vector()
POSTURE = np.array([0.95, 1.3, 1.36, -1.23])
PLACE = np.array([ARM.links[-1].a + 0.19, 0.0, np.pi])
ERRORS = MassErrors(momentum_walk=0.0, angular_momentum_walk=0.0)
PRIOR = MassProperties.from_assumption(Target(10.0, 0.25), PLACE, ERRORS)
TWIST_SIGMA = np.array([1e-3, 1e-3, 1e-3])  # [m/s, m/s, rad/s]
RATE_SIGMA = 5e-4  # of the joints [rad/s]
THRUST_ERROR = 0.05  # relative


class Holding:
    """Base and arm with a held body (mass, x, y, inertia); momenta are about the world's origin."""

    def __init__(self, mass, x, y, inertia):
        self.mass, self.com, self.inertia = mass, complex(x, y), inertia
        self.both = with_payload(P, Target(mass, inertia), np.array([x, y, 0.0]))

    def momentum(self, q, qd, p=P):
        """Return the momentum (3,) of base and arm, or of both (p = self.both)."""
        H = inertia_matrix(p, q)[:3]
        return H @ qd + [0.0, 0.0, (q[0] * H[1] - q[1] * H[0]) @ qd]

    def free_momentum(self, tip, twist):
        """Return the momentum (3,) of the free body that moves with the twist of the tip."""
        c = self.com - ARM.links[-1].a
        at = complex(*tip[:2]) + c * np.exp(1j * (tip[2] - P[layout.TIP_ANGLE]))
        force = self.mass * (complex(*twist[:2]) + 1j * twist[2] * (at - complex(*tip[:2])))
        turn = (np.conj(at) * force).imag + self.inertia * twist[2]
        return np.array([force.real, force.imag, turn])

    def base_twist(self, q, rates, momentum):
        """Return the twist of the base for a total momentum and joint rates."""
        units = np.eye(3, 3 + ARM.n)
        by_base = np.column_stack([self.momentum(q, unit, self.both) for unit in units])
        still = np.append(np.zeros(3), rates)
        return np.linalg.solve(by_base, momentum - self.momentum(q, still, self.both))


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
    holding, moving = Holding(*truth), 0.0 if still else 1.0
    q = np.array([*rng.uniform(-0.5, 0.5, 2), 0.4, *POSTURE])
    qd = np.concatenate([rng.uniform(-0.01, 0.01, 3), 0.1 * rng.standard_normal(4)])
    twist = np.append(rng.uniform(-0.03, 0.03, 2), rng.choice([-1, 1]) * rng.uniform(0.05, 0.2))
    qd, twist = moving * qd, moving * twist
    tip = tip_pose(P, q)
    covariance = np.diag(TWIST_SIGMA**2)

    def measured(qd):
        return qd + np.append(TWIST_SIGMA, np.full(len(qd) - 3, RATE_SIGMA)) * rng.standard_normal(
            len(qd)
        )

    def sample(t, q, qd, impulse):
        return Sample(t, q, measured(qd), covariance, np.full(4, RATE_SIGMA), impulse)

    free = FreeBody(tip, measured(twist), covariance)
    before = sample(0.0, q, qd, np.zeros(3))
    estimate = MassEstimator(P, PRIOR, [before], free, ERRORS, THRUST_ERROR)
    start = holding.momentum(q, qd) + holding.free_momentum(tip, twist)

    def rate(t, y):
        q_m, rates = joints(t, moving)
        state = np.concatenate([y[:3], q_m])
        force = moving * wrench(t)
        pushed = complex(force[0], force[1]) * np.exp(1j * y[2])
        about = force[2] + y[0] * pushed.imag - y[1] * pushed.real
        twist = holding.base_twist(state, rates, start + gain * y[3:] + leak * t)
        return np.concatenate([twist, [pushed.real, pushed.imag, about]])

    y = np.concatenate([q[:3], np.zeros(3)])
    for t in np.arange(1.0, last + 1):
        y = solve_ivp(rate, (t - 1.0, t), y, rtol=1e-6, atol=1e-8).y[:, -1]
        q_m, rates = joints(t, moving)
        state = np.concatenate([y[:3], q_m])
        twist = holding.base_twist(state, rates, start + gain * y[3:] + leak * t)
        estimate.add_sample(sample(t, state, np.append(twist, rates), y[3:].copy()))
    return estimate


def draw_body(rng):
    """Draw a body from the prior."""
    mass, inertia = np.array([10.0, 0.25]) * np.exp(0.7 * rng.standard_normal(2))
    x, y = PLACE[:2] + 0.05 * rng.standard_normal(2)
    return np.array([mass, x, y, inertia])


@pytest.mark.parametrize("targets", [8, pytest.param(50, marks=pytest.mark.slow)])
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


def test_navigation_estimates_a_payload_without_markers():
    mass, inertia = 20.0, 0.5
    truth = np.array([mass, PLACE[0] + 0.05, 0.03, inertia])
    rng, holding = np.random.default_rng(1), Holding(*truth)
    navigation, found = Navigation(ARM, body=Target(10.0, 0.25)), None

    def rate(t, pose):
        q, rates = joints(t, 1.0)
        return holding.base_twist(np.concatenate([pose, q]), rates, np.zeros(3))

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


def test_every_other_sample_is_dropped_when_there_are_too_many():
    estimate = make_estimator([10.0, *PLACE[:2], 0.25], np.random.default_rng(7), last=3)
    for t in np.arange(4.0, 1.5 * MAX_SAMPLES):
        if estimate.is_due(t):
            estimate.add_sample(estimate.samples[-1]._replace(t=t))
    assert len(estimate.samples) <= MAX_SAMPLES
    assert estimate.spacing == 2.0 * SPACING
