"""Selection, names and QoS of the topics that are played."""

import pytest
from rclpy.qos import DurabilityPolicy, HistoryPolicy, ReliabilityPolicy

from fss_arm_bags.reader import Topic
from fss_arm_bags.recorder import bag_qos
from fss_arm_bags.replay import choose_topics, playback_name, playback_qos
from fss_arm_ros.qos import LATCHED, SENSOR


@pytest.mark.parametrize(
    ("recorded", "msgtype", "played"),
    [
        ("/joint_states", "sensor_msgs/msg/JointState", "/joint_states"),
        ("/lab/vicon/fss/fss", "geometry_msgs/msg/PoseStamped", "/lab/vicon/fss/fss"),
        ("/link_1/telemetry", "fss_arm_msgs/msg/LinkTelemetry", "/link_1/telemetry"),
        ("/robot_description", "std_msgs/msg/String", "/robot_description"),
        ("/link_1/command", "fss_arm_msgs/msg/LinkCommand", None),
        ("/lab/link_1/command", "fss_arm_msgs/msg/LinkCommand", None),
        ("/thrusters/command", "std_msgs/msg/UInt8", None),
        ("/thrusters/anything", "sensor_msgs/msg/JointState", None),
        ("/thrusters/pulses", "fss_arm_msgs/msg/ThrusterCommand", "/thrusters/pulses"),
        ("/base/wrench", "geometry_msgs/msg/WrenchStamped", None),
        ("/base/trajectory", "trajectory_msgs/msg/MultiDOFJointTrajectory", None),
        ("/base/stop", "std_msgs/msg/Empty", None),
        ("/gripper/command", "std_msgs/msg/Bool", None),
        ("/arm/stop", "std_msgs/msg/Empty", None),
        ("/lab/arm/stop", "std_msgs/msg/Empty", None),
        ("/clock", "rosgraph_msgs/msg/Clock", None),
        ("/rosout", "rcl_interfaces/msg/Log", None),
        ("/parameter_events", "rcl_interfaces/msg/ParameterEvent", None),
        ("/events/write_split", "rosbag2_interfaces/msg/WriteSplitEvent", None),
        ("/calibration/kinematic", "fss_arm_msgs/msg/X", "recorded/calibration/kinematic"),
        ("/base/state", "nav_msgs/msg/Odometry", "recorded/base/state"),
        ("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", "recorded/diagnostics"),
    ],
)
def test_commands_are_not_played_and_results_are_renamed(recorded, msgtype, played):
    assert playback_name(recorded, msgtype) == played
    topics = {recorded: Topic(msgtype, 7, [], "", "")}
    assert choose_topics(topics) == ({recorded: played} if played else {})


def test_selected_topics_are_played_in_place_but_no_commands():
    topics = dict.fromkeys(["/calibration/kinematic", "/arm/stop", "/a"], Topic("", 7, [], "", ""))
    assert choose_topics(topics, ["calibration/kinematic"]) == {
        "/calibration/kinematic": "/calibration/kinematic"
    }
    with pytest.raises(ValueError, match="/arm/stop is a command"):
        choose_topics(topics, ["/a", "arm/stop"])
    with pytest.raises(ValueError, match="/b is not in the bags, which contain"):
        choose_topics(topics, ["/b"])


def test_volatile_topics_keep_all_and_latched_ones_keep_the_recorded():
    volatile = playback_qos(Topic("", 7, [bag_qos(SENSOR)], "", ""))
    assert volatile.history == HistoryPolicy.KEEP_ALL
    assert volatile.reliability == ReliabilityPolicy.RELIABLE
    latched = playback_qos(Topic("", 7, [bag_qos(LATCHED)], "", ""))
    assert latched.depth == 7
    assert latched.durability == DurabilityPolicy.TRANSIENT_LOCAL
