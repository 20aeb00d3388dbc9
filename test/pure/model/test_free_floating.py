"""Torques on a base that floats, against the whole system's equations of motion."""

import numpy as np
import pytest
from model_arms import random_arm
from numpy.testing import assert_allclose

from fss_arm_model import dynamics
from fss_arm_model.free_floating import free_torques
from fss_arm_model.momentum import momentum


@pytest.mark.parametrize("n", [1, 2, 4, 9])
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
    L = momentum(p, q, qd)[2] + rotor[1] * qd[3:].sum()
    tau, omega = free_torques(p, q[3:], qd[3:], qdd[3:], L, rotor)
    assert omega == pytest.approx(qd[2], abs=1e-12)
    H = dynamics.inertia_matrix(p, q) + rotors
    h = dynamics.bias(p, q, qd)
    got = np.linalg.solve(H, np.concatenate([np.zeros(3), tau]) - h)
    assert_allclose(got[3:], qdd[3:], atol=1e-9)
