"""Flexible joints, compared with MuJoCo, eigenvalues and formulas; the audit balances."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from model_arms import random_arm
from model_oracles import mujoco_index, mujoco_model

from fss_arm_model.description import paper_arm
from fss_arm_model.integration import STEP
from fss_arm_model.settings import SettingError
from fss_sim import settings as of_testbed
from fss_sim.noise import PRESETS as NOISE
from fss_sim.plant.drives import MODE_CURRENT, MODE_OFF, MODE_POSITION, MODE_VELOCITY, STIFFNESS
from fss_sim.plant.joints import PRESETS, Joints, link_normals, outboard_momentum
from fss_sim.plant.plant import Plant
from fss_sim.plant.surroundings import Surroundings
from fss_sim.plant.vehicle import Demand, World

WIDE = Surroundings(table=(20.0, 20.0))
REAL = PRESETS["laboratory"]
#: Springs alone.
BARE = Joints(
    rotor_inertia=0.0026,
    stiffness=390.0,
    damping=1.0,
    viscous=0.0,
    coulomb=0.0,
    stop_stiffness=0.0,
    stop_damping=0.0,
)


def bed(joints, q=(0.3, -0.2, 0.4, 0.1), qd=None, tolerance=0.0, arm=None):
    arm = arm or paper_arm()
    world = World(joints, WIDE, tolerance=tolerance)
    return Plant(arm, (0.1, -0.2, 0.3, *q), qd, world)


def motors(plant):
    """Angle and rate of each motor, (n, 2)."""
    return np.array([motion[:2] for motion in plant.motions()])


@pytest.mark.parametrize(
    ("n", "tolerance", "joints"),
    [(1, 0.0, BARE), (4, 1e-12, BARE), (4, 1e-11, replace(BARE, dead_band=0.002))],
)
def test_motors_and_springs_move_as_in_mujoco(n, tolerance, joints):
    """Same integrator and step in other coordinates; with a tolerance, the converged solution."""
    rng = np.random.default_rng(n)
    arm = random_arm(n, rng)
    model = mujoco_model(arm, joints)
    model.opt.integrator, model.opt.timestep = mujoco.mjtIntegrator.mjINT_RK4, 0.2 * STEP
    data, motor = mujoco.MjData(model), mujoco_index(model, "m", n)
    place, N = [0, 1, 2, *mujoco_index(model, "q", n)], joints.gear_ratio
    q, qd = rng.uniform(-0.5, 0.5, (2, 3 + n))
    torques = rng.uniform(-0.4, 0.4, n)
    data.qpos[place], data.qvel[place] = q, qd
    data.qpos[motor], data.qvel[motor] = N * q[3:], N * qd[3:]
    data.qfrc_applied[motor] = torques / N
    plant = Plant(arm, q, qd, World(joints, WIDE, tolerance=tolerance))
    for joint, torque in enumerate(torques):
        plant.command(joint, Demand(MODE_CURRENT, torque / arm.links[joint].drive.torque_constant))
    for _ in range(2):
        plant.advance(0.1)
        for _ in range(500):
            mujoco.mj_step(model, data)
        np.testing.assert_allclose(plant.q, data.qpos[place], rtol=0, atol=1e-7)
        np.testing.assert_allclose(plant.qd, data.qvel[place], rtol=0, atol=1e-6)
        turned = np.column_stack([data.qpos[motor], data.qvel[motor]]) / N
        np.testing.assert_allclose(motors(plant), turned, rtol=0, atol=1e-6)
    assert np.abs(plant.q[3:] - motors(plant)[:, 0]).max() > 1e-4  # the gears are twisted


@pytest.mark.parametrize("speed", [0.01, 0.06, 0.4])
def test_friction_follows_stribecks_curve(speed):
    joints = replace(REAL, ripple=0.0, dead_band=0.0, current_bandwidth=0.0, static=0.5)
    plant, torques = bed(joints), []
    plant.command(0, Demand(MODE_VELOCITY, speed, speed, 2.0))
    plant.advance(0.5 + speed)
    for _ in range(1000):
        plant.advance(STEP)
        motor, passed = plant._torques[0]
        torques.append(motor - passed)
    expected = 0.3 + 0.2 * np.exp(-((speed / 0.05) ** 2)) + 0.5 * speed
    assert np.mean(torques) == pytest.approx(expected, rel=0.01)


def test_a_motor_sticks_up_to_static_friction_and_no_further():
    plant = bed(replace(REAL, ripple=0.0))
    for joint in range(4):
        plant.command(joint, Demand(MODE_CURRENT, 0.99 * REAL.static / 0.8))
    before = motors(plant)
    plant.advance(10.0)
    assert (motors(plant) == before).all()
    for joint in range(4):
        plant.command(joint, Demand(MODE_CURRENT, 1.02 * REAL.static / 0.8))
    plant.advance(0.5)
    assert (motors(plant)[:, 0] > before[:, 0] + 1e-4).all()


def test_motors_come_to_rest_exactly_and_energy_never_grows():
    rng, energies = np.random.default_rng(3), []
    plant = bed(REAL, qd=rng.uniform(-0.3, 0.3, 7))
    for _ in range(2000):
        plant.advance(STEP)
        energies.append(plant.audit.energy)
    assert np.diff(energies).max() < 1e-12
    rest = motors(plant)
    assert (rest[:, 1] == 0.0).all()
    plant.advance(1.0)
    assert (motors(plant) == rest).all()


@pytest.mark.parametrize("n", [1, 6])
def test_the_audit_balances_with_springs_and_friction(n):
    """Within 1e-9 with error control; with fixed steps of 1 ms, within their error."""
    rng = np.random.default_rng(n)
    around = Surroundings((0.001, -0.002), 0.01, 0.5, 0.02, table=(20.0, 20.0))
    q, qd = rng.uniform(-1.0, 1.0, (2, 3 + n))
    arm = random_arm(n, rng)
    for tolerance, momentum, energy in ((1e-12, 1e-9, 1e-9), (0.0, 1e-8, 1e-4)):
        plant = Plant(arm, q, 0.2 * qd, World(REAL, around, tolerance=tolerance))
        for joint in range(n):
            mode = (MODE_OFF, MODE_CURRENT, MODE_VELOCITY, MODE_POSITION)[joint % 4]
            plant.command(joint, Demand(mode, rng.uniform(-0.5, 0.5), 0.5, 1.0))
        plant.advance(1.5)
        assert np.abs(plant.audit.impulse).min() > 1e-3
        off = np.abs(plant.imbalance)
        assert off[:3].max() < momentum
        assert off[3] < energy


def test_a_current_follows_its_command_at_the_loops_bandwidth():
    plant, seen = bed(replace(REAL, current_bandwidth=50.0)), []
    plant.command(0, Demand(MODE_CURRENT, 1.0))
    for _ in range(10):
        plant.advance(STEP)
        seen.append(plant.motion(0).current)
    t = STEP * np.arange(1, 11)
    np.testing.assert_allclose(seen, 1.0 - np.exp(-2 * np.pi * 50.0 * t), rtol=1e-12)


@pytest.mark.parametrize("bandwidth", [0.0, 30.0])
def test_a_move_ends_within_the_friction_band(bandwidth):
    plant, posture = bed(replace(REAL, current_bandwidth=bandwidth)), (-1.4, 1.4, -1.3, 1.4)
    for joint, target in enumerate(posture):
        plant.command(joint, Demand(MODE_POSITION, target, 0.8, 1.0))
    plant.advance(6.0)
    q, qd = motors(plant).T
    assert np.abs(q - posture).max() < 2.0 * REAL.static / STIFFNESS
    assert np.abs(qd).max() < 1e-3
    assert np.abs(plant.q[3:] - q).max() < 0.5 * REAL.dead_band + 5e-4
    assert np.abs(plant.momentum()).max() < 1e-4  # without that of the rotors


def test_a_servo_cancels_its_share_of_friction():
    """In motion, the following error is the remaining friction divided by the stiffness."""
    joints = replace(REAL, ripple=0.0, dead_band=0.0, static=0.3, current_bandwidth=0.0)
    for share in (1.0, 0.5):
        plant, speed = bed(replace(joints, cancelled=share)), 0.1
        plant.command(0, Demand(MODE_VELOCITY, speed, speed, 2.0))
        plant.advance(4.0)
        lag = plant._reference[0, 0] - motors(plant)[0, 0]
        expected = (1.0 - share) * (0.3 + 0.5 * speed) / STIFFNESS
        assert lag == pytest.approx(expected, abs=2e-5)


def test_outboard_momentum_is_that_of_the_links_beyond_a_joint():
    rng = np.random.default_rng(2)
    arm, (q, qd) = random_arm(3, rng), rng.uniform(-1.0, 1.0, (2, 6))
    p = arm.vector()
    x, y = arm.base.com
    turn = np.exp(1j * q[2])
    base = arm.base.mass * (complex(*qd[:2]) + 1j * qd[2] * complex(x, y) * turn)
    total = Plant(arm, q, qd).momentum()[:2]
    momenta = outboard_momentum(p, q, qd)
    np.testing.assert_allclose(momenta[0] + [base.real, base.imag], total, atol=1e-12)
    still = outboard_momentum(p, q, np.array([0.3, -0.1, 0.0, 0.0, 0.0, 0.0]))
    masses = np.cumsum([link.mass for link in arm.links][::-1])[::-1]
    np.testing.assert_allclose(still, masses[:, None] * [0.3, -0.1], atol=1e-12)
    along = q[2] + arm.base.mount[2] + arm.links[0].theta_0 + q[3]
    np.testing.assert_allclose(link_normals(p, q)[0], [-np.sin(along), np.cos(along)], atol=1e-12)


def test_a_preset_sets_joints_and_errors_and_parameters_override_it():
    assert PRESETS.keys() == NOISE.keys()
    for name in PRESETS:
        settings = of_testbed.TestbedSettings(preset=name)
        assert settings.world().joints == PRESETS[name]
        assert settings.noise() == NOISE[name]
    given = of_testbed.TestbedSettings(preset="laboratory", dead_band=0.0, coulomb_friction=0.1)
    assert given.world().joints == replace(REAL, dead_band=0.0, coulomb=0.1)
    rigid = {"dead_band": 0.0, "gear_damping": 0.0, "static_friction": 0.0, "torque_ripple": 0.0}
    rigid |= {"friction_cancelled": 1.0, "current_bandwidth": 0.0, "rotor_inertia": 0.0}
    settings = of_testbed.TestbedSettings(preset="laboratory", gear_stiffness=0.0, **rigid)
    assert settings.world().joints == Joints()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"gear_stiffness": 400.0}, "stiffness is 400 N m/rad with a rotor_inertia of 0"),
        ({"static_friction": 0.5}, "static is 0.5, which needs a gear stiffness above 0"),
        ({"friction_cancelled": 1.5, "preset": "laboratory"}, "cancelled is 1.5, expected 0 to 1"),
    ],
)
def test_impossible_joints_are_rejected(given, message):
    with pytest.raises(SettingError, match=message):
        of_testbed.TestbedSettings(**given)
