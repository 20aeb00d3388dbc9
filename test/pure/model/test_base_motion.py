"""The base's motion and drift against ODE solutions, and derivatives by finite differences."""

import math
from itertools import pairwise

import numpy as np
import pytest
from model_arms import random_arm
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

from fss_arm_model import base_motion, dynamics, joint_path, momentum
from fss_arm_model.description import paper_arm
from fss_arm_model.drifting import drift

DURATION = 6.0
AT_REST = np.array([0.3, -0.2, 2.9, 0.0, 0.0, 0.0, 0.0, 0.0])
DRIFTING = np.array([0.3, -0.2, 2.9, 0.2, -0.3, 0.15, 0.002, -0.003])


def single(n):
    """One joint goes from -60 to 60 degrees and rests before and after."""
    joint, reach = n // 2, math.radians(60.0)

    def law(t):
        q, qd = np.zeros((len(t), n)), np.zeros((len(t), n))
        x = np.clip((t - 1.0) / 4.0, 0.0, 1.0)
        q[:, joint] = reach * (6.0 * x**2 - 4.0 * x**3 - 1.0)
        qd[:, joint] = reach * 3.0 * x * (1.0 - x)
        return q, qd

    return law, [0.0, 1.0, 5.0, DURATION]


def several(n):
    """Each joint swings at its own pace."""
    rng = np.random.default_rng(n)
    reach, pace, phase = (rng.uniform(*span, n) for span in ((0.3, 1.2), (0.5, 1.5), (0.0, 6.0)))

    def law(t):
        angle = t[:, None] * pace + phase
        return reach * np.sin(angle), reach * pace * np.cos(angle)

    return law, np.linspace(0.0, DURATION, 7)


MARKS = [0.0, 0.5, 2.5, DURATION]


def integrate(p, law, edges, state):
    """Poses at MARKS, from the base's rows of the inertia matrix and a tight ODE solver."""
    mass = p[0] + p[10::6].sum()

    def rate(t, pose):
        q, qd = (part[0] for part in law(np.array([t])))
        H = dynamics.inertia_matrix(p, [*pose, *q])
        x, y = momentum.system_com(p, [*pose, *q]) - pose[:2]
        px, py = state[3:5] + mass * t * state[6:8]
        return np.linalg.solve(H[:3, :3], [px, py, state[5] + x * py - y * px] - H[:3, 3:] @ qd)

    times, poses = np.union1d(edges, MARKS), [np.array(state[:3])]
    for a, b in pairwise(times):
        part = solve_ivp(rate, (a, b), poses[-1], method="DOP853", rtol=1e-13, atol=1e-13)
        poses.append(part.y[:, -1])
    return np.array(poses)[np.searchsorted(times, MARKS)]


@pytest.mark.parametrize("motion", [single, several])
@pytest.mark.parametrize(("n", "state"), [(1, DRIFTING), (4, AT_REST), (4, DRIFTING)])
def test_poses_are_those_of_the_ode(n, state, motion):
    p = random_arm(n, np.random.default_rng(n)).vector()
    law, edges = motion(n)
    poses = base_motion.base_poses(p, joint_path.path(law, edges, MARKS), state)
    assert_allclose(poses, integrate(p, law, edges, state), rtol=1e-10, atol=1e-10)
    assert np.abs(poses - state[:3]).max() > 0.005


@pytest.mark.parametrize("n", [1, 4])
def test_sensitivities_are_finite_differences(n):
    p = random_arm(n, np.random.default_rng(n)).vector()
    path = joint_path.path(*several(n), MARKS)
    poses, J = base_motion.base_pose_sensitivities(p, path, DRIFTING)
    assert_allclose(poses, base_motion.base_poses(p, path, DRIFTING), rtol=0, atol=1e-14)
    x, step = np.concatenate([p, DRIFTING]), 1e-5
    points = x + step * np.concatenate([np.eye(x.size), -np.eye(x.size)])
    there = base_motion.base_poses(points[:, : p.size], path, points[:, p.size :])
    numeric = (there[: x.size] - there[x.size :]) / (2.0 * step)
    assert_allclose(J, np.moveaxis(numeric, 0, -1), rtol=0, atol=2e-8)


def test_paths_and_parameter_sets_broadcast():
    rng = np.random.default_rng(0)
    p = np.array([random_arm(3, rng).vector() for _ in range(2)])
    paths = [joint_path.path(*motion(3), MARKS) for motion in (single, several)]
    poses, J = base_motion.base_pose_sensitivities(p[:, None], joint_path.stack(paths), DRIFTING)
    assert poses.shape == (2, 2, 4, 3)
    assert J.shape == (2, 2, 4, 3, p.shape[1] + 8)
    for i, j in np.ndindex(2, 2):
        one, sensitivities = base_motion.base_pose_sensitivities(p[i], paths[j], DRIFTING)
        assert np.array_equal(poses[i, j], one)
        assert np.array_equal(J[i, j], sensitivities)


def test_a_batch_of_paths_is_made_as_each_alone():
    """Paths have different lengths and different marks."""
    begins, lasts = np.array([[0.0], [1.0], [2.5]]), np.array([[6.0], [0.5], [3.0]])
    law, marks = several(4)[0], begins + lasts * [0.0, 0.25, 1.0]

    def batch(t):
        return tuple(part.reshape(*t.shape, 4) for part in law(t.ravel()))

    whole = joint_path.path(batch, begins + lasts * np.linspace(0.0, 1.0, 4), marks)
    for one, *own in zip(marks, *whole, strict=True):
        edges = one[0] + (one[-1] - one[0]) * np.linspace(0.0, 1.0, 4)
        alone = joint_path.path(law, edges, one)
        assert_allclose(own[0][: len(alone.nodes)], alone.nodes, rtol=0, atol=1e-14)
        assert_allclose(own[1], alone.marks, rtol=0, atol=1e-14)
    assert len({*whole.marks[:, -1, -2]}) == 3


def test_a_batch_repeats_the_last_mark_of_a_path_with_fewer():
    p = paper_arm().vector()
    paths = [joint_path.path(*several(4), marks) for marks in (MARKS, [0.0, DURATION])]
    poses = base_motion.base_poses(p, joint_path.stack(paths), DRIFTING)
    assert_allclose(poses[1, 1:], poses[0, [3, 3, 3]], rtol=0, atol=1e-13)


def test_marks_must_ascend_and_shapes_fit():
    with pytest.raises(ValueError, match="marks are"):
        joint_path.path(*several(4), [1.0, 0.0, DURATION])
    path = joint_path.path(*several(3), MARKS)
    with pytest.raises(ValueError, match=r"expected \(\.\.\., 26\) and \(\.\.\., 8\)"):
        base_motion.base_poses(paper_arm().vector(), path, DRIFTING)


def test_samples_of_a_drives_profile_give_the_path_back():
    """Links report at 5 Hz, each in its own phase; accelerations jump in between."""

    def law(t):
        x = np.clip(t - 1.0, 0.0, 3.0)
        q = np.where(x < 1.0, 0.5 * x**2, np.where(x < 2.0, x - 0.5, 2.0 - 0.5 * (3.0 - x) ** 2))
        qd = np.clip(np.minimum(x, 3.0 - x), 0.0, 1.0)
        scale = np.array([0.8, -0.6, 1.0, 0.4])
        return q[:, None] * scale, qd[:, None] * scale

    times = [np.arange(0.03 * i, 5.0, 0.2) for i in range(4)]
    samples = [[part[:, i] for part in law(t)] for i, t in enumerate(times)]
    measured, edges = joint_path.sampled(times, *zip(*samples, strict=True))
    p, marks = paper_arm().vector(), [0.0, 5.0]
    ideal = joint_path.path(law, [0.0, 1.0, 2.0, 3.0, 4.0, 5.0], marks)
    taken = joint_path.path(measured, [*edges, *marks], marks)
    poses = [base_motion.base_poses(p, path, DRIFTING)[-1] for path in (ideal, taken)]
    assert_allclose(*poses, rtol=0, atol=2e-4)
    inside = np.array([2.1, 2.25, 2.4])  # speed is constant from 2 to 3 s
    assert_allclose(measured(inside)[0], law(inside)[0], rtol=0, atol=1e-14)
    assert_allclose(measured(inside)[1], law(inside)[1], rtol=0, atol=1e-13)


# --- the drift of base and arm as one body, beside scipy's integration ----------------------------

BODY = np.array([21.5, 1.4, 0.3, -0.1])
ACTING = np.array([2e-3, -1e-3, 0.001, 0.02, 0.05])


def integrated(body, shared, own, times):
    M, K, c = body[0], body[1], complex(*body[2:])
    g, (tau, kappa, d) = complex(*shared[:2]), shared[2:]

    def rate(_, s):
        turned = np.exp(1j * s[4]) * c
        v = complex(s[2], s[3]) - 1j * s[5] * turned
        a = g - d / M * v
        torque = tau - kappa * s[5] + d * (turned.conjugate() * v).imag
        return [s[2], s[3], a.real, a.imag, s[5], torque / K]

    lever = np.exp(1j * own[2]) * c
    z, u = complex(*own[:2]) + lever, complex(*own[3:5]) + 1j * own[5] * lever
    begin = [z.real, z.imag, u.real, u.imag, own[2], own[5]]
    s = solve_ivp(rate, (0.0, times[-1]), begin, "DOP853", times, rtol=1e-12, atol=1e-14).y
    x = s[0] + 1j * s[1] - np.exp(1j * s[4]) * c
    return np.column_stack([x.real, x.imag, s[4], s[5]])


@pytest.mark.parametrize("omega", [0.0, 0.05, -1.5])
def test_it_is_what_scipy_integrates(omega):
    own, times = np.array([0.1, -0.4, 2.0, 0.01, -0.02, omega]), np.arange(0.0, 60.0, 0.5)
    expected = integrated(BODY, ACTING, own, times)
    assert_allclose(drift(BODY, ACTING, own, times), expected, rtol=0, atol=1e-6)


def test_it_broadcasts():
    own = np.random.default_rng(0).normal(0.0, 0.1, (3, 2, 6))
    many = drift(BODY, ACTING, own, np.arange(5.0))
    assert many.shape == (3, 2, 5, 4)
    assert_allclose(many[2, 1], drift(BODY, ACTING, own[2, 1], np.arange(5.0)), rtol=0, atol=0)
