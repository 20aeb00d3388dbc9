"""The test bed as a node: topics at their rate and stamps, links on UDP, time kept on request."""

import socket

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu

from fss_arm_driver.protocol import Command, Mode, Telemetry, decode, encode
from fss_arm_ros.convert import planar_pose, stamp_ns
from fss_arm_ros.qos import sensor
from fss_sim import testbed_node

QUIET = Command(
    link=1, flags=0, boot=0, sequence=0, clock=1, expiry=0, mode=Mode.OFF, watchdog=2000,
    set_point=0, velocity=0, acceleration=0,
)  # fmt: skip


def testbed(**settings):
    settings = {"ports": [0, 0, 0, 0], **settings}
    return testbed_node.TestbedNode(
        parameter_overrides=[Parameter(k, value=v) for k, v in settings.items()]
    )


testbed.__test__ = False


@pytest.fixture
def ears(ros):
    node = Node("ears")
    node.heard = {"base": [], "tip": [], "imu": [], "clock": []}
    for name, kind, topic in (
        ("base", PoseStamped, "vicon/fss/fss"),
        ("tip", PoseStamped, "vicon/end_effector/end_effector"),
        ("imu", Imu, "fog/imu"),
        ("clock", Clock, "/clock"),
    ):
        node.create_subscription(kind, topic, node.heard[name].append, sensor())
    return node


def test_vicon_and_gyro_come_at_100_hz_evenly_stamped(spin, ears):
    bed = testbed(base=[0.5, -0.5, 1.0])
    spin([bed, ears], lambda: len(ears.heard["imu"]) >= 100)
    for name in ("base", "tip", "imu"):
        stamps = np.array([stamp_ns(m.header.stamp) for m in ears.heard[name]])
        assert set(np.diff(stamps)) == {10_000_000}
    assert abs(stamps[-1] - bed.get_clock().now().nanoseconds) < 1_000_000_000
    np.testing.assert_allclose(
        planar_pose(ears.heard["base"][-1].pose), (0.5, -0.5, 1.0), atol=0.01
    )
    imu = ears.heard["imu"][-1]
    assert imu.orientation_covariance[0] == imu.linear_acceleration_covariance[0] == -1.0
    assert imu.angular_velocity_covariance[8] > 0.0


def test_time_kept_goes_as_fast_as_asked_and_never_begins_at_zero(spin, ears):
    bed = testbed(keep_clock=True, speed=10.0)
    begin = bed.get_clock().now().nanoseconds
    spin([bed, ears], lambda: len(ears.heard["clock"]) >= 500)
    took = bed.get_clock().now().nanoseconds - begin
    clocks = [stamp_ns(m.clock) for m in ears.heard["clock"]]
    assert clocks[0] > 1_000_000_000
    steps = np.diff(clocks)  # who is late gets the newest
    assert (steps > 0).all()
    assert (steps % 10_000_000 == 0).all()
    assert clocks[-1] - clocks[0] > 1.5 * took  # of 10, on a machine with other things to do


def test_a_link_answers_who_sends_it_a_good_command(spin, ears):
    bed = testbed()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as host:
        host.bind(("127.0.0.1", 0))
        host.setblocking(False)
        host.sendto(b"noise", ("127.0.0.1", bed.sockets[0].port))
        host.sendto(encode(QUIET), ("127.0.0.1", bed.sockets[0].port))

        def answer():
            try:
                return decode(host.recv(100))
            except BlockingIOError:
                return None

        frame = spin([bed], answer)
    assert isinstance(frame, Telemetry)
    assert (frame.link, frame.boot, frame.echo) == (1, 1, 1)


def test_it_goes_on_from_its_state_file(spin, ears, tmp_path):
    path = str(tmp_path / "state.json")
    first = testbed(state_file=path, keep_clock=True, q=[0.1, 0.2, 0.3, 0.4])
    spin([first, ears], lambda: len(ears.heard["clock"]) >= 30)
    first.save()
    last = stamp_ns(ears.heard["clock"][-1].clock)
    second = testbed(state_file=path, keep_clock=True)
    assert second.testbed.links[0].gate.boot == 2
    np.testing.assert_allclose(second.testbed.plant.q[3:], [0.1, 0.2, 0.3, 0.4], atol=1e-6)
    assert second.stamp() > last
    second.close()
    second.destroy_node()


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"preset": "none"}, "preset is 'none'"),
        ({"speed": 5.0}, "without keep_clock"),
        ({"ports": [0, 0]}, "expected 4"),
        ({"q": [0.0]}, "expected 4"),
        ({"seed": -1}, "seed is -1"),
    ],
)
def test_impossible_settings_are_refused(ros, settings, words):
    with pytest.raises(ValueError, match=words):
        testbed(**settings)


def test_a_port_in_use_is_named(ros):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        port = other.getsockname()[1]
        with pytest.raises(OSError, match=f"UDP port {port} of 127.0.0.1"):
            testbed(ports=[port, 0, 0, 0])
