"""The node of the base's board: its telemetry to topics, wrenches and pulses to its valves.

A thread takes the board's datagrams and publishes what they say; all else happens in the executor.
What they share is the session, under a lock.
"""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from math import isfinite
from threading import RLock
from typing import Any

import numpy as np
from geometry_msgs.msg import WrenchStamped
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.task import Future
from sensor_msgs.msg import BatteryState, FluidPressure, Imu
from std_msgs.msg import Bool, Empty, Float64
from std_srvs.srv import SetBool, Trigger

from fss_arm_driver.host_clock import HostClock
from fss_arm_driver.receiver import Receiver
from fss_arm_driver.session import Arming, CommandError, News
from fss_arm_driver.transport import Transport, is_exposed, open_transport
from fss_arm_msgs.msg import BaseTelemetry, GripperState, ThrusterCommand, ThrusterHealth
from fss_arm_ros.convert import SECOND, stamp_ns
from fss_arm_ros.diagnostics import Diagnostics, Health
from fss_arm_ros.events import report
from fss_arm_ros.parameters import declare, declare_live
from fss_arm_ros.qos import LATCHED, SENSOR, command
from fss_arm_ros.run import RCLError
from fss_arm_ros.timer_clock import timer_clock
from fss_arm_ros.validation import subscribe
from fss_base_driver import messages
from fss_base_driver.allocation import Allocation
from fss_base_driver.gyro import BiasError, BiasSearch, Sums
from fss_base_driver.programs import base as main
from fss_base_driver.protocol import BOARD, TIME_UNIT, VALVES, BaseSlow
from fss_base_driver.session import NO_PULSE, BoardSession, Heard
from fss_base_driver.settings import BaseSettings, live_kinds

SIMULATED_STEP = 0.01  # of /clock [s]
AHEAD = 0.5  # by which a stamp may seem to come from the future [s]
OFF = VALVES * (0.0,)


class BaseNode(Node):
    """Publishes what the base's board measures, and opens its valves when asked.

    Args:
        transport: to the board, instead of the parameter `url`.
        clock: the computer's, but for tests.
    """

    def __init__(
        self, transport: Transport | None = None, clock: HostClock | None = None, **options: Any
    ) -> None:
        super().__init__("base", **options)
        self.settings = s = declare(self, BaseSettings, live=True)
        simulated = self.get_parameter("use_sim_time").value
        if simulated:
            clock = HostClock(self.simulated_now, self.simulated_now)
        self.clock = clock or HostClock()
        self.now = self.clock.now
        self.session = BoardSession(
            s.timeout, s.watchdog, s.command_lifetime, s.max_on_time,
            SIMULATED_STEP if simulated else 0.0, s.key(), s.empty, self.clock.ahead,
        )  # fmt: skip
        self.transport = transport or open_transport(s.url, BOARD, s.key())
        self.lock = RLock()
        self.live: dict[str, Any] = {name: kind() for name, kind in live_kinds().items()}
        self.found = ThrusterHealth()  # of the valves, by the navigation
        self.wrench: tuple[tuple[float, float, float], int] | None = None  # and when given
        self.shared = 0  # when a wrench was shared out last
        self.sums = Sums()
        self.search: BiasSearch | None = None
        self.result: tuple[float, float] | str | None = None  # of it
        self.changes = News(self.session)
        self.sent, self.warned = NO_PULSE, {"trouble": self.transport.trouble}
        self.waiting: list[Future] = []
        self.seeking: Future | None = None  # who asked for the gyro's bias
        if is_exposed(s.url, s.keys):
            self.get_logger().warning(
                f"{s.url}: frames are not signed, so anybody on this network can open the valves; "
                "see docs/how-to/security.md"
            )

        def publish(kind: type, topic: str) -> Any:
            return self.create_publisher(kind, topic, SENSOR)

        self.telemetry = publish(BaseTelemetry, "base/telemetry")
        self.imu, self.gripper = publish(Imu, "fog/imu"), publish(GripperState, "gripper/state")
        self.pressure = publish(FluidPressure, "base/pressure")
        self.battery = publish(BatteryState, "base/battery")
        self.propellant = publish(Float64, "base/propellant")
        self.pulses = publish(ThrusterCommand, "thrusters/pulses")
        lives = command(s.command_lifetime)
        subscribe(self, ThrusterCommand, "thrusters/command", self.on_thrust, lives)
        lives = command(s.wrench_lifetime)
        subscribe(self, WrenchStamped, "base/wrench", self.on_wrench, lives)
        self.create_subscription(Bool, "gripper/command", self.on_grip, command(1.0))
        subscribe(self, ThrusterHealth, "thrusters/health", self.on_found, LATCHED)
        for topic in ("base/stop", "arm/stop"):
            self.create_subscription(Empty, topic, self.on_stop, 10)
        group = ReentrantCallbackGroup()  # answers wait for the board's; all else goes on
        self.create_service(SetBool, "base/arm", self.on_arm, callback_group=group)
        self.create_service(Trigger, "base/find_gyro_bias", self.on_find, callback_group=group)
        clock_of_timers = timer_clock(self)
        self.steady = self.create_timer(1.0 / s.rate, self.send, clock=clock_of_timers)
        self.sharing = self.create_timer(s.wrench_period, self.share, clock=clock_of_timers)
        declare_live(self, live_kinds(), self.on_live)
        self.allocation = self.new_allocation()
        self.board_health = messages.BoardHealth(self.session, self.transport, bool(s.keys))
        self.diagnostics = Diagnostics(self, self.health, s.url)
        self.news = self.create_guard_condition(self.answer)
        self.receiver = Receiver(self.transport, self.poll, self.news)

    def simulated_now(self) -> int:
        """The time of /clock [ns]; 0 before its first message."""
        return int(self.get_clock().now().nanoseconds)

    def poll(self, datagrams: list[bytes]) -> None:
        """Take what has come. Without a clock yet nothing can be stamped: it is dropped."""
        with self.lock:
            now = self.now()
            try:
                for data in datagrams if now else ():
                    if heard := self.session.feed(data, now):
                        self.publish(heard, now)
            except RCLError:
                if self.context.ok():
                    raise
                return  # shut down meanwhile
        if self.waiting:
            self.news.trigger()

    def publish(self, heard: Heard, now: int) -> None:
        """Publish what the board says; its rate of turn before all else."""
        heard = heard._replace(stamp=heard.stamp + self.clock.ahead)
        frame, slow = heard.frame, self.session.slow
        self.publish_rate(heard)
        frame_id, prefix = self.settings.base_frame, self.settings.frame_prefix
        self.telemetry.publish(messages.telemetry(heard, self.session, now, frame_id))
        self.gripper.publish(messages.gripper_state(heard, f"{prefix}end_effector"))
        if frame.slow_id == BaseSlow.BATTERY:
            voltage = self.session.battery.voltage
            self.battery.publish(messages.battery(heard.stamp, voltage, f"{prefix}base"))
        if frame.slow_id == BaseSlow.TANK:
            kilopascals = frame.slow_value
            self.pressure.publish(messages.pressure(heard.stamp, kilopascals, f"{prefix}tank"))
            if left := messages.propellant(slow, self.settings.tank_volume):
                self.propellant.publish(left)

    def publish_rate(self, heard: Heard) -> None:
        """Publish the mean rate of turn since the frame before, at the middle of that time."""
        if (turn := self.sums.take(heard.frame, heard.stamp)) is None:
            return
        gyro, settings = self.live["gyro"], self.settings
        rate = gyro.scale * turn.counts
        deviation = settings.gyro_noise / turn.samples**0.5
        frame_id = settings.base_frame
        self.imu.publish(messages.imu(turn.stamp, rate - gyro.bias, deviation, frame_id))
        if self.search:
            self.seek(turn.stamp, rate, turn.samples, heard.frame.valves)

    def seek(self, stamp: int, rate: float, samples: int, valves: int) -> None:
        """Let the search for the gyro's bias go on."""
        if self.search:
            try:
                self.result = self.search.take(stamp, rate, samples, valves)
            except BiasError as error:
                self.result = str(error)
        if self.result:
            self.search = None
            self.news.trigger()

    def send(self) -> None:
        """Send the command of the moment, and say what has become of earlier requests."""
        with self.lock:
            self.transmit()
        self.answer()
        self.complain()

    def transmit(self) -> None:
        """Send the command of the moment, and publish what is new in it."""
        now = self.now()
        self.transport.send(self.session.command(now))
        self.steady.reset()
        pulse, last = self.session.pulse, self.sent
        if pulse.number == last.number:
            return
        self.sent = pulse
        stamp = now + self.clock.ahead
        if pulse.number:
            times = [1e-6 * TIME_UNIT * time for time in pulse.on_times]
            self.pulses.publish(messages.pulses(stamp, times))
        elif now < last.given + last.longest:  # closed before its time
            self.pulses.publish(messages.pulses(stamp, OFF))

    @contextmanager
    def taking(self, topic: str) -> Iterator[None]:
        """Hold the session; say what of a topic is not taken, and count it."""
        with self.lock:
            try:
                yield
                self.warn("refused", "")
            except CommandError as error:
                self.session.counts["commands_refused"] += 1
                self.warn("refused", f"{topic} is refused: {error}")

    def on_thrust(self, message: ThrusterCommand) -> None:
        """Open the valves that a person asks for; a wrench waits for the next one."""
        with self.taking("thrusters/command"):
            given = self.given(message, self.settings.command_lifetime)
            self.session.thrust(message.on_time, given, self.now())
            self.wrench = None
            self.transmit()

    def on_wrench(self, message: WrenchStamped) -> None:
        """Take a wrench, and share it out at once if none was for a period."""
        with self.taking("base/wrench"):
            given = self.given(message, self.settings.wrench_lifetime)
            self.session.require_armed()
            self.wrench = self.planar(message), given
            if self.now() - self.shared >= SECOND * self.settings.wrench_period:
                self.share()

    def planar(self, message: WrenchStamped) -> tuple[float, float, float]:
        """Force along the base's x and y [N] and torque [N m], or CommandError."""
        frame, base = message.header.frame_id, self.settings.base_frame
        if frame not in ("", base):
            raise CommandError(f"its frame is {frame[:40]!r}, expected {base!r}")
        wrench = message.wrench.force.x, message.wrench.force.y, message.wrench.torque.z
        if not all(map(isfinite, wrench)):
            raise CommandError(f"force and torque are {wrench}, expected finite numbers")
        return wrench

    def share(self) -> None:
        """Give the next period's part of the wrench in force; no more until one is, if none is."""
        if self.wrench is None:
            self.sharing.cancel()
            return
        with self.taking("base/wrench"):
            now, (wrench, given) = self.now(), self.wrench
            if now - given > SECOND * self.settings.wrench_lifetime or not any(wrench):
                self.wrench = None
                self.allocation = self.new_allocation()  # nothing is owed any more
            if now - given > SECOND * self.settings.wrench_lifetime:
                return  # what was given ends by itself
            times = self.allocation.on_times(wrench).tolist() if any(wrench) else OFF
            self.session.thrust(times, now, now)
            self.shared = now
            self.sharing.reset()
            self.transmit()

    def new_allocation(self) -> Allocation:
        """How wrenches are shared out, by the valves that work."""

        def stuck(how: str) -> list[int]:
            found = getattr(self.found, how)
            return [
                i for i in range(VALVES) if found[i] or getattr(self.live[f"valve_{i + 1}"], how)
            ]

        s = self.settings
        return Allocation(
            s.valves(), s.wrench_period, s.minimum_on_time, stuck("stuck_open"),
            stuck("stuck_closed"),
        )  # fmt: skip

    def on_found(self, message: ThrusterHealth) -> None:
        """Do without the valves that do not do what they are told."""
        with self.lock:
            self.found = message
            self.allocation = self.new_allocation()

    def given(self, message: Any, lifetime: float) -> int:
        """When a message was given, by the clock that nobody sets, if it is not too old."""
        now = self.now()
        if not (stamp := stamp_ns(message.header.stamp)):
            raise CommandError("it has no stamp, so that a recording could not be told from it")
        age = (now + self.clock.ahead - stamp) / SECOND
        if not -AHEAD <= age <= lifetime:
            raise CommandError(f"it is {age:.3f} s old, expected at most {lifetime:g} s")
        return min(now, stamp - self.clock.ahead)

    def on_grip(self, message: Bool) -> None:
        """Close the gripper, or open it."""
        with self.taking("gripper/command"):
            self.session.grip(message.data, self.now())
            self.transmit()

    def on_stop(self, _: Empty) -> None:
        """Close all valves at once."""
        with self.lock:
            self.wrench = None
            self.session.stop()
        self.send()

    async def on_arm(self, request: SetBool.Request, response: SetBool.Response) -> Any:
        """Arm or disarm; answer when the board has."""
        try:
            with self.lock:
                if request.data:
                    self.session.arm(self.now())
                else:
                    self.session.disarm()
            self.waiting.append(settled := Future())
            self.send()
            await settled
            response.success, response.message = self.outcome(request.data)
        except CommandError as error:
            response.success, response.message = False, str(error)
        return response

    def outcome(self, arm: bool) -> tuple[bool, str]:
        """Whether the board has armed or disarmed, and how it is in words."""
        session = self.session
        done = session.armed if arm else session.released
        if done or arm or session.arming is not Arming.DISARMED:
            words = messages.state_words(session), "" if done else session.strain
            return done, "; ".join(filter(None, words))
        how = "is lost" if session.lost else "does not say that its valves are closed"
        return False, f"{session.partner.name} {how}: asked to disarm, not confirmed"

    async def on_find(self, _: Trigger.Request, response: Trigger.Response) -> Any:
        """Find the gyro's bias while the base is at rest, and set it."""
        s = self.settings
        with self.lock:
            if self.seeking or self.session.lost:
                response.message = "it is being sought" if self.seeking else self.session.absence
                return response
            self.seeking = Future()
            self.result = None
            self.search = BiasSearch(s.bias_time, s.bias_scatter, s.max_bias)
        result = await self.seeking
        self.seeking = None
        if isinstance(result, str):
            response.message = result
            return response
        bias, deviation = result
        self.set_parameters([Parameter("gyro.bias", value=bias)])
        response.success = True
        response.message = f"gyro.bias is {bias:.3g} rad/s, +- {deviation:.1g}"
        return response

    def on_live(self, prefix: str, field: str, value: float) -> None:
        """A parameter was set."""
        with self.lock:
            self.live[prefix] = replace(self.live[prefix], **{field: value})
            self.allocation = self.new_allocation()

    def complain(self) -> None:
        """Log what has changed, and what is wrong, once each time that it begins."""
        with self.lock:
            news = self.changes(self.now())
        report(self, news)
        session, trouble = self.session, self.transport.trouble
        self.warn("trouble", trouble and f"{self.settings.url}: {trouble}")
        self.warn("rival", session.rival)

    def warn(self, kind: str, text: str) -> None:
        """Log a warning once in a row."""
        if text not in ("", self.warned.get(kind)):
            self.get_logger().warning(text)
        self.warned[kind] = text

    def answer(self) -> None:
        """Answer requests that have come to an end."""
        if self.receiver.error and self.context.ok():
            raise self.receiver.error
        while self.waiting and self.session.settled:
            self.waiting.pop().set_result(None)
        if self.search and self.session.lost:
            self.search, self.result = None, self.session.absence
        if self.seeking and self.result and not self.seeking.done():
            self.seeking.set_result(self.result)

    def health(self) -> Health:
        """For diagnostics."""
        more: dict[str, Any] = {"gyro bias [rad/s]": self.live["gyro"].bias}
        for name, valve in self.live.items():
            for how, value in vars(valve).items() if name != "gyro" else ():
                if value:
                    more[f"{name} is said to be"] = how.replace("_", " ")
        for how in ("stuck_open", "stuck_closed"):
            for i in np.flatnonzero(getattr(self.found, how)):
                more[f"valve_{i + 1} is found to be"] = how.replace("_", " ")
        with self.lock:
            return self.board_health(self.now(), more)

    def close(self) -> None:
        """Close all valves, and give the port back."""
        with self.lock:
            self.session.disarm()
            self.transport.send(self.session.command(self.now()))
        self.receiver.close()
        self.transport.close()


if __name__ == "__main__":
    sys.exit(main())
