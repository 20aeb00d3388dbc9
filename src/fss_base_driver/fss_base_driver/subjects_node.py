"""Implementation of the command `subjects`."""

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import degrees
from typing import Any

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped
from rclpy.exceptions import NameValidationException
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.validate_topic_name import validate_topic_name
from rich.console import Console
from rich.markup import escape
from rich.table import Column, Table

from fss_arm_model.planar import mean_pose, wrap
from fss_arm_model.settings import POSITIVE
from fss_arm_ros.command_line import interrupt_at_end
from fss_arm_ros.convert import SECOND, seen_pose, stamp_ns
from fss_arm_ros.qos import subscribe_sensor
from fss_arm_ros.run import spin_once
from fss_base_driver.subjects_options import parser

COLUMNS = ("rate", "jitter", "latency", "longest gap", "x", "y", "heading", "unusable")
UNITS = ("[1/s]", "[ms]", "p50, p99 [ms]", "[ms]", "[m]", "[m]", "[deg]", "")


@dataclass
class SubjectLog:
    """Messages received of one subject."""

    stamps: list[int] = field(default_factory=list)  # [ns]
    arrivals: list[int] = field(default_factory=list)  # [ns]
    poses: list[tuple[float, float, float]] = field(default_factory=list)
    unusable: int = 0  # occluded or not finite

    def add(self, message: Any) -> None:
        """Record a message."""
        self.arrivals.append(time.time_ns())
        self.stamps.append(stamp_ns(message.header.stamp))
        if pose := seen_pose(message):
            self.poses.append(pose)
        else:
            self.unusable += 1

    def row(self) -> list[str]:
        """Return the cells of COLUMNS."""
        stamps, arrivals = np.array(self.stamps, float), np.array(self.arrivals, float)
        late = np.percentile((arrivals - stamps) / SECOND * 1e3, (50, 99))
        between = np.diff(stamps) / SECOND
        cells = ["-", "-", f"{late[0]:.1f}, {late[1]:.1f}", "-"]
        if between.size > 1 and between.mean() > 0.0:
            typical = np.median(between)
            cells[0], cells[1] = f"{1.0 / between.mean():.1f}", f"{between.std() * 1e3:.2f}"
            cells[3] = f"{between.max() * 1e3:.1f}"
            if between.max() > 1.5 * typical:
                cells[3] += f" ({(between > 1.5 * typical).sum()} over {1.5e3 * typical:.1f})"
        if not self.poses:
            return [*cells, "-", "-", "-", str(self.unusable)]
        x, y, heading = mean_pose(np.array(self.poses))
        turned = degrees(wrap(heading))
        return [*cells, f"{x:.4f}", f"{y:.4f}", f"{turned:.2f}", str(self.unusable)]


class Listener(Node):
    """Node that subscribes to all topics of poses under a prefix."""

    def __init__(self, prefix: str) -> None:
        super().__init__("subjects", enable_rosout=False, start_parameter_services=False)
        self.prefix = self.resolve_topic_name(prefix) + "/"
        self.subjects: dict[str, SubjectLog] = {}
        self.create_timer(0.2, self.subscribe_to_new_topics)

    def subscribe_to_new_topics(self) -> None:
        """Subscribe to new topics."""
        for topic, kinds in self.get_topic_names_and_types():
            pose = "geometry_msgs/msg/PoseStamped" in kinds and topic.startswith(self.prefix)
            if pose and topic not in self.subjects:
                self.subjects[topic] = SubjectLog()
                subscribe_sensor(self, PoseStamped, topic, self.subjects[topic].add)


def table(subjects: dict[str, SubjectLog]) -> Table:
    """Return the received subjects as a table."""
    headings = (escape(f"{name}\n{unit}") for name, unit in zip(COLUMNS, UNITS, strict=True))
    shown = Table(Column("topic", overflow="fold"), *headings, box=None)
    for topic, subject in sorted(subjects.items()):
        shown.add_row(topic, *(subject.row() if subject.stamps else ["silent"]))
    return shown


def main(args: Sequence[str] | None = None) -> int:
    """Run as `ros2 run fss_base_driver subjects`."""
    command = parser()
    given = command.parse_args(args)
    if not POSITIVE.holds(given.seconds):
        command.error(f"--seconds is {given.seconds}, expected {POSITIVE.expected}")
    try:
        validate_topic_name(given.prefix)
    except NameValidationException:
        command.error(f"--prefix is {given.prefix!r}, expected the first part of a topic's name")
    return listen(given)


def listen(given: argparse.Namespace) -> int:
    """Receive for a while, and print the table."""
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    interrupt_at_end()
    try:
        node = Listener(given.prefix)
        until = time.monotonic() + given.seconds
        while (left := until - time.monotonic()) > 0.0:
            spin_once(node, min(left, 0.1))
        domain, prefix, subjects = node.context.get_domain_id(), node.prefix, node.subjects
    except KeyboardInterrupt:
        return 130
    finally:
        rclpy.try_shutdown()
    if not any(subject.stamps for subject in subjects.values()):
        problem = f"no pose on {prefix}... in ROS domain {domain}; does a receiver run, as mocap?"
        print(f"subjects: {problem}", file=sys.stderr)
        return 1
    Console().print(table(subjects))
    return 0


if __name__ == "__main__":
    sys.exit(main())
