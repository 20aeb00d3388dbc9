"""The mocap node: against a server of a real protocol, the library's mock, and other receivers."""

import struct
import subprocess
import sys
import time
from functools import partial
from math import cos, sin
from socket import AF_INET, SOCK_DGRAM, socket
from subprocess import PIPE
from threading import Event, Thread
from types import SimpleNamespace

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, TransformStamped
from natnet import NatNetServer
from rclpy.node import Node
from rclpy.parameter import Parameter
from running import wait_until
from std_msgs.msg import Empty
from std_srvs.srv import Trigger

from fss_arm_ros.convert import SECOND, stamp_ns, to_time
from fss_arm_ros.qos import SENSOR, subscribe_sensor
from fss_base_driver import subjects_node
from fss_base_driver.mocap import Receiver
from fss_base_driver.mocap import receiver as receiver_module
from fss_base_driver.mocap_node import MocapNode

NAMES = ["fss", "end_effector"]


def mocap(**values):
    overrides = [Parameter(name, value=value) for name, value in values.items()]
    return MocapNode(parameter_overrides=overrides)


def pose(k, x=0.0):
    """Slowly along y; single precision, as the protocol has it."""
    heading = 2e-3 * k
    values = x, 1e-3 * k, 0.05, 0.0, 0.0, sin(0.5 * heading), cos(0.5 * heading)
    return tuple(map(float, np.array(values, np.float32)))


def numbers(message):
    at, turn = message.pose.position, message.pose.orientation
    return at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w


class User(Node):
    def __init__(self):
        super().__init__("user")
        self.heard = {name: [] for name in NAMES}
        for name in NAMES:
            subscribe_sensor(self, PoseStamped, f"vicon/{name}/{name}", self.heard[name].append)


def served_node(server, **values):
    return mocap(system="optitrack", host="127.0.0.1", options=server.options, **values)


@pytest.fixture
def served(spin):
    """A server, the node that receives from it, and a user of both subjects."""
    server, user = NatNetServer(NAMES), User()
    node = served_node(server, timeout=0.5)
    nodes = node, user
    spin(nodes, lambda: server.clients, 30.0)

    def has_poses():  # until the first poses come through
        server.send({name: pose(-1, x) for x, name in enumerate(NAMES)})
        return all(user.heard.values())

    spin(nodes, has_poses, 20.0)
    for heard in user.heard.values():
        heard.clear()
    yield server, node, user, nodes
    server.close()


def test_poses_are_those_that_the_server_sent(spin, served):
    server, _, user, nodes = served
    for k in range(20):
        sent, before = {"fss": pose(k), "end_effector": pose(k, 1.0)}, time.time_ns()
        server.send(sent)
        spin(nodes, lambda k=k: all(len(heard) == k + 1 for heard in user.heard.values()))
        for name, heard in user.heard.items():
            assert numbers(heard[k]) == sent[name]
            assert heard[k].header.frame_id == "world"
            assert before <= stamp_ns(heard[k].header.stamp) <= time.time_ns()


def test_occluded_and_swapped_subjects_are_not_published_and_named(spin, served):
    server, node, user, nodes = served
    server.send({"end_effector": pose(0, 1.0)})
    spin(nodes, lambda: user.heard["end_effector"])
    for k in range(1, 4):
        server.send({"fss": pose(k, 1.0), "end_effector": pose(k)})
    spin(nodes, lambda: "swapped" in node.health().message)
    assert not user.heard["fss"]
    assert len(user.heard["end_effector"]) == 1

    accept = user.create_client(Trigger, "mocap/accept")
    spin(nodes, accept.service_is_ready)
    answer = accept.call_async(Trigger.Request())
    spin(nodes, answer.done)
    assert answer.result().message == "accepted again: end_effector, fss"
    server.send({"fss": pose(5, 1.0)})
    spin(nodes, lambda: user.heard["fss"])


def test_a_datagram_that_kills_the_library_kills_not_the_node(spin, served):
    server, node, user, nodes = served
    first = node.receiver.process
    # 2 billion marker sets: the library believes it, and reads beyond what it has.
    server.send_raw(struct.pack("<HHii", 7, 0xFFFF, 1, 0x7FFFFFF0))
    spin(nodes, lambda: first.poll() is not None and "SIGSEGV" in node.health().message)
    spin(nodes, lambda: server.clients == 2, 30.0)

    def again():
        server.send({"fss": pose(time.monotonic_ns() % 100)})
        return user.heard["fss"]

    spin(nodes, again, 20.0)
    spin(nodes, lambda: "SIGSEGV" not in node.health().message)


def test_a_subject_whose_name_makes_no_topic_is_named_and_the_others_are_published(spin):
    """Motive names an unnamed body `Rigid Body 1`."""
    server, user, k = NatNetServer(["fss", "Rigid Body 1"]), User(), 0
    node = served_node(server)

    def send():
        nonlocal k
        k += 1
        server.send({"fss": pose(k), "Rigid Body 1": pose(k, 1.0)})

    spin([node, user], lambda: send() or len(user.heard["fss"]) > 3, 30.0)
    spin([node, user], lambda: send() or node.health().message.startswith("'Rigid Body 1' is no "))
    assert node.health().level == DiagnosticStatus.WARN
    server.close()


def test_a_host_that_does_not_answer_is_told_at_once_and_left_at_once(start):
    with socket(AF_INET, SOCK_DGRAM) as deaf:
        deaf.bind(("127.0.0.1", 0))
        options = f"options:=['port_command={deaf.getsockname()[1]}']"
        given = ("system:=optitrack", "host:=127.0.0.1", options)
        node = start(
            "fss_base_driver.mocap_node", "--ros-args", *(w for g in given for w in ("-p", g))
        )
        said = "waiting for optitrack at 127.0.0.1"
        told = f"{said}: it does not answer"
        wait_until(lambda: told in node.output, 30.0, partial(time.sleep, 0.05))
        assert node.output.count(said) == 2  # at the start, and after the timeout
        assert node.stop(timeout=3.0) == 0


def test_a_receiver_that_is_closed_as_its_process_begins_ends(monkeypatch):
    begun, closing = Event(), Event()

    def popen(*args, **options):
        process = subprocess.Popen([sys.executable, "-c", "input()"], stdin=PIPE, **options)
        begun.set()
        assert closing.wait(10.0)
        return process

    monkeypatch.setattr(receiver_module, "subprocess", SimpleNamespace(Popen=popen, PIPE=PIPE))
    receiver = Receiver("mock", [], lambda *_: None, lambda _: None)
    assert begun.wait(10.0)
    monkeypatch.setattr(receiver, "join", lambda: closing.set() or Thread.join(receiver, 10.0))
    receiver.close()
    assert not receiver.is_alive()


def test_the_librarys_mock_and_only_the_subjects_asked_for(spin):
    user = User()
    bodies = "rigid_bodies=fss(1,2,0,1,0,0,0);other(0,0,0,1,0,0,0)"
    node = mocap(system="mock", options=[bodies], subjects=["fss", "tip"], latency=0.005)
    spin([node, user], lambda: user.heard["fss"], 30.0)
    assert numbers(user.heard["fss"][0]) == (1.0, 2.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    frames = node.reception.frames
    spin([node, user], lambda: node.reception.frames > frames + 20)
    assert len(user.heard["fss"]) == 1  # it never moves, as if occluded
    assert node.poses.keys() == {"fss", "tip"}
    spin(node, lambda: "tip was not seen yet" in node.health().message)
    assert node.health().level == DiagnosticStatus.WARN


def test_other_receivers_are_relayed_with_their_stamps(spin):
    user = User()
    node = mocap(relays=["fss=/vrpn_mocap/fss/pose", "end_effector=/tip"], relay_scale=0.001)
    poses = user.create_publisher(PoseStamped, "/vrpn_mocap/fss/pose", SENSOR)
    tips = user.create_publisher(TransformStamped, "/tip", SENSOR)
    spin([node, user], lambda: poses.get_subscription_count() and tips.get_subscription_count())
    stamp = to_time(1_700_000_000 * SECOND + 5)
    message, tip = PoseStamped(), TransformStamped()
    message.header.stamp = tip.header.stamp = stamp
    message.pose.position.x, message.pose.orientation.w = 1500.0, 1.0
    tip.transform.translation.y, tip.transform.rotation.w = -250.0, 1.0
    poses.publish(message)
    tips.publish(tip)
    spin([node, user], lambda: all(user.heard.values()))
    assert numbers(user.heard["fss"][0]) == (1.5, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    assert numbers(user.heard["end_effector"][0])[1] == -0.25
    assert user.heard["fss"][0].header.stamp == stamp


def test_relayed_poses_do_not_hide_a_system_that_is_down(ros, capfd):
    options = ["rigid_bodies=fss(0,0,0,1,0,0,0)"]
    node = mocap(system="mock", options=options, relays=["tip=/tip"], timeout=3600.0)
    wait_until(lambda: node.reception.frames, 30.0, partial(time.sleep, 0.05))
    node.receiver.close()
    frames, tip = node.reception.frames, PoseStamped()
    tip.pose.orientation.w = 1.0
    for _ in range(3):  # the process restarts and fails
        node.on_end("the receiver ended")
        node.on_message(node.relays[0], tip)
    assert node.health().level == DiagnosticStatus.ERROR
    assert node.health().message.startswith("the receiver ended (")
    assert node.reception.frames == frames
    assert node.subjects.subjects["tip"].counts["unchanged"] == 2
    assert capfd.readouterr().err.count("the receiver ended") == 1
    node.destroy_node()


def test_what_is_to_be_relayed_and_does_not_come_is_named(spin):
    node, user = mocap(relays=["fss=/a", "/b"]), User()
    spin([node, user], lambda: node.health().level == DiagnosticStatus.ERROR)
    wanted = "waiting for /a: it has no publisher; /b: it has no publisher ("
    assert node.health().message.startswith(wanted)
    strange = user.create_publisher(Empty, "/b", SENSOR)
    is_none = "/b: std_msgs/msg/Empty contains no poses, expected one of geometry_msgs/msg/PoseSta"
    spin([node, user], lambda: is_none in node.health().message)
    user.destroy_publisher(strange)
    spin([node, user], lambda: user.count_publishers("/b") == 0)
    tips = user.create_publisher(TransformStamped, "/b", SENSOR)
    spin([node, user], tips.get_subscription_count)
    tip = TransformStamped(child_frame_id="end_effector")
    tip.transform.rotation.w = 1.0
    tips.publish(tip)
    spin([node, user], lambda: user.heard["end_effector"])
    assert "/b" not in node.health().message


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({}, "no source of poses: set system"),
        ({"system": "viconn"}, "system is 'viconn', expected one of"),
        ({"system": "vicon"}, "host is '', expected the address of the vicon computer"),
        ({"system": "mock", "options": ["x"]}, "options holds 'x', expected OPTION=VALUE"),
        ({"system": "mock", "subjects": ["fss=a b"]}, "subjects: 'vicon/a b' is no valid"),
        ({"system": "mock", "latency": 1e11}, "latency is .*, expected 0 to 10"),
        ({"relays": ["fss=a b"]}, "relays: 'a b' is no valid topic name"),
    ],
)
def test_wrong_settings_are_named(ros, given, expected):
    with pytest.raises(ValueError, match=expected):
        mocap(**given)


def test_the_command_shows_what_is_seen(ros, spin, start):
    user, k = Node("user"), 0
    poses = user.create_publisher(PoseStamped, "vicon/fss/fss", SENSOR)
    command = start("fss_base_driver.subjects_node:main", "--seconds", "1", COLUMNS="120")

    def publish():
        nonlocal k
        k += 1
        message = PoseStamped()
        message.header.stamp = user.get_clock().now().to_msg()
        message.pose.position.x, message.pose.orientation.w = 0.5, float(k % 4 > 0)
        poses.publish(message)
        return command.process.poll() is not None

    spin(user, publish, 60.0)
    row = next(line for line in command.output.splitlines() if "vicon/fss/fss" in line)
    assert command.wait() == 0
    assert " 0.5000 " in row
    assert int(row.split()[-1]) > 0  # of the zero quaternions


def test_the_command_says_that_nothing_is_seen(domain, start):
    command = start("fss_base_driver.subjects_node:main", "--seconds", "0.5")
    assert command.wait() == 1
    problem = f"no pose on /vicon/... in ROS domain {domain}; does a receiver run, as mocap?"
    assert command.output == f"subjects: {problem}\n"


def test_the_command_is_ended_without_a_traceback(ros, spin, start):
    user = Node("user")
    poses = user.create_publisher(PoseStamped, "vicon/fss/fss", SENSOR)
    command = start("fss_base_driver.subjects_node:main", "--seconds", "600")
    spin(user, poses.get_subscription_count, 30.0)
    assert command.stop(timeout=5.0) == 130
    assert command.output == ""


def test_a_prefix_that_cannot_be_is_named(capsys):
    with pytest.raises(SystemExit) as end:
        subjects_node.main(["--prefix", "a b"])
    assert end.value.code == 1
    assert capsys.readouterr().err.startswith("subjects: --prefix is 'a b', expected ")
