"""The simulated test bed as a node: VICON and FOG on topics, links on UDP, time on request."""

import sys
import time
from pathlib import Path
from typing import Any

from geometry_msgs.msg import PoseStamped
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rosgraph_msgs.msg import Clock as ClockMessage
from sensor_msgs.msg import Imu

from fss_arm_driver.protocol import load_keys
from fss_arm_ros.convert import pose_stamped, to_time
from fss_arm_ros.diagnostics import OK, WARN, Diagnostics, Health
from fss_arm_ros.qos import SENSOR
from fss_arm_ros.run import run
from fss_arm_ros.settings import declare
from fss_sim.pace import Pace
from fss_sim.sensors import RATE, Sight
from fss_sim.settings import TestbedSettings
from fss_sim.testbed import FRAME, Testbed
from fss_sim.udp import LinkSocket

SECOND = 1_000_000_000  # [ns]
BURST = RATE  # frames made up for at once, so that the node remains responsive
SAVED = RATE // 5  # frames from one writing of the state file to the next


class TestbedNode(Node):
    """A free-floating arm and its links' electronics, seen by VICON and FOG."""

    def __init__(self, **options: Any) -> None:
        super().__init__("testbed", **options)
        self.settings = settings = declare(self, TestbedSettings)
        arm = settings.description()
        begin = settings.begin(arm.n)
        keys = load_keys(settings.keys) if settings.keys else {}
        self.testbed = Testbed(
            arm, settings.noise(), settings.seed, begin, settings.telemetry_rate, keys
        )
        self.sockets = [LinkSocket(settings.host, port) for port in settings.link_ports(arm.n)]
        self.base = self.create_publisher(PoseStamped, "vicon/fss/fss", SENSOR)
        self.tip = self.create_publisher(PoseStamped, "vicon/end_effector/end_effector", SENSOR)
        self.gyro = self.create_publisher(Imu, "fog/imu", SENSOR)
        if settings.keep_clock:
            self.clock = self.create_publisher(ClockMessage, "/clock", 10)
            # What cannot be computed in time makes time run slower.
            self.pace = Pace(self._own_time, begin.frame, back=SECOND, ahead=SECOND)
        else:
            self.pace = Pace(self._ros_time, begin.frame, back=SECOND, ahead=30 * SECOND)
        self.save()
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(max(0.001, 0.5 / RATE / settings.speed), self.tick, clock=steady)
        self._counted = begin.frame, time.monotonic()
        self.diagnostics = Diagnostics(self, self.health)

    def tick(self) -> None:
        """Make the frames that are due, and hand on the datagrams that have come."""
        due = self.pace.late(self.testbed.frame) // FRAME
        for _ in range(min(due, BURST)):
            self.make_frame()
        if due <= BURST:
            self.receive()

    def make_frame(self) -> None:
        """Let one frame's time pass and report it."""
        sight, telemetry = self.testbed.step()
        self.publish(self.stamp(), sight)
        for socket, data in zip(self.sockets, telemetry, strict=True):
            if data is not None:
                socket.send(data)
        if self.testbed.frame % SAVED == 0:
            self.save()

    def stamp(self) -> int:
        """Time of the last frame [ns]; the time kept begins at 1 s, as 0 is "no time" to ROS."""
        epoch = SECOND if self.settings.keep_clock else self.pace.epoch
        return epoch + self.testbed.frame * FRAME

    def publish(self, stamp: int, sight: Sight) -> None:
        """Publish what the sensors see."""
        settings = self.settings
        if settings.keep_clock:
            self.clock.publish(ClockMessage(clock=to_time(stamp)))
        self.base.publish(pose_stamped(stamp, settings.world_frame, sight.base))
        self.tip.publish(pose_stamped(stamp, settings.world_frame, sight.tip))
        imu = Imu()
        imu.header.stamp, imu.header.frame_id = to_time(stamp), settings.base_frame
        imu.orientation_covariance[0] = imu.linear_acceleration_covariance[0] = -1.0  # not measured
        imu.angular_velocity.z = sight.rate
        imu.angular_velocity_covariance[8] = self.testbed.sensors.noise.gyro_noise**2
        self.gyro.publish(imu)

    def receive(self) -> None:
        """Hand datagrams to the links, as arrived now, or at the last frame if time is kept."""
        late = 0 if self.settings.keep_clock else self.pace.late(self.testbed.frame)
        late = min(max(late, 0), FRAME - 1)
        for link, socket in enumerate(self.sockets):
            for data, sender in socket.receive():
                if self.testbed.receive(link, data, late):
                    socket.answer(sender)

    def save(self) -> None:
        """Write the state file."""
        if self.settings.state_file:
            self.testbed.state().save(Path(self.settings.state_file))

    def health(self) -> Health:
        """Whether time passes as it should, and what the simulation is like."""
        frame, now = self.testbed.frame, time.monotonic()
        before, then = self._counted
        self._counted = frame, now
        speed = (frame - before) / RATE / max(now - then, 1e-9)
        slow = now - then > 0.5 and speed < 0.95 * self.settings.speed
        values: dict[str, Any] = {
            "simulated time [s]": frame / RATE,
            "speed": speed,
            "momentum drift [kg m/s, kg m^2/s]": self.testbed.momentum_drift(),
            "rests": self.testbed.sensors.rests,
            "clock jumps": self.pace.jumps,
        }
        for link, socket in zip(self.testbed.links, self.sockets, strict=True):
            refused = link.gate.refused.total()
            values[f"link {link.gate.number}"] = f"port {socket.port}, {refused} refused"
        return Health(WARN if slow else OK, "too slow" if slow else "running", values)

    def close(self) -> None:
        """Keep the state and give the ports back."""
        self.save()
        for socket in self.sockets:
            socket.close()

    def _own_time(self) -> int:
        return int(time.monotonic_ns() * self.settings.speed)

    def _ros_time(self) -> int:
        return int(self.get_clock().now().nanoseconds)


def main() -> int:
    """Entry point of `ros2 run fss_sim testbed`."""
    return run(TestbedNode, TestbedSettings)


if __name__ == "__main__":
    sys.exit(main())
