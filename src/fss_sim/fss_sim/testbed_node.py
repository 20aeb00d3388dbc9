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
from fss_sim.pace import Clocked, FlatOut, Pace
from fss_sim.programs import testbed as main
from fss_sim.sensors import RATE
from fss_sim.settings import TestbedSettings
from fss_sim.testbed import FRAME, State, Testbed, step, together
from fss_sim.ticker import Ticker
from fss_sim.vehicle_topics import VehicleTopics, at_one_time
from fss_sim.vehicles import vehicles
from fss_sim.vicon import TARGET

BURST = RATE  # largest number of late frames per tick, so that the node remains responsive
STALL = 0.3  # longest stall of a busy computer that is made up for, in real time [s]
TOGETHER = 5  # number of frames for which the clock is published once
TOLD = 0.5  # period of publishing the clock while paused [s]
ROS_TIME = (
    "the time is ROS time as it is: start the test bed with -p keep_clock:=true, and all other "
    "nodes with -p use_sim_time:=true, to pause and step it"
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
            for name, one in vehicles(settings).items()
        ]
        check_keys(self.vehicles)
        if settings.keep_clock:
            self.clock = self.create_publisher(ClockMessage, "/clock", SENSOR)
        self.clock_image = SerializedClock()
        self.told = 0.0  # when the clock was last published [s]
        self.seed, self.paused = settings.seed, settings.paused
        self.begin([v.settings.begin(v.n) for v in self.vehicles])
        self.declare_faults()
        self.create_service(SetBool, "sim/pause", self.on_pause)
        self.create_service(StepTime, "sim/step", self.on_step)
        self.create_service(ResetTestbed, "sim/reset", self.on_reset)
        self.create_service(Trigger, "sim/charge", self.on_charge)
        self._counted = self.testbed.frame, time.monotonic()
        self.diagnostics = [Diagnostics(self, self.health)]
        for vehicle in self.vehicles if settings.vehicles else ():
            name = f"{vehicle.space}{self.get_name()}"
            health = partial(self.health_of, vehicle, "no contact")
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

    def begin(self, states: list[State]) -> None:
        """Create the vehicles in these states, and start their time now."""
        plants: list[Any] = [None]
        if self.settings.vehicles:
            plants = [v.made(state) for v, state in zip(self.vehicles, states, strict=True)]
            together(plants, states)
        states = at_one_time(states)
        kinds = [kind for vehicle in self.vehicles for kind in vehicle.subjects]
        kinds += [TARGET] if self.settings.target_mass else []
        air = self.settings.air(f"{self.seed}, {states[0].boots}")
        vicon = self.settings.vicon(self.seed, kinds)
        for vehicle, plant, state in zip(self.vehicles, plants, states, strict=True):
            seed = self.seed + vehicle.settings.seed - self.settings.seed
            vehicle.begin(plant, state, seed, air, vicon)
        self.pace = self.new_pace()
        for vehicle in self.vehicles:
            vehicle.publish_faults()

    def declare_faults(self) -> None:
        """Declare each fault of each vehicle as a parameter."""
        owners = {prefix: vehicle for vehicle in self.vehicles for prefix in vehicle.kinds()}
        found = {prefix: kind for v in self.vehicles for prefix, kind in v.kinds().items()}

        def on_fault(prefix: str, fault: str, value: float) -> None:
            with self.lock:
                owner = owners[prefix]
                owner.set_fault(prefix.removeprefix(owner.prefix), fault, value)

        declare_live(self, found, on_fault)

    def new_pace(self) -> Pace:
        """Return the pace that the settings select, starting at the present frame."""
        frame = self.testbed.frame
        if not self.settings.keep_clock:
            return Clocked(self._ros_time, frame, back=SECOND, ahead=30 * SECOND)
        if not self.settings.speed:
            return FlatOut()
        # If frames cannot be computed in time, time runs slower, but a short stall is made up for.
        speed = self.settings.speed
        ahead = round(max(1.0, STALL * speed) * SECOND)
        return Clocked(self._own_time, frame, back=SECOND, ahead=ahead, speed=speed)

    def tick(self) -> float:
        """Simulate the frames that are due, and pass on the received datagrams.

        Returns:
            Time to wait before the next tick [s].
        """
        with self.lock:
            due = 0 if self.paused else self.pace.due(self.testbed.frame)
            for made in range(0, min(due, BURST), TOGETHER):
                self.make_frames(min(due - made, TOGETHER))
                if self.settings.keep_clock:
                    self.receive()
            # Check again: after a stall meanwhile, datagrams would be processed too early.
            if not self.paused and max(due, self.pace.due(self.testbed.frame)) <= BURST:
                self.receive()
            if self.paused and time.monotonic() - self.told > TOLD:
                self.tell_time(self.stamp())  # for nodes that have started meanwhile
        return self.pace.rest if due <= BURST else 0.0

    def on_failure(self) -> None:
        """Stop the node with the error of the thread, if the thread has failed."""
        if self.ticker.error and self.context.ok():
            raise self.ticker.error

    def make_frames(self, count: int) -> None:
        """Simulate `count` frames; publish the clock first, so that no stamp is ahead of it."""
        if self.settings.keep_clock:
            self.tell_time(self.stamp() + count * FRAME)
        for _ in range(count):
            reports = step([vehicle.testbed for vehicle in self.vehicles])
            for vehicle, report in zip(self.vehicles, reports, strict=True):
                vehicle.report(report)

    def tell_time(self, stamp: int) -> None:
        """Publish a time [ns] on /clock, for all nodes."""
        self.clock.publish(self.clock_image.of(stamp))
        self.told = time.monotonic()

    def receive(self) -> None:
        """Pass on datagrams as received now, or at the last frame if keep_clock is set."""
        frame = self.testbed.frame
        late = 0 if self.settings.keep_clock else self.pace.late(frame)
        late = min(max(late, 0), FRAME - 1)
        before = 0
        for vehicle in self.vehicles:
            for link in vehicle.receive(late):
                self.pace.hear(before + link, frame)
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
                response.message = "time runs: pause it first (sim/pause)" if kept else ROS_TIME
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
        """Restart from the parameters, not from the state file; only boot numbers continue."""
        with self.lock:
            self.seed = request.seed if request.seed >= 0 else self.seed
            for wire in self.all_wires():
                wire.reset()
            self.begin(
                [replace(v.settings.fresh(v.n), boot_offset=v.testbed.boot) for v in self.vehicles]
            )
        response.success, response.message = True, f"begun with seed {self.seed}"
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
        before, then = self._counted
        self._counted = frame, now
        speed = (frame - before) / RATE / max(now - then, 1e-9)
        slow = now - then > 0.5 and speed < 0.95 * self.settings.speed and not self.paused
        values = {"simulated time [s]": frame / RATE, "speed": speed}
        values["VICON's frame"], values["clock jumps"] = frame, self.pace.jumps
        if self.testbed.air:
            values["airtime used"] = self.testbed.air.used(self.testbed.now)
        state = "paused" if self.paused else "too slow" if slow else "running"
        level = WARN if slow else OK
        if self.settings.vehicles:
            return Health(level, f"{state}, {len(self.vehicles)} vehicles", values)
        found = self.health_of(self.vehicles[0])
        words = f"{state}, {found.message}" if found.message else state
        return Health(max(level, found.level), words, {**values, **found.values})

    def health_of(self, vehicle: VehicleTopics, apart: str = "") -> Health:
        """Return the status of a vehicle; `apart` is the message if there is no problem."""
        words = [vehicle.unwritten] if vehicle.unwritten else []
        if vehicle.touches():
            words += ["bodies touch each other or the table's border"]
        if not vehicle.testbed.plant.thrusters.floats:
            words += ["without air the bearings rub on the table"]
        return Health(WARN if words else OK, ", ".join(words) or apart, vehicle.values())

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

    def _own_time(self) -> int:
        return int(time.monotonic_ns() * self.settings.speed)

    def _ros_time(self) -> int:
        return int(self.get_clock().now().nanoseconds)


def check_keys(vehicles: Sequence[VehicleTopics]) -> None:
    """Raise SettingError if links of two vehicles would accept each other's commands."""
    for one, other in combinations(vehicles, 2):
        if set(one.keys.values()) & set(other.keys.values()):
            raise SettingError(f"{one.name} and {other.name} have a key in common")


if __name__ == "__main__":
    sys.exit(main())
