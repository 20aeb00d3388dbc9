"""Bags made for tests."""

from pathlib import Path
from shutil import copytree
from typing import Any

from builtin_interfaces.msg import Time
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from fss_arm_bags.recorder import Recording
from fss_arm_model.units import SECOND
from fss_arm_msgs.msg import KinematicCalibration
from fss_arm_ros.convert import stamp_ns
from fss_arm_ros.qos import LATCHED, SENSOR

START = 1_700_000_000 * SECOND
STEP = SECOND // 100

#: A bag that holds the first version of our messages.
FIRST = Path(__file__).parents[1] / "data/first"


def joint_state(k: int) -> JointState:
    """A message that is like no other."""
    # Without empty lists at the end: serialize_message would leave more behind them than a
    # publisher does, and rosbags refuses it.
    message = JointState(
        name=[f"joint_{k % 4 + 1}"], position=[0.001 * k], velocity=[0.1], effort=[-0.5 * k]
    )
    sec, nanosec = divmod(START + k * STEP, SECOND)
    message.header.stamp = Time(sec=sec, nanosec=nanosec)
    return message


def number(message: Any) -> int:
    """The k of a joint state."""
    return (stamp_ns(message.header.stamp) - START) // STEP


def fill(recording: Recording, count: int, first: int = 0, chunk: int = 10) -> None:
    """Record `count` joint states 10 ms apart, and a latched text at the beginning."""
    recording.add("/robot_description", "std_msgs/msg/String", [LATCHED])
    recording.add("/joint_states", "sensor_msgs/msg/JointState", [SENSOR])
    begin = START + first * STEP
    recording.write("/robot_description", begin, serialize_message(String(data="arm")))
    for k in range(first, first + count):
        receipt = START + k * STEP
        recording.write("/joint_states", receipt, serialize_message(joint_state(k)))
        if (k + 1) % chunk == 0:
            recording.flush()


def make_bag(folder: Path, count: int = 100, first: int = 0) -> Path:
    """A whole bag, the next one in `folder`."""
    recording = Recording(folder)
    fill(recording, count, first)
    recording.close()
    return recording.path


def make_killed_bag(folder: Path, count: int = 100, first: int = 0) -> Path:
    """A bag as a killed recorder leaves it: whole chunks, no index, no metadata."""
    recording = Recording(folder)
    fill(recording, count, first)
    recording.flush()
    recording.abort()
    return recording.path


def make_before_and_after(folder: Path) -> Path:
    """The bag of the first version of our messages, and one of the present version."""
    copytree(FIRST, folder / "bag_0")
    recording = Recording(folder)
    recording.add("/calibration/kinematic", "fss_arm_msgs/msg/KinematicCalibration", [LATCHED])
    recording.write("/calibration/kinematic", START, serialize_message(KinematicCalibration()))
    recording.close()
    return folder


def states(messages: Any) -> list[int]:
    """The numbers k of the joint states among messages as `Bags.messages` gives them."""
    return [number(m) for topic, _, _, m in messages if topic == "/joint_states"]
