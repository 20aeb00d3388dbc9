"""Rollouts against Pinocchio with the same integrator, and against conservation laws."""

import numpy as np
import pinocchio as pin
import pytest
from model_arms import random_arm, random_states
from model_oracles import pinocchio_inertia, pinocchio_model
from numpy.testing import assert_allclose

from fss_arm_model import dynamics
from fss_arm_model.description import paper_arm
from fss_arm_model.integration import STEP
from fss_arm_model.momentum import momentum
from fss_arm_model.rollout import rollout

STEPS = 1000


def driven(n, rng, steps=STEPS):
    """An arm of n unlike links, a state, and smooth forces on all coordinates."""
    q, qd = rng.uniform(-1.0, 1.0, (2, 3 + n))
    t = STEP * np.arange(steps)[:, None]
    tau = rng.uniform(0.1, 0.3, 3 + n) * np.sin(t * rng.uniform(1.0, 6.0, 3 + n))
    return random_arm(n, rng), q, 0.2 * qd, tau


def runge_kutta(rate, q, qd, tau, step=STEP):
    for forces in tau:
        a1 = rate(q, qd, forces)
        v2 = qd + 0.5 * step * a1
        a2 = rate(q + 0.5 * step * qd, v2, forces)
        v3 = qd + 0.5 * step * a2
        a3 = rate(q + 0.5 * step * v2, v3, forces)
        v4 = qd + step * a3
        a4 = rate(q + step * v3, v4, forces)
        q = q + step / 6.0 * (qd + 2.0 * v2 + 2.0 * v3 + v4)
        qd = qd + step / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
    return q, qd


@pytest.mark.parametrize("n", [1, 4, 8])
def test_a_driven_second_ends_where_pinocchio_ends(n):
    arm, q, qd, tau = driven(n, np.random.default_rng(n))
    model = pinocchio_model(arm)
    data = model.createData()
    theirs = runge_kutta(lambda *state: pin.aba(model, data, *state), q, qd, tau)
    ours = rollout(arm.vector(), q, qd, tau)
    assert_allclose([x[-1] for x in ours], theirs, rtol=0, atol=1e-9)


@pytest.mark.parametrize("n", [1, 4, 8])
def test_a_hundred_free_seconds_keep_momentum_and_energy(n):
    rng = np.random.default_rng(n)
    arm = paper_arm() if n == 4 else random_arm(n, rng)
    q, qd = rng.uniform(-0.5, 0.5, (2, 3 + n))
    p = arm.vector()
    q_end, qd_end = (x[-1] for x in rollout(p, q, qd, np.zeros((100_000, 3 + n))))
    before, after = momentum(p, q, qd), momentum(p, q_end, qd_end)
    assert_allclose(after[:2], before[:2], rtol=0, atol=1e-12)
    assert after[2] == pytest.approx(before[2], abs=1e-8)
    energy = dynamics.kinetic_energy(p, q, qd)
    assert dynamics.kinetic_energy(p, q_end, qd_end) == pytest.approx(energy, abs=1e-8)
    assert np.abs(q_end - q)[3:].max() > 0.5  # it did move


@pytest.mark.parametrize("n", [1, 12, 32])
def test_rotors_add_what_their_kinetic_energy_says(n):
    """(H + H_rotors) qdd + h = tau, by a dense solution in joint coordinates."""
    rng = np.random.default_rng(n)
    p = np.concatenate([random_arm(1, rng).vector()] + [random_arm(2, rng).vector()[14:]] * (n - 1))
    q, qd, tau = (x[0] for x in random_states(n, 1, rng))
    across, along = rotor = (0.0026, 0.0026 / 30)
    # Of joint k: N^2 J qd_k^2 / 2 + N J qd_k (theta' + qd_1 + .. + qd_{k-1})
    H = dynamics.inertia_matrix(p, q)
    for k in range(3, 3 + n):
        H[k, k] += across
        H[k, 2:k] += along
        H[2:k, k] += along
    qdd = np.linalg.solve(H, tau - dynamics.bias(p, q, qd))
    step = 1e-7
    ours = (rollout(p, q, qd, tau[None], step, rotor)[1][0] - qd) / step
    assert_allclose(ours, qdd, rtol=0, atol=1e-5 * np.abs(qdd).max())


@pytest.mark.parametrize("count", [1, 3, 16, 37])
def test_a_batch_of_arms_is_their_rollouts_whatever_the_threads_and_lanes(count):
    rng = np.random.default_rng(count)
    p = np.array([random_arm(5, rng).vector() for _ in range(count)])
    q, qd, _ = random_states(5, count, rng)
    tau = rng.standard_normal((count, 40, 8))
    each = [rollout(*one) for one in zip(p, q, qd, tau, strict=True)]
    for threads in (1, 2, 8):
        batch = rollout(p, q, qd, tau, threads=threads)
        assert_allclose(batch, np.swapaxes(each, 0, 1), rtol=0, atol=1e-13)


def test_a_lane_that_turns_far_leaves_the_others_as_they_are():
    rng = np.random.default_rng(5)
    arm, q, qd, tau = driven(4, rng, steps=200)
    fast = qd + np.array([0.0, 0.0, 400.0, 0.0, 0.0, 0.0, 0.0])  # 0.4 rad a step
    rates = np.array([*8 * [qd], fast, *7 * [qd]])
    together = rollout(arm.vector(), q, rates, tau)
    assert_allclose([x[0] for x in together], rollout(arm.vector(), q, qd, tau), rtol=0, atol=1e-13)


@pytest.mark.parametrize("n", [1, 4])
def test_what_acts_from_around_acts_as_in_pinocchio(n):
    """A slope as gravity, an air film that takes from each mass element, a hose on the base."""
    arm, q, qd, tau = driven(n, np.random.default_rng(n), steps=500)
    slope, film, drag, twist = np.array([0.03, -0.02]), 0.4, 0.8, 0.05
    model = pinocchio_model(arm)
    model.gravity.linear = np.array([*slope, 0.0])
    data = model.createData()

    def rate(q, v, tau):
        forces = tau - film * pinocchio_inertia(model, data, q) @ v
        forces[:2] -= drag * v[:2]
        forces[2] -= twist * v[2]
        return pin.aba(model, data, q, v, forces)

    theirs = runge_kutta(rate, q, qd, tau)
    around = (*slope, film, drag, twist)
    ours = rollout(arm.vector(), q, qd, tau, around=around)
    assert_allclose([x[-1] for x in ours], theirs, rtol=0, atol=1e-11)
    many = rollout(arm.vector(), np.tile(q, (16, 1)), qd, tau, around=around)
    assert_allclose([x[7] for x in many], ours, rtol=0, atol=1e-13)


def test_large_turns_within_a_step_are_as_exact():
    """Angles are linear in joint coordinates, so that the method gives the same in either."""
    p, step = random_arm(4, np.random.default_rng(0)).vector(), 0.1
    q, qd, tau = (x[0] for x in random_states(4, 1, np.random.default_rng(1)))
    theirs = runge_kutta(lambda *x: dynamics.forward_dynamics(p, *x), q, qd, tau[None], step)
    ours = rollout(p, q, qd, tau[None], step)
    assert np.abs(ours[0][0] - q)[2:].max() > 0.2
    assert_allclose([x[0, 2:] for x in ours], [x[2:] for x in theirs], rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"qd": np.zeros(6)}, "qd and tau have the shapes"),
        ({"tau": np.zeros(7)}, "qd and tau have the shapes"),
        ({"step": 0.0}, "step is 0.0"),
        ({"threads": 0}, "threads 0"),
        ({"around": (0.0, 0.0)}, "around has the shape"),
    ],
)
def test_what_does_not_fit_is_refused(change, words):
    given = {"q": np.zeros(7), "qd": np.zeros(7), "tau": np.zeros((1, 7)), **change}
    with pytest.raises(ValueError, match=words):
        rollout(paper_arm().vector(), **given)
