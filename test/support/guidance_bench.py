"""The node `guidance` with an ideal craft, and clients of its actions."""

from gnc_bench import FakeCraft
from rclpy.action import ActionClient
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Empty
from trajectory_msgs.msg import MultiDOFJointTrajectory

from fss_arm_msgs.msg import MissionState
from fss_arm_ros.qos import LATCHED
from fss_gnc import guidance_node, messages
from fss_gnc.guidance.kinds import BASE
from fss_gnc.guidance_node import GuidanceNode

HOLD = BASE[0]


class Bench(FakeCraft):
    """An ideal craft, which is at the newest reference, and a client that sends goals."""

    def __init__(self, spin, time=None, namespace="", **parameters):
        super().__init__(time, namespace)
        quick = {"acceleration": 0.01, "turn_acceleration": 0.02, **parameters}
        overrides = [Parameter(name, value=value) for name, value in quick.items()]
        self.guidance = GuidanceNode(namespace=namespace, parameter_overrides=overrides)
        self.run, self.paths, self.states, self.rates, self.grips = spin, [], [], [], []
        self.obeys, self.feedback = True, []
        self.clients_ = {k.name: ActionClient(self, k.action, k.name) for k in guidance_node.KINDS}
        self.create_subscription(MultiDOFJointTrajectory, "base/trajectory", self.on_path, 10)
        self.create_subscription(MissionState, "mission/state", self.states.append, LATCHED)
        self.create_subscription(JointState, "arm/joint_commands", self.rates.append, 10)
        self.create_subscription(Bool, "gripper/command", self.grips.append, 10)
        self.stops = {n: self.create_publisher(Empty, n, 10) for n in ("base/stop", "arm/stop")}
        self.until(lambda: all(c.server_is_ready() for c in self.clients_.values()))
        self.until(lambda: self.states and not self.guidance.observe()[1])

    def close(self):
        for client in self.clients_.values():
            client.destroy()

    def on_path(self, message):
        self.paths.append(messages.path(message))
        if self.paths[-1] and self.obeys:
            there = self.paths[-1].at(1e-3)
            self.pose, self.twist = there.pose, there.twist

    def until(self, condition, timeout=20.0):
        return self.run([self, self.guidance], condition, timeout)

    def after(self, future):
        self.until(future.done)
        return future.result()

    def begin(self, kind, **goal):
        sent = self.clients_[kind.name].send_goal_async(
            kind.action.Goal(**goal), self.feedback.append
        )
        handle = self.after(sent)
        assert handle.accepted
        return handle

    def end(self, handle):
        return self.after(handle.get_result_async())

    def does(self, kind, **goal):
        return self.end(self.begin(kind, **goal))

    def holding(self):
        """Start a hold, and return its goal handle."""
        count = len(self.paths)
        handle = self.begin(HOLD)
        self.until(lambda: len(self.paths) > count + 2 and self.paths[-1])
        return handle

    def coasts(self):
        """Return the last mission state, once the base coasts."""
        self.until(lambda: self.paths[-1] is None)
        return self.states[-1]
