"""Conversion of messages to the inputs of a law, and of its outputs to messages."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool

from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm, joint_names
from fss_arm_msgs.msg import ThrusterCommand, ThrusterHealth
from fss_arm_ros.convert import to_time
from fss_gnc.law.contract import Outputs
from fss_gnc.law.run import Command
from fss_gnc.law.snapshot import ValveHealth

PLANE = np.ix_((0, 1, 5), (0, 1, 5))  # x, y and heading among the six axes of a covariance
OUTPUT_TYPES = {
    "base/wrench": WrenchStamped,
    "thrusters/command": ThrusterCommand,
    "arm/joint_commands": JointState,
    "gripper/command": Bool,
}


def planar_covariances(message: Any) -> tuple[Floats, Floats]:
    """Return the covariances (3, 3) of pose and twist of an Odometry."""
    pose, twist = (
        np.reshape(part.covariance, (6, 6))[PLANE] for part in (message.pose, message.twist)
    )
    return pose, twist


def health(message: ThrusterHealth) -> ValveHealth:
    """Return the stuck valves of a ThrusterHealth."""
    return ValveHealth(np.array(message.stuck_open), np.array(message.stuck_closed))


def output_messages(command: Command, arm: Arm, base_frame: str) -> Iterator[tuple[str, Any]]:
    """Yield topic and message of each command, with the time of the law's inputs as stamp.

    Args:
        command: of the law.
        arm: whose torque constants convert currents.
        base_frame: frame id of the base.
    """
    outputs, stamp = command.outputs, to_time(command.stamp)
    if outputs.wrench is not None:
        wrench = WrenchStamped()
        wrench.header.stamp, wrench.header.frame_id = stamp, base_frame
        force, torque = wrench.wrench.force, wrench.wrench.torque
        force.x, force.y, torque.z = outputs.wrench.tolist()
        yield "base/wrench", wrench
    if outputs.valve_on_times is not None:
        thrust = ThrusterCommand(on_time=outputs.valve_on_times)
        thrust.header.stamp, thrust.header.frame_id = stamp, base_frame
        yield "thrusters/command", thrust
    if values := _joint_values(outputs, arm):
        joints = JointState(name=joint_names(arm.n), **values)
        joints.header.stamp = stamp
        yield "arm/joint_commands", joints
    if outputs.gripper_closed is not None:
        yield "gripper/command", Bool(data=outputs.gripper_closed)


def _joint_values(outputs: Outputs, arm: Arm) -> dict[str, list[float]]:
    """Return the field of a JointState that commands the joints, if they are commanded."""
    if outputs.joint_positions is not None:
        return {"position": outputs.joint_positions.tolist()}
    if outputs.joint_velocities is not None:
        return {"velocity": outputs.joint_velocities.tolist()}
    if outputs.joint_currents is not None:
        constants = np.array([link.drive.torque_constant for link in arm.links])
        return {"effort": (constants * outputs.joint_currents).tolist()}
    return {}
