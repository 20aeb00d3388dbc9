"""The node `control` with a fake craft, a reference for it, and the wrenches that it publishes."""

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from gnc_bench import FakeCraft
from rclpy.parameter import Parameter
from trajectory_msgs.msg import JointTrajectory, MultiDOFJointTrajectory

from fss_arm_ros.convert import stamp_ns
from fss_gnc import messages
from fss_gnc.control_node import ControlNode
from fss_gnc.reference import Path

ZERO = (0.0, 0.0, 0.0)


def at(*pose):
    """Return a path that rests at a pose."""
    return Path(np.zeros(1), np.array(pose).reshape(1, 1, 3))


class Bench(FakeCraft):
    """A craft with a reference, and the wrenches that `control` publishes for it."""

    def __init__(self, spin, time=None, **parameters):
        super().__init__(time)
        parameters = {"max_pause": 1000.0, **parameters}  # a test does not always run the node
        overrides = [Parameter(name, value=value) for name, value in parameters.items()]
        self.control = ControlNode(parameter_overrides=[Parameter("rate", value=50.0), *overrides])
        self.run, self.wrenches, self.stamps, self.words = spin, [], [], ""
        self.path, self.plan = at(0.01, 0.0, 0.0), None
        self.silent |= {"base/trajectory"}
        self.trajectory = self.create_publisher(MultiDOFJointTrajectory, "base/trajectory", 1)
        self.planned = self.create_publisher(JointTrajectory, "arm/planned", 1)
        self.create_subscription(WrenchStamped, "base/wrench", self.on_wrench, 10)
        self.create_subscription(DiagnosticArray, "/diagnostics", self.on_health, 10)
        known = self.control.controller
        self.until(lambda: known.base.value and known.joints.value is not None)

    def report(self):
        super().report()
        if "base/trajectory" not in self.silent:
            self.guide(self.path)
        if self.plan:
            self.planned.publish(self.plan)

    def guide(self, path):
        self.trajectory.publish(messages.trajectory(path, 0.0, self.now(), 1.0, 0.25))

    def on_wrench(self, message):
        w = message.wrench
        self.wrenches.append((w.force.x, w.force.y, w.torque.z))
        self.stamps.append(stamp_ns(message.header.stamp))

    def on_health(self, message):
        self.words = {s.name: s.message for s in message.status}.get("/control", self.words)

    def until(self, condition, timeout=10.0):
        return self.run([self, self.control], condition, timeout)

    def acts(self, count=3):
        self.silent -= {"base/trajectory"}
        before = len(self.wrenches)
        self.until(lambda: len(self.wrenches) >= before + count)
        return np.array(self.wrenches[-1])

    def stops(self, words, within=2.5):
        """Expect one zero wrench, and none after it; diagnostics report why."""
        self.until(lambda: self.wrenches[-1] == ZERO, within)
        count = len(self.wrenches)
        self.until(lambda: words in self.words)  # which takes up to a second
        assert len(self.wrenches) == count
        assert self.wrenches.count(ZERO) == 1
