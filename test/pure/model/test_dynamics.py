"""Dynamics against Pinocchio, momentum, and functions of the model over many arms and states."""

import numpy as np
import pinocchio as pin
import pytest
from model_arms import random_arm, random_states
from model_oracles import pinocchio_inertia, pinocchio_model
from numpy.testing import assert_allclose

from fss_arm_model import dynamics, kinematics, momentum
from fss_arm_model.free_floating import free_torques

RELATIVE = 1e-9
STATES = 125  # for each n


def assert_alike(ours, theirs):
    assert np.abs(ours - theirs).max() <= RELATIVE * np.abs(theirs).max()


@pytest.mark.parametrize("n", [1, 2, 4, 8])
def test_against_pinocchio(n):
    rng = np.random.default_rng(n)
    arm = random_arm(n, rng)
    model, p = pinocchio_model(arm), arm.vector()
    data = model.createData()
    batch = random_states(n, STATES, rng)
    H, h = dynamics.inertia_matrix(p, batch[0]), dynamics.bias(p, batch[0], batch[1])
    qdd = dynamics.forward_dynamics(p, *batch)
    J, tip = kinematics.tip_jacobian(p, batch[0]), kinematics.tip_pose(p, batch[0])
    for i, (q, qd, tau) in enumerate(zip(*batch, strict=True)):
        assert_alike(qdd[i], pin.aba(model, data, q, qd, tau))
        assert_alike(H[i], pinocchio_inertia(model, data, q))
        assert_alike(h[i], pin.nle(model, data, q, qd))
        frame = model.getFrameId("tip")
        axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        assert_alike(J[i], pin.computeFrameJacobian(model, data, q, frame, axes)[[0, 1, 5]])
        place = data.oMf[frame]
        assert_alike(tip[i, :2], place.translation[:2])
        assert_allclose(place.rotation[:2, 0], [np.cos(tip[i, 2]), np.sin(tip[i, 2])], atol=1e-12)


@pytest.mark.parametrize("n", [1, 12, 32])
def test_inverse_and_forward_dynamics_and_the_inertia_matrix_agree(n):
    rng = np.random.default_rng(n)
    p = np.concatenate([random_arm(1, rng).vector()] + [random_arm(2, rng).vector()[14:]] * (n - 1))
    q, qd, tau = random_states(n, 20, rng)
    qdd = dynamics.forward_dynamics(p, q, qd, tau)
    assert_allclose(dynamics.inverse_dynamics(p, q, qd, qdd), tau, atol=1e-9 * np.abs(qdd).max())
    H, h = dynamics.inertia_matrix(p, q), dynamics.bias(p, q, qd)
    assert_allclose(np.einsum("...ij,...j->...i", H, qdd) + h, tau, atol=1e-9 * np.abs(qdd).max())
    assert (np.linalg.eigvalsh(H) > 0.0).all()


def test_kinetic_energy_is_half_the_inertia_matrix_between_rates():
    rng = np.random.default_rng(0)
    p, (q, qd, _) = random_arm(5, rng).vector(), random_states(5, 50, rng)
    T = 0.5 * np.einsum("...i,...ij,...j", qd, dynamics.inertia_matrix(p, q), qd)
    assert_allclose(dynamics.kinetic_energy(p, q, qd), T, rtol=1e-12)


@pytest.mark.parametrize(
    ("function", "count", "shape"),
    [
        (dynamics.inertia_matrix, 1, (6, 6)),
        (dynamics.bias, 2, (6,)),
        (dynamics.inverse_dynamics, 3, (6,)),
        (dynamics.forward_dynamics, 3, (6,)),
        (dynamics.kinetic_energy, 2, ()),
        (kinematics.joint_positions, 1, (4, 2)),
        (kinematics.com_positions, 1, (4, 2)),
        (kinematics.tip_pose, 1, (3,)),
        (kinematics.tip_jacobian, 1, (3, 6)),
        (kinematics.tip_in_base, 0, (3,)),
        (kinematics.tip_regressor, 0, (3, 8)),
        (momentum.system_com, 1, (2,)),
        (momentum.momentum, 2, (3,)),
        (momentum.generalized_jacobian, 1, (3, 3)),
    ],
)
def test_arms_and_states_broadcast(function, count, shape):
    """A function of `count` states, or of the joints' angles alone if it is 0."""
    rng = np.random.default_rng(0)
    p = np.array([random_arm(3, rng).vector() for _ in range(2)])[:, None]
    q, qd, tau = random_states(3, 5, rng)
    states = (q, qd, tau)[:count] or (q[:, 3:],)
    batch = function(p, *states)
    assert batch.shape == (2, 5, *shape)
    assert_allclose(batch[1, 3], function(p[1, 0], *(s[3] for s in states)), rtol=0, atol=0)


def test_shapes_that_do_not_fit_are_refused():
    p = random_arm(2, np.random.default_rng(0)).vector()
    with pytest.raises(ValueError, match="p and q have the shapes"):
        dynamics.forward_dynamics(p, np.zeros(7), np.zeros(7), np.zeros(7))
    with pytest.raises(ValueError, match="mismatch"):
        dynamics.bias(p, np.zeros(5), np.zeros(6))


@pytest.mark.parametrize("n", [1, 4])
@pytest.mark.parametrize("rotor", [(0.0, 0.0), (0.0026, 0.0026 / 30)])
def test_torques_accelerate_the_joints_and_leave_the_base_free(n, rotor):
    rng = np.random.default_rng(n)
    p = random_arm(n, rng).vector()
    q, qd, qdd = rng.uniform(-2.0, 2.0, (3, 3 + n))
    q[:3] = 0.0
    rotors = np.zeros((3 + n, 3 + n))
    for k in range(3, 3 + n):
        rotors[k, k] = rotor[0]
        rotors[k, 2:k] = rotors[2:k, k] = rotor[1]
    L = momentum.momentum(p, q, qd)[2] + rotor[1] * qd[3:].sum()
    tau, omega = free_torques(p, q[3:], qd[3:], qdd[3:], L, rotor)
    assert omega == pytest.approx(qd[2], abs=1e-12)
    H = dynamics.inertia_matrix(p, q) + rotors
    h = dynamics.bias(p, q, qd)
    got = np.linalg.solve(H, np.concatenate([np.zeros(3), tau]) - h)
    assert_allclose(got[3:], qdd[3:], atol=1e-9)


# --- momentum, and torques on a base that floats --------------------------------------------------

STEP = 1e-6


def masses(p):
    return np.concatenate([p[:1], p[10::6]])


def inertias(p):
    return np.concatenate([p[1:2], p[11::6]])


@pytest.mark.parametrize("n", [1, 4])
def test_momentum_is_the_sum_over_bodies(n):
    rng = np.random.default_rng(n)
    p = random_arm(n, rng).vector()
    m = masses(p)[:, None]
    for q, qd, _ in zip(*random_states(n, 10, rng), strict=True):
        c = kinematics.com_positions(p, q)
        com = (m * c).sum(axis=0) / m.sum()
        assert_allclose(momentum.system_com(p, q), com)
        ahead, behind = (kinematics.com_positions(p, q + s * qd) for s in (STEP, -STEP))
        f = m * (ahead - behind) / (2.0 * STEP)
        r = c - com
        L = (r[:, 0] * f[:, 1] - r[:, 1] * f[:, 0] + inertias(p) * np.cumsum(qd[2:])).sum()
        assert_allclose(momentum.momentum(p, q, qd), [*f.sum(axis=0), L], atol=1e-6)


@pytest.mark.parametrize("n", [1, 4])
def test_generalized_jacobian_is_the_tips_without_momentum(n):
    rng = np.random.default_rng(n)
    p = random_arm(n, rng).vector()
    for q, qd, _ in zip(*random_states(n, 10, rng), strict=True):
        H = dynamics.inertia_matrix(p, q)
        qd[:3] = -np.linalg.solve(H[:3, :3], H[:3, 3:] @ qd[3:])
        assert_allclose(momentum.momentum(p, q, qd), 0.0, atol=1e-12)
        twist = kinematics.tip_jacobian(p, q) @ qd
        assert_allclose(momentum.generalized_jacobian(p, q) @ qd[3:], twist, atol=1e-12)
