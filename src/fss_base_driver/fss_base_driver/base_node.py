"""Node `base`: publishes the telemetry of the base's board and sends pulses to its valves."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from math import inf
from typing import Any

import numpy as np
from geometry_msgs.msg import WrenchStamped
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.parameter import Parameter
from rclpy.task import Future
from sensor_msgs.msg import BatteryState, FluidPressure, Imu
from std_msgs.msg import Bool, Empty, Float64
from std_srvs.srv import Trigger

from fss_arm_msgs.msg import BaseTelemetry, GripperState, ThrusterCommand, ThrusterHealth
from fss_arm_ros.convert import SECOND, stamp_ns
from fss_arm_ros.diagnostics import Health
from fss_arm_ros.parameters import declare_live
from fss_arm_ros.qos import LATCHED, SENSOR, command, subscribe_stop
from fss_arm_ros.timer_clock import timer_clock
from fss_arm_ros.validation import subscribe, validators
from fss_base_driver import messages
from fss_base_driver.allocation import Allocation
from fss_base_driver.gyro import BiasError, BiasSearch, GyroSums
from fss_base_driver.programs import base as main
from fss_base_driver.protocol import TIME_UNIT, VALVES, BaseSlow
from fss_base_driver.session import NO_PULSE, BoardSample, BoardSession, Pulse
from fss_base_driver.settings import BaseSettings, live_kinds
from fss_base_driver.wrench import planar_wrench
from fss_link.pacer import Pacer
from fss_link.session import CommandError
from fss_link.session_node import SessionNode
from fss_link.transport import Transport, open_transport

COMMANDS = "thrusters/command", "base/wrench", "gripper/command"
MAX_STAMP_LEAD = 0.5  # largest lead of a stamp over the clock [s]
MAX_OVERLOAD = 1000.0  # components of a wrench, as multiples of the total thrust
ALL_CLOSED = VALVES * (0.0,)


class BaseNode(SessionNode):
    """Publish what the base's board measures, and open its valves on request.

    Args:
        transport: to the board, instead of the parameter `url`.
        clock: the computer's clock, except in tests.
    """

    session: BoardSession
    unconfirmed = "does not confirm that its valves are closed"

    def __init__(self, transport: Transport | None = None, **options: Any) -> None:
        super().__init__("base", BaseSettings, live=True, **options)
        s: BaseSettings = self.settings
        self.session = BoardSession(
            s.timeout, s.watchdog, s.command_lifetime, s.max_on_time, self.resolution, s.key(),
            s.empty, self.clock.offset,
        )  # fmt: skip
        transport = transport or open_transport(s.url)
        self.connect(self.session, transport, "open the valves")
        self.live: dict[str, Any] = {name: kind() for name, kind in live_kinds().items()}
        self.valve_faults = ThrusterHealth()  # detected by the navigation
        self.wrench: tuple[tuple[float, float, float], int] | None = None  # active one and its time
        self.allocated_at = 0  # time of the last allocation
        self.pacer, self.sums = Pacer(s.max_rate), GyroSums()
        self.gyro_time = 0  # time of the gyro's last rate
        self.search: BiasSearch | None = None
        self.bias_result: tuple[float, float] | str | None = None  # of the search
        self.last_pulse = NO_PULSE
        self.bias_future: Future | None = None  # completed when the search for the gyro's bias ends

        def publish(kind: type, topic: str) -> Any:
            return self.create_publisher(kind, topic, SENSOR)

        self.telemetry = publish(BaseTelemetry, "base/telemetry")
        self.imu, self.gripper = publish(Imu, "fog/imu"), publish(GripperState, "gripper/state")
        self.pressure = publish(FluidPressure, "base/pressure")
        self.battery = publish(BatteryState, "base/battery")
        self.propellant = publish(Float64, "base/propellant")
        self.pulses = publish(ThrusterCommand, "thrusters/pulses")
        for kind, topic, callback, lifetime in (
            (ThrusterCommand, "thrusters/command", self.on_thrust, s.command_lifetime),
            (WrenchStamped, "base/wrench", self.on_wrench, s.wrench_lifetime),
            (Bool, "gripper/command", self.on_grip, 1.0),
        ):
            subscribe(self, kind, topic, callback, command(lifetime))
        subscribe(self, ThrusterHealth, "thrusters/health", self.on_valve_faults, LATCHED)
        for topic in ("base/stop", "arm/stop"):
            subscribe_stop(self, topic, self.on_stop)
        group = ReentrantCallbackGroup()  # the search takes long; other callbacks run meanwhile
        self.create_service(Trigger, "base/find_gyro_bias", self.on_find_bias, callback_group=group)
        self.allocation_timer = self.create_timer(
            s.wrench_period, self.allocate_wrench, clock=timer_clock(self)
        )
        declare_live(self, live_kinds(), self.on_live)
        self.allocation = self.new_allocation()
        total_thrust = float(np.hypot(*s.valves()[:, :2].T).sum())
        self.max_component = MAX_OVERLOAD * total_thrust  # of a wrench [N, N m]
        self.session.counts["wrenches_clipped"] = 0
        self.board_health = messages.BoardHealth(self.session, self.transport, bool(s.keys))
        self.start_communication("base/arm")

    def process_datagram(self, data: bytes, now: int) -> None:
        """Decode a datagram and publish its contents."""
        if sample := self.session.feed(data, now):
            self.publish(sample, now)

    def publish(self, sample: BoardSample, now: int) -> None:
        """Publish a telemetry frame; the gyro's rate comes first."""
        sample = sample._replace(stamp=sample.stamp + self.clock.offset)
        frame, slow = sample.frame, self.session.slow
        self.publish_rate(sample)
        frame_id, prefix = self.settings.base_frame, self.settings.frame_prefix
        self.telemetry.publish(messages.telemetry(sample, self.session, now, frame_id))
        self.gripper.publish(messages.gripper_state(sample, f"{prefix}end_effector"))
        if frame.slow_id == BaseSlow.BATTERY:
            voltage = self.session.battery.voltage
            self.battery.publish(messages.battery(sample.stamp, voltage, f"{prefix}base"))
        if frame.slow_id == BaseSlow.TANK:
            kilopascals = frame.slow_value
            self.pressure.publish(messages.pressure(sample.stamp, kilopascals, f"{prefix}tank"))
            if left := messages.propellant(slow, self.settings.tank_volume):
                self.propellant.publish(left)

    def publish_rate(self, sample: BoardSample) -> None:
        """Publish the mean turn rate since the last frame, stamped at the middle of that time."""
        if (turn := self.sums.add(sample.frame, sample.stamp)) is None:
            return
        self.gyro_time = self.now()
        gyro, settings = self.live["gyro"], self.settings
        rate = gyro.scale * turn.counts
        deviation = settings.gyro_noise / turn.samples**0.5
        frame_id = settings.base_frame
        self.imu.publish(messages.imu(turn.stamp, rate - gyro.bias, deviation, frame_id))
        if self.search:
            self.update_bias_search(turn.stamp, rate, turn.samples, sample.frame.valves)

    def update_bias_search(self, stamp: int, rate: float, samples: int, valves: int) -> None:
        """Pass a rate to the search for the gyro's bias, and store the result."""
        if self.search:
            try:
                self.bias_result = self.search.add(stamp, rate, samples, valves)
            except BiasError as error:
                self.bias_result = str(error)
        if self.bias_result:
            self.search = None
            self.wakeup.trigger()

    def transmit(self) -> None:
        """Send the present command, and publish a new pulse."""
        with self.lock:
            now = self.now()
            self.transport.send(self.session.command(now))
            self.pacer.sent(now)
            self.steady.reset()
            self.publish_pulse(now, self.session.pulse, self.last_pulse)
            self.last_pulse = self.session.pulse

    def publish_pulse(self, now: int, pulse: Pulse, last: Pulse) -> None:
        """Publish a new pulse, or that the last one was ended early."""
        stamp = now + self.clock.offset
        if pulse.number == last.number:
            return
        if pulse.number:
            times = [1e-6 * TIME_UNIT * time for time in pulse.on_times]
            self.pulses.publish(messages.pulses(stamp, times))
        elif now < last.given + last.longest:
            self.pulses.publish(messages.pulses(stamp, ALL_CLOSED))

    @contextmanager
    def receiving(self, topic: str) -> Iterator[None]:
        """Context with the session's lock; it logs and counts a rejected message of the topic."""
        with self.lock:
            try:
                yield
                self.warn(topic, "")
            except CommandError as error:
                self.session.counts["commands_refused"] += 1
                self.warn(topic, f"{topic} is refused: {error}")

    def on_thrust(self, message: ThrusterCommand) -> None:
        """Open the requested valves, instead of following the active wrench."""
        with self.receiving("thrusters/command"):
            given = self.message_time(message, self.settings.command_lifetime)
            self.session.thrust(message.on_time, given, self.now())
            self.wrench = None
            self.send_soon()

    def on_wrench(self, message: WrenchStamped) -> None:
        """Store a wrench, and allocate it at once if there was none for a period."""
        with self.receiving("base/wrench"):
            given = self.message_time(message, self.settings.wrench_lifetime)
            self.session.require_armed()
            frame = self.settings.base_frame
            self.wrench = planar_wrench(message, frame, self.max_component), given
            if self.now() - self.allocated_at >= SECOND * self.settings.wrench_period:
                self.allocate_wrench()

    def allocate_wrench(self) -> None:
        """Allocate the active wrench for the next period; without one, stop the timer."""
        if self.wrench is None:
            self.allocation_timer.cancel()
            return
        with self.receiving("base/wrench"):
            now, (wrench, given) = self.now(), self.wrench
            if now - given > SECOND * self.settings.wrench_lifetime or not any(wrench):
                self.wrench = None
                self.allocation = self.new_allocation()  # resets the impulse carried over
            if now - given > SECOND * self.settings.wrench_lifetime:
                return  # the last pulse ends by itself
            times = self.allocation.on_times(wrench).tolist() if any(wrench) else ALL_CLOSED
            self.session.counts["wrenches_clipped"] += self.allocation.clipped
            self.session.thrust(times, now, now)
            self.allocated_at = now
            self.allocation_timer.reset()
            self.transmit()

    def new_allocation(self) -> Allocation:
        """Return an allocation to the valves that work."""

        def stuck(how: str) -> list[int]:
            found = getattr(self.valve_faults, how)
            return [
                i for i in range(VALVES) if found[i] or getattr(self.live[f"valve_{i + 1}"], how)
            ]

        s = self.settings
        return Allocation(
            s.valves(), s.wrench_period, s.minimum_on_time, stuck("stuck_open"),
            stuck("stuck_closed"),
        )  # fmt: skip

    def on_valve_faults(self, message: ThrusterHealth) -> None:
        """Exclude the valves that the navigation has found stuck."""
        with self.lock:
            self.valve_faults = message
            self.allocation = self.new_allocation()

    def message_time(self, message: Any, lifetime: float) -> int:
        """Return the time of a message in the steady clock; reject a message that is too old."""
        now = self.now()
        if not (stamp := stamp_ns(message.header.stamp)):
            raise CommandError("it has no stamp, so it could be an old recording")
        age = (now + self.clock.offset - stamp) / SECOND
        if not -MAX_STAMP_LEAD <= age <= lifetime:
            raise CommandError(f"it is {age:.3f} s old, expected at most {lifetime:g} s")
        return min(now, stamp - self.clock.offset)

    def on_grip(self, message: Bool) -> None:
        """Close the gripper, or open it."""
        with self.receiving("gripper/command"):
            self.session.grip(message.data, self.now())
            self.send_soon()

    def send_soon(self) -> None:
        """Send an accepted command at once, or with the next one if max_rate would be exceeded."""
        if not self.pacer.wait(self.now()):
            self.transmit()

    def on_stop(self, _: Empty) -> None:
        """Close all valves at once."""
        with self.lock:
            self.wrench = None
            self.session.stop()
        self.send()

    def describe_state(self) -> str:
        """Return the board's state as text."""
        return messages.describe_state(self.session)

    async def on_find_bias(self, _: Trigger.Request, response: Trigger.Response) -> Any:
        """Find the gyro's bias while the base is at rest, and set it."""
        s = self.settings
        with self.lock:
            if self.bias_future or self.session.lost:
                running = "a search for the bias is already running"
                response.message = running if self.bias_future else self.session.loss_reason
                return response
            self.bias_future = Future()
            self.bias_result, self.gyro_time = None, self.now()
            self.search = BiasSearch(s.bias_time, s.bias_scatter, s.max_bias)
        result = await self.bias_future
        self.bias_future = None
        if isinstance(result, str):
            response.message = result
            return response
        bias, deviation = result
        self.set_parameters([Parameter("gyro.bias", value=bias)])
        response.success = True
        response.message = f"gyro.bias is {bias:.3g} rad/s, +- {deviation:.1g}"
        return response

    def on_live(self, prefix: str, field: str, value: float) -> None:
        """Update a parameter that was set."""
        with self.lock:
            self.live[prefix] = replace(self.live[prefix], **{field: value})
            self.allocation = self.new_allocation()

    def answer_requests(self) -> None:
        """Answer requests that are complete."""
        super().answer_requests()
        silence = (self.now() - self.gyro_time) / SECOND
        if self.search and (self.session.lost or silence > self.settings.timeout):
            self.search = None
            silent = "the gyro is silent"
            self.bias_result = self.session.loss_reason if self.session.lost else silent
        if self.bias_future and self.bias_result and not self.bias_future.done():
            self.bias_future.set_result(self.bias_result)

    @property
    def commands_refused(self) -> int:
        """Number of commands rejected, those that the rule of their type rejects included."""
        invalid = sum(each.refused for each in validators(self) if each.topic in COMMANDS)
        return self.session.counts["commands_refused"] + invalid

    def health(self) -> Health:
        """Health for the diagnostics."""
        silence = (self.now() - self.gyro_time) / SECOND if self.gyro_time else inf
        more = {"gyro bias [rad/s]": self.live["gyro"].bias, "gyro's age [s]": silence}
        more["commands_refused"] = self.commands_refused
        for name, valve in self.live.items():
            for how, value in vars(valve).items() if name != "gyro" else ():
                if value:
                    more[f"{name} is configured as"] = how.replace("_", " ")
        for how in ("stuck_open", "stuck_closed"):
            for i in np.flatnonzero(getattr(self.valve_faults, how)):
                more[f"valve_{i + 1} is detected as"] = how.replace("_", " ")
        with self.lock:
            return self.board_health(self.now(), more)

    def close(self) -> None:
        """Close all valves and the port."""
        with self.lock:
            self.session.disarm()
            self.transport.send(self.session.command(self.now()))
        super().close()


if __name__ == "__main__":
    sys.exit(main())
