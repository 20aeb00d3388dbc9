"""The node `fog`: a gyro at the other end of a pseudo-terminal."""

import os
import pty
import tty
from math import radians

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import Imu

from fss_arm_ros.convert import stamp_ns
from fss_base_driver.fog_node import FogNode


@pytest.fixture
def gyro():
    """The gyro's end, and the device's name."""
    end, device = pty.openpty()
    tty.setraw(end)
    yield end, os.ttyname(device)
    for file in (end, device):
        os.close(file)


def test_rates_are_published_corrected_and_in_order(spin, gyro):
    end, device = gyro
    values = {"device": device, "gyro.scale": -1.0, "gyro.bias": 0.001}
    node = FogNode(parameter_overrides=[Parameter(k, value=v) for k, v in values.items()])
    user, heard, health = Node("user"), [], []
    user.create_subscription(Imu, "fog/imu", heard.append, 100)
    user.create_subscription(DiagnosticArray, "/diagnostics", health.append, 10)
    spin([node, user], lambda: health and node.imu.get_subscription_count())
    assert "the gyro is lost" in health[0].status[0].message
    os.write(end, b"56 1\r\n-5.729578 1\r\n1.000000 0\r\n\xff\xfe")
    os.write(end, b"\r\n-5.729578 1\r\n-5.729578 1\r\n")
    spin([node, user], lambda: len(heard) == 3)
    for imu in heard:
        assert imu.angular_velocity.z == pytest.approx(radians(5.729578) - 0.001)
        assert imu.header.frame_id == "fss"
    stamps = [stamp_ns(imu.header.stamp) for imu in heard]
    assert stamps == sorted(set(stamps))
    assert node.lines.counts == (3, 1, 1)
    spin([node, user], lambda: health[-1].status[0].level == DiagnosticStatus.WARN)


def test_a_port_that_cannot_be_opened_is_named(ros, tmp_path):
    with pytest.raises(OSError, match="No such file"):
        FogNode(parameter_overrides=[Parameter("device", value=str(tmp_path / "none"))])
