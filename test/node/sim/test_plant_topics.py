"""Thrusters, gripper and target by their topics, and the truth that tells of them."""

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import Bool

from fss_arm_model.description import paper_arm
from fss_arm_model.held import Target
from fss_arm_model.kinematics import tip_pose
from fss_arm_msgs.msg import GripperState, SimTruth, ThrusterCommand
from fss_arm_ros.convert import planar_pose
from fss_arm_ros.qos import COMMAND, sensor
from fss_sim import messages, settings, testbed_node
from fss_sim.plant.plant import Plant, World

STEPPED = {"ports": [0, 0, 0, 0], "keep_clock": True, "speed": 20.0, "preset": "ideal"}


def testbed(**given):
    parameters = [Parameter(k, value=v) for k, v in {**STEPPED, **given}.items()]
    return testbed_node.TestbedNode(parameter_overrides=parameters)


def before_the_tip(apart):
    """Pose of a target whose fixture is so far ahead of the tip of the straight arm [m]."""
    x, y, heading = tip_pose(paper_arm().vector(), np.zeros(7)).tolist()
    at = complex(x, y) + (0.19 + apart) * np.exp(1j * heading)
    return [float(at.real), float(at.imag), heading + np.pi]


testbed.__test__ = False


@pytest.fixture
def person(ros):
    node = Node("person")
    node.truth, node.gripper, node.target = [], [], []
    node.create_subscription(SimTruth, "sim/truth", node.truth.append, sensor())
    node.create_subscription(GripperState, "gripper/state", node.gripper.append, sensor())
    node.create_subscription(PoseStamped, "vicon/target/target", node.target.append, sensor())
    node.thrust = node.create_publisher(ThrusterCommand, "thrusters/command", COMMAND)
    node.grip = node.create_publisher(Bool, "gripper/command", COMMAND)
    return node


def test_thrusters_push_the_base_and_use_propellant(spin, person):
    bed = testbed()
    spin([bed, person], lambda: person.truth and person.thrust.get_subscription_count())
    before = person.truth[-1]
    assert before.q == pytest.approx([0.0] * 7)
    push = [0.0, 0.0, 0.5, 0.0, 0.5, 0.0, 0.0, 0.0]  # along x
    person.thrust.publish(ThrusterCommand(on_time=push))
    spin([bed, person], lambda: person.truth[-1].impulse[0] > 0.15)
    spin([bed, person], lambda: not any(person.truth[-1].valves))
    after = person.truth[-1]
    assert after.impulse[0] == pytest.approx(2 * 0.16 * 0.5, rel=0.01)
    assert after.propellant > 0.0
    assert after.pressure < before.pressure
    assert max(map(abs, [*after.momentum_error, after.energy_error])) < 1e-9
    assert not after.target_present
    assert not person.target


def test_the_gripper_holds_the_target_and_lets_it_go(spin, person):
    pose = before_the_tip(0.01)
    bed = testbed(target_mass=8.0, target_pose=pose, table=[6.0, 6.0])
    spin([bed, person], lambda: person.gripper and person.grip.get_subscription_count())
    state = person.gripper[-1]
    assert (state.closed, state.holds) == (False, False)
    assert state.distance == pytest.approx(0.01, abs=1e-6)
    got = planar_pose(spin([bed, person], lambda: person.target and person.target[-1].pose))
    np.testing.assert_allclose(got[:2], pose[:2], atol=1e-9)
    person.grip.publish(Bool(data=True))
    spin([bed, person], lambda: person.gripper[-1].holds and person.truth[-1].holds)
    person.grip.publish(Bool(data=False))
    spin([bed, person], lambda: not (person.gripper[-1].holds or person.truth[-1].holds))


def test_a_held_target_and_used_propellant_outlive_a_restart(spin, person, tmp_path):
    path = str(tmp_path / "state.json")
    given = {"target_mass": 8.0, "target_pose": before_the_tip(0.0), "table": [6.0, 6.0]}
    first = testbed(**given, state_file=path)
    with first.lock:
        first.testbed.plant.closed = True
        first.testbed.plant.thrust([0.1] * 8)
    spin([first, person], lambda: person.truth and person.truth[-1].propellant > 0.0)
    spin([first, person], lambda: not any(person.truth[-1].valves))
    first.close()
    kept = first.testbed.plant
    second = testbed(**given, state_file=path)
    with second.lock:
        again = second.testbed.plant
        assert again.holds
        assert again.thrusters.used == kept.thrusters.used > 0.0
        np.testing.assert_allclose(again._p, kept._p, rtol=0, atol=1e-12)
    second.close()


def test_nonsense_opens_no_valve(spin, person):
    bed = testbed()
    spin([bed, person], lambda: person.truth and person.thrust.get_subscription_count())
    person.thrust.publish(ThrusterCommand(on_time=[-1.0] + 7 * [0.5]))
    seen = len(person.truth)
    spin([bed, person], lambda: len(person.truth) > seen + 10)
    assert person.truth[-1].propellant == 0.0


def test_the_truth_survives_its_serialization():
    bed = Plant(paper_arm(), np.linspace(0.1, 0.7, 7), np.ones(7), World(target=Target()))
    message = messages.truth(1_500_000_000, "world", bed)
    assert deserialize_message(serialize_message(message), SimTruth) == message


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"target_mass": -1.0}, "target_mass is -1.0"),
        ({"tilt": (0.1,)}, "tilt has 1 numbers, expected 2"),
        ({"table": (0.0, 4.0)}, "table"),
        ({"tank_volume": 0.0}, "tank_volume is 0.0"),
        ({"truth_rate": 0.0}, "truth_rate is 0.0"),
        ({"film_damping": -0.1}, "film_damping is -0.1"),
        ({"gear_stiffness": 400.0}, "stiffness is 400 N m/rad with a rotor_inertia of 0"),
    ],
)
def test_impossible_settings_are_refused(given, words):
    with pytest.raises(ValueError, match=words):
        settings.TestbedSettings(**given)
