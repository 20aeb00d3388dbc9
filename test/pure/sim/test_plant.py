"""The floating arm with its drives, compared with an independent integration; rest and audit."""

import numpy as np
import pytest
from model_arms import random_arm
from scipy.integrate import solve_ivp

from fss_arm_model.description import paper_arm
from fss_arm_model.dynamics import forward_dynamics, kinetic_energy
from fss_arm_model.held import Target
from fss_arm_model.momentum import system_com
from fss_sim.plant.drives import MODE_CURRENT, MODE_OFF, MODE_POSITION, MODE_VELOCITY
from fss_sim.plant.joints import Joints
from fss_sim.plant.plant import Plant
from fss_sim.plant.surroundings import Surroundings
from fss_sim.plant.vehicle import Demand, World

COUNT = 2 * np.pi / 240_000  # [rad]
POSTURES = [(0.3, -0.2, 0.4, 0.1), (-1.4, 1.4, -1.3, 1.4)]
FRICTIONLESS = Joints(viscous=0.0, coulomb=0.0, stop_stiffness=0.0, stop_damping=0.0)


def plant(q=(0.0, 0.0, 0.0, 0.0)):
    return Plant(paper_arm(), (0.1, -0.2, 0.3, *q))


def move(bed, targets, speed=0.8, acceleration=1.0):
    for joint, target in enumerate(targets):
        bed.command(joint, Demand(MODE_POSITION, target, speed, acceleration))


@pytest.mark.parametrize(("rate", "exact"), [(0.0, 1e-9), (3.0, 1e-11)])
def test_motion_under_currents_agrees_with_an_accurate_integration(rate, exact):
    """Error control keeps to its tolerance where fixed steps of 1 ms do not suffice."""
    rng = np.random.default_rng(5)
    arm = random_arm(3, rng)
    q, qd = rng.uniform(-1.0, 1.0, 6), rate * rng.uniform(-1.0, 1.0, 6)
    p, currents = arm.vector(), rng.uniform(-0.3, 0.3, 3)
    tau = np.concatenate([np.zeros(3), 0.8 * currents])
    tight = solve_ivp(
        lambda _, s: np.concatenate([s[6:], forward_dynamics(p, s[:6], s[6:], tau)]),
        (0.0, 0.5),
        np.concatenate([q, qd]),
        rtol=1e-13,
        atol=1e-13,
        method="DOP853",
    ).y[:, -1]
    errors = []
    for tolerance in (0.0, 1e-13):
        bed = Plant(arm, q, qd, World(FRICTIONLESS, tolerance=tolerance))
        for joint, current in enumerate(currents):
            bed.command(joint, Demand(MODE_CURRENT, current))
        bed.advance(0.5)
        errors.append(np.abs(np.concatenate([bed.q, bed.qd]) - tight).max())
    assert errors[1] < 1e-11
    assert (errors[0] < exact) == (rate == 0.0)


@pytest.mark.parametrize("posture", POSTURES)
def test_a_move_arrives_rests_and_conserves_momentum(posture):
    bed = plant()
    move(bed, posture)
    bed.advance(max(map(abs, posture)) / 0.8 + 0.8 + 0.5)  # trapezoid, and half a second
    q = bed.q.copy()
    np.testing.assert_allclose(q[3:], posture, rtol=0, atol=COUNT)
    bed.advance(2.0)
    assert np.abs(bed.q[3:] - q[3:]).max() < 0.5 * COUNT
    # Torques are internal; what is left is the integrator's own error.
    assert np.abs(bed.momentum()).max() < 1e-8


def test_moves_respect_speed_acceleration_and_torque_limits():
    bed, speeds, torques = plant(), [], []
    move(bed, (1.0, 0.0, 0.0, 0.0), speed=0.5, acceleration=0.5)
    for _ in range(350):
        bed.advance(0.01)
        speeds.append(bed.motion(0).qd)
        torques.append(abs(bed.motion(0).torque))
    assert max(speeds) == pytest.approx(0.5, abs=0.01)
    assert np.diff(speeds).max() < 0.5 * 0.01 * 1.5
    assert 0.0 < max(torques) < 1.8


def test_a_drive_ends_at_its_torque_and_at_the_soft_limits():
    bed = plant()
    bed.command(2, Demand(MODE_CURRENT, 10.0))
    bed.advance(0.05)
    motion = bed.motion(2)
    assert motion.current == pytest.approx(2.25)
    assert motion.torque == pytest.approx(1.8 - 0.3 - 0.5 * motion.qd, abs=0.01)
    bed.command(2, Demand(MODE_OFF))
    bed.command(0, Demand(MODE_POSITION, 3.0, 1.0, 2.0))
    bed.command(1, Demand(MODE_VELOCITY, -1.0, 1.0, 2.0))
    bed.advance(5.0)
    np.testing.assert_allclose(bed.q[3:5], [np.pi / 2, -np.pi / 2], rtol=0, atol=1e-4)


@pytest.mark.parametrize(
    ("joint", "demand", "words"),
    [
        (4, Demand(MODE_OFF), "joint is 4, expected 0 to 3: counted from 0"),
        (-1, Demand(MODE_OFF), "joint is -1, expected 0 to 3"),
        (0, 0.1, r"demand is 0.1, expected Demand\(mode, set_point, speed, acceleration\)"),
        (0, Demand(2), "expected Demand.* with a mode MODE_OFF, MODE_CURRENT"),
        (0, Demand(MODE_VELOCITY, np.nan), "demand is Demand.*nan.*, expected finite numbers"),
    ],
)
def test_a_wrong_command_is_refused_with_what_is_expected(joint, demand, words):
    with pytest.raises(ValueError, match=words):
        plant().command(joint, demand)


def test_friction_brakes_a_drive_that_is_off_and_position_mode_at_speed_0_brakes_and_holds():
    bed = Plant(paper_arm(), np.zeros(7), (0, 0, 0, 0.5, 0, 0, 0))
    for joint in range(4):
        bed.command(joint, Demand(MODE_OFF))
    bed.advance(3.0)
    assert np.abs(bed.qd[3:]).max() < 1e-3
    assert bed.motion(0).current == 0.0
    assert bed.q[3] > 0.001
    bed.command(2, Demand(MODE_VELOCITY, 0.5, 0.5, 1.0))
    bed.advance(1.0)
    q, qd = bed.motion(2)[:2]
    assert qd == pytest.approx(0.5, abs=1e-3)
    bed.command(2, Demand(MODE_POSITION, 0.0, 0.0, 1.0))
    bed.advance(1.5)
    assert bed.motion(2).q == pytest.approx(q + 0.5**2 / 2, abs=1e-3)
    rest = bed.motion(2).q
    bed.advance(1.0)
    assert abs(bed.motion(2).q - rest) < 0.5 * COUNT


@pytest.mark.parametrize("tolerance", [0.0, 1e-11])
@pytest.mark.parametrize("n", [1, 8])
def test_the_audit_balances_under_all_forces(n, tolerance):
    rng = np.random.default_rng(n)
    around = Surroundings((0.001, -0.002), 0.01, 0.5, 0.02, table=(20.0, 20.0))
    q, qd = rng.uniform(-1.0, 1.0, (2, 3 + n))
    arm = random_arm(n, rng)
    world = World(Joints(rotor_inertia=0.0026), around, tolerance=tolerance)
    bed = Plant(arm, q, 0.2 * qd, world)
    start = bed.audit.balance
    for joint in range(n):
        mode = (MODE_OFF, MODE_CURRENT, MODE_VELOCITY, MODE_POSITION)[joint % 4]
        bed.command(joint, Demand(mode, rng.uniform(-0.5, 0.5), 0.5, 1.0))
    bed.advance(3.0)
    assert np.abs(bed.audit.impulse).min() > 1e-3
    np.testing.assert_allclose(bed.audit.balance, start, rtol=0, atol=1e-9)


def test_energy_and_momentum_of_the_audit_are_those_of_the_bodies():
    rng = np.random.default_rng(2)
    q, qd = rng.uniform(-1.0, 1.0, (2, 7))
    bed = Plant(paper_arm(), q, qd)
    p = bed.arm.vector()
    assert bed.audit.energy == pytest.approx(kinetic_energy(p, q, qd), rel=1e-12)
    x, y = system_com(p, q)
    px, py, about_com = bed.momentum()
    np.testing.assert_allclose(bed.audit.momentum, [px, py, about_com + x * py - y * px])
    rotors = Plant(paper_arm(), q, qd, World(Joints(rotor_inertia=0.0026)))
    spin = np.cumsum(qd[2:])[:-1]  # of the body before each joint
    J = np.array([0.0026, 0.0026 / 30])
    more = (0.5 * J[0] * qd[3:] ** 2 + J[1] * spin * qd[3:]).sum()
    assert rotors.audit.energy - bed.audit.energy == pytest.approx(more, rel=1e-9)
    gained = rotors.audit.momentum - bed.audit.momentum
    np.testing.assert_allclose(gained, [0.0, 0.0, J[1] * qd[3:].sum()], atol=1e-12)


def test_film_slope_and_tether_act_with_their_coefficients():
    """The kernel that applies them is compared with Pinocchio in test_rollout.py."""
    qd = np.array([0.05, -0.02, 0.3, 0.1, -0.2, 0.1, 0.05])

    def moving(qd, **around):
        world = World(FRICTIONLESS, Surroundings(**around, table=(20.0, 20.0)), target=Target())
        return Plant(paper_arm(), np.zeros(7), qd, world, [[5.0, 5.0, 0.0], [0.0, 0.0, 0.0]])

    film, slope = moving(qd, film=0.05), moving(None, tilt=(1e-3, 0.0))
    tether, before = moving([0.1, 0, 0, 0, 0, 0, 0], tether=2.0), film.momentum()
    film.advance(4.0)
    np.testing.assert_allclose(film.momentum(), before * np.exp(-0.05 * 4.0), rtol=1e-8)
    slope.advance(3.0)
    down = 0.5 * 9.81e-3 * 3.0**2
    np.testing.assert_allclose(slope.q, [down, 0, 0, 0, 0, 0, 0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(slope.target[0], [5.0 + down, 5.0, 0.0], rtol=0, atol=1e-12)
    tether.advance(1e-3)
    np.testing.assert_allclose(tether.audit.impulse / 1e-3, [-0.2, 0.0, 0.0], rtol=0, atol=1e-4)


@pytest.mark.parametrize(("axis", "sense"), [(0, 1), (1, -1)])
def test_the_border_pushes_vehicles_back(axis, sense):
    velocity = np.zeros(7)
    velocity[axis] = 0.3 * sense
    bed = Plant(paper_arm(), np.zeros(7), velocity, World(tolerance=1e-9))
    start = bed.audit.balance
    bed.advance(12.0)
    assert bed.audit.impulse[axis] * sense < -0.1
    assert np.abs(bed.q[:2]).max() < 2.0
    assert bed.audit.energy < start[3]
    np.testing.assert_allclose(bed.audit.balance, start, rtol=0, atol=1e-7)


def test_end_stops_hold_what_a_motor_pushes_into_them():
    bed, current = plant(), -2.0
    bed.command(1, Demand(MODE_CURRENT, current))
    bed.advance(4.0)
    beyond = np.sign(current) * bed.q[4] - np.pi / 2
    assert 0.0 < beyond < 0.02
    assert np.abs(bed.qd[3:]).max() < 0.02
    bed.command(1, Demand(MODE_CURRENT, -0.5 * current))
    bed.advance(1.0)
    assert np.sign(current) * bed.q[4] < 1.5  # the stop does not hold it


def test_a_state_of_another_number_of_joints_is_refused():
    with pytest.raises(ValueError, match=r"q has shape \(6,\), expected \(7,\)"):
        Plant(paper_arm(), np.zeros(6))
