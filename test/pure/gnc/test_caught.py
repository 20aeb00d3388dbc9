"""Mass properties of what is caught; its motion is made without the model, of point masses."""

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
from fss_gnc.navigation.caught import (
    MOST,
    SPACING,
    Caught,
    CaughtErrors,
    FreeBody,
    MassProperties,
    Sample,
)
from fss_gnc.navigation.valve_faults import Faults

ARM = paper_arm()
P = ARM.vector()
POSTURE = np.array([0.95, 1.3, 1.36, -1.23])
PLACE = np.array([ARM.links[-1].a + 0.19, 0.0, np.pi])
ERRORS = CaughtErrors(push=0.0, twisting=0.0)
PRIOR = MassProperties.assumed(Target(10.0, 0.25), PLACE, ERRORS)
TWIST = np.array([1e-3, 1e-3, 1e-3])  # deviations of what is measured [m/s, m/s, rad/s]
RATES = 5e-4  # of the joints [rad/s]
THRUST = 0.05


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
    """Base, arm and what is caught as points; positions and momenta are sums over them."""

    def __init__(self, caught):
        base = ARM.base
        self.bodies = [Body(base.mass, complex(*base.com), base.inertia)]
        self.bodies += [Body(k.mass, complex(k.g, k.lateral), k.inertia) for k in ARM.links]
        self.caught = caught

    def frames(self, q):
        """Origin and direction of base and links."""
        found = [(complex(*q[:2]), np.exp(1j * q[2]))]
        x, y, turn = ARM.base.mount
        at, u = found[0][0] + complex(x, y) * found[0][1], found[0][1] * np.exp(1j * turn)
        for link, angle in zip(ARM.links, q[3:], strict=True):
            u = u * np.exp(1j * (link.theta_0 + angle))
            found.append((at, u))
            at = at + link.a * u
        return found

    def matrix(self, q, held=True):
        """(3, 3 + n): momentum about the world's origin by rates, points turning about pivots."""
        frames = self.frames(q)
        bodies = list(zip(self.bodies, frames, range(ARM.n + 1), strict=True))
        bodies += [(self.caught, frames[-1], ARM.n)] if held else []
        at = np.array([origin + u * body.points for body, (origin, u), _ in bodies])
        masses = np.array([[body.mass / 4] for body, *_ in bodies])
        number = np.array([[k] for *_, k in bodies])
        moves = [np.ones_like(at), 1j * np.ones_like(at)]
        moves += [1j * (at - pivot) * (number >= k) for k, (pivot, _) in enumerate(frames)]
        P_ = [(masses * v).sum() for v in moves]
        L = [(masses * (np.conj(at) * v).imag).sum() for v in moves]
        return np.array([np.real(P_), np.imag(P_), L])

    def of_free(self, q, twist, at):
        """Momentum of what is caught, moving by itself with the twist of its point `at`."""
        origin, u = self.frames(q)[-1]
        points = origin + u * self.caught.points
        v = complex(*twist[:2]) + 1j * twist[2] * (points - at)
        m = self.caught.mass / 4
        P_ = m * v.sum()
        return np.array([P_.real, P_.imag, m * (np.conj(points) * v).imag.sum()])

    def base_twist(self, q, rates, momentum):
        """That momentum leaves to the base."""
        A = self.matrix(q)
        return np.linalg.solve(A[:, :3], momentum - A[:, 3:] @ rates)


def joints(t, moving):
    """Angles and rates of the joints: at rest for 2 s, then swinging."""
    s, w = max(t - 2.0, 0.0), np.array([0.5, 0.7, 0.6, 0.9])
    size = moving * np.array([0.3, -0.25, 0.3, 0.25])
    return POSTURE + size * (1.0 - np.cos(w * s)), size * w * np.sin(w * s)


def wrench(t):
    """Of the valves as commanded, in the base's axes, from 8 s on."""
    if t < 8.0:
        return np.zeros(3)
    return np.array([[0.2, 0.0, 0.03], [0.0, 0.2, -0.03], [-0.2, 0.0, 0.02]])[int(t / 2.0) % 3]


def caught_of(truth, rng, gain=1.0, last=20, still=False, leak=(0.0, 0.0, 0.0)):
    """An estimate that has seen a body (4,) caught, and `last` seconds of what came then.

    Nothing turns or is pushed if all is still, but for the noise of what is measured. A leak, in
    the world's axes [N, N, N m], pushes without its knowledge.
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
    covariance = np.diag(TWIST**2)

    def measured(qd):
        return qd + np.append(TWIST, np.full(len(qd) - 3, RATES)) * rng.standard_normal(len(qd))

    def sample(t, q, qd, impulse):
        return Sample(t, q, measured(qd), covariance, np.full(4, RATES), impulse)

    pose = np.array([tip.real, tip.imag, np.angle(u) + P[layout.TIP_ANGLE]])
    free = FreeBody(pose, measured(twist), covariance)
    before = sample(0.0, q, qd, np.zeros(3))
    estimate = Caught(P, PRIOR, [before], free, ERRORS, THRUST)
    start = points.matrix(q, held=False) @ qd + points.of_free(q, twist, tip)

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
        estimate.take(sample(t, state, np.append(twist, rates), y[3:].copy()))
    return estimate


def drawn(rng):
    """A body as the prior has it."""
    mass, inertia = np.array([10.0, 0.25]) * np.exp(0.7 * rng.standard_normal(2))
    x, y = PLACE[:2] + 0.05 * rng.standard_normal(2)
    return np.array([mass, x, y, inertia])


@pytest.mark.parametrize("targets", [15, pytest.param(50, marks=pytest.mark.slow)])
def test_targets_are_found_within_their_deviations(targets):
    off, nees, shares = [], [], []
    for seed in range(targets):
        rng = np.random.default_rng(seed)
        truth = drawn(rng)
        estimate = caught_of(truth, rng, 1.0 + THRUST * rng.standard_normal())
        found = estimate.solve()
        assert estimate.explained
        apart = found.values - truth
        off.append(apart / found.deviations)
        nees.append(apart @ np.linalg.solve(found.covariance, apart) / 4)
        shares.append(found.deviations / np.array([truth[0], 1.0, 1.0, truth[3]]))
    low, high = chi2.ppf([0.005, 0.995], 4 * targets) / (4 * targets)
    assert low < np.mean(nees) < high
    assert np.abs(off).max() < 3.0
    assert (np.median(shares, axis=0) < [0.05, 0.01, 0.01, 0.3]).all()


def test_what_a_leaking_valve_gives_is_not_explained_by_any_mass():
    truth = [10.0, *PLACE[:2], 0.25]
    estimate = caught_of(truth, np.random.default_rng(4), last=8, leak=(0.1, 0.1, 0.0))
    estimate.solve()
    assert not estimate.explained


def test_what_nothing_has_shown_yet_keeps_its_deviation():
    """Noise is no motion: a regression on measured twists would take it for some."""
    rng = np.random.default_rng(3)
    found = caught_of([10.0, *PLACE[:2], 0.25], rng, still=True).solve()
    relative = found.deviations / [found.values[0], 1.0, 1.0, found.values[3]]
    np.testing.assert_allclose(relative, [0.7, 0.05, 0.05, 0.7], rtol=0.1)


def test_a_grip_shows_the_mass_and_motion_shows_the_rest():
    truth = np.array([20.0, PLACE[0] + 0.05, 0.03, 0.5])
    first, last = (
        caught_of(truth, np.random.default_rng(5), last=seconds).solve().deviations / truth
        for seconds in (2, 20)
    )
    assert (last < first).all()


def test_a_payload_that_was_in_the_gripper_already_is_found_by_its_motion():
    truth = np.array([20.0, PLACE[0] + 0.05, 0.03, 0.5])
    estimate = caught_of(truth, np.random.default_rng(6), last=40)
    unknown = estimate.free._replace(twist=np.zeros(3), covariance=np.eye(3))
    found = replace(estimate, free=unknown).solve()
    assert (np.abs(found.values - truth) < 3.0 * found.deviations).all()
    assert found.deviations[0] < 2.0


@pytest.mark.parametrize("truth", [(20.0, 0.05, 0.03, 0.5), (6.0, -0.03, -0.03, 0.15)])
def test_navigation_finds_a_payload_that_no_camera_sees(truth):
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
            navigation.joint(i, now, *joint)
        navigation.base.rate(now, rate(t, pose)[2] + 1e-3 * rng.standard_normal())
        navigation.base.pose(now, *(pose + [2e-4, 2e-4, 1e-3] * rng.standard_normal(3)))
        navigation.gripper(t >= 1.0)
        navigation.predict(now)
        found = navigation.observe(now) or found
    assert (np.abs(found.values - truth) < 3.0 * found.deviations).all()
    assert found.deviations[0] < 0.12 * mass


def test_what_was_found_is_where_another_estimate_begins():
    truth = np.array([20.0, PLACE[0] + 0.05, 0.03, 0.5])
    first = caught_of(truth, np.random.default_rng(8)).solve()
    later = caught_of(truth, np.random.default_rng(9), still=True)
    then = replace(later, prior=first).solve()
    np.testing.assert_allclose(then.deviations, first.deviations, rtol=0.05)
    np.testing.assert_allclose(then.values, first.values, rtol=0.05)


def test_another_mass_leaves_joints_heard():
    inputs, now = KnownInputs(P), 100 * SECOND
    for i, q in enumerate(POSTURE):
        inputs.joint(i, now, q, 0.0, 0.0)
    before = inputs.over([now, now + SECOND // 20])[1]
    inputs.describe(P)
    np.testing.assert_array_equal(inputs.over([now, now + SECOND // 20])[1], before)


def test_what_valves_have_given_is_counted_once_until_the_next_command():
    inputs = KnownInputs(P, EstimatorSettings(valve_delay=0.0))
    at, ms = 100 * 10**9, 10**6
    inputs.pulses(at, [0.08, *[0.0] * 7])
    inputs.pulses(at + 50 * ms, [0.0, 0.02, *[0.0] * 6])  # which closes the first
    open_times = inputs.open_times(at - ms, at + 100 * ms)
    np.testing.assert_allclose(open_times[:3], [0.05, 0.02, 0.0], atol=1e-12)
    parts = inputs.open_times(at, at + 30 * ms) + inputs.open_times(at + 30 * ms, at + 100 * ms)
    np.testing.assert_allclose(parts, open_times)
    inputs.fail(Faults(open=frozenset({5}), closed=frozenset({0})))
    open_times = inputs.open_times(at, at + 100 * ms)
    np.testing.assert_allclose(open_times[[0, 1, 5]], [0.0, 0.02, 0.1], atol=1e-12)


def test_of_many_samples_every_other_one_is_kept():
    estimate = caught_of([10.0, *PLACE[:2], 0.25], np.random.default_rng(7), last=3)
    for t in np.arange(4.0, 1.5 * MOST):
        if estimate.is_due(t):
            estimate.take(estimate.samples[-1]._replace(t=t))
    assert len(estimate.samples) <= MOST
    assert estimate.spacing == 2.0 * SPACING
