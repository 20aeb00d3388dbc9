"""The floating arm with its drives: right against an independent integration, and truly at rest."""

import numpy as np
import pytest
from model_arms import random_arm
from scipy.integrate import solve_ivp

from fss_arm_model.description import paper_arm
from fss_arm_model.drives import CURRENT, OFF, POSITION, VELOCITY
from fss_arm_model.dynamics import forward_dynamics, kinetic_energy
from fss_sim.plant import Demand, Plant

COUNT = 2 * np.pi / 240_000  # [rad]
POSTURES = [(0.3, -0.2, 0.4, 0.1), (-1.4, 1.4, -1.3, 1.4), (1.5, -1.5, 1.5, 0.0)]


def plant(q=(0.0, 0.0, 0.0, 0.0)):
    return Plant(paper_arm(), (0.1, -0.2, 0.3, *q))


def move(bed, targets, speed=0.8, acceleration=1.0):
    for joint, target in enumerate(targets):
        bed.command(joint, Demand(POSITION, target, speed, acceleration))


@pytest.mark.parametrize("seed", range(3))
def test_driven_by_currents_it_moves_as_a_tight_integration_says(seed):
    rng = np.random.default_rng(seed)
    arm = random_arm(3, rng)
    q, currents = rng.uniform(-0.5, 0.5, 6), rng.uniform(-0.3, 0.3, 3)
    bed = Plant(arm, q)
    for joint, current in enumerate(currents):
        bed.command(joint, Demand(CURRENT, current))
    tau = np.concatenate([np.zeros(3), 0.8 * currents])
    p = arm.vector()
    tight = solve_ivp(
        lambda _, s: np.concatenate([s[6:], forward_dynamics(p, s[:6], s[6:], tau)]),
        (0.0, 0.5), np.concatenate([q, np.zeros(6)]), rtol=1e-12, atol=1e-12, method="DOP853",
    ).y[:, -1]  # fmt: skip
    bed.advance(0.5)
    # Runge-Kutta of fourth order at 1 ms: its own error is below 1e-9 here.
    np.testing.assert_allclose(np.concatenate([bed.q, bed.qd]), tight, rtol=0, atol=1e-9)


def test_without_torque_energy_and_momentum_stay():
    rng = np.random.default_rng(4)
    qd = rng.uniform(-0.5, 0.5, 7)
    bed = Plant(paper_arm(), np.zeros(7), qd)
    for joint in range(4):
        bed.command(joint, Demand(CURRENT, 0.0))
    p = bed.arm.vector()
    energy, before = kinetic_energy(p, bed.q, bed.qd), bed.momentum()
    bed.advance(2.0)
    assert kinetic_energy(p, bed.q, bed.qd) == pytest.approx(energy, rel=1e-9)
    np.testing.assert_allclose(bed.momentum(), before, rtol=0, atol=1e-9)


@pytest.mark.parametrize("posture", POSTURES)
def test_a_move_arrives_rests_and_leaves_the_momentum_alone(posture):
    bed = plant()
    move(bed, posture)
    bed.advance(max(map(abs, posture)) / 0.8 + 0.8 + 0.5)  # trapezoid, and half a second
    q = bed.q.copy()
    np.testing.assert_allclose(q[3:], posture, rtol=0, atol=COUNT)
    bed.advance(2.0)
    assert np.abs(bed.q[3:] - q[3:]).max() < 0.5 * COUNT
    # Torques are internal; what is left is the integrator's own error.
    assert np.abs(bed.momentum()).max() < 1e-8


def test_moves_keep_to_speed_acceleration_and_torque():
    bed, speeds, torques = plant(), [], []
    move(bed, (1.0, 0.0, 0.0, 0.0), speed=0.5, acceleration=0.5)
    for _ in range(350):
        bed.advance(0.01)
        speeds.append(bed.motion(0).qd)
        torques.append(abs(bed.motion(0).torque))
    assert max(speeds) == pytest.approx(0.5, abs=0.01)
    assert np.diff(speeds).max() < 0.5 * 0.01 * 1.5
    assert 0.0 < max(torques) < 1.8


def test_no_drive_gives_more_than_its_torque():
    bed = plant()
    bed.command(1, Demand(CURRENT, 10.0))
    bed.advance(0.05)
    assert bed.motion(1).torque == pytest.approx(1.8)
    assert bed.motion(1).current == pytest.approx(2.25)


def test_positions_and_velocities_end_at_the_soft_limits():
    bed = plant()
    bed.command(0, Demand(POSITION, 3.0, 1.0, 2.0))
    bed.command(1, Demand(VELOCITY, -1.0, 1.0, 2.0))
    bed.advance(5.0)
    np.testing.assert_allclose(bed.q[3:5], [np.pi / 2, -np.pi / 2], rtol=0, atol=1e-4)


def test_position_at_speed_0_comes_to_rest_where_braking_ends_and_stays():
    bed = plant()
    bed.command(2, Demand(VELOCITY, 0.5, 0.5, 1.0))
    bed.advance(1.0)
    q, qd = bed.motion(2)[:2]
    assert qd == pytest.approx(0.5, abs=1e-3)
    bed.command(2, Demand(POSITION, 0.0, 0.0, 1.0))
    bed.advance(1.5)
    assert bed.motion(2).q == pytest.approx(q + 0.5**2 / 2, abs=1e-3)
    rest = bed.motion(2).q
    bed.advance(1.0)
    assert abs(bed.motion(2).q - rest) < 0.5 * COUNT


def test_a_drive_that_is_off_is_braked_by_friction_alone():
    bed = Plant(paper_arm(), np.zeros(7), (0, 0, 0, 0.5, 0, 0, 0))
    for joint in range(4):
        bed.command(joint, Demand(OFF))
    bed.advance(3.0)
    assert np.abs(bed.qd[3:]).max() < 1e-3
    assert bed.motion(0).current == 0.0
    assert bed.q[3] > 0.001
