"""Serialized messages: equal to messages that are created and serialized each time."""

from geometry_msgs.msg import PoseStamped
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu

from fss_arm_ros.convert import pose_stamped, to_time
from fss_sim.messages import SerializedClock, SerializedGyro, SerializedPose
from fss_sim.sensors import SubjectReading

STAMP = 1_700_000_000_123_456_789


def test_a_pose_equals_the_converted_one_for_any_frame_id():
    for frame_id in ("", "w", "world", "a_longer_name_of_the_world"):
        message = SerializedPose(frame_id)
        for pose in ((1.5, -2.5, 3.0), (0.0, 1e-9, -0.1)):
            got = deserialize_message(message.serialize(STAMP, SubjectReading(pose)), PoseStamped)
            assert got == pose_stamped(STAMP, frame_id, pose)


def test_an_occluded_subject_is_all_zero_and_the_next_pose_is_complete():
    message = SerializedPose("world")
    got = deserialize_message(
        message.serialize(STAMP, SubjectReading((1.0, 2.0, 3.0), occluded=True)), PoseStamped
    )
    expected = PoseStamped()
    expected.header.stamp, expected.header.frame_id = to_time(STAMP), "world"
    expected.pose.orientation.w = 0.0
    assert got == expected
    got = deserialize_message(
        message.serialize(STAMP, SubjectReading((1.0, 2.0, 3.0))), PoseStamped
    )
    assert got == pose_stamped(STAMP, "world", (1.0, 2.0, 3.0))


def test_the_gyro_message_has_its_rate_and_marks_unmeasured_fields():
    got = deserialize_message(SerializedGyro("fss", 0.01).serialize(STAMP, -0.25), Imu)
    expected = Imu()
    expected.header.stamp, expected.header.frame_id = to_time(STAMP), "fss"
    expected.orientation_covariance[0] = expected.linear_acceleration_covariance[0] = -1.0
    expected.angular_velocity.z, expected.angular_velocity_covariance[8] = -0.25, 0.01**2
    assert repr(got) == repr(expected)  # == is ambiguous for arrays


def test_the_clock_is_exact():
    assert deserialize_message(SerializedClock().serialize(STAMP), Clock) == Clock(
        clock=to_time(STAMP)
    )
