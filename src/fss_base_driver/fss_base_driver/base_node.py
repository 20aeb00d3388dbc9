"""Node `base`: publishes the telemetry of the base's board and sends pulses to its valves."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

from geometry_msgs.msg import WrenchStamped
from std_msgs.msg import Bool, Empty

from fss_arm_msgs.msg import ThrusterCommand, ThrusterHealth
from fss_arm_ros.convert import stamp_ns
from fss_arm_ros.diagnostics import Health
from fss_arm_ros.parameters import declare_live
from fss_arm_ros.qos import LATCHED, SENSOR, command
from fss_arm_ros.subscriptions import SubscriptionThread, stop_topics
from fss_arm_ros.timers import timer_clock
from fss_arm_ros.validation import subscribe, validators
from fss_base_driver import messages
from fss_base_driver.command_time import command_time
from fss_base_driver.gyro_topics import GyroTopics
from fss_base_driver.programs import base as main
from fss_base_driver.session import BoardSession
from fss_base_driver.settings import BaseSettings, live_kinds
from fss_base_driver.stuck_valves import describe_stuck_valves, stuck_valves
from fss_base_driver.wrench_follower import WrenchFollower
from fss_link.session import CommandError
from fss_link.session_node import SessionNode
from fss_link.transport import Transport, open_transport

COMMANDS = "thrusters/command", "base/wrench", "gripper/command"


class BaseNode(SessionNode):
    """Publish what the base's board measures, and open its valves on request.

    Args:
        transport: to the board, instead of the parameter `url`.
    """

    session: BoardSession
    HAS_LIVE_PARAMETERS = True

    def __init__(self, transport: Transport | None = None, **options: Any) -> None:
        super().__init__("base", BaseSettings, **options)
        s: BaseSettings = self.settings
        times = s.timeout, s.watchdog, s.command_lifetime, s.max_on_time
        session = BoardSession(*times, self.resolution, s.key(), s.empty, self.clock.offset)
        self.connect(session, transport or open_transport(s.url))
        self.live: dict[str, Any] = {name: kind() for name, kind in live_kinds().items()}
        self.valve_faults = ThrusterHealth()  # detected by the navigation
        self.wrench, clock = WrenchFollower(s), timer_clock(self)
        self.outputs = {
            topic: self.create_publisher(kind, topic, SENSOR)
            for topic, kind in messages.TOPICS.items()
        }
        subscribe(self, ThrusterCommand, COMMANDS[0], self.on_thrust, command(s.command_lifetime))
        subscribe(self, WrenchStamped, COMMANDS[1], self.on_wrench, command(s.wrench_lifetime))
        subscribe(self, Bool, COMMANDS[2], self.on_grip, command(1.0))
        subscribe(self, ThrusterHealth, "thrusters/health", self.on_valve_faults, LATCHED)
        self.wrench_timer = self.create_timer(s.wrench_period, self.allocate_wrench, clock=clock)
        self.gyro = GyroTopics(self)
        declare_live(self, live_kinds(), self.on_live)
        self.start_communication("base/arm", messages.BoardHealth)
        self.commands = SubscriptionThread(self, stop_topics(self.on_stop, "base/stop", "arm/stop"))

    def process_datagram(self, data: bytes, now: int, sheds: bool) -> None:
        """Decode a datagram and publish its contents; the gyro's rate comes first."""
        if sample := self.session.feed(data, now):
            self.gyro.publish(sample, self.live["gyro"])
            if sheds:
                return
            sample = sample._replace(stamp=sample.stamp + self.clock.offset)
            for topic, message in messages.frame_messages(sample, self.session, now, self.settings):
                self.outputs[topic].publish(message)

    def complete_command(self, now: int) -> None:
        """Publish a new pulse, or that the last one was ended early."""
        if (times := self.session.take_pulse_change(now)) is not None:
            message = messages.pulses(now + self.clock.offset, times)
            self.outputs["thrusters/pulses"].publish(message)

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
            lifetime = self.settings.command_lifetime
            given = command_time(stamp_ns(message.header.stamp), self.clock, lifetime)
            self.session.thrust(message.on_time, given, self.now())
            self.wrench.cancel()
            self.send_soon()

    def on_wrench(self, message: WrenchStamped) -> None:
        """Store a wrench, and allocate it at once if there was none for a period."""
        with self.receiving("base/wrench"):
            lifetime = self.settings.wrench_lifetime
            given = command_time(stamp_ns(message.header.stamp), self.clock, lifetime)
            self.session.require_armed()
            self.wrench.follow(message, given)
            if self.wrench.is_due(self.now()):
                self.allocate_wrench()

    def allocate_wrench(self) -> None:
        """Allocate the active wrench for the next period; without one, stop the timer."""
        if not self.wrench.active:
            self.wrench_timer.cancel()
            return
        with self.receiving("base/wrench"):
            if self.wrench.command_pulses(self.session, self.now()):
                self.wrench_timer.reset()
                self.transmit()

    def on_valve_faults(self, message: ThrusterHealth) -> None:
        """Exclude the valves that the navigation has found stuck."""
        with self.lock:
            self.valve_faults = message
            self.wrench.exclude(*stuck_valves(self.live, message))

    def on_live(self, prefix: str, field: str, value: float) -> None:
        """Update a parameter that was set."""
        with self.lock:
            self.live[prefix] = replace(self.live[prefix], **{field: value})
            self.wrench.exclude(*stuck_valves(self.live, self.valve_faults))

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
        """Close all valves at once, in a separate thread that does not wait for the executor."""
        with self.lock:
            self.wrench.cancel()
            self.session.stop()
        self.transmit()
        self.wakeup.trigger()

    def answer_requests(self) -> None:
        """Answer requests that are complete."""
        super().answer_requests()
        self.gyro.answer_request()

    def health(self) -> Health:
        """Return the status for diagnostics."""
        # Commands that the rule of their type rejects count, too.
        invalid = sum(each.refused for each in validators(self) if each.topic in COMMANDS)
        refused = self.session.counts["commands_refused"] + invalid
        values = {**self.gyro.values(self.live["gyro"]), "commands refused": refused}
        values |= describe_stuck_valves(self.live, self.valve_faults)
        with self.lock:
            return self.session_health(self.now(), values)

    def close(self) -> None:
        """Close all valves, the threads and the port."""
        with self.lock:
            self.session.disarm()
            self.transport.send(self.session.command(self.now()))
        super().close()


if __name__ == "__main__":
    sys.exit(main())
