"""The node `kinematic`: finds rests in live or replayed topics and calibrates the arm from them."""

import sys
from dataclasses import dataclass
from functools import partial
from typing import Any

from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from fss_arm_calib.acceptance import clocks_kept, count
from fss_arm_calib.kinematic.checks import PASS, calibrate
from fss_arm_calib.kinematic.report import kinematic_report
from fss_arm_calib.kinematic.settings import CalibrationSettings
from fss_arm_calib.messages import (
    feed_joints,
    feed_pose,
    feed_telemetry,
    observations_message,
    to_message,
)
from fss_arm_calib.report import write
from fss_arm_calib.segments.rests import BASE, TIP, Observation, RestFinder, homed
from fss_arm_calib.segments.streams import newest
from fss_arm_calib.state import Writes, read_observations, write_observations
from fss_arm_model.description import described, from_yaml, save
from fss_arm_model.settings import setting
from fss_arm_msgs.msg import KinematicCalibration, KinematicObservations, LinkTelemetry
from fss_arm_ros.diagnostics import ERROR, OK, WARN, Diagnostics, Health
from fss_arm_ros.memory import give_back
from fss_arm_ros.parameters import declare
from fss_arm_ros.qos import LATCHED, subscribe_sensor
from fss_arm_ros.run import run


@dataclass(frozen=True)
class KinematicSettings(CalibrationSettings):
    """The parameters of a KinematicNode."""

    base_frame: str = setting("fss", "frame id of the results")
    state_file: str = setting("", "observations are kept here across restarts; empty: nowhere")
    output: str = setting("", "description YAML to write whenever a calibration passes")
    report: str = setting("", "folder to write a report to when asked to solve; empty: none")


class KinematicNode(Node):
    """Publishes each rest of the arm as an observation, and the calibration from all of them.

    Subscribes joint_states and the two VICON topics; nobody needs to say when the arm rests.
    `~/solve` closes the present rest and solves; `~/forget` begins anew.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__("kinematic", **options)
        s = self.settings = declare(self, KinematicSettings)
        self.arm = described(s.arm)
        kept = read_observations(s.state_file, self.arm.n) if s.state_file else []
        self.observations: list[Observation] = newest(kept, s.kept)
        resting_at = kept[-1].q if kept and kept[-1].used else None
        self.finder = RestFinder(self.arm.n, s, resting_at)
        self.writes = Writes(self.get_logger())
        self.solve()
        self.observed = self.create_publisher(
            KinematicObservations, "calibration/observations", LATCHED
        )
        self.calibrated = self.create_publisher(
            KinematicCalibration, "calibration/kinematic", LATCHED
        )
        subscribe_sensor(self, JointState, s.joints_topic, self.on_joints, keep_all=True)
        for subject, topic in ((BASE, s.base_topic), (TIP, s.tip_topic)):
            subscribe_sensor(
                self, PoseStamped, topic, partial(self.on_pose, subject), keep_all=True
            )
        for i in range(1, self.arm.n + 1):
            subscribe_sensor(self, LinkTelemetry, f"link_{i}/telemetry", self.on_telemetry)
        self.create_service(Trigger, "~/solve", self.on_solve)
        self.create_service(Trigger, "~/forget", self.on_forget)
        if kept:
            self.get_logger().info(f"goes on with {len(kept)} observations of {s.state_file}")
            self.publish()
        self.diagnostics = Diagnostics(self, self.health)

    def on_joints(self, message: JointState) -> None:
        """Readings of one link or more."""
        self.take(feed_joints(self.finder, message))

    def on_pose(self, subject: str, message: PoseStamped) -> None:
        """A pose of the base or the end effector."""
        self.take(feed_pose(self.finder, subject, message))

    def on_telemetry(self, message: LinkTelemetry) -> None:
        """What a link tells of its zero."""
        self.take(feed_telemetry(self.finder, message))

    def on_solve(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Close the present rest and solve; succeeds if the calibration passes."""
        if not self.take(self.finder.close()):
            self.solve()
            self.publish()
        if self.settings.report:
            self.writes(lambda: write(self.settings.report, kinematic_report(self.message())))
        response.success = self.calibration.verdict == PASS
        response.message = f"{self.calibration.verdict}: {self.calibration.reason}"
        return response

    def on_forget(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Drop all observations, in the state file too, and whatever befell the streams."""
        response.success = True
        response.message = f"{count(len(self.observations), 'observation')} forgotten"
        self.get_logger().info(response.message)
        self.observations, self.finder = [], RestFinder(self.arm.n, self.settings)
        self.solve()
        self.publish()
        return response

    def take(self, found: list[Observation]) -> bool:
        """Keep, save and publish new observations and solve again; False if there are none."""
        if not found:
            return False
        self.observations = newest(self.observations + found, self.settings.kept)
        self.solve()
        self.publish()
        for o in found:
            what = f"averaged {o.vicon_frames} frames" if o.used else f"not used: {o.reason}"
            self.get_logger().info(f"observation {len(self.observations)}: {what}")
        self.get_logger().info(f"{self.calibration.verdict}: {self.calibration.reason}")
        return True

    def solve(self) -> None:
        """Calibrate from all observations."""
        s = self.settings
        self.calibration = calibrate(self.observations, self.arm, s, self.finder.streams())
        give_back()

    def message(self) -> KinematicCalibration:
        """What is concluded by now."""
        return to_message(self.calibration, self.settings.base_frame)

    def publish(self) -> None:
        """Save the observations, publish them and the calibration; write what passes."""
        s, self.writes.trouble = self.settings, ""
        if path := s.state_file:
            self.writes(lambda: write_observations(path, self.observations))
        self.observed.publish(observations_message(self.observations, s.base_frame, TIP))
        self.calibrated.publish(self.message())
        if s.output and self.calibration.verdict == PASS:
            calibrated = from_yaml(self.calibration.description)
            self.writes(lambda: save(calibrated, s.output))

    def health(self) -> Health:
        """For diagnostics."""
        streams = self.finder.streams()
        values = {
            "observations": len(self.observations),
            "verdict": self.calibration.verdict,
            "time offset [s]": streams.offset.value,
            **{f"refused: {kind}": number for kind, number in streams.refused.items()},
        }
        if trouble := self.writes.trouble:
            return Health(ERROR, trouble, values)
        if streams.silent:
            return Health(WARN, f"waiting for {', '.join(streams.silent)}", values)
        if streams.strange:
            return Health(WARN, f"the arm has no {', '.join(streams.strange)}", values)
        if clocks := clocks_kept(streams, self.settings.joint_gap).reason:
            return Health(WARN, f"{clocks}: kinematic/forget begins anew", values)
        if again := homed(self.calibration, streams):
            names = ", ".join(f"joint_{i}" for i in again)
            return Health(WARN, f"{names} homed or restarted since: calibrate the offsets", values)
        return Health(OK, f"{len(self.observations)} observations", values)


def main() -> int:
    """Run as `ros2 run fss_arm_calib kinematic`."""
    return run(KinematicNode, KinematicSettings)


if __name__ == "__main__":
    sys.exit(main())
