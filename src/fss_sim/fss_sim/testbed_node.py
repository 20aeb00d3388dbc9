"""Node of the simulated test bed: VICON and FOG on topics, links on UDP, optionally the clock.

The services `sim/pause`, `sim/step` (while paused) and `sim/reset` control the time; `sim/charge`
charges the batteries.
The simulation runs in a thread of its own; callbacks of the executor hold the lock.
"""

import sys
from collections.abc import Iterator
from functools import partial
from threading import RLock
from typing import Any

from rclpy.node import Node
from rosgraph_msgs.msg import Clock as ClockMessage
from std_srvs.srv import SetBool, Trigger

from fss_arm_msgs.srv import ResetTestbed, StepTime
from fss_arm_ros.convert import to_time
from fss_arm_ros.diagnostics import OK, WARN, Diagnostics, Health
from fss_arm_ros.parameters import declare
from fss_arm_ros.qos import SENSOR
from fss_arm_ros.subscription_set import receive_pending
from fss_sim.lockstep_topic import wait_for_nodes
from fss_sim.messages import SerializedClock
from fss_sim.programs import testbed as main
from fss_sim.settings import TestbedSettings
from fss_sim.table_topics import declare_faults, start_vehicles
from fss_sim.testbed import State, Testbed, step
from fss_sim.ticker import Ticker
from fss_sim.timeline import Timeline
from fss_sim.vehicle_topics import VehicleTopics
from fss_sim.vehicles import check_keys, read_vehicles


class TestbedNode(Node):
    """Free-floating vehicles and their links' electronics, observed by VICON and FOG."""

    def __init__(self, **options: Any) -> None:
        super().__init__("testbed", **options)
        self.settings = settings = declare(self, TestbedSettings, live=True)
        self.lock, self.seed = RLock(), settings.seed
        times = settings.keep_clock, settings.speed, settings.paused
        self.timeline = Timeline(self, *times, lambda: int(self.get_clock().now().nanoseconds))
        self.vehicles = [
            VehicleTopics(self, self.lock, self.timeline.stamp, one, name)
            for name, one in read_vehicles(settings).items()
        ]
        check_keys({vehicle.name: vehicle.keys.values() for vehicle in self.vehicles})
        if settings.keep_clock:
            self.clock = self.create_publisher(ClockMessage, "/clock", SENSOR)
        self.clock_message = SerializedClock()
        if settings.lockstep:
            wait_for_nodes(self, self.lock, self.timeline)
        self.start([v.settings.initial_state(v.n) for v in self.vehicles])
        declare_faults(self, self.lock, self.vehicles)
        self.create_service(SetBool, "sim/pause", self.on_pause)
        self.create_service(StepTime, "sim/step", self.on_step)
        self.create_service(ResetTestbed, "sim/reset", self.on_reset)
        self.create_service(Trigger, "sim/charge", self.on_charge)
        self.diagnostics = [Diagnostics(self, self.health)]
        self.get_logger().info(f"ready for drivers (links: {len(self.wires)})")
        for vehicle in self.vehicles if settings.vehicles else ():
            name = f"{vehicle.namespace}{self.get_name()}"
            health = partial(vehicle.health, "no contact")
            self.diagnostics.append(Diagnostics(self, health, name=name))
        self.ticker = Ticker(self.tick, self.create_guard_condition(self.on_failure))

    @property
    def testbed(self) -> Testbed:
        """Test bed of the first vehicle, or of the only one."""
        return self.vehicles[0].testbed

    @property
    def frame(self) -> int:
        """Number of the last simulated frame."""
        return self.testbed.frame

    @property
    def wires(self) -> list[Any]:
        """Connections of all links."""
        return [wire for vehicle in self.vehicles for wire in vehicle.wires]

    def start(self, states: list[State]) -> None:
        """Create the vehicles in these states, and start their time now."""
        start_vehicles(self.vehicles, self.settings, states, self.seed)
        self.timeline.start()
        for vehicle in self.vehicles:
            vehicle.publish_faults()

    def tick(self) -> float:
        """Simulate the frames that are due; return the time to wait before the next tick [s]."""
        with self.lock:
            return self.timeline.tick()

    def on_failure(self) -> None:
        """Stop the node with the error of the thread, if the thread has failed."""
        if self.ticker.error and self.context.ok():
            raise self.ticker.error

    def make_frames(self, count: int) -> None:
        """Simulate frames and publish their outputs."""
        for _ in range(count):
            reports = step([vehicle.testbed for vehicle in self.vehicles])
            for vehicle, report in zip(self.vehicles, reports, strict=True):
                vehicle.report(report)

    def receive(self, delay: int) -> Iterator[int]:
        """Pass on datagrams as received `delay` ns after the last frame; yield each one's link."""
        before = 0
        for vehicle in self.vehicles:
            for link in vehicle.receive(delay):
                yield before + link
            before += len(vehicle.wires)

    def publish_clock(self, stamp: int) -> None:
        """Publish a time [ns] on /clock, for all nodes."""
        self.clock.publish(self.clock_message.serialize(stamp))

    def on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        """Pause or resume the time."""
        with self.lock:
            problem = self.timeline.pause(request.data)
        response.success = not problem
        response.message = problem or ("paused" if request.data else "running")
        return response

    def on_step(self, request: StepTime.Request, response: StepTime.Response) -> StepTime.Response:
        """Simulate frames; commands received before the request act from the first frame on."""
        receive_pending(self)
        with self.lock:
            response.message = self.timeline.step(request.frames)
            response.success = not response.message
            response.stamp = to_time(self.timeline.stamp())
        return response

    def on_reset(
        self, request: ResetTestbed.Request, response: ResetTestbed.Response
    ) -> ResetTestbed.Response:
        """Restart from the parameters, not from the state file; only boot numbers continue."""
        with self.lock:
            self.seed = request.seed if request.seed >= 0 else self.seed
            self.start([vehicle.reset() for vehicle in self.vehicles])
        response.success, response.message = True, f"restarted with seed {self.seed}"
        return response

    def on_charge(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Charge all batteries immediately."""
        with self.lock:
            for vehicle in self.vehicles:
                vehicle.testbed.charge()
        response.success, response.message = True, "all batteries are full"
        return response

    def health(self) -> Health:
        """Return the status of the time; with only one vehicle, also that of the vehicle."""
        with self.lock:
            state, is_slow, values = self.timeline.status()
            if channel := self.testbed.radio_channel:
                values["airtime used"] = channel.utilization(self.testbed.now)
        level = WARN if is_slow else OK
        if is_slow:
            self.get_logger().warning(state, throttle_duration_sec=10.0)
        if self.settings.vehicles:
            return Health(level, f"{state}, {len(self.vehicles)} vehicles", values)
        vehicle = self.vehicles[0].health()
        message = f"{state}, {vehicle.message}" if vehicle.message else state
        return Health(max(level, vehicle.level), message, {**values, **vehicle.values})

    def close(self) -> None:
        """Save the state and close the ports."""
        self.ticker.close()
        for vehicle in self.vehicles:
            vehicle.close()


if __name__ == "__main__":
    sys.exit(main())
