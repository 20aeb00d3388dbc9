"""Who arms the links of a whole graph and has motions executed."""

from time import monotonic

from nav_msgs.msg import Odometry
from rclpy.action import ActionClient
from rclpy.node import Node
from std_srvs.srv import SetBool

from fss_arm_msgs.action import ExecuteMotion
from fss_arm_msgs.msg import MotionReport, SimTruth
from fss_arm_ros.qos import LATCHED, SENSOR, subscribe_sensor


class Person(Node):
    """Arms the links and has motions executed."""

    def __init__(self, spin):
        super().__init__("person")
        self.spin, self.seen, self.reports, self.feedback = spin, 0, [], []
        self.truths = []
        self.armer = self.create_client(SetBool, "arm/enable")
        self.mover = ActionClient(self, ExecuteMotion, "arm/execute")
        self.create_subscription(MotionReport, "arm/motion", self.reports.append, LATCHED)
        subscribe_sensor(self, Odometry, "base/state", self.see)
        self.create_subscription(SimTruth, "sim/truth", self.truths.append, SENSOR)

    def see(self, _):
        self.seen += 1

    def after(self, future, timeout=60.0):
        self.spin(self, future.done, timeout)
        return future.result()

    def begin(self):
        self.spin(
            self, lambda: self.armer.service_is_ready() and self.mover.server_is_ready(), 60.0
        )
        deadline = monotonic() + 40.0
        while not self.after(self.armer.call_async(SetBool.Request(data=True))).success:
            assert monotonic() < deadline
        self.spin(self, lambda: self.seen > 300, 60.0)  # longer than the drift is averaged over

    def send(self, **goal):
        sent = self.mover.send_goal_async(ExecuteMotion.Goal(**goal), self.feedback.append)
        handle = self.after(sent)
        assert handle.accepted
        return handle

    def execute(self, **goal):
        return self.after(self.send(**goal).get_result_async())
