"""Node of the simulated test bed: VICON and FOG on topics, links on UDP, optionally the clock.

The services `sim/pause`, `sim/step` (while paused) and `sim/reset` control the time; `sim/charge`
charges the batteries.
The simulation runs in a thread of its own; callbacks of the executor hold the lock.
"""

import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations
from threading import RLock
from typing import Any

from rclpy.node import Node
from rosgraph_msgs.msg import Clock as ClockMessage
from std_srvs.srv import SetBool, Trigger

from fss_arm_model.settings import SettingError
from fss_arm_msgs.srv import ResetTestbed, StepTime
from fss_arm_ros.convert import SECOND, to_time
from fss_arm_ros.diagnostics import OK, WARN, Diagnostics, Health
from fss_arm_ros.parameters import declare, declare_live
from fss_arm_ros.qos import SENSOR
from fss_arm_ros.subscription_set import receive_pending
from fss_sim.messages import SerializedClock
from fss_sim.pace import ClockPace, FullSpeedPace, Pace
from fss_sim.programs import testbed as main
from fss_sim.sensors import RATE
from fss_sim.settings import TestbedSettings
from fss_sim.testbed import FRAME, State, Testbed, place_on_table, step
from fss_sim.ticker import Ticker
from fss_sim.vehicle_topics import VehicleTopics, align_frames
from fss_sim.vehicles import read_vehicles
from fss_sim.vicon import TARGET

# Largest number of late frames per tick, so that the node remains responsive.
MAX_FRAMES_PER_TICK = RATE
MAX_CATCH_UP = 0.3  # longest stall of a busy computer that is made up for, in real time [s]
FRAMES_PER_CLOCK = 5  # number of frames for which the clock is published once
PAUSED_CLOCK_PERIOD = 0.5  # period of publishing the clock while paused [s]
ROS_TIME = (
    "the test bed uses ROS time: to pause and step the time, start the test bed with "
    "-p keep_clock:=true and all other nodes with -p use_sim_time:=true"
)
MAX_FRAMES = 60 * RATE  # largest number of frames of one step, so that the node responds soon


class TestbedNode(Node):
    """Free-floating vehicles and their links' electronics, observed by VICON and FOG."""

    def __init__(self, **options: Any) -> None:
        super().__init__("testbed", **options)
        self.settings = settings = declare(self, TestbedSettings, live=True)
        self.lock = RLock()
        self.vehicles = [
            VehicleTopics(self, self.lock, self.stamp, one, name)
            for name, one in read_vehicles(settings).items()
        ]
        check_keys(self.vehicles)
        if settings.keep_clock:
            self.clock = self.create_publisher(ClockMessage, "/clock", SENSOR)
        self.clock_message = SerializedClock()
        self.clock_published = 0.0  # when the clock was last published [s]
        self.seed, self.paused = settings.seed, settings.paused
        self.start_vehicles([v.settings.initial_state(v.n) for v in self.vehicles])
        self.declare_faults()
        self.create_service(SetBool, "sim/pause", self.on_pause)
        self.create_service(StepTime, "sim/step", self.on_step)
        self.create_service(ResetTestbed, "sim/reset", self.on_reset)
        self.create_service(Trigger, "sim/charge", self.on_charge)
        self._last_speed_check = self.testbed.frame, time.monotonic()
        self.diagnostics = [Diagnostics(self, self.health)]
        for vehicle in self.vehicles if settings.vehicles else ():
            name = f"{vehicle.namespace}{self.get_name()}"
            health = partial(self.vehicle_health, vehicle, "no contact")
            self.diagnostics.append(Diagnostics(self, health, name=name))
        self.ticker = Ticker(self.tick, self.create_guard_condition(self.on_failure))

    @property
    def testbed(self) -> Testbed:
        """Test bed of the first vehicle, or of the only one."""
        return self.vehicles[0].testbed

    @property
    def wires(self) -> list[Any]:
        """Connections of all links."""
        return [wire for vehicle in self.vehicles for wire in vehicle.wires]

    def start_vehicles(self, states: list[State]) -> None:
        """Create the vehicles in these states, and start their time now."""
        plants: list[Any] = [None]
        if self.settings.vehicles:
            plants = [v.make_vehicle(state) for v, state in zip(self.vehicles, states, strict=True)]
            place_on_table(plants, states)
        states = align_frames(states)
        kinds = [kind for vehicle in self.vehicles for kind in vehicle.subjects]
        kinds += [TARGET] if self.settings.target_mass else []
        radio_channel = self.settings.radio_channel(f"{self.seed}, {states[0].boots}")
        vicon = self.settings.vicon(self.seed, kinds)
        for vehicle, plant, state in zip(self.vehicles, plants, states, strict=True):
            seed = self.seed + vehicle.settings.seed - self.settings.seed
            vehicle.start(plant, state, seed, radio_channel, vicon)
        self.pace = self.new_pace()
        for vehicle in self.vehicles:
            vehicle.publish_faults()

    def declare_faults(self) -> None:
        """Declare each fault of each vehicle as a parameter."""
        owners = {prefix: v for v in self.vehicles for prefix in v.fault_classes()}
        classes = {
            prefix: kind for v in self.vehicles for prefix, kind in v.fault_classes().items()
        }

        def on_fault(prefix: str, fault: str, value: float) -> None:
            with self.lock:
                owner = owners[prefix]
                owner.set_fault(prefix.removeprefix(owner.prefix), fault, value)

        declare_live(self, classes, on_fault)

    def new_pace(self) -> Pace:
        """Return the pace that the settings select, starting at the present frame."""
        frame = self.testbed.frame
        if not self.settings.keep_clock:
            return ClockPace(self._ros_time, frame, max_behind=SECOND, max_ahead=30 * SECOND)
        if not self.settings.speed:
            return FullSpeedPace()
        # If frames cannot be computed in time, time runs slower, but a short stall is made up for.
        speed = self.settings.speed
        max_ahead = round(max(1.0, MAX_CATCH_UP * speed) * SECOND)
        return ClockPace(
            self._scaled_time, frame, max_behind=SECOND, max_ahead=max_ahead, speed=speed
        )

    def tick(self) -> float:
        """Simulate the frames that are due, and pass on the received datagrams.

        Returns:
            Time to wait before the next tick [s].
        """
        with self.lock:
            due = 0 if self.paused else self.pace.due_frames(self.testbed.frame)
            for done in range(0, min(due, MAX_FRAMES_PER_TICK), FRAMES_PER_CLOCK):
                self.make_frames(min(due - done, FRAMES_PER_CLOCK))
                if self.settings.keep_clock:
                    self.receive()
            # Check again: after a stall meanwhile, datagrams would be processed too early.
            if (
                not self.paused
                and max(due, self.pace.due_frames(self.testbed.frame)) <= MAX_FRAMES_PER_TICK
            ):
                self.receive()
            if self.paused and time.monotonic() - self.clock_published > PAUSED_CLOCK_PERIOD:
                self.publish_clock(self.stamp())  # for nodes that have started meanwhile
        return self.pace.check_period if due <= MAX_FRAMES_PER_TICK else 0.0

    def on_failure(self) -> None:
        """Stop the node with the error of the thread, if the thread has failed."""
        if self.ticker.error and self.context.ok():
            raise self.ticker.error

    def make_frames(self, count: int) -> None:
        """Simulate `count` frames; publish the clock first, so that no stamp is ahead of it."""
        if self.settings.keep_clock:
            self.publish_clock(self.stamp() + count * FRAME)
        for _ in range(count):
            reports = step([vehicle.testbed for vehicle in self.vehicles])
            for vehicle, report in zip(self.vehicles, reports, strict=True):
                vehicle.report(report)

    def publish_clock(self, stamp: int) -> None:
        """Publish a time [ns] on /clock, for all nodes."""
        self.clock.publish(self.clock_message.serialize(stamp))
        self.clock_published = time.monotonic()

    def receive(self) -> None:
        """Pass on datagrams as received now, or at the last frame if keep_clock is set."""
        frame = self.testbed.frame
        delay = 0 if self.settings.keep_clock else self.pace.lag(frame)
        delay = min(max(delay, 0), FRAME - 1)
        before = 0
        for vehicle in self.vehicles:
            for link in vehicle.receive(delay):
                self.pace.record_datagram(before + link, frame)
            before += len(vehicle.wires)

    def on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        """Pause or resume the time."""
        if not self.settings.keep_clock:
            response.message = ROS_TIME
            return response
        with self.lock:
            self.paused, self.pace = request.data, self.new_pace()
        response.success, response.message = True, "paused" if request.data else "running"
        return response

    def on_step(self, request: StepTime.Request, response: StepTime.Response) -> StepTime.Response:
        """Simulate frames; commands received before the request act from the first frame on."""
        receive_pending(self)
        with self.lock:
            if not self.paused:
                kept = self.settings.keep_clock
                response.message = (
                    "the clock is running: pause it first (service sim/pause)" if kept else ROS_TIME
                )
            elif request.frames > MAX_FRAMES:
                response.message = (
                    f"{request.frames} frames requested, expected at most {MAX_FRAMES}"
                )
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
        """Restart from the parameters, not from the state file; only boot numbers continue."""
        with self.lock:
            self.seed = request.seed if request.seed >= 0 else self.seed
            for wire in self.all_wires():
                wire.reset()
            states = [v.settings.state_from_parameters(v.n) for v in self.vehicles]
            boots = [v.testbed.boot for v in self.vehicles]
            pairs = zip(states, boots, strict=True)
            self.start_vehicles([replace(state, boot_offset=boot) for state, boot in pairs])
        response.success, response.message = True, f"restarted with seed {self.seed}"
        return response

    def on_charge(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Charge all batteries immediately."""
        with self.lock:
            for vehicle in self.vehicles:
                vehicle.testbed.charge()
        response.success, response.message = True, "all batteries are full"
        return response

    def stamp(self) -> int:
        """Return the time of the last frame [ns]; /clock starts at 1 s, as 0 is no time in ROS."""
        epoch = SECOND if self.settings.keep_clock else self.pace.epoch
        return epoch + self.testbed.frame * FRAME

    def health(self) -> Health:
        """Return the status of the time; with only one vehicle, also that of the vehicle."""
        frame, now = self.testbed.frame, time.monotonic()
        last_frame, last_time = self._last_speed_check
        self._last_speed_check = frame, now
        speed = (frame - last_frame) / RATE / max(now - last_time, 1e-9)
        slow = now - last_time > 0.5 and speed < 0.95 * self.settings.speed and not self.paused
        values = {"simulated time [s]": frame / RATE, "speed": speed}
        values["VICON's frame"], values["clock jumps"] = frame, self.pace.jumps
        if self.testbed.radio_channel:
            values["airtime used"] = self.testbed.radio_channel.utilization(self.testbed.now)
        state = "paused" if self.paused else "too slow" if slow else "running"
        level = WARN if slow else OK
        if self.settings.vehicles:
            return Health(level, f"{state}, {len(self.vehicles)} vehicles", values)
        vehicle = self.vehicle_health(self.vehicles[0])
        message = f"{state}, {vehicle.message}" if vehicle.message else state
        return Health(max(level, vehicle.level), message, {**values, **vehicle.values})

    def vehicle_health(self, vehicle: VehicleTopics, default: str = "") -> Health:
        """Return the status of a vehicle; `default` is the message if there is no problem."""
        problems = [vehicle.save_error] if vehicle.save_error else []
        if vehicle.is_touching():
            problems += ["bodies touch each other or the table's border"]
        if not vehicle.testbed.plant.thrusters.floats:
            problems += ["no air in the bearings: the vehicle rubs on the table"]
        return Health(WARN if problems else OK, ", ".join(problems) or default, vehicle.values())

    def close(self) -> None:
        """Save the state and close the ports."""
        self.ticker.close()
        for vehicle in self.vehicles:
            vehicle.save()
        for wire in self.all_wires():
            wire.close()

    def all_wires(self) -> list[Any]:
        """Return the connections of links and boards."""
        return [wire for vehicle in self.vehicles for wire in vehicle.all_wires()]

    def _scaled_time(self) -> int:
        return int(time.monotonic_ns() * self.settings.speed)

    def _ros_time(self) -> int:
        return int(self.get_clock().now().nanoseconds)


def check_keys(vehicles: Sequence[VehicleTopics]) -> None:
    """Raise SettingError if links of two vehicles would accept each other's commands."""
    for one, other in combinations(vehicles, 2):
        if set(one.keys.values()) & set(other.keys.values()):
            raise SettingError(
                f"{one.name} and {other.name} have a key in common: give each vehicle its own keys"
            )


if __name__ == "__main__":
    sys.exit(main())
