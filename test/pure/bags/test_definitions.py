"""Definitions from the installed .msg files."""

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from fss_arm_bags.definitions import NotInstalledError, definition, message_class

JAZZY = get_typestore(Stores.ROS2_JAZZY)


@pytest.mark.parametrize(
    "msgtype",
    [
        "sensor_msgs/msg/JointState",
        "sensor_msgs/msg/Imu",
        "geometry_msgs/msg/PoseStamped",
        "diagnostic_msgs/msg/DiagnosticArray",
        "nav_msgs/msg/OccupancyGrid",
        "visualization_msgs/msg/MarkerArray",
        "rcl_interfaces/msg/ParameterEvent",
        "std_msgs/msg/Empty",
    ],
)
def test_hash_equals_the_one_of_the_distribution(msgtype):
    assert definition(msgtype).hash == JAZZY.hash_rihs01(msgtype)


def test_the_text_has_comments_and_all_nested_types():
    text = definition("fss_arm_msgs/msg/KinematicObservations").text
    assert "# All rests since the last reset" in text
    assert "MSG: fss_arm_msgs/KinematicObservation\n" in text
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(text, "fss_arm_msgs/msg/KinematicObservations"))
    assert "builtin_interfaces/msg/Time" in store.fielddefs


@pytest.mark.parametrize("msgtype", ["no_such_msgs/msg/A", "std_msgs/msg/NoSuch"])
def test_missing_types_are_named(msgtype):
    with pytest.raises(NotInstalledError, match=msgtype):
        definition(msgtype)
    with pytest.raises(NotInstalledError, match=msgtype):
        message_class(msgtype)
