"""Scene for the view: base, arm, target, thrusters, mission and reaction, published as by nodes.

As a program (`python view_scene.py`) it publishes until it is stopped.
"""

from contextlib import suppress
from math import cos, pi, radians, sin

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from fss_arm_model.description import paper_arm
from fss_arm_model.kinematics import tip_pose
from fss_arm_msgs.msg import (
    BaseReaction,
    BaseTelemetry,
    LinkTelemetry,
    MissionState,
    ThrusterCommand,
)
from fss_arm_ros.convert import pose_stamped, to_time
from fss_arm_ros.qos import SENSOR

TARGET, KEEP_OUT = (0.9, 0.7), 0.45  # [m]
SIGMA = radians(0.4)  # of the predicted heading [rad]


class Scene(Node):
    """Node that publishes poses at 100 Hz, each joint at 5 Hz, and the rest at 10 Hz."""

    def __init__(self, name=""):
        super().__init__("scene", namespace=name)
        self.arm, self.step, self.sends = paper_arm().vector(), 0, True

        def publisher(kind, topic):
            return self.create_publisher(kind, topic, SENSOR)

        subject = name or "fss"
        self.poses = {
            what: publisher(PoseStamped, f"/vicon/{of}/{of}")
            for what, of in {
                "base": subject,
                "tip": "end_effector" if not name else f"{name}_end_effector",
                "target": "target",
            }.items()
        }
        self.joints = publisher(JointState, "joint_states")
        self.telemetry = [publisher(LinkTelemetry, f"link_{i}/telemetry") for i in range(1, 5)]
        self.board = publisher(BaseTelemetry, "base/telemetry")
        self.propellant = publisher(Float64, "base/propellant")
        self.reaction = publisher(BaseReaction, "base_reaction")
        self.mission = publisher(MissionState, "mission/state")
        self.thrust = publisher(ThrusterCommand, "thrusters/pulses")
        self.create_timer(0.01, self.publish)

    def state(self):
        """Base pose and joint angles now, (7,)."""
        s = 0.01 * self.step
        turn = 2.0 * pi * s / 40.0
        q = [radians(a) * sin(2.0 * pi * s / p) for a, p in ((50, 11), (60, 7), (40, 5), (30, 3))]
        pose = [-0.5 + 0.5 * cos(turn), -0.3 + 0.5 * sin(turn), 0.5 + 0.15 * sin(pi * s / 6)]
        return np.array([*pose, *q])

    def publish(self):
        """Publish one hundredth of a second."""
        if not self.sends:
            return
        now, state, k = self.get_clock().now().nanoseconds, self.state(), self.step
        self.step += 1
        target = (*TARGET, 0.02 * k * 0.01)
        for what, pose in (("base", state[:3]), ("tip", tip_pose(self.arm, state))):
            self.poses[what].publish(pose_stamped(now, "world", tuple(map(float, pose))))
        self.poses["target"].publish(pose_stamped(now, "world", target))
        if k % 5 == 0:
            i = k // 5 % 4
            joint = JointState(name=[f"joint_{i + 1}"], position=[float(state[3 + i])])
            joint.velocity, joint.effort = [0.0], [0.1]
            joint.header.stamp = to_time(now)
            self.joints.publish(joint)
            link = LinkTelemetry(link=i + 1, armed=True, battery=165 - i, sequence=k // 20)
            link.header.stamp = to_time(now)
            self.telemetry[i].publish(link)
        if k % 10 == 0:
            self.publish_slowly(now, state, k // 10)

    def publish_slowly(self, now, state, k):
        """Publish what has a rate of 10 Hz."""
        difference = [0.02 * sin(0.05 * k), 0.01, 0.8 * SIGMA * sin(0.07 * k)]
        reaction = BaseReaction(difference=difference, predicted_deviation=[0.0, 0.0, SIGMA])
        reaction.measured = state[:3].tolist()
        reaction.predicted = (state[:3] - difference).tolist()
        reaction.com = state[:2].tolist()
        reaction.header.stamp = to_time(now)
        self.reaction.publish(reaction)
        self.board.publish(BaseTelemetry(armed=True, battery=121))
        self.propellant.publish(Float64(data=0.0421))
        path = [x for u in np.linspace(0.2, 0.8, 6) for x in (*(u * np.array(TARGET)), 0.0)]
        mission = MissionState(mission="capture", phase="approach", path=path, keep_out=KEEP_OUT)
        mission.header.stamp = to_time(now)
        self.mission.publish(mission)
        if k % 10 == 0:
            on_time = [0.0] * 8
            on_time[k // 10 % 8] = 0.5
            self.thrust.publish(ThrusterCommand(on_time=on_time))


def main():
    """Publish until stopped."""
    rclpy.init()
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(Scene())


if __name__ == "__main__":
    main()
