"""Conversions between messages and plain values, for rclpy's and rosbags' classes; dates."""

from math import nan, pi

import numpy as np
import pytest
from geometry_msgs.msg import Pose
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import JointState

from fss_arm_model.units import SECOND
from fss_arm_ros.convert import (
    PoseError,
    joint_readings,
    planar_pose,
    pose_stamped,
    stamp_ns,
    to_time,
)
from fss_arm_ros.dates import format_period, format_time


@given(st.integers(0, 2**31 * 10**9 - 1))
def test_times_survive_to_the_nanosecond(ns):
    assert stamp_ns(to_time(ns)) == ns


def test_data_have_a_date_unless_they_are_simulated():
    assert format_time(1_795_694_646 * SECOND) == "2026-11-26 12:04 UTC"
    assert format_time(312 * SECOND) == "312 s of simulated time"
    assert format_period(4 * SECOND, 312 * SECOND) == "4 to 312 s of simulated time"


def test_readings_are_told_by_their_joints_names():
    message = JointState(name=["joint_2", "gripper", "joint_10"], position=[0.1, 9.0, 0.2])
    message.velocity = [1.0]
    first, second = joint_readings(message)
    assert first[:3] == (2, 0.1, 1.0)
    assert second[:2] == (10, 0.2)
    assert np.isnan([first[3], *second[2:]]).all()
    assert list(joint_readings(JointState(position=[1.0]))) == []


def test_a_joint_of_thousands_of_digits_is_another_arms():
    """It ended nodes: int() takes no more than 4300."""
    message = JointState(name=["joint_" + 5000 * "1", "joint_" + 5000 * "0" + "2"])
    message.position = [0.1, 0.2]
    assert [i for i, *_ in joint_readings(message)] == [111_111_111, 0]


@given(st.floats(-4, 4), st.floats(-4, 4), st.floats(-pi, pi, exclude_min=True))
def test_a_planar_pose_survives(x, y, heading):
    got = planar_pose(pose_stamped(0, "world", (x, y, heading)).pose)
    assert got == (x, y, pytest.approx(heading, abs=1e-15))


def test_a_pose_of_rosbags_reads_the_same():
    store = get_typestore(Stores.ROS2_JAZZY)
    message = pose_stamped(12_345_678_901, "world", (0.1, -0.2, 2.0), z=0.3)
    read = store.deserialize_cdr(serialize_message(message), "geometry_msgs/msg/PoseStamped")
    assert planar_pose(read.pose) == planar_pose(message.pose)
    assert stamp_ns(read.header.stamp) == 12_345_678_901


def test_a_tilt_does_not_disturb_the_heading():
    pose = Pose()
    pose.orientation.x, pose.orientation.w = 0.6, 0.8  # rolled about the x axis, which stays
    assert planar_pose(pose)[2] == 0.0


@pytest.mark.parametrize(
    ("field", "value", "said"),
    [
        ("orientation", (0.0, 0.0, 0.0, 0.0), "occluded"),
        ("orientation", (0.0, 0.0, nan, 1.0), "finite"),
        ("position", (nan, 0.0, 0.0), "finite"),
    ],
)
def test_poses_that_say_nothing_are_refused(field, value, said):
    pose = Pose()
    for axis, number in zip("xyzw", value, strict=False):
        setattr(getattr(pose, field), axis, number)
    with pytest.raises(PoseError, match=said):
        planar_pose(pose)
