"""What is played back, and how."""

import pytest
from rclpy.qos import DurabilityPolicy, HistoryPolicy, ReliabilityPolicy

from fss_arm_ros.bags import Topic
from fss_arm_ros.qos import LATCHED, SENSOR
from fss_arm_ros.recording import bag_qos
from fss_arm_ros.replay_node import played_as, profile


@pytest.mark.parametrize(
    ("recorded", "played"),
    [
        ("/joint_states", "/joint_states"),
        ("/lab/vicon/fss/fss", "/lab/vicon/fss/fss"),
        ("/link_1/telemetry", "/link_1/telemetry"),
        ("/robot_description", "/robot_description"),
        ("/link_1/command", None),
        ("/lab/link_1/command", None),
        ("/thrusters/command", None),
        ("/thrusters/anything", None),
        ("/arm/stop", None),
        ("/lab/arm/stop", None),
        ("/clock", None),
        ("/rosout", None),
        ("/parameter_events", None),
        ("/calibration/kinematic", "recorded/calibration/kinematic"),
        ("/lab/calibration/observations", "recorded/lab/calibration/observations"),
        ("/diagnostics", "recorded/diagnostics"),
    ],
)
def test_nothing_that_moves_the_arm_is_played_and_verdicts_go_aside(recorded, played):
    assert played_as(recorded) == played


def test_volatile_topics_keep_all_and_latched_ones_hold_what_was_recorded():
    volatile = profile(Topic("", 7, [bag_qos(SENSOR)], ""))
    assert volatile.history == HistoryPolicy.KEEP_ALL
    assert volatile.reliability == ReliabilityPolicy.RELIABLE
    latched = profile(Topic("", 7, [bag_qos(LATCHED)], ""))
    assert latched.depth == 7
    assert latched.durability == DurabilityPolicy.TRANSIENT_LOCAL
