"""Capture and release of a target: momentum is conserved, the impact is plastic."""

import numpy as np
import pytest
from model_arms import random_arm

from fss_arm_model.description import paper_arm
from fss_arm_model.held import Approach, Target
from fss_arm_model.kinematics import tip_pose
from fss_sim.plant.joints import Joints
from fss_sim.plant.plant import Plant
from fss_sim.plant.surroundings import Surroundings
from fss_sim.plant.target import Gripper
from fss_sim.plant.vehicle import World

SURROUNDINGS = Surroundings(table=(20.0, 20.0))
WIDE_GRIPPER = Gripper(reach=0.05, angle=3.2, speed=10.0)
TARGET = Target(mass=9.0, inertia=0.2, fixture=(0.15, 0.05, 0.3))


def before_capture(arm, rng, rotor=0.0026, gripper=WIDE_GRIPPER):
    """Return a moving arm with the fixture of a tumbling target at its tip."""
    q, qd = rng.uniform(-0.5, 0.5, (2, 3 + arm.n))
    x, y, heading = tip_pose(arm.vector(), q)
    theta = heading + np.pi - TARGET.fixture[2]
    c = complex(x, y) - complex(*TARGET.fixture[:2]) * np.exp(1j * theta) + 0.01
    target = [[c.real, c.imag, theta], rng.uniform(-0.3, 0.3, 3)]
    world = World(Joints(rotor_inertia=rotor), SURROUNDINGS, gripper=gripper, target=TARGET)
    return Plant(arm, q, qd, world, target)


def total(bed):
    """Return momentum about the origin (3,) and kinetic energy, summed over separate bodies."""
    (x, y, _), (vx, vy, omega) = bed.target
    m, inertia = TARGET.mass, TARGET.inertia
    own = Plant(bed.arm, bed.q, bed.qd, World(bed.world.joints)).audit
    energy = own.energy + 0.5 * m * (vx * vx + vy * vy) + 0.5 * inertia * omega**2
    momentum = np.array([m * vx, m * vy, m * (x * vy - y * vx) + inertia * omega])
    return own.momentum + momentum, energy


@pytest.mark.parametrize("n", [1, 4])
def test_momentum_is_conserved_by_capture_and_release(n):
    bed = before_capture(random_arm(n, np.random.default_rng(n)), np.random.default_rng(n))
    before, energy = total(bed)
    np.testing.assert_allclose(bed.audit.momentum, before, rtol=0, atol=1e-12)
    balance = bed.audit.balance
    bed.closed = True
    bed.advance(0.0)
    assert bed.holds
    after, less = total(bed)
    np.testing.assert_allclose(after, before, rtol=0, atol=1e-12)
    assert less < energy
    bed.advance(0.5)
    # The audit of the composite equals the sum over its parts.
    np.testing.assert_allclose(bed.audit.momentum, total(bed)[0], rtol=0, atol=1e-11)
    assert bed.audit.energy == pytest.approx(total(bed)[1], rel=1e-10)
    bed.closed = False
    pose, twist = bed.target.copy()
    bed.advance(0.1)
    assert not bed.holds
    np.testing.assert_allclose(bed.target[0], pose + 0.1 * twist, rtol=0, atol=1e-12)
    bed.advance(0.5)
    np.testing.assert_allclose(total(bed)[0], before, rtol=0, atol=1e-9)
    np.testing.assert_allclose(bed.audit.balance, balance, rtol=0, atol=1e-9)


def test_the_capture_is_the_smallest_change_that_equalizes_the_velocities():
    """Gauss's principle: any other velocity of the joined bodies is farther in kinetic energy."""
    rng = np.random.default_rng(5)
    bed = before_capture(paper_arm(), rng)
    still = bed.target.copy()
    q, qd = bed.q.copy(), bed.qd.copy()
    bed.closed = True
    bed.advance(0.0)

    def gap(velocity):
        joined = Plant(bed.arm, q, velocity, bed.world, still, holds=True)
        change = joined.target[1] - still[1]
        arm = Plant(bed.arm, q, velocity - qd, World(bed.world.joints)).audit.energy
        return arm + 0.5 * change**2 @ [TARGET.mass, TARGET.mass, TARGET.inertia]

    least = gap(bed.qd)
    for _ in range(50):
        assert gap(bed.qd + 1e-3 * rng.standard_normal(7)) > least


def test_a_gripper_rejects_a_large_angle():
    assert Gripper().can_grip(Approach(0.0, -0.4, 0.0))
    assert not Gripper().can_grip(Approach(0.0, -0.6, 0.0))


@pytest.mark.parametrize("limits", [(0.005, 3.2, 10.0), (0.05, 3.2, 0.001)])
def test_a_gripper_rejects_a_large_distance_or_speed(limits):
    gripper = Gripper(*limits)
    bed = before_capture(paper_arm(), np.random.default_rng(1), gripper=gripper)
    bed.closed = True
    bed.advance(0.001)
    assert not bed.holds


def test_without_a_target_nothing_is_held():
    bed = Plant(paper_arm(), np.zeros(7))
    bed.closed = True
    bed.advance(0.01)
    assert not bed.holds


def test_a_target_without_mass_is_rejected():
    with pytest.raises(ValueError, match="mass is 0"):
        Target(mass=0.0)
