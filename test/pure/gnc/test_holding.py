"""Known inputs of the base: thrust and the reaction of the arm, against which it is held."""

import numpy as np
import pytest

from fss_arm_model.description import paper_arm
from fss_arm_model.dynamics import forward_dynamics, inertia_matrix, inverse_dynamics
from fss_arm_model.units import SECOND
from fss_gnc.control import PoseControl
from fss_gnc.navigation import EstimatorSettings, KnownInputs, Navigation
from fss_gnc.navigation.body_filter import HISTORY_LENGTH
from fss_gnc.reference import Reference
from fss_sim.plant.drives import MODE_POSITION
from fss_sim.plant.plant import Plant
from fss_sim.plant.vehicle import Demand


def to_world(heading, a):
    """Rotate a planar vector and a turn rate from the base's axes to the world's."""
    line = complex(a[0], a[1]) * np.exp(1j * heading)
    return np.array([line.real, line.imag, a[2]])


def test_known_inputs_match_the_motion_of_the_base():
    arm, rng = paper_arm(), np.random.default_rng(3)
    q = np.concatenate([[0.1, -0.2, 0.7], rng.uniform(-1.0, 1.0, 4)])
    plant = Plant(arm, q)
    inputs = KnownInputs(arm.vector())
    for i in range(4):  # drives hold the joints
        plant.command(i, Demand(MODE_POSITION, float(q[3 + i]), 0.5, 1.0))
    gained = np.zeros(3)
    for k in range(20):
        on_times = rng.uniform(0.0, 0.2, 8)  # some are replaced while they are open
        on_times[on_times < 0.02] = on_times[4:] = 0.0
        now = k * 100_000_000
        plant.thrust(on_times)
        inputs.add_pulses(now, on_times)
        for i in range(4):
            inputs.add_joint_reading(i, now, float(plant.q[3 + i]), 0.0, float(plant.qd[2]))
        for _ in range(10):
            plant.advance(0.01)
        gained += 0.1 * to_world(
            plant.q[2], inputs.mean_accelerations([now, now + 100_000_000])[0][0]
        )
        # Joints deflect by a milliradian under thrust, and oscillate.
        np.testing.assert_allclose(gained, plant.qd[:3], atol=5e-4)
    assert np.abs(gained).max() > 5e-3
    parts = inputs.mean_accelerations(range(0, 2_000_000_000, 7_000_000))[0]
    whole = inputs.mean_accelerations([0, len(parts) * 7_000_000])[0][0]
    np.testing.assert_allclose(np.mean(parts, axis=0), whole, rtol=1e-9, atol=1e-12)


def test_feedforward_wrench_keeps_the_base_at_rest():
    arm, rng = paper_arm(), np.random.default_rng(4)
    p = arm.vector()
    for _ in range(20):
        q = rng.uniform(-1.0, 1.0, 7)
        qd = np.concatenate([np.zeros(3), rng.uniform(-0.2, 0.2, 4)])
        qdd_m = rng.uniform(-0.1, 0.1, 4)
        w = PoseControl(arm).wrench(q, qd, Reference.at_rest(q[:3]), 0.1, qdd_m)
        tau = inverse_dynamics(p, q, qd, np.concatenate([np.zeros(3), qdd_m]))
        force = complex(w[0], w[1]) * np.exp(1j * q[2])
        tau[:3] = force.real, force.imag, w[2]
        np.testing.assert_allclose(forward_dynamics(p, q, qd, tau)[:3], 0.0, atol=1e-12)


P = paper_arm().vector()
Q, MS = (0.1, 0.2, 0.3, 0.4), 1_000_000


def test_joints_and_valves_are_stored_over_the_history_of_the_filter():
    """Links report up to 50 times a second, and a program may open valves as often."""
    inputs = KnownInputs(P, EstimatorSettings(valve_delay=0.0))
    on_times = [0.02, *7 * [0.0]]
    for at in range(0, 2 * SECOND, 20 * MS):
        for i, q in enumerate(Q):
            inputs.add_joint_reading(i, at, q, 0.01e-9 * at * (i == 0), 0.0)
        inputs.add_pulses(at, on_times)
    early, late = inputs.mean_accelerations(
        [at - HISTORY_LENGTH, at - HISTORY_LENGTH + 40 * MS, at - 40 * MS, at]
    )[0][[0, 2]]
    np.testing.assert_allclose(early, late, rtol=1e-6)
    assert inputs.open_times(at - HISTORY_LENGTH, at)[0] == pytest.approx(1.0)
    H = inertia_matrix(P, [0.0, 0.0, 0.0, *Q])[:3]
    expected = np.linalg.solve(H[:, :3], inputs.valves[0] - 0.01 * H[:, 3])
    np.testing.assert_allclose(early, expected, atol=5e-4)  # turning at 0.02 rad/s


def test_implausible_joint_rate_is_ignored():
    navigation = Navigation(paper_arm())
    for k in range(200):
        at = 10 * k * MS
        navigation.base.update_rate(at, 0.0)
        navigation.base.update_pose(at, 0.0, 0.0, 0.0)
        if k % 20 == 0:
            for i, q in enumerate(Q):
                navigation.add_joint_reading(i, at, q, 1e9 if k == 100 and i == 0 else 0.0)
    state = navigation.base.state()
    assert np.abs([*state.pose, *state.twist]).max() < 1e-3
    assert navigation.base.lost_reason(at) == ""
