"""A ROS program that knows nothing of this workspace: standard messages and names alone."""

from control_msgs.action import FollowJointTrajectory
from control_msgs.msg import JointTolerance
from rclpy.action import ActionClient
from rclpy.duration import Duration
from rclpy.node import Node
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

JOINTS = ("joint_1", "joint_2", "joint_3", "joint_4")


class StandardClient(Node):
    """Drives an arm by each of the three standard ways, and watches it."""

    def __init__(self):
        super().__init__("standard_client")
        self.q, self.qd, self.states, self.feedback = {}, {}, [], []
        self.create_subscription(JointState, "arm/joint_states", self.on_states, 10)
        self.action = ActionClient(
            self, FollowJointTrajectory, "arm_controller/follow_joint_trajectory"
        )
        self.topic = self.create_publisher(JointTrajectory, "arm_controller/joint_trajectory", 1)
        self.stream = self.create_publisher(JointState, "arm/joint_commands", 1)

    def on_states(self, message):
        self.states.append(message)
        self.q = dict(zip(message.name, message.position, strict=True))
        self.qd = dict(zip(message.name, message.velocity, strict=True))

    def ready(self):
        return self.q and self.action.server_is_ready() and self.stream.get_subscription_count()

    def resting(self):
        return all(abs(rate) < 0.01 for rate in self.qd.values())

    def near(self, goal, within=0.01):
        return all(abs(self.q[name] - angle) < within for name, angle in goal.items())

    def goal(self, points, names=JOINTS, stamp=None, path=(), end=(), time=0.0):
        """A goal of points (time, positions[, velocities]); tolerances by joint."""
        goal = FollowJointTrajectory.Goal(
            trajectory=self.trajectory(points, names, stamp),
            path_tolerance=[JointTolerance(name=n, position=float(p)) for n, p in path],
            goal_tolerance=[JointTolerance(name=n, position=float(p)) for n, p in end],
        )
        goal.goal_time_tolerance = Duration(seconds=time).to_msg()
        return goal

    def trajectory(self, points, names=JOINTS, stamp=None):
        message = JointTrajectory(joint_names=list(names))
        if stamp is not None:
            message.header.stamp = stamp.to_msg()
        for time, positions, *velocities in points:
            point = JointTrajectoryPoint(positions=[float(q) for q in positions])
            point.velocities = [float(v) for v in (velocities[0] if velocities else ())]
            point.time_from_start = Duration(seconds=time).to_msg()
            message.points.append(point)
        return message

    def send(self, goal):
        return self.action.send_goal_async(goal, self.feedback.append)

    def command(self, names=JOINTS, stamp=None, **fields):
        """A message of the stream."""
        message = JointState(name=list(names))
        message.header.stamp = (stamp or self.get_clock().now()).to_msg()
        for field, values in fields.items():
            setattr(message, field, [float(value) for value in values])
        self.stream.publish(message)
