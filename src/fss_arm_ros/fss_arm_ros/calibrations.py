"""Subscription to the results of calibrations."""

from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.node import Node

from fss_arm_msgs.msg import DynamicCalibration, KinematicCalibration
from fss_arm_ros.qos import LATCHED
from fss_arm_ros.validation import subscribe

CALIBRATIONS = {
    "calibration/kinematic": KinematicCalibration,
    "calibration/dynamic": DynamicCalibration,
}


def subscribe_calibrations(node: Node, callback: Callable[[str, Any], None]) -> None:
    """Call a function with topic and message of each kinematic or dynamic calibration."""
    for topic, kind in CALIBRATIONS.items():
        subscribe(node, kind, topic, partial(callback, topic), LATCHED)
