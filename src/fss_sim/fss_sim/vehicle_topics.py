"""Topics, connections and faults of one vehicle of the test bed."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from math import inf
from pathlib import Path
from threading import RLock
from typing import Any

from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from sensor_msgs.msg import Imu
from std_msgs.msg import Bool

from fss_arm_model.description import Arm
from fss_arm_msgs.msg import GripperState, SimFaults, SimTruth, ThrusterCommand
from fss_arm_ros.convert import to_time
from fss_arm_ros.diagnostics import OK, WARN, Health
from fss_arm_ros.qos import COMMAND, LATCHED, SENSOR
from fss_arm_ros.validation import subscribe
from fss_link.protocol import load_keys
from fss_sim.faults import fault_classes, read_script
from fss_sim.link.radio import RadioChannel
from fss_sim.messages import (
    SerializedGyro,
    SerializedPose,
    clearances,
    gripper_state,
    truth_message,
)
from fss_sim.plant.bed import Bed
from fss_sim.plant.vehicle import Vehicle
from fss_sim.sensors import RATE, Readings
from fss_sim.settings import TestbedSettings
from fss_sim.testbed import Report, State, Testbed
from fss_sim.vicon import BASE, MIN_MARKERS, NOT_VISIBLE, TARGET, TIP, Vicon

# Frames between two messages of the faults, for recorders that start later.
FAULTS_PERIOD = 10 * RATE
TOUCHING_GAP = 1e-6  # gap below which bodies touch [m]
SUBJECTS = {BASE: "base", TIP: "end effector", TARGET: "target"}
SAVE_PERIOD = RATE // 5  # frames between two writes of the state file


class VehicleTopics:
    """Interface of one vehicle: publishes sensor data, passes datagrams to links and board.

    Args:
        node: node of the test bed; a vehicle with a name has its topics in a namespace.
        lock: lock that callbacks hold.
        stamp: returns the time of the last frame [ns].
        settings: settings of the vehicle.
        name: name of the vehicle; empty if it is the only one.
    """

    def __init__(
        self,
        node: Node,
        lock: RLock,
        stamp: Callable[[], int],
        settings: TestbedSettings,
        name: str = "",
    ) -> None:
        self.node, self.lock, self.stamp = node, lock, stamp
        self.save_error = ""  # reason why the state file could not be written
        self._saved_boot = 0  # boot number in the state file
        self.settings, self.name = settings, name
        self.namespace, self.prefix = (f"/{name}/", f"{name}.") if name else ("", "")
        self.arm = settings.description()
        self.n = self.arm.n if isinstance(self.arm, Arm) else 0
        self.subjects = (BASE, TIP) if self.n else (BASE,)  # VICON subjects
        self.keys = load_keys(settings.keys) if settings.keys else {}
        self.script = settings.script()
        self.wires = settings.open_wires(self.n)
        self.board_wire = settings.open_board_wire()
        self.base = node.create_publisher(PoseStamped, settings.base_topic, SENSOR)
        self.tip = self.gripper = self.target = None
        if self.n:
            self.tip = node.create_publisher(PoseStamped, settings.tip_topic, SENSOR)
        if self.board_wire is None:
            self.create_base_topics()
        if settings.target_mass:
            self.target = node.create_publisher(PoseStamped, settings.target_topic, SENSOR)
        self.truth = node.create_publisher(SimTruth, f"{self.namespace}sim/truth", SENSOR)
        self.faults = node.create_publisher(SimFaults, f"{self.namespace}sim/faults", LATCHED)
        self.pose_message = SerializedPose(settings.world_frame)
        self.gyro_message = SerializedGyro(settings.base_frame, settings.noise().gyro_noise)
        self.set_faults: dict[tuple[str, str], float] = {}

    def create_base_topics(self) -> None:
        """Create the base's topics, as there is no board for the node `base`."""
        node, namespace = self.node, self.namespace
        self.gyro = node.create_publisher(Imu, f"{namespace}fog/imu", SENSOR)
        if self.n:
            self.gripper = node.create_publisher(GripperState, f"{namespace}gripper/state", SENSOR)
            node.create_subscription(Bool, f"{namespace}gripper/command", self.on_grip, COMMAND)
        self.pulses = node.create_publisher(ThrusterCommand, f"{namespace}thrusters/pulses", SENSOR)
        subscribe(node, ThrusterCommand, f"{namespace}thrusters/command", self.on_thrust, COMMAND)

    def make_vehicle(self, state: State) -> Vehicle:
        """Return the vehicle in a state, not yet on a table."""
        world = self.settings.world()
        return Vehicle(self.arm, state.q, state.qd, world, state.propellant, self.name)

    def start(
        self,
        bed: Bed | None,
        number: int,
        state: State,
        seed: int,
        radio_channel: RadioChannel | None = None,
        vicon: Vicon | None = None,
    ) -> None:
        """Create electronics and sensors of vehicle `number` of a bed; None: the only one."""
        settings = self.settings
        self.testbed = Testbed(
            self.arm,
            settings.noise(),
            seed,
            state,
            settings.telemetry_rate,
            self.keys,
            settings.torque_rate,
            settings.battery,
            read_script(self.script),
            settings.world(),
            settings.board_rate if self.board_wire else 0.0,
            bed,
            number,
            settings.power(),
            radio_channel,
            vicon,
        )
        for (part, fault), value in self.set_faults.items():
            self.testbed.faults.set(part, fault, value)
        self.save()

    def report(self, report: Report) -> None:
        """Publish and send the outputs of a frame; a new boot number is saved before it is sent."""
        if self.testbed.boot != self._saved_boot or self.testbed.frame % SAVE_PERIOD == 0:
            self.save()
        self.publish(self.stamp(), report.readings)
        for wire, datagrams in zip(self.wires, report.telemetry, strict=True):
            for datagram in datagrams:
                wire.send(*datagram)
        if self.board_wire:
            for datagram in report.board:
                self.board_wire.send(*datagram)
        if report.faults_changed or self.testbed.frame % FAULTS_PERIOD == 0:
            self.publish_faults()

    def publish(self, stamp: int, readings: Readings) -> None:
        """Publish the readings of the sensors."""
        settings, testbed = self.settings, self.testbed
        publishers = (
            (self.base, readings.base),
            (self.tip, readings.tip),
            (self.target, readings.target),
        )
        for publisher, reading in publishers:
            if publisher and reading:
                publisher.publish(self.pose_message.serialize(stamp, reading))
        if readings.rate is not None and self.board_wire is None:
            self.gyro.publish(self.gyro_message.serialize(stamp, readings.rate))
        if testbed.frame % round(RATE / settings.truth_rate) == 0:
            bed, plant = testbed.bed, testbed.plant
            default_count = NOT_VISIBLE.markers if testbed.vicon else MIN_MARKERS
            counts = {kind: result.markers for kind, result in testbed.marker_results.items()}
            markers = [counts.get(kind, default_count) for kind in SUBJECTS]
            self.truth.publish(
                truth_message(stamp, settings.world_frame, bed, plant, testbed.frame, markers)
            )
            if self.gripper:
                frame_id = f"{settings.frame_prefix}end_effector"
                self.gripper.publish(gripper_state(stamp, frame_id, bed, plant))

    def receive(self, delay: int) -> Iterator[int]:
        """Pass datagrams on, as received `delay` ns after the last frame; yield each one's link."""
        for link, wire in enumerate(self.wires):
            for data, sender in wire.receive():
                yield link
                self.testbed.receive(link, data, sender, delay)
        for data, sender in self.board_wire.receive() if self.board_wire else ():
            self.testbed.receive_base(data, sender, delay)

    def on_thrust(self, command: ThrusterCommand) -> None:
        """Open valves, and publish the accepted command."""
        with self.lock:
            try:
                self.testbed.plant.thrust(command.on_time)
                pulses = ThrusterCommand(on_time=command.on_time)
                pulses.header.stamp = to_time(self.stamp())
                self.pulses.publish(pulses)
            except ValueError as error:
                message = f"{self.namespace}thrusters/command is rejected: {error}"
                self.node.get_logger().warning(message)

    def on_grip(self, command: Bool) -> None:
        """Close or open the gripper."""
        with self.lock:
            self.testbed.plant.closed = command.data

    def fault_classes(self) -> dict[str, type]:
        """Return the classes of its faults, by the prefix of their parameters' names."""
        return {f"{self.prefix}{part}": kind for part, kind in fault_classes(self.n).items()}

    def set_fault(self, part: str, fault: str, value: float) -> None:
        """Set a fault by hand."""
        self.testbed.faults.set(part, fault, value)
        self.set_faults[part, fault] = value
        self.publish_faults()

    def publish_faults(self) -> None:
        """Publish the active faults."""
        message = SimFaults(script=self.script)
        message.header.stamp = to_time(self.stamp())
        for part, fault, value in self.testbed.faults.active():
            message.part.append(part)
            message.fault.append(fault)
            message.value.append(value)
        self.faults.publish(message)

    def health(self, default: str = "") -> Health:
        """Return the status of the vehicle; `default` is the message if there is no problem."""
        problems = [self.save_error] if self.save_error else []
        with self.lock:
            if self.is_touching():
                problems += ["bodies touch each other or the table's border"]
            if not self.testbed.plant.thrusters.floats:
                problems += ["no air in the bearings: the vehicle rubs on the table"]
            return Health(WARN if problems else OK, ", ".join(problems) or default, self.values())

    def is_touching(self) -> bool:
        """Return True if its bodies touch each other or the table's border."""
        return min(self.gap(), self.testbed.plant.edge_clearance) < TOUCHING_GAP

    def gap(self) -> float:
        """Return the least gap between two bodies [m]."""
        bed, plant = self.testbed.bed, self.testbed.plant
        return min((pair.gap for pair in clearances(bed, plant)), default=inf)

    def values(self) -> dict[str, Any]:
        """Return the diagnostic values of the vehicle."""
        plant, imbalance = self.testbed.plant, self.testbed.bed.imbalance
        values: dict[str, Any] = {
            "largest error of momentum and energy [N s, N m s, J]": abs(imbalance).max(),
            "gap between bodies [m]": self.gap(),
            "gap to the table's edge [m]": plant.edge_clearance,
            "propellant used [kg]": plant.thrusters.propellant_used,
            "rests of the arm": self.testbed.sensors.rests,
        }
        for kind, result in self.testbed.marker_results.items():
            values[f"markers of the {SUBJECTS[kind]}"] = result.markers
        for link, wire in zip(self.testbed.links, self.wires, strict=True):
            values[f"link {link.number}"] = f"{wire.address}, {link.rejected} rejected"
        if self.board_wire and self.testbed.board:
            values["board"] = f"{self.board_wire.address}, {self.testbed.board.rejected} rejected"
        for part, fault, value in self.testbed.faults.active():
            values[f"fault {part}.{fault}"] = value
        return values

    def save(self) -> None:
        """Write the state file; if that fails, log the error once and continue."""
        self._saved_boot = self.testbed.boot
        if not self.settings.state_file:
            return
        before, self.save_error = self.save_error, ""
        try:
            self.testbed.state().save(Path(self.settings.state_file))
        except OSError as error:
            self.save_error = f"cannot write {self.settings.state_file}: {error.strerror}"
            if self.save_error != before:
                self.node.get_logger().error(self.save_error)

    def reset(self) -> State:
        """Reset the connections; return the state given by the parameters, at the present boot."""
        for wire in self.all_wires():
            wire.reset()
        state = self.settings.state_from_parameters(self.n)
        return replace(state, boot_offset=self.testbed.boot)

    def close(self) -> None:
        """Save the state and close the connections."""
        self.save()
        for wire in self.all_wires():
            wire.close()

    def all_wires(self) -> list[Any]:
        """Return the connections of links and board."""
        return [*self.wires, *([self.board_wire] if self.board_wire else [])]
