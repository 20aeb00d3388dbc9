"""The node `fog`: a gyro at the other end of a pseudo-terminal."""

import functools
import os
import pty
import time
import tty
from math import radians
from threading import Event

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import Imu

from fss_arm_ros.convert import SECOND, stamp_ns
from fss_arm_ros.rclpy_compat import RCLError
from fss_base_driver.fog_node import MAX_PAUSE, TIMEOUT, FogNode
from fss_link.host_clock import HostClock


@pytest.fixture
def gyro():
    """The gyro's end, and the device's name."""
    end, device = pty.openpty()
    tty.setraw(end)
    yield end, os.ttyname(device)
    for file in (end, device):
        os.close(file)


def fog(device, clock=None, **gyro):
    values = {"device": str(device), **{f"gyro.{name}": value for name, value in gyro.items()}}
    return FogNode(clock, parameter_overrides=[Parameter(k, value=v) for k, v in values.items()])


class User(Node):
    """Receives the rates and the diagnostics."""

    def __init__(self):
        super().__init__("user")
        self.rates, self.health = [], []
        self.create_subscription(Imu, "fog/imu", self.rates.append, 100)
        self.create_subscription(DiagnosticArray, "/diagnostics", self.health.append, 10)


def test_rates_are_published_corrected_and_in_order(spin, gyro):
    end, device = gyro
    node, user = fog(device, scale=-1.0, bias=0.001), User()
    heard, health = user.rates, user.health
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
    with pytest.raises(ValueError, match=r"device '.*none' cannot be opened: No such file"):
        fog(tmp_path / "none")


def test_what_is_no_line_of_the_gyro_is_said(spin, gyro):
    end, device = gyro
    node = fog(device)
    spin(node, lambda: node.health().message == "the gyro is lost: nothing received yet")
    os.write(end, b"\x00\xfe garbage\r\n" * 3)
    words = "the gyro is lost: the received bytes are no rates: "
    spin(node, lambda: node.health().message.startswith(words))


@pytest.mark.parametrize("step", [-3600, 3600])
def test_a_clock_that_is_set_shows_in_the_stamps_and_nowhere_else(spin, gyro, step):
    end, device = gyro
    day = [0]  # what was added to the time of day [ns]
    clock = HostClock(day=lambda: time.time_ns() + day[0])
    node, user = fog(device, clock), User()
    spin([node, user], node.imu.get_subscription_count)
    for count in (1, 2):
        os.write(end, b"\r\n0.500000 1\r\n")
        spin([node, user], lambda count=count: len(user.rates) == count)
        day[0] = step * SECOND
    first, second = (stamp_ns(imu.header.stamp) for imu in user.rates)
    assert second - first == pytest.approx(step * SECOND, abs=30 * SECOND)  # a slow computer


def test_a_gyro_that_is_plugged_in_again_is_heard_without_a_warning(spin, gyro, tmp_path):
    end, device = gyro
    link = tmp_path / "gyro"
    link.symlink_to(device)
    node = fog(link)
    write = functools.partial(os.write, end, b"0.500000 1\r\n0.500000 1\r\n")
    spin(node, lambda: write() and node.lines.counts.rates > 3)
    node.health()
    other, again = pty.openpty()
    tty.setraw(other)
    link.unlink()
    link.symlink_to(os.ttyname(again))
    before = node.port
    node.received.clear()
    node.close_port()  # as reading it fails
    spin(node, lambda: node.port not in (None, before))
    reopened = "the gyro is lost: nothing received since the port was reopened"
    spin(node, lambda: node.health().message == reopened)
    write = functools.partial(os.write, other, b"0.500000 1\r\n0.500000 1\r\n")
    rates = node.lines.counts.rates
    spin(node, lambda: write() and node.lines.counts.rates > rates)
    assert node.health().level == DiagnosticStatus.OK
    for file in (other, again):
        os.close(file)


def test_a_silent_gyro_is_lost_and_one_asked_twice_is_not(spin, gyro):
    end, device = gyro
    node = fog(device)
    os.write(end, b"\r\n0.500000 1\r\n")
    spin(node, lambda: node.lines.counts.rates)
    received = node.received["rates"]
    assert [node.health().level for _ in range(2)] == 2 * [DiagnosticStatus.OK]
    spin(node, lambda: node.health().message == "the gyro is lost: silent")
    assert time.monotonic() - received > TIMEOUT


def test_bytes_without_lines_are_named_as_another_format(spin, gyro):
    end, device = gyro
    node = fog(device)
    words = "the gyro is lost: the received bytes are no rates: "
    write = functools.partial(os.write, end, bytes(range(64, 80)))
    spin(node, lambda: write() and node.health().message.startswith(words))


def test_an_invalid_line_has_its_time_among_the_others(ros, gyro):
    node, published = fog(gyro[1], HostClock(lambda: SECOND, lambda: SECOND)), []
    node.imu.publish = published.append
    node.process_bytes(b"\r\n0.500000 1\r\n0.500000 0\r\nx\r\n0.500000 1\r\n", SECOND)
    first, second = (stamp_ns(imu.header.stamp) for imu in published)
    assert second - first == 3 * SECOND // 100
    node.close()
    node.destroy_node()


def test_rates_received_during_a_pause_are_dropped_and_counted(spin, gyro):
    end, device = gyro
    runs, pause = Event(), [0]  # whether the process runs, and for how long it did not [ns]
    runs.set()

    def now():
        assert runs.wait(10.0)
        return time.monotonic_ns() + pause[0]

    node = fog(device, HostClock(now))
    os.write(end, b"\r\n0.500000 1\r\n")
    spin(node, lambda: node.lines.counts.rates == 1)
    runs.clear()
    os.write(end, 100 * b"0.500000 1\r\n")
    pause[0] = round(1.1 * MAX_PAUSE * SECOND)
    runs.set()
    spin(node, lambda: node.health().values["pauses"] == 1)
    os.write(end, b"\r\n0.500000 1\r\n")
    spin(node, lambda: node.lines.counts.rates == 2)


def test_an_error_of_the_thread_ends_the_node(spin, gyro, monkeypatch):
    end, device = gyro
    node = fog(device)

    def fail(_):
        raise RCLError("no memory")

    monkeypatch.setattr(node.imu, "publish", fail)
    os.write(end, b"\r\n0.500000 1\r\n")
    node.thread.join(10.0)
    with pytest.raises(RCLError, match="no memory"):
        node.health()
