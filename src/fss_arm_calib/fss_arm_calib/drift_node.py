"""The node `float`: what tilt, hose and leaks do to the base, from drifts with the arm at rest."""

import sys
from dataclasses import dataclass

from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from fss_arm_calib.acceptance import PASS
from fss_arm_calib.drift.checks import calibrate, parameters
from fss_arm_calib.drift.problem import Drift
from fss_arm_calib.drift.settings import DriftSettings
from fss_arm_calib.messages import feed_joints, float_message, seen_pose
from fss_arm_calib.segments.drifts import DriftFinder
from fss_arm_calib.segments.poses import BASE
from fss_arm_calib.state import Writes, write_text
from fss_arm_model.description import described
from fss_arm_model.settings import setting
from fss_arm_msgs.msg import FloatCalibration
from fss_arm_ros.convert import SECOND
from fss_arm_ros.diagnostics import ERROR, OK, WARN, Diagnostics, Health
from fss_arm_ros.parameters import declare
from fss_arm_ros.qos import LATCHED, subscribe_sensor
from fss_arm_ros.run import run


@dataclass(frozen=True)
class FloatSettings(DriftSettings):
    """The parameters of a FloatNode."""

    world_frame: str = setting("world", "frame id of the result")
    output: str = setting("", "parameter file for dynamic and base_reaction, if it passes")


class FloatNode(Node):
    """Publishes what acts on the base from outside, after each drift.

    Subscribes joint_states and the base's VICON topic; nobody needs to say when the arm rests.
    `~/solve` closes the present drift and solves.
    """

    def __init__(self, **options: object) -> None:
        super().__init__("float", **options)
        s = self.settings = declare(self, FloatSettings)
        self.arm = described(s.arm)
        self.finder = DriftFinder(self.arm.n, s)
        self.drifts: list[Drift] = []
        self.writes = Writes(self.get_logger())
        self.calibration = calibrate([], self.arm, s)
        self.publisher = self.create_publisher(FloatCalibration, "calibration/float", LATCHED)
        subscribe_sensor(self, JointState, s.joints_topic, self.on_joints, keep_all=True)
        subscribe_sensor(self, PoseStamped, s.base_topic, self.on_pose, keep_all=True)
        self.create_service(Trigger, "~/solve", self.on_solve)
        self.diagnostics = Diagnostics(self, self.health)

    def on_joints(self, message: JointState) -> None:
        """Readings of one link or more."""
        self.take(feed_joints(self.finder, message))

    def on_pose(self, message: PoseStamped) -> None:
        """A pose of the base."""
        self.take(self.finder.pose(BASE, *seen_pose(message)))

    def on_solve(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Close the present drift and solve; succeeds if the result passes."""
        if not self.take(self.finder.close()):
            self.solve()
        response.success = self.calibration.verdict == PASS
        response.message = f"{self.calibration.verdict}: {self.calibration.reason}"
        return response

    def take(self, found: list[Drift]) -> bool:
        """Keep new drifts and solve again; False if there are none."""
        if not found:
            return False
        self.drifts = (self.drifts + found)[-self.settings.kept :]
        self.solve()
        self.get_logger().info(f"{self.calibration.verdict}: {self.calibration.reason}")
        return True

    def solve(self) -> None:
        """Publish what all drifts tell; write the file if it passes."""
        s, streams, self.writes.trouble = self.settings, self.finder.streams(), ""
        self.calibration = calibrate(self.drifts, self.arm, s, streams)
        self.publisher.publish(float_message(self.calibration, s.world_frame))
        if s.output and self.calibration.verdict == PASS:
            told = parameters(self.calibration)
            self.writes(lambda: write_text(s.output, told))

    def health(self) -> Health:
        """For diagnostics."""
        begin, end = self.finder.resting
        values = {
            "drifts": len(self.drifts),
            "arm rests for [s]": (end - begin) / SECOND,
            "verdict": self.calibration.verdict,
        }
        if trouble := self.writes.trouble:
            return Health(ERROR, trouble, values)
        if silent := self.finder.streams().silent:
            return Health(WARN, f"waiting for {', '.join(silent)}", values)
        return Health(OK, f"{len(self.drifts)} drifts", values)


def main() -> int:
    """Run as `ros2 run fss_arm_calib float`."""
    return run(FloatNode, FloatSettings)


if __name__ == "__main__":
    sys.exit(main())
