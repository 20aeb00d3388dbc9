"""Node of one link; separate threads receive its telemetry, and commands and stops."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from rclpy.parameter import Parameter
from sensor_msgs.msg import BatteryState, JointState
from std_msgs.msg import Empty
from std_srvs.srv import Trigger

from fss_arm_driver.messages import LinkHealth, SampleMessages, command_status, command_values
from fss_arm_driver.programs import link as main
from fss_arm_driver.protocol import Slow
from fss_arm_driver.session import CommandReports, LinkSession, Report, Status
from fss_arm_driver.settings import LinkSettings
from fss_arm_driver.transport import open_transport
from fss_arm_msgs.msg import CommandStatus, LinkCommand, LinkPath, LinkTelemetry
from fss_arm_ros.convert import stamp_ns
from fss_arm_ros.diagnostics import Health
from fss_arm_ros.qos import COMMAND, SENSOR
from fss_arm_ros.subscriptions import SubscriptionThread, Topic, stop_topics
from fss_arm_ros.timers import OneShotTimer, timer_clock
from fss_arm_ros.validation import subscribe
from fss_link.session import CommandError
from fss_link.session_node import SessionNode
from fss_link.transport import Transport


class LinkNode(SessionNode):
    """Node that publishes what one link measures and sends it commands at a steady rate.

    Args:
        number: of the link.
        url: address of its electronics.
        transport: used instead of `url`.
        kind: LinkSettings or a subclass.
        options: of SessionNode.
    """

    session: LinkSession

    def __init__(
        self,
        number: int = 1,
        url: str = "",
        transport: Transport | None = None,
        kind: type[LinkSettings] = LinkSettings,
        **options: Any,
    ) -> None:
        overrides = [Parameter("link", value=number), *options.pop("parameter_overrides", ())]
        if url:
            overrides.append(Parameter("url", value=url))
        options["parameter_overrides"] = overrides
        super().__init__(f"link_{number}", kind, **options)
        s: LinkSettings = self.settings
        times, offset = (s.timeout, s.watchdog, self.resolution), self.clock.offset
        session = LinkSession(number, s.link_description(), *times, s.key(), s.empty, offset, s.arm)
        self.connect(session, transport or open_transport(s.url, number, s.key()))
        self.messages, self.reports = SampleMessages(session, s.frame_prefix), CommandReports()
        name, clock = session.partner.label, timer_clock(self)
        self.joint_states = self.create_publisher(JointState, "joint_states", SENSOR)
        self.telemetry = self.create_publisher(LinkTelemetry, f"{name}/telemetry", SENSOR)
        self.battery = self.create_publisher(BatteryState, f"{name}/battery", SENSOR)
        self.status = self.create_publisher(CommandStatus, f"{name}/command_status", SENSOR)
        subscribe(self, LinkPath, f"{name}/path", self.on_path, 10)
        self.create_service(Trigger, f"{name}/clear_faults", self.on_clear_faults)
        self.delayed_send = OneShotTimer(self, self.send, clock)
        self.start_communication(f"{name}/arm", LinkHealth)
        command = Topic(LinkCommand, f"{name}/command", COMMAND, self.on_command)
        stops = stop_topics(self.on_stop, "arm/stop")
        self.commands = SubscriptionThread(self, [*stops, command])

    def process_datagram(self, data: bytes, now: int, sheds: bool) -> None:
        """Publish the contents of a datagram; the joint's state first."""
        if (sample := self.session.measure(data, now)) is None:
            return
        sample = sample._replace(stamp=sample.stamp + self.clock.offset)
        if sample.referenced:  # else the position is not valid
            self.joint_states.publish(self.messages.joint_state(sample))
        self.session.follow(sample)
        if sheds:
            return
        self.telemetry.publish(self.messages.telemetry(sample, now))
        if sample.frame.slow_id == Slow.BATTERY:
            self.battery.publish(self.messages.battery(sample))

    def complete_command(self, now: int) -> None:
        """Send path segments after a command; the next one follows sooner on a path."""
        self.delayed_send.cancel()
        for data in self.session.segments(now):
            self.transport.send(data)
        period = self.settings.command_period(self.session.follows)
        if period != self.steady.timer_period_ns:
            self.steady.timer_period_ns = period
            self.wakeup.trigger()  # wakes the executor

    @contextmanager
    def accepting(self, what: str, given: int) -> Iterator[None]:
        """Context in which a command or a path may be refused; it reports the refusal."""
        try:
            yield
            self.warn(f"{what} refused", "")
        except CommandError as error:
            refusal = Report(Status.REFUSED, str(error), given + self.clock.offset)
            self.status.publish(command_status(refusal, self.now() + self.clock.offset))
            self.warn(f"{what} refused", f"{what} refused: {error}")

    def on_command(self, message: LinkCommand) -> None:
        """Accept a command, valid from the time of its stamp, and send it.

        This runs in a separate thread; the executor reports the command's status later.
        """
        with self.lock:
            now, given = self.now(), stamp_ns(message.header.stamp)
            given = min(given - self.clock.offset, now) if given else now
            with self.accepting("command", given):
                self.session.set(*command_values(message, given), now)
                self.reports.add(self.session.progress)
                self.send_soon(now)

    def send_soon(self, now: int) -> None:
        """Send the accepted command at once, or as soon as the highest rate allows."""
        if wait := self.pacer.wait(now):
            self.delayed_send.start(wait)
            self.wakeup.trigger()  # wakes the executor
        else:
            self.transmit()

    def on_path(self, message: LinkPath) -> None:
        """Accept a path, and send its first segments to the link."""
        with self.lock:
            now, begin = self.now(), stamp_ns(message.header.stamp) - self.clock.offset
            knots = message.time, message.position, message.velocity
            with self.accepting("path", now):
                self.session.give_path(message.path, begin, *knots, now)
            for data in self.session.segments(now):
                self.transport.send(data)

    def on_stop(self, _: Empty) -> None:
        """Stop at once, in a separate thread that does not wait for the executor."""
        with self.lock:
            self.session.stop()
        self.transmit()
        self.wakeup.trigger()

    def on_clear_faults(self, _: Trigger.Request, response: Trigger.Response) -> Any:
        """Disarm and clear the drive's latched faults; telemetry shows those that remain."""
        with self.lock:
            self.session.clear_faults(self.now())
        self.send()
        response.success, response.message = not self.session.lost, "clearing requested"
        if self.session.lost:
            response.message = f"{self.session.partner.label} is lost"
        return response

    def has_pending_answers(self) -> bool:
        """Return True if a request waits, or the last command's status is not yet reported."""
        return bool(self.waiting or self.reports.pending)

    def answer_requests(self) -> None:
        """Report changes: the progress of the last command, and the end of arming."""
        with self.lock:
            for report in self.reports.take_changes(self.clock.offset):
                self.status.publish(command_status(report, self.now() + self.clock.offset))
        super().answer_requests()

    def health(self) -> Health:
        """Return the status for diagnostics, and log, as a stream of commands delays the timer."""
        self.log_changes()
        return super().health()


if __name__ == "__main__":
    sys.exit(main())
