"""The arm of a node's parameter `arm`, compared with the arm that runs.

The node `arm` defines the arm of a vehicle: it publishes `robot_description`. Another node whose
description has another number of joints would plan, predict or wait for joints that do not exist,
so it ends with one line. The first description decides: a node that has started stays.
"""

import re
from collections import Counter
from collections.abc import Iterable

from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from fss_arm_model.description import MAX_LINKS, Arm
from fss_arm_model.description_file import described
from fss_arm_ros.convert import joint_readings
from fss_arm_ros.qos import LATCHED, sensor
from fss_arm_ros.subscription_set import unsubscribe
from fss_arm_ros.validation import subscribe

JOINT = re.compile(r"<joint\b[^>]*\bname=[\"']joint_(\d{1,9})[\"']")
SETTLED = 3  # readings of every joint, after which a further joint would have been received


def count_joints(urdf: str) -> int:
    """Return the number of joints `joint_<i>` of a URDF; 0: it is not of an arm."""
    return len(set(JOINT.findall(urdf)))


def describe_joint_mismatch(joints: int, arm: Arm) -> str:
    """Return the difference between the arm that runs and a description; empty: there is none."""
    if joints in (0, arm.n):
        return ""
    return f"the arm has {joints} joints, description {arm.name!r} has {arm.n}; give -p arm:=..."


class JointCount:
    """Number of joints of an arm of n joints, by readings that arrive one joint at a time.

    A joint that is silent may be switched off, so only additional joints are counted.
    """

    def __init__(self, n: int) -> None:
        self.n = n
        self.received: Counter[int] = Counter()

    @property
    def settled(self) -> bool:
        """True if every joint was received several times, and none beyond them."""
        return all(self.received[i] >= SETTLED for i in range(1, self.n + 1))

    def add(self, joints: Iterable[int]) -> int:
        """Add numbers of joints received; return the number of joints known to exist."""
        self.received.update(joints)
        return max([self.n, *self.received])


def load_described_arm(node: Node, name: str) -> Arm:
    """Return the arm that a parameter names; the node ends if the arm that runs has other joints.

    Raises:
        OSError: the file cannot be read.
        DescriptionError: there is no arm of that name, or the file's content is invalid.
    """
    arm = described(name)
    counts: list[int] = []

    def receive(message: String) -> None:
        if not counts and (joints := count_joints(message.data)):
            if why := describe_joint_mismatch(joints, arm):
                raise SystemExit(why)
            counts.append(joints)

    subscribe(node, String, "robot_description", receive, LATCHED)
    return arm


def compare_with_joint_states(node: Node, arm: Arm) -> None:
    """End the node `arm` if more joints are driven than its description has."""
    count = JointCount(arm.n)

    def receive(message: JointState) -> None:
        joints = count.add(i for i, *_ in joint_readings(message) if 0 < i <= MAX_LINKS)
        if why := describe_joint_mismatch(joints, arm):
            raise SystemExit(why)
        if count.settled:
            unsubscribe(node, subscription)

    subscription = subscribe(node, JointState, "joint_states", receive, sensor(best_effort=True))
