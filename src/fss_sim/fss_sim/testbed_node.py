"""The simulated test bed as a node: VICON and FOG on topics, links on UDP, time on request.

Its services are for whoever keeps the clock: `sim/pause`, `sim/step` while paused, `sim/reset`;
`sim/charge` is the charger of the batteries.
Time passes in a thread of its own; callbacks of the executor hold the lock.
"""

import sys
import time
from pathlib import Path
from threading import RLock
from typing import Any

from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rosgraph_msgs.msg import Clock as ClockMessage
from sensor_msgs.msg import Imu
from std_msgs.msg import Bool
from std_srvs.srv import SetBool, Trigger

from fss_arm_driver.protocol import load_keys
from fss_arm_msgs.msg import GripperState, SimFaults, SimTruth, ThrusterCommand
from fss_arm_msgs.srv import ResetTestbed, StepTime
from fss_arm_ros.convert import SECOND, to_time
from fss_arm_ros.diagnostics import OK, WARN, Diagnostics, Health
from fss_arm_ros.door import subscribe
from fss_arm_ros.parameters import declare, declare_live
from fss_arm_ros.qos import COMMAND, LATCHED, SENSOR
from fss_arm_ros.run import run
from fss_sim.faults import kinds, read_script
from fss_sim.messages import ClockImage, GyroImage, PoseImage, gripper_state, truth
from fss_sim.pace import Clocked, FlatOut, Pace
from fss_sim.sensors import RATE, Sight
from fss_sim.settings import TestbedSettings
from fss_sim.testbed import FRAME, State, Testbed
from fss_sim.ticker import Ticker

BURST = RATE  # frames made up for at once, so that the node remains responsive
STALL = 0.3  # of a busy computer, in real time [s]
REMINDED = 10 * RATE  # from one telling of the faults to the next, for recorders that come late
TOGETHER = 5  # of them, for which the clock is published once
SAVED = RATE // 5  # frames from one writing of the state file to the next
MAX_FRAMES = 60 * RATE  # frames of one step, so that the node answers before long


class TestbedNode(Node):
    """A free-floating arm and its links' electronics, seen by VICON and FOG."""

    def __init__(self, **options: Any) -> None:
        super().__init__("testbed", **options)
        self.settings = settings = declare(self, TestbedSettings, live=True)
        self.arm = arm = settings.description()
        self.keys = load_keys(settings.keys) if settings.keys else {}
        self.lock = RLock()
        self.script = settings.script()
        self.wires = settings.wires(arm.n)
        self.base = self.create_publisher(PoseStamped, "vicon/fss/fss", SENSOR)
        self.tip = self.create_publisher(PoseStamped, "vicon/end_effector/end_effector", SENSOR)
        self.board_wire = settings.board_wire()
        if self.board_wire is None:
            self.take_base()
        if settings.target_mass:
            self.target = self.create_publisher(PoseStamped, "vicon/target/target", SENSOR)
        self.truth = self.create_publisher(SimTruth, "sim/truth", SENSOR)
        if settings.keep_clock:
            self.clock = self.create_publisher(ClockMessage, "/clock", SENSOR)
        self.clock_image, self.pose_image = ClockImage(), PoseImage(settings.world_frame)
        self.gyro_image = GyroImage(settings.base_frame, settings.noise().gyro_noise)
        self.seed, self.paused = settings.seed, settings.paused
        self.faults = self.create_publisher(SimFaults, "sim/faults", LATCHED)
        self.set_faults: dict[tuple[str, str], float] = {}
        self.begin(settings.begin(arm.n))
        declare_live(self, kinds(arm.n), self.on_fault)
        self.create_service(SetBool, "sim/pause", self.on_pause)
        self.create_service(StepTime, "sim/step", self.on_step)
        self.create_service(ResetTestbed, "sim/reset", self.on_reset)
        self.create_service(Trigger, "sim/charge", self.on_charge)
        self._counted = self.testbed.frame, time.monotonic()
        self.diagnostics = Diagnostics(self, self.health)
        self.ticker = Ticker(self.tick, self.create_guard_condition(self.on_failure))

    def take_base(self) -> None:
        """Be the base's topics, as there is no board for the node `base`."""
        self.gyro = self.create_publisher(Imu, "fog/imu", SENSOR)
        self.gripper = self.create_publisher(GripperState, "gripper/state", SENSOR)
        self.pulses = self.create_publisher(ThrusterCommand, "thrusters/pulses", SENSOR)
        subscribe(self, ThrusterCommand, "thrusters/command", self.on_thrust, COMMAND)
        self.create_subscription(Bool, "gripper/command", self.on_grip, COMMAND)

    def begin(self, state: State) -> None:
        """Make the test bed in this state, and let its time begin now."""
        settings = self.settings
        self.testbed = Testbed(
            self.arm,
            settings.noise(),
            self.seed,
            state,
            settings.telemetry_rate,
            self.keys,
            settings.torque_rate,
            settings.battery,
            read_script(self.script),
            settings.world(),
            settings.board_rate if self.board_wire else 0.0,
            settings.room(),
            settings.radio(),
        )
        for (part, fault), value in self.set_faults.items():
            self.testbed.faults.set(part, fault, value)
        self.pace = self.new_pace()
        self.save()
        self.publish_faults()

    def new_pace(self) -> Pace:
        """The pace that is asked for, from the present frame on."""
        frame = self.testbed.frame
        if not self.settings.keep_clock:
            return Clocked(self._ros_time, frame, back=SECOND, ahead=30 * SECOND)
        if not self.settings.speed:
            return FlatOut()
        # What cannot be computed in time makes time run slower, but a stall is made up for.
        speed = self.settings.speed
        ahead = round(max(1.0, STALL * speed) * SECOND)
        return Clocked(self._own_time, frame, back=SECOND, ahead=ahead, speed=speed)

    def tick(self) -> float:
        """Make the frames that are due, and hand on the datagrams that have come.

        Returns:
            How long to wait before the next tick [s].
        """
        with self.lock:
            due = 0 if self.paused else self.pace.due(self.testbed.frame)
            for made in range(0, min(due, BURST), TOGETHER):
                self.make_frames(min(due - made, TOGETHER))
                if self.settings.keep_clock:
                    self.receive()
            if due <= BURST and not self.paused:
                self.receive()
        return self.pace.rest if due <= BURST else 0.0

    def on_failure(self) -> None:
        """The thread has ended; so does the node."""
        if self.ticker.error and self.context.ok():
            raise self.ticker.error

    def make_frames(self, count: int) -> None:
        """Let so many frames pass, the clock going before, so that nothing is early by it."""
        if self.settings.keep_clock:
            self.clock.publish(self.clock_image.of(self.stamp() + count * FRAME))
        for _ in range(count):
            self.make_frame()

    def make_frame(self) -> None:
        """Let one frame's time pass and report it."""
        sight, telemetry, faulted, of_board = self.testbed.step()
        self.publish(self.stamp(), sight)
        for wire, datagrams in zip(self.wires, telemetry, strict=True):
            for datagram in datagrams:
                wire.send(*datagram)
        if self.board_wire:
            for datagram in of_board:
                self.board_wire.send(*datagram)
        if faulted or self.testbed.frame % REMINDED == 0:
            self.publish_faults()
        if self.testbed.frame % SAVED == 0:
            self.save()

    def on_thrust(self, command: ThrusterCommand) -> None:
        """Open valves."""
        with self.lock:
            try:
                self.testbed.plant.thrust(command.on_time)
                pulses = ThrusterCommand(on_time=command.on_time)
                pulses.header.stamp = to_time(self.stamp())
                self.pulses.publish(pulses)
            except ValueError as error:
                self.get_logger().warning(f"thrusters/command is refused: {error}")

    def on_grip(self, command: Bool) -> None:
        """Close the gripper, or open it."""
        with self.lock:
            self.testbed.plant.closed = command.data

    def on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        """Let time stand still, or go on."""
        if not self.settings.keep_clock:
            response.message = "the time is ROS time as it is: keep_clock is false"
            return response
        with self.lock:
            self.paused, self.pace = request.data, self.new_pace()
        response.success, response.message = True, "paused" if request.data else "running"
        return response

    def on_step(self, request: StepTime.Request, response: StepTime.Response) -> StepTime.Response:
        """Let so many frames pass; what has come before is taken before the first of them."""
        with self.lock:
            if not self.paused:
                response.message = "time runs: pause it first"
            elif request.frames > MAX_FRAMES:
                response.message = f"{request.frames} frames, expected at most {MAX_FRAMES}"
            else:
                for _ in range(request.frames):
                    self.receive()
                    self.make_frames(1)
                response.success = True
            response.stamp = to_time(self.stamp())
        return response

    def on_reset(
        self, request: ResetTestbed.Request, response: ResetTestbed.Response
    ) -> ResetTestbed.Response:
        """Begin anew from the parameters, whatever the state file holds."""
        with self.lock:
            self.seed = request.seed if request.seed >= 0 else self.seed
            for wire in self.all_wires():
                wire.reset()
            self.begin(self.settings.fresh(self.arm.n))
        response.success, response.message = True, f"begun with seed {self.seed}"
        return response

    def on_charge(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Charge the links' batteries, at once."""
        with self.lock:
            self.testbed.charge()
        response.success, response.message = True, "all batteries are full"
        return response

    def stamp(self) -> int:
        """Time of the last frame [ns]; the time kept begins at 1 s, as 0 is "no time" to ROS."""
        epoch = SECOND if self.settings.keep_clock else self.pace.epoch
        return epoch + self.testbed.frame * FRAME

    def on_fault(self, part: str, fault: str, value: float) -> None:
        """A parameter was set."""
        with self.lock:
            self.testbed.faults.set(part, fault, value)
            self.set_faults[part, fault] = value
            self.publish_faults()

    def publish_faults(self) -> None:
        """Publish what is wrong."""
        message = SimFaults(script=self.script)
        message.header.stamp = to_time(self.stamp())
        for part, fault, value in self.testbed.faults.in_force():
            message.part.append(part)
            message.fault.append(fault)
            message.value.append(value)
        self.faults.publish(message)

    def publish(self, stamp: int, sight: Sight) -> None:
        """Publish what the sensors see."""
        for publisher, seen in ((self.base, sight.base), (self.tip, sight.tip)):
            if seen:
                publisher.publish(self.pose_image.of(stamp, seen))
        if sight.target:
            self.target.publish(self.pose_image.of(stamp, sight.target))
        if sight.rate is not None and self.board_wire is None:
            self.gyro.publish(self.gyro_image.of(stamp, sight.rate))
        if self.testbed.frame % round(RATE / self.settings.truth_rate) == 0:
            bed = self.testbed
            markers = [look.markers for look in bed.sensors.looks]
            frame_id = self.settings.world_frame
            self.truth.publish(truth(stamp, frame_id, bed.plant, bed.frame, markers))
            if self.board_wire is None:
                self.gripper.publish(gripper_state(stamp, self.testbed.plant))

    def receive(self) -> None:
        """Hand datagrams to the links, as arrived now, or at the last frame if time is kept."""
        late = 0 if self.settings.keep_clock else self.pace.late(self.testbed.frame)
        late = min(max(late, 0), FRAME - 1)
        for link, wire in enumerate(self.wires):
            for data, sender in wire.receive():
                self.pace.hear(link, self.testbed.frame)
                self.testbed.receive(link, data, sender, late)
        for data, sender in self.board_wire.receive() if self.board_wire else ():
            self.testbed.receive_base(data, sender, late)

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
        slow = now - then > 0.5 and speed < 0.95 * self.settings.speed and not self.paused
        plant = self.testbed.plant
        values: dict[str, Any] = {
            "simulated time [s]": frame / RATE,
            "speed": speed,
            "momentum and energy from nothing [N s, N m s, J]": abs(plant.imbalance).max(),
            "gap between bodies [m]": plant.clearance,
            "gap to the table's edge [m]": plant.edge_clearance,
            "propellant used [kg]": plant.thrusters.used,
            "rests": self.testbed.sensors.rests,
            "VICON's frame": frame,
            **self.sight(),
            "clock jumps": self.pace.jumps,
        }
        for link, wire in zip(self.testbed.links, self.wires, strict=True):
            values[f"link {link.number}"] = f"{wire.place}, {link.refused} refused"
        if self.board_wire and self.testbed.board:
            values["board"] = f"{self.board_wire.place}, {self.testbed.board.refused} refused"
        for part, fault, value in self.testbed.faults.in_force():
            values[f"fault {part}.{fault}"] = value
        touches = min(plant.clearance, plant.edge_clearance) < 0.0
        state = "paused" if self.paused else "too slow" if slow else "running"
        if touches:
            state += ", bodies touch each other or the table's border"
        return Health(WARN if slow or touches else OK, state, values)

    def sight(self) -> dict[str, Any]:
        """How many markers VICON has of each subject, and how busy the radio channel is."""
        sensors, air = self.testbed.sensors, self.testbed.air
        values: dict[str, Any] = {}
        if sensors.vicon:
            counts = zip(("base", "end effector", "target"), sensors.looks, strict=True)
            values = {f"markers of the {name}": look.markers for name, look in counts}
        if air:
            values["airtime used"] = air.used(self.testbed.now)
        return values

    def close(self) -> None:
        """Keep the state and give the ports back."""
        self.ticker.close()
        self.save()
        for wire in self.all_wires():
            wire.close()

    def all_wires(self) -> list[Any]:
        """What links and board are reached by."""
        return [*self.wires, *([self.board_wire] if self.board_wire else [])]

    def _own_time(self) -> int:
        return int(time.monotonic_ns() * self.settings.speed)

    def _ros_time(self) -> int:
        return int(self.get_clock().now().nanoseconds)


def main() -> int:
    """Entry point of `ros2 run fss_sim testbed`."""
    return run(TestbedNode, TestbedSettings)


if __name__ == "__main__":
    sys.exit(main())
