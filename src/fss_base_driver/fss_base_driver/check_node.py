"""Node of the command `check`: it opens valves and records the base's motion."""

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import isfinite
from typing import Any

from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from sensor_msgs.msg import Imu, JointState
from std_srvs.srv import SetBool

from fss_arm_model.description import Arm
from fss_arm_msgs.msg import BaseTelemetry, ThrusterCommand
from fss_arm_ros.convert import SECOND, joint_readings, seen_pose, stamp_ns
from fss_arm_ros.qos import COMMAND, subscribe_sensor
from fss_arm_ros.run import spin_once
from fss_base_driver.findings import Trial
from fss_base_driver.programs import check as main

ANSWER_TIMEOUT = 10.0  # longest wait for an answer [s]
DISCOVERY = 1.0  # time to discover the topics [s]


class CheckError(RuntimeError):
    """Failure to carry out the check; the message says why."""


class CheckNode(Node):
    """Node that opens valves through the node `base` and records the base's motion."""

    def __init__(self, namespace: str, base_topic: str) -> None:
        super().__init__(
            "check", namespace=namespace, enable_rosout=False, start_parameter_services=False
        )
        self.trial = Trial()  # in progress
        self.sent: list[ThrusterCommand] = []
        self.joints: dict[int, float] = {}
        subscribe_sensor(self, PoseStamped, base_topic, self.on_pose)
        subscribe_sensor(self, Imu, "fog/imu", self.on_imu)
        subscribe_sensor(self, JointState, "joint_states", self.on_joints)
        subscribe_sensor(self, BaseTelemetry, "base/telemetry", self.on_telemetry)
        subscribe_sensor(self, ThrusterCommand, "thrusters/pulses", self.sent.append)
        self.command = self.create_publisher(ThrusterCommand, "thrusters/command", COMMAND)
        self.arming = self.create_client(SetBool, "base/arm")

    def on_pose(self, message: PoseStamped) -> None:
        """Store a valid pose."""
        if pose := seen_pose(message):
            self.trial.poses.append((stamp_ns(message.header.stamp) / SECOND, *pose))

    def on_imu(self, message: Imu) -> None:
        """Store a turn rate."""
        rate = message.angular_velocity.z
        if isfinite(rate):
            self.trial.rates.append((stamp_ns(message.header.stamp) / SECOND, rate))

    def on_telemetry(self, message: BaseTelemetry) -> None:
        """Store which valves are open."""
        self.trial.open_valves.append(message.valves)

    def on_joints(self, message: JointState) -> None:
        """Store the joints' last angles."""
        self.joints |= {i: q for i, q, _, _ in joint_readings(message) if isfinite(q)}

    def wait(self, condition: Callable[[], Any], timeout: float) -> bool:
        """Spin until the condition holds or the timeout passes; return True if it holds."""
        until = time.monotonic() + timeout
        while not (holds := bool(condition())) and (left := until - time.monotonic()) > 0.0:
            spin_once(self, min(left, 0.1))
        return holds

    def arm(self, data: bool) -> None:
        """Arm the board, or disarm it.

        Raises:
            CheckError: it fails.
        """
        if not self.arming.wait_for_service(ANSWER_TIMEOUT):
            raise CheckError("no node `base` answers on base/arm: does it run in this ROS domain?")
        answer = self.arming.call_async(SetBool.Request(data=data))
        if not self.wait(answer.done, ANSWER_TIMEOUT):
            raise CheckError("the node `base` does not answer on base/arm")
        if not answer.result().success:
            raise CheckError(answer.result().message)

    @contextmanager
    def armed(self) -> Iterator[None]:
        """Arm the board for a block, and disarm it however the block ends.

        Raises:
            CheckError: arming or disarming fails.
        """
        try:
            self.arm(True)
            yield
        except BaseException:  # it matters more than a failure to disarm
            if self.arming.service_is_ready():
                try:
                    self.arm(False)
                except CheckError as error:
                    print(f"check: {error}", file=sys.stderr)
            raise
        self.arm(False)

    def angles(self, arm: Arm) -> list[float]:
        """Return the angles of the arm's joints.

        Raises:
            CheckError: not all joints have sent readings.
        """
        self.wait(lambda: len(self.joints) >= arm.n, DISCOVERY + ANSWER_TIMEOUT)
        if missing := [i for i in range(1, arm.n + 1) if i not in self.joints]:
            joints = ", ".join(map(str, missing))
            raise CheckError(f"joint_states has no reading of joints {joints}; give --q RAD ...")
        return [self.joints[i] for i in range(1, arm.n + 1)]

    def pulse(self, valve: int, on_time: float) -> float:
        """Open a valve, numbered from 0; return when the pulse was sent [s].

        Raises:
            CheckError: the node `base` did not send it.
        """
        self.sent.clear()
        message = ThrusterCommand()
        message.on_time[valve] = on_time
        message.header.stamp = self.get_clock().now().to_msg()
        self.command.publish(message)
        if not self.wait(lambda: self.sent, 1.0):
            raise CheckError("the node `base` sent no pulse: see its log for the reason")
        return stamp_ns(self.sent[0].header.stamp) / SECOND

    def try_valve(self, valve: int, given: argparse.Namespace) -> Trial:
        """Record the base's motion around a pulse of a valve, numbered from 0.

        Raises:
            CheckError: the node `base` did not open it.
        """
        self.trial = Trial(valve, given.on_time)
        self.wait(lambda: False, given.before)
        self.trial.begin = self.pulse(valve, given.on_time)
        self.wait(lambda: False, given.on_time + given.after)
        return self.trial


if __name__ == "__main__":
    sys.exit(main())
