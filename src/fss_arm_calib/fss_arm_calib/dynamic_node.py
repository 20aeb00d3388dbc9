"""The node `dynamic`: finds maneuvers in live or replayed topics and calibrates from them."""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from sensor_msgs.msg import Imu, JointState
from std_srvs.srv import Trigger

from fss_arm_calib.acceptance import PASS, count
from fss_arm_calib.dynamic.checks import calibrate
from fss_arm_calib.dynamic.report import dynamic_report
from fss_arm_calib.dynamic.settings import DynamicCalibrationSettings
from fss_arm_calib.dynamic_messages import (
    feed_gyro,
    feed_joints,
    feed_pose,
    feed_tip,
    maneuvers_message,
    to_message,
)
from fss_arm_calib.messages import feed_telemetry
from fss_arm_calib.report import write
from fss_arm_calib.segments.maneuvers import Maneuver, ManeuverFinder
from fss_arm_calib.segments.streams import newest
from fss_arm_calib.state import Writes
from fss_arm_model.description import described, from_yaml, save
from fss_arm_model.settings import setting
from fss_arm_msgs.msg import DynamicCalibration, LinkTelemetry, Maneuvers
from fss_arm_ros.diagnostics import ERROR, OK, WARN, Diagnostics, Health
from fss_arm_ros.memory import give_back
from fss_arm_ros.parameters import declare
from fss_arm_ros.qos import LATCHED, subscribe_sensor
from fss_arm_ros.run import run


@dataclass(frozen=True)
class DynamicSettings(DynamicCalibrationSettings):
    """The parameters of a DynamicNode."""

    base_frame: str = setting("fss", "frame id of the results")
    output: str = setting("", "description YAML to write whenever a calibration passes")
    report: str = setting("", "folder to write a report to when asked to solve; empty: none")


class DynamicNode(Node):
    """Publishes each maneuver of the arm, and the dynamic calibration from all of them.

    Subscribes joint_states, the two VICON topics, the gyro and the links' telemetry; nobody needs
    to say when the arm moves. `~/solve` closes the present rest and solves; `~/forget` begins anew.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__("dynamic", **options)
        s = self.settings = declare(self, DynamicSettings)
        self.arm = described(s.arm)
        self.maneuvers: list[Maneuver] = []
        self.finder = ManeuverFinder(self.arm.n, s)
        self.writes = Writes(self.get_logger())
        self.solve()
        self.seen = self.create_publisher(Maneuvers, "calibration/maneuvers", LATCHED)
        self.calibrated = self.create_publisher(DynamicCalibration, "calibration/dynamic", LATCHED)
        links = [f"link_{i}/telemetry" for i in range(1, self.arm.n + 1)]
        for kind, topic, feed in (
            (JointState, s.joints_topic, feed_joints),
            (PoseStamped, s.base_topic, feed_pose),
            (PoseStamped, s.tip_topic, feed_tip),
            (Imu, s.gyro_topic, feed_gyro),
            *((LinkTelemetry, topic, feed_telemetry) for topic in links),
        ):
            subscribe_sensor(self, kind, topic, partial(self.on_sample, feed), keep_all=True)
        self.create_service(Trigger, "~/solve", self.on_solve)
        self.create_service(Trigger, "~/forget", self.on_forget)
        self.diagnostics = Diagnostics(self, self.health)

    def on_sample(self, feed: Callable[[ManeuverFinder, Any], list[Maneuver]], m: Any) -> None:
        """A message of a sensor."""
        self.take(feed(self.finder, m))

    def on_solve(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Close the present rest and solve; succeeds if the calibration passes."""
        if not self.take(self.finder.close()):
            self.solve()
            self.publish()
        s = self.settings
        if s.report:
            told = dynamic_report(
                to_message(self.calibration, s.base_frame),
                maneuvers=maneuvers_message(self.maneuvers, s.base_frame).maneuvers,
            )
            self.writes(lambda: write(s.report, told))
        response.success = self.calibration.verdict == PASS
        response.message = f"{self.calibration.verdict}: {self.calibration.reason}"
        return response

    def on_forget(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Drop all maneuvers, and whatever befell the streams."""
        response.success = True
        response.message = f"{count(len(self.maneuvers), 'maneuver')} forgotten"
        self.get_logger().info(response.message)
        self.maneuvers, self.finder = [], ManeuverFinder(self.arm.n, self.settings)
        self.solve()
        self.publish()
        return response

    def take(self, found: list[Maneuver]) -> bool:
        """Keep and publish new maneuvers and solve again; False if there are none."""
        if not found:
            return False
        self.maneuvers = newest(self.maneuvers + found, self.settings.kept)
        self.solve()
        self.publish()
        for m in found:
            what = f"joints {list(m.moved)} moved" if m.used else f"not used: {m.reason}"
            self.get_logger().info(f"maneuver {len(self.maneuvers)}: {what}")
        self.get_logger().info(f"{self.calibration.verdict}: {self.calibration.reason}")
        return True

    def solve(self) -> None:
        """Calibrate from all maneuvers."""
        self.calibration = calibrate(self.maneuvers, self.arm, self.settings, self.finder.streams())
        give_back()

    def publish(self) -> None:
        """Publish maneuvers and calibration; write the description if it passes."""
        s, self.writes.trouble = self.settings, ""
        self.seen.publish(maneuvers_message(self.maneuvers, s.base_frame))
        self.calibrated.publish(to_message(self.calibration, s.base_frame))
        if s.output and self.calibration.verdict == PASS:
            calibrated = from_yaml(self.calibration.description)
            self.writes(lambda: save(calibrated, s.output))

    def health(self) -> Health:
        """For diagnostics."""
        streams = self.finder.streams()
        values = {
            "maneuvers": len(self.maneuvers),
            "verdict": self.calibration.verdict,
            **{f"refused: {kind}": number for kind, number in streams.refused.items()},
        }
        if trouble := self.writes.trouble:
            return Health(ERROR, trouble, values)
        if streams.silent:
            return Health(WARN, f"waiting for {', '.join(streams.silent)}", values)
        if streams.strange:
            return Health(WARN, f"the arm has no {', '.join(streams.strange)}", values)
        return Health(OK, f"{len(self.maneuvers)} maneuvers", values)


def main() -> int:
    """Run as `ros2 run fss_arm_calib dynamic`."""
    return run(DynamicNode, DynamicSettings)


if __name__ == "__main__":
    sys.exit(main())
