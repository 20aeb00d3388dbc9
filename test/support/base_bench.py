"""The node `base` with a fake board, and a user of its topics and services."""

from base_link import FakeBoardTransport
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import BatteryState, FluidPressure, Imu
from std_msgs.msg import Bool, Float64
from std_srvs.srv import SetBool, Trigger

from fss_arm_model.units import SECOND
from fss_arm_msgs.msg import BaseTelemetry, GripperState, ThrusterCommand
from fss_arm_ros.convert import to_time
from fss_base_driver.base_node import BaseNode

PUBLISHED = {
    "telemetry": (BaseTelemetry, "base/telemetry"),
    "imu": (Imu, "fog/imu"),
    "gripper": (GripperState, "gripper/state"),
    "pressure": (FluidPressure, "base/pressure"),
    "battery": (BatteryState, "base/battery"),
    "propellant": (Float64, "base/propellant"),
    "pulses": (ThrusterCommand, "thrusters/pulses"),
    "health": (DiagnosticArray, "/diagnostics"),
}


class User(Node):
    """Receives everything that the node publishes, and commands it."""

    def __init__(self):
        super().__init__("user")
        for name, (kind, topic) in PUBLISHED.items():
            setattr(self, name, [])
            self.create_subscription(kind, topic, getattr(self, name).append, 100)
        self.thrust = self.create_publisher(ThrusterCommand, "thrusters/command", 1)
        self.wrench = self.create_publisher(WrenchStamped, "base/wrench", 1)
        self.grip = self.create_publisher(Bool, "gripper/command", 1)
        self.arm = self.create_client(SetBool, "base/arm")
        self.find = self.create_client(Trigger, "base/find_gyro_bias")

    def stamp(self, age=0.0):
        return to_time(self.get_clock().now().nanoseconds - round(age * SECOND))

    def open(self, *times, age=0.0, stamped=True):
        message = ThrusterCommand(on_time=[*times, *(8 - len(times)) * [0.0]])
        message.header.stamp = self.stamp(age) if stamped else to_time(0)
        self.thrust.publish(message)

    def push(self, x=0.0, y=0.0, torque=0.0, age=0.0, frame="fss"):
        message = WrenchStamped()
        message.header.stamp, message.header.frame_id = self.stamp(age), frame
        message.wrench.force.x, message.wrench.force.y = x, y
        message.wrench.torque.z = torque
        self.wrench.publish(message)


class Bench:
    """The node with its board, a user, and `until`, which spins both."""

    def __init__(self, spin, parameters):
        self.transport = FakeBoardTransport()
        self.board = self.transport.board
        overrides = [Parameter(name, value=value) for name, value in parameters.items()]
        self.node = BaseNode(self.transport, parameter_overrides=overrides)
        self.user = user = User()
        self.until = lambda condition, timeout=10.0: spin([self.node, user], condition, timeout)
        self.until(lambda: user.telemetry and user.health and user.arm.service_is_ready())
        publishers = user.thrust, user.wrench, user.grip
        self.until(lambda: all(p.get_subscription_count() for p in publishers))
        self.until(lambda: self.node.outputs["thrusters/pulses"].get_subscription_count())
        self.until(lambda: not self.node.session.lost)

    def call(self, client, request, timeout=10.0):
        answer = client.call_async(request)
        self.until(answer.done, timeout)
        return answer.result()

    def arm(self, data=True):
        return self.call(self.user.arm, SetBool.Request(data=data))

    @property
    def refused(self):
        return self.node.health().values["commands refused"]

    @property
    def opened(self):
        self.board.valves(self.transport.clock())
        return self.board.state.opened

    def is_open(self):
        return self.board.valves(self.transport.clock())

    def status(self):
        return self.user.health[-1].status[0]

    def values(self):
        return {pair.key: pair.value for pair in self.status().values}
