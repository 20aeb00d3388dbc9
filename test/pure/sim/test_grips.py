"""Grips: closing time and slip, two arms that hold one target or each other."""

from dataclasses import replace

import numpy as np
import pytest

from fss_arm_model.description import paper_arm
from fss_arm_model.held import Target
from fss_arm_model.kinematics import tip_pose
from fss_sim.plant.bed import Bed
from fss_sim.plant.contact import Contact
from fss_sim.plant.drives import MODE_CURRENT, MODE_VELOCITY
from fss_sim.plant.joints import Joints
from fss_sim.plant.plant import Plant
from fss_sim.plant.surroundings import Surroundings
from fss_sim.plant.target import Gripper, Load, PassiveTarget
from fss_sim.plant.vehicle import Demand, Vehicle, World

WIDE = Surroundings(table=(40.0, 40.0))
PAPER = paper_arm()
BENT = np.array([0.0, 0.0, 0.0, 0.4, 0.3, -0.5, 0.6])


def target_before_tip(gripper=Gripper(), distance=0.0, twist=(0.0, 0.0, 0.0), **world):  # noqa: B008
    """Return an arm with the fixture of a target in front of its tip."""
    x, y, heading = tip_pose(PAPER.vector(), BENT)
    c = complex(x, y) + (0.19 + distance) * np.exp(1j * heading)
    world = World(surroundings=WIDE, gripper=gripper, target=Target(), **world)
    along = np.exp(1j * heading) * complex(*twist[:2])
    moving = [along.real, along.imag, twist[2]]
    return Plant(PAPER, BENT, None, world, [[c.real, c.imag, heading + np.pi], moving])


def arm_before(tip, heading, name, gripper):
    """Return a vehicle with its tip at a pose."""
    x, y, theta = tip_pose(PAPER.vector(), -BENT)
    turn = heading - theta
    base = tip - complex(x, y) * np.exp(1j * turn)
    q = [base.real, base.imag, turn, *-BENT[3:]]
    return Vehicle(PAPER, q, None, World(surroundings=WIDE, gripper=gripper), name=name)


def frames(bed, count):
    for _ in range(count):
        bed.advance(0.01)


def drive_joints(vehicle, sense=1.0):
    for joint, rate in enumerate((0.2, -0.1, 0.15, 0.1)):
        vehicle.command(joint, Demand(MODE_VELOCITY, sense * rate, abs(rate), 2.0))


# Fingers


def test_fingers_close_in_their_time_and_must_open_first_if_closed_on_nothing():
    bed = target_before_tip(Gripper(closing_time=0.3), 0.02, (0.09, 0.0, 0.0))
    bed.closed = True
    frames(bed, 40)  # the target has left before they are closed
    assert not bed.holds
    bed.bed.targets[0]._state[:] = target_before_tip().target
    bed.advance(0.01)
    assert not bed.holds
    bed.closed = False
    bed.advance(0.01)
    bed.closed = True
    frames(bed, 30)
    assert not bed.holds
    frames(bed, 2)
    assert bed.holds


def test_a_missed_grip_pushes_the_target_away():
    bed = target_before_tip(Gripper(speed=0.02), 0.05, (-0.1, 0.0, 0.0))
    bed.closed = True
    balance = bed.audit.balance
    frames(bed, 250)
    assert not bed.holds
    assert bed.approach.distance > 0.03
    along = np.exp(1j * tip_pose(PAPER.vector(), BENT)[2])
    assert (np.conj(along) * complex(*bed.target[1, :2])).real > -0.08
    assert bed.audit.contact < -1e-4
    np.testing.assert_allclose(bed.audit.balance, balance, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("limits", "slips"),
    [
        ({"force": 0.2}, True),
        ({"force": 50.0}, False),
        ({"force": 1000.0, "torque": 0.05}, True),  # 0.25 kg m^2 at 2 rad/s^2 about its centre
    ],
)
def test_an_overloaded_grip_slides_within_its_limits_and_out(limits, slips):
    gripper = Gripper(**limits)
    bed = target_before_tip(gripper)
    bed.closed = True
    frames(bed, 11)
    assert bed.holds
    assert not bed.fingers.slides
    balance = bed.audit.balance
    drive_joints(bed)
    for _ in range(100):
        bed.advance(0.01)
        assert Load(bed.fingers.force, bed.fingers.torque).share(gripper) <= 1.0 + 1e-12
    assert bed.holds != slips
    assert bed.fingers.slips == bed.fingers.losses == slips
    np.testing.assert_allclose(bed.audit.balance, balance, rtol=0, atol=1e-9)
    if slips:
        bed.advance(1.0)
        assert not bed.holds  # the fingers are closed


def test_a_closing_grip_needs_as_long_as_its_limits_require():
    """Slide until the limits have transmitted the impulse of a grip without limits."""
    spinning = {"twist": (0.01, -0.005, 0.3), "joints": Joints(viscous=0.0, coulomb=0.0)}
    rigid = target_before_tip(**spinning)
    at, before = rigid.target
    x, y = at[:2] - tip_pose(PAPER.vector(), BENT)[:2]
    rigid.closed = True
    rigid.advance(0.001)
    fx, fy, spin = (rigid.target[1] - before) * rigid.bed.targets[0].masses
    impulse = abs(spin + x * fy - y * fx)  # about the tip
    bed = target_before_tip(Gripper(force=50.0, torque=0.5), **spinning)
    bed.closed = True
    steps = 0
    while not steps or bed.fingers.slides:
        bed.advance(0.001)
        steps += 1
        assert bed.holds
        assert bed.fingers.torque == pytest.approx(0.5, abs=1e-12) or not bed.fingers.slides
    assert steps == pytest.approx(impulse / 0.5 / 0.001, rel=0.03)  # the arm moves meanwhile
    assert bed.fingers.slips == 0


# Closed chains


def two_arms_holding(limit=0.0):
    """Return a bed with two arms that hold one target from both sides."""
    one = target_before_tip()
    x, y, heading = tip_pose(PAPER.vector(), BENT)
    tip = complex(x, y) + 2 * 0.19 * np.exp(1j * heading)
    other = arm_before(tip, heading + np.pi, "fss2", Gripper(0.5, 3.2, 1.0, force=limit))
    first = Vehicle(PAPER, BENT, [0.02, 0.01, 0.03, 0, 0, 0, 0], one.world, name="fss")
    target = PassiveTarget(Target(), [one.target[0], [0.0, 0.0, 0.05]], WIDE)
    bed = Bed([first, other], [target], Contact())
    first.closed = other.closed = True
    bed.advance(0.001)
    assert first.held is other.held is target
    return bed, first, other, target


def in_tip_frame(vehicle, pose):
    """Return a pose in the frame of the vehicle's tip."""
    x, y, heading = tip_pose(vehicle.p, vehicle.q)
    apart = complex(pose[0] - x, pose[1] - y) * np.exp(-1j * heading)
    return np.array([apart.real, apart.imag, pose[2] - heading])


def test_two_arms_hold_one_target_within_a_micron():
    bed, first, other, target = two_arms_holding()
    places = [in_tip_frame(vehicle, target.q) for vehicle in (first, other)]
    balance, worst = bed.audit.balance, 0.0
    drive_joints(first)
    drive_joints(other, -1.0)
    for _ in range(150):
        bed.advance(0.01)
        for vehicle, place in zip((first, other), places, strict=True):
            worst = max(worst, np.abs(in_tip_frame(vehicle, target.q) - place).max())
    print(f"worst {worst} m, rad; {bed.audit.balance - balance}")
    assert np.abs(first.qd[3:]).min() > 0.02
    assert worst < 1e-6
    np.testing.assert_allclose(bed.audit.balance, balance, rtol=0, atol=1e-9)
    first.closed = False  # the other one holds it alone
    bed.advance(0.01)
    assert first.held is None
    assert other.payload is target
    np.testing.assert_allclose(in_tip_frame(other, target.q), places[1], rtol=0, atol=1e-6)
    other.closed = False
    frames(bed, 20)
    assert target.is_free
    np.testing.assert_allclose(bed.audit.balance, balance, rtol=0, atol=1e-9)


def test_two_arms_hold_each_other():
    first = Vehicle(PAPER, BENT, None, World(surroundings=WIDE), name="fss")
    x, y, heading = tip_pose(PAPER.vector(), BENT)
    other = arm_before(complex(x, y) + 0.01, heading + np.pi, "fss2", Gripper())
    bed = Bed([first, other], [], Contact())
    first.closed = other.closed = True
    bed.advance(0.01)
    assert (first.held, other.held) == (other, first)
    place = in_tip_frame(first, tip_pose(other.p, other.q))
    drive_joints(first)
    frames(bed, 100)
    np.testing.assert_allclose(
        in_tip_frame(first, tip_pose(other.p, other.q)), place, rtol=0, atol=1e-6
    )
    np.testing.assert_allclose(bed.imbalance, 0.0, atol=1e-9)
    first.closed = False
    bed.advance(0.01)
    assert other.held is first  # it still holds
    other.closed = False
    frames(bed, 50)
    assert np.abs(in_tip_frame(first, tip_pose(other.p, other.q)) - place).max() > 1e-3


def test_one_of_two_grips_slips():
    bed, first, other, target = two_arms_holding(limit=3.0)
    for vehicle in (first, other):  # each turns the target in another direction
        vehicle.command(1, Demand(MODE_CURRENT, 2.0))
        vehicle.command(2, Demand(MODE_CURRENT, 2.0))
    frames(bed, 60)
    assert first.held is target
    assert other.held is None
    np.testing.assert_allclose(bed.imbalance, 0.0, atol=1e-9)


def test_a_base_without_arm_drifts_and_collides():
    """A vehicle without an arm behaves like any other."""
    world = World(surroundings=WIDE)
    alone = Vehicle(PAPER.base, [-1.0, 0.0, 0.0], [0.1, 0.0, 0.0], world, name="fss2")
    other = Vehicle(replace(PAPER), BENT, None, world, name="fss")
    bed = Bed([alone, other], [], Contact(0.0, 0.0))
    assert alone.motions() == []
    assert alone.edge_clearance == pytest.approx(20.0 - 1.0 - 0.19)
    np.testing.assert_allclose(alone.momentum(), [1.0, 0.0, 0.0])
    frames(bed, 800)
    assert bed.audit.contact < -1e-3
    assert alone.qd[0] < 0.09
    np.testing.assert_allclose(bed.imbalance, 0.0, atol=1e-9)
