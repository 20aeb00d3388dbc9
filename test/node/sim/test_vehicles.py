"""Several vehicles in one test bed: each on its own topics and ports, one time."""

import re
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import Imu

from fss_arm_msgs.msg import SimFaults, SimTruth, ThrusterCommand
from fss_arm_ros.convert import planar_pose, stamp_ns
from fss_arm_ros.qos import COMMAND, LATCHED, sensor
from fss_sim import testbed_node
from fss_sim.settings import TestbedSettings
from fss_sim.vehicles import read_vehicles

ROOT = Path(__file__).parents[3]
VEHICLES = """
vehicles:
  fss1: {ports: [0, 0, 0, 0], base: [-1, 0.5, 0.0]}
  fss2: {ports: [0, 0, 0, 0], base: [1.0, -0.5, 1.0]}
  fss3: {without_arm: true, base: [0.0, 1.5, 0.0], seed: 7}
"""


@pytest.fixture
def bed(ros, tmp_path):
    def make(text=VEHICLES, **given):
        (tmp_path / "vehicles.yaml").write_text(text)
        given = {"vehicles": str(tmp_path / "vehicles.yaml"), "keep_clock": True, **given}
        parameters = [Parameter(k, value=v) for k, v in given.items()]
        return testbed_node.TestbedNode(parameter_overrides=parameters)

    return make


def test_each_vehicle_has_its_own_topics_and_all_share_one_time(spin, bed):
    node, listener, received = bed(), Node("listener"), {}
    topics = {"vicon/{0}/{0}": PoseStamped, "vicon/{0}_end_effector/{0}_end_effector": PoseStamped}
    topics |= {"{0}/fog/imu": Imu, "{0}/sim/truth": SimTruth}
    for topic, kind in topics.items():
        for name in ("fss1", "fss2", "fss3")[: 2 if "end_effector" in topic else 3]:
            key = topic.format(name)
            received[key] = []
            listener.create_subscription(kind, f"/{key}", received[key].append, sensor())
    spin([node, listener], lambda: all(len(messages) > 20 for messages in received.values()))
    for name, pose in (("fss1", (-1.0, 0.5, 0.0)), ("fss2", (1.0, -0.5, 1.0))):
        message = received[f"vicon/{name}/{name}"][-1]
        assert message.header.frame_id == "world"
        np.testing.assert_allclose(planar_pose(message.pose), pose, atol=0.01)
        assert received[f"{name}/fog/imu"][-1].header.frame_id == f"{name}/fss"
    first, second = (received[f"vicon/{name}/{name}"] for name in ("fss1", "fss2"))
    stamps = [{stamp_ns(m.header.stamp) for m in messages} for messages in (first, second)]
    assert len(stamps[0] & stamps[1]) > 15
    errors = [np.array(planar_pose(m.pose)) for m in (first[-1], second[-1])]
    assert abs(errors[0] - (-1.0, 0.5, 0.0) - errors[1] + (1.0, -0.5, 1.0)).min() > 0.0
    topics_found = {topic for topic, _ in listener.get_topic_names_and_types()}
    assert not topics_found & {"/fog/imu", "/vicon/fss/fss", "/sim/truth"}


@pytest.fixture
def truths(spin):
    """truths(node, *names): the truth of each vehicle, once all are received."""

    def receive(node, *names):
        found, operator = {}, Node("person")
        for name in names:
            operator.create_subscription(
                SimTruth, f"/{name}/sim/truth", partial(found.__setitem__, name), sensor()
            )
        spin([node, operator], lambda: len(found) == len(names))
        return found

    return receive


def test_thrusters_and_faults_act_on_their_vehicle(spin, bed):
    node, operator, faults = bed(), Node("person"), {}
    thrust = operator.create_publisher(ThrusterCommand, "/fss2/thrusters/command", COMMAND)
    for name in ("fss1", "fss2"):
        operator.create_subscription(
            SimFaults, f"/{name}/sim/faults", lambda m, name=name: faults.update({name: m}), LATCHED
        )
    spin([node, operator], thrust.get_subscription_count)
    thrust.publish(ThrusterCommand(on_time=[0.5, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    one, two, _ = (vehicle.testbed.plant for vehicle in node.vehicles)
    spin([node, operator], lambda: two.thrusters.propellant_used > 0.0)
    assert one.thrusters.propellant_used == 0.0
    assert node.set_parameters([Parameter("fss2.link_1.loss", value=0.5)])[0].successful
    spin([node, operator], lambda: len(faults) == 2 and list(faults["fss2"].part) == ["link_1"])
    assert not faults["fss1"].part
    assert [v.testbed.faults.links[0].loss for v in node.vehicles[:2]] == [0.0, 0.5]


def test_vehicles_share_a_table_and_a_target(spin, bed, truths):
    pose = [-1.0, 1.5, 0.0]
    node = bed(target_mass=5.0, target_pose=pose, target_twist=[0.0, 0.0, 0.0])
    operator, target_poses = Node("person"), []
    operator.create_subscription(PoseStamped, "/vicon/target/target", target_poses.append, sensor())
    spin([node, operator], lambda: target_poses)
    found = truths(node, "fss1", "fss3")
    assert len({id(vehicle.testbed.bed) for vehicle in node.vehicles}) == 1
    np.testing.assert_allclose(planar_pose(target_poses[-1].pose), pose, atol=0.01)
    assert operator.count_publishers("/vicon/target/target") == 1
    other, alone = found["fss1"], found["fss3"]
    assert len(alone.q) == 3
    assert alone.pairs
    assert all("fss3 base" in pair for pair in alone.pairs)
    assert {"fss3 base, target", "target, fss3 base"} & set(alone.pairs)
    assert len(other.pairs) > len(alone.pairs)
    for message in found.values():
        assert message.target_present
        np.testing.assert_allclose(message.target, pose, atol=1e-6)
        assert message.clearance == min(message.gaps)
        assert len(message.gaps) == len(set(message.pairs)) == len(message.pairs)


def test_vehicles_share_a_vicon_and_a_radio_channel(bed, truths):
    node = bed(preset="laboratory", wifi=True, target_mass=5.0, target_pose=[-1.0, 1.5, 0.0])
    beds = [vehicle.testbed for vehicle in node.vehicles]
    assert len({id(one.vicon) for one in beds}) == len({id(one.radio_channel) for one in beds}) == 1
    found = truths(node, "fss1", "fss2", "fss3")
    marked = {name: message.markers.tolist() for name, message in found.items()}
    assert marked == {"fss1": [5, 4, 5], "fss2": [5, 4, 5], "fss3": [5, 0, 5]}
    assert 0.0 < node.health().values["airtime used"] < 1.0


def test_all_vehicles_resume_together_from_their_state_files(spin, bed, tmp_path):
    node = bed(state_file=str(tmp_path / "bed.json"))
    spin([node], lambda: node.testbed.frame > 50)
    node.close()
    frame = node.testbed.frame
    node.destroy_node()
    files = {path.name for path in tmp_path.glob("bed*.json")}
    assert files == {f"bed_fss{k}.json" for k in (1, 2, 3)}
    again = bed(state_file=str(tmp_path / "bed.json"))
    frames = [vehicle.testbed.frame for vehicle in again.vehicles]
    assert max(frames) - min(frames) <= 1  # they already run, started one after the other
    assert frames.pop() > frame
    again.close()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("fss1: {}", "vehicles is missing, expected the settings of each, by name"),
        ("vehicles: [fss1]", "vehicles is ['fss1'], expected"),
        ("vehicles: {2nd: {}}", "name is '2nd', expected letters, digits and _"),
        ("vehicles: {a: {sped: 1}}", "a is 'sped', expected some of "),
        ("vehicles: {a: {keep_clock: true}}", "a is 'keep_clock', expected some of"),
        ("vehicles: {a: {ports: 5001}}", "a: ports is 5001, expected a list"),
        ("vehicles: {a: {base: [0, 0]}}", "a: base has 2 numbers, expected 3"),
        ("vehicles: {a: {}, b: {base: [0.1, 0, 0]}}", "a and b start in the same place"),
        ("vehicles: {a: {}, a: {}}", "a is 'given twice'"),
    ],
)
def test_an_invalid_file_is_rejected_in_one_line(ros, bed, text, words):
    with pytest.raises(ValueError, match=re.escape(words)) as caught:
        bed(text)
    assert "\n" not in str(caught.value)


def test_vehicles_with_a_common_key_are_rejected(ros, bed, tmp_path):
    for name, first in (("a", "00"), ("b", "01"), ("c", "00")):
        (tmp_path / name).write_text("".join(f"{i} {first}{i:02}{28 * '7'}\n" for i in range(1, 5)))
        (tmp_path / name).chmod(0o600)
    text = VEHICLES.replace("0], base", f"0], keys: {tmp_path}/KEYS, base")
    apart = text.replace("KEYS", "a", 1).replace("KEYS", "b")
    node = bed(apart)
    assert [len(vehicle.keys) for vehicle in node.vehicles] == [4, 4, 0]
    node.close()
    with pytest.raises(ValueError, match="fss1 and fss2 have a key in common"):
        bed(text.replace("KEYS", "a", 1).replace("KEYS", "c"))


def test_the_example_is_a_valid_vehicles_file(monkeypatch):
    monkeypatch.chdir(ROOT)
    first = {"board_port": 5000, "ports": (5001, 5002, 5003, 5004)}
    each = read_vehicles(TestbedSettings(vehicles="config/two_vehicles.yaml", **first))
    assert list(each) == ["fss1", "fss2"]
    ports = [port for one in each.values() for port in (*one.ports, one.board_port)]
    assert len(set(ports)) == len(ports) == 10
    assert all(one.description().n == 4 for one in each.values())
