"""Topics of thrusters, gripper, target and truth."""

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
from fss_sim.plant.plant import Plant
from fss_sim.plant.vehicle import World

STEPPED = {"ports": [0, 0, 0, 0], "keep_clock": True, "speed": 20.0, "preset": "ideal"}


def testbed(**given):
    parameters = [Parameter(k, value=v) for k, v in {**STEPPED, **given}.items()]
    return testbed_node.TestbedNode(parameter_overrides=parameters)


def target_before_tip(distance):
    """Return a target pose with the fixture at a distance [m] from the tip of the straight arm."""
    x, y, heading = tip_pose(paper_arm().vector(), np.zeros(7)).tolist()
    at = complex(x, y) + (0.19 + distance) * np.exp(1j * heading)
    return [float(at.real), float(at.imag), heading + np.pi]


testbed.__test__ = False


@pytest.fixture
def operator(ros):
    node = Node("operator")
    node.truth_message, node.gripper, node.target = [], [], []
    node.create_subscription(SimTruth, "sim/truth", node.truth_message.append, sensor())
    node.create_subscription(GripperState, "gripper/state", node.gripper.append, sensor())
    node.create_subscription(PoseStamped, "vicon/target/target", node.target.append, sensor())
    node.thrust = node.create_publisher(ThrusterCommand, "thrusters/command", COMMAND)
    node.grip = node.create_publisher(Bool, "gripper/command", COMMAND)
    return node


def test_thrusters_push_the_base_and_use_propellant(spin, operator):
    bed = testbed()
    spin(
        [bed, operator], lambda: operator.truth_message and operator.thrust.get_subscription_count()
    )
    before = operator.truth_message[-1]
    assert before.q == pytest.approx([0.0] * 7)
    push = [0.0, 0.0, 0.5, 0.0, 0.5, 0.0, 0.0, 0.0]  # along x
    operator.thrust.publish(ThrusterCommand(on_time=push))
    spin([bed, operator], lambda: operator.truth_message[-1].impulse[0] > 0.15)
    spin([bed, operator], lambda: not any(operator.truth_message[-1].valves))
    after = operator.truth_message[-1]
    assert after.impulse[0] == pytest.approx(2 * 0.16 * 0.5, rel=0.01)
    assert after.propellant > 0.0
    assert after.pressure < before.pressure
    assert max(map(abs, [*after.momentum_error, after.energy_error])) < 1e-9
    assert not after.target_present
    assert not operator.target


def test_the_gripper_holds_and_releases_the_target(spin, operator):
    pose = target_before_tip(0.01)
    bed = testbed(target_mass=8.0, target_pose=pose, table=[6.0, 6.0])
    spin([bed, operator], lambda: operator.gripper and operator.grip.get_subscription_count())
    state = operator.gripper[-1]
    assert (state.closed, state.holds) == (False, False)
    assert state.distance == pytest.approx(0.01, abs=1e-6)
    got = planar_pose(spin([bed, operator], lambda: operator.target and operator.target[-1].pose))
    np.testing.assert_allclose(got[:2], pose[:2], atol=1e-9)
    operator.grip.publish(Bool(data=True))
    spin([bed, operator], lambda: operator.gripper[-1].holds and operator.truth_message[-1].holds)
    operator.grip.publish(Bool(data=False))
    spin(
        [bed, operator],
        lambda: not (operator.gripper[-1].holds or operator.truth_message[-1].holds),
    )


def test_a_held_target_and_used_propellant_survive_a_restart(spin, operator, tmp_path):
    path = str(tmp_path / "state.json")
    given = {"target_mass": 8.0, "target_pose": target_before_tip(0.0), "table": [6.0, 6.0]}
    first = testbed(**given, state_file=path)
    with first.lock:
        first.testbed.plant.closed = True
        first.testbed.plant.thrust([0.1] * 8)
    spin(
        [first, operator],
        lambda: operator.truth_message and operator.truth_message[-1].propellant > 0.0,
    )
    spin([first, operator], lambda: not any(operator.truth_message[-1].valves))
    first.close()
    kept = first.testbed.plant
    second = testbed(**given, state_file=path)
    with second.lock:
        again = second.testbed.plant
        assert again.holds
        assert again.thrusters.propellant_used == kept.thrusters.propellant_used > 0.0
        np.testing.assert_allclose(again._p, kept._p, rtol=0, atol=1e-12)
    second.close()


def test_an_invalid_command_opens_no_valve(spin, operator):
    bed = testbed()
    spin(
        [bed, operator], lambda: operator.truth_message and operator.thrust.get_subscription_count()
    )
    operator.thrust.publish(ThrusterCommand(on_time=[-1.0] + 7 * [0.5]))
    seen = len(operator.truth_message)
    spin([bed, operator], lambda: len(operator.truth_message) > seen + 10)
    assert operator.truth_message[-1].propellant == 0.0


def test_the_truth_survives_its_serialization():
    plant = Plant(paper_arm(), np.linspace(0.1, 0.7, 7), np.ones(7), World(target=Target()))
    message = messages.truth_message(1_500_000_000, "world", plant.bed, plant)
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
def test_impossible_settings_are_rejected(given, words):
    with pytest.raises(ValueError, match=words):
        settings.TestbedSettings(**given)
