"""Node that publishes a flight to the nodes under test, and receives their results."""

from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from sensor_msgs.msg import Imu, JointState
from tf2_msgs.msg import TFMessage

from fss_arm_msgs.msg import BaseReaction, KinematicCalibration
from fss_arm_ros.convert import pose_stamped, to_time
from fss_arm_ros.qos import LATCHED, SENSOR, sensor

BEGIN = 1_000_000_000


class Bench(Node):
    """Node that publishes a flight and receives the results."""

    def __init__(self, flight):
        super().__init__("bench")
        self.flight, self.k = flight, 0
        self.joints = self.create_publisher(JointState, "joint_states", SENSOR)
        self.pose = self.create_publisher(PoseStamped, "vicon/fss/fss", SENSOR)
        self.gyro = self.create_publisher(Imu, "fog/imu", SENSOR)
        self.calibration = self.create_publisher(
            KinematicCalibration, "calibration/kinematic", LATCHED
        )
        self.reactions, self.states, self.transforms = [], [], []
        self.create_subscription(BaseReaction, "base_reaction", self.reactions.append, sensor())
        self.create_subscription(Odometry, "base/state", self.states.append, sensor())
        self.create_subscription(TFMessage, "/tf", self.transforms.append, sensor())

    def ready(self):
        publishers = (self.joints, self.pose, self.gyro, self.calibration)
        return all(p.get_subscription_count() for p in publishers)

    def play(self, frames):
        """Publish `frames` milliseconds of the flight: one link's reading every 50 ms."""
        f = self.flight
        for k in range(self.k, min(self.k + frames, len(f.t))):
            t = BEGIN + k * 1_000_000
            if k % 10 == 0:
                self.pose.publish(pose_stamped(t, "world", tuple(f.pose[k])))
                imu = Imu()
                imu.header.stamp, imu.angular_velocity.z = to_time(t), float(f.twist[k, 2])
                self.gyro.publish(imu)
            if k % 50 == 0:
                i = k // 50 % 4
                joint = JointState(
                    name=[f"joint_{i + 1}"],
                    position=[float(f.q[k, i])],
                    velocity=[float(f.qd[k, i])],
                    effort=[0.25],
                )
                joint.header.stamp = to_time(t)
                self.joints.publish(joint)
        self.k += frames
