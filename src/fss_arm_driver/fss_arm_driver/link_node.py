"""Node of one link: it publishes telemetry and sends commands to the electronics.

Separate threads receive commands and stops, and send them.
"""

import sys
from collections import deque
from typing import Any

from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import BatteryState, JointState
from std_msgs.msg import Empty
from std_srvs.srv import Trigger

from fss_arm_driver.messages import (
    LinkHealth,
    SampleMessages,
    command_refused,
    command_status,
    describe_state,
)
from fss_arm_driver.programs import link as main
from fss_arm_driver.protocol import Slow
from fss_arm_driver.session import LinkSession, Progress
from fss_arm_driver.settings import LinkSettings
from fss_arm_driver.transport import open_transport
from fss_arm_msgs.msg import CommandStatus, LinkCommand, LinkPath, LinkTelemetry
from fss_arm_ros.convert import SECOND, stamp_ns
from fss_arm_ros.diagnostics import Health
from fss_arm_ros.parameters import declare
from fss_arm_ros.qos import COMMAND, SENSOR, STOPS
from fss_arm_ros.subscriptions import SubscriptionThread, Topic
from fss_arm_ros.timer_clock import timer_clock
from fss_arm_ros.validation import subscribe
from fss_link.host_clock import HostClock
from fss_link.pacer import Pacer
from fss_link.session import CommandError
from fss_link.session_node import SessionNode
from fss_link.transport import Transport

PATH_RATE = 10.0  # rate of commands below which it is doubled on a path [1/s]


class LinkNode(SessionNode):
    """Node that publishes what one link measures and sends it commands at a steady rate.

    Args:
        number: of the link.
        url: address of its electronics.
        transport: used instead of `url`.
        clock: by default the computer's; tests may pass another.
        kind: LinkSettings or a subclass.
    """

    session: LinkSession
    unconfirmed = "does not confirm that it is off"

    def __init__(
        self,
        number: int = 1,
        url: str = "",
        transport: Transport | None = None,
        clock: HostClock | None = None,
        kind: type[LinkSettings] = LinkSettings,
        **options: Any,
    ) -> None:
        overrides = [Parameter("link", value=number), *options.pop("parameter_overrides", ())]
        if url:
            overrides.append(Parameter("url", value=url))
        options["parameter_overrides"] = overrides
        super().__init__(f"link_{number}", kind, clock=clock, **options)
        settings: LinkSettings = self.settings
        self.session = LinkSession(
            number,
            settings.link_description(),
            settings.timeout,
            settings.watchdog,
            self.resolution,
            settings.key(),
            settings.empty,
            self.clock.offset,
            settings.arm,
        )
        transport = transport or open_transport(settings.url, number, settings.key())
        self.connect(self.session, transport, "move the link")
        self.name = f"link_{number}"
        self.reported: tuple[Any, ...] = ()  # of the last command
        self.given = 0, 0  # when that was given: by the session, and by the time of day then
        self.replaced: deque[Progress] = deque()  # by others, whose end is yet to be reported
        self.period = round(SECOND / settings.rate)  # of repeated commands [ns]
        self.path_period = self.period // 2 if settings.rate < PATH_RATE else self.period
        self.joint_states = self.create_publisher(JointState, "joint_states", SENSOR)
        self.telemetry = self.create_publisher(LinkTelemetry, f"{self.name}/telemetry", SENSOR)
        self.battery = self.create_publisher(BatteryState, f"{self.name}/battery", SENSOR)
        self.status = self.create_publisher(CommandStatus, f"{self.name}/command_status", SENSOR)
        subscribe(self, LinkPath, f"{self.name}/path", self.on_path, 10)
        self.create_service(Trigger, f"{self.name}/clear_faults", self.on_clear_faults)
        self.pacer = Pacer(settings.max_rate)
        period = 1.0 / settings.rate
        self.delayed_send = self.create_timer(
            period, self.send, clock=timer_clock(self), autostart=False
        )
        self.messages = SampleMessages(self.session, self.settings.frame_prefix)
        self.link_health = LinkHealth(self.session, self.transport, bool(settings.keys))
        self.start_communication(f"{self.name}/arm")
        self.commands = SubscriptionThread(self, [
            *(Topic(Empty, "arm/stop", qos, self.on_stop) for qos in STOPS),
            Topic(LinkCommand, f"{self.name}/command", COMMAND, self.on_command),
        ])  # fmt: skip

    def process_datagram(self, data: bytes, now: int) -> None:
        """Publish the contents of a datagram; the joint's state first."""
        sample = self.session.measure(data, now)
        if sample is None:
            return
        sample = sample._replace(stamp=sample.stamp + self.clock.offset)
        if sample.referenced:  # else the position is not valid
            self.joint_states.publish(self.messages.joint_state(sample))
        self.session.follow(sample)
        self.telemetry.publish(self.messages.telemetry(sample, now))
        if sample.frame.slow_id == Slow.BATTERY:
            self.battery.publish(self.messages.battery(sample))

    def log_changes(self) -> None:
        """Log changes and problems, each problem once when it starts."""
        super().log_changes()
        self.warn("path", self.session.breakage)

    def transmit(self) -> None:
        """Send the current command; the next one follows sooner on a path."""
        with self.lock:
            self.transport.send(self.session.command(now := self.now()))
            self.pacer.sent(now)
            self.send_path(now)
            period = self.path_period if self.session.follows else self.period
            if period != self.steady.timer_period_ns:
                self.steady.timer_period_ns = period
                self.wakeup.trigger()  # wakes the executor
            self.steady.reset()
            self.delayed_send.cancel()

    def send_path(self, now: int) -> None:
        """Send the path segments that the link lacks."""
        for data in self.session.segments(now):
            self.transport.send(data)

    def on_command(self, message: LinkCommand) -> None:
        """Accept a command, valid from the time of its stamp, and send it.

        This runs in a separate thread; the executor reports the command's status later.
        """
        with self.lock:
            now, before, ahead = self.now(), self.session.progress, self.clock.offset
            given = stamp_ns(message.header.stamp)
            given = min(given - ahead, now) if given else now
            try:
                self.set_command(message, given, now)
                self.warn("command refused", "")
                self.send_soon(now)
            except CommandError as error:
                self.report_refusal("command", error, given)
            if before and before is not self.session.progress:
                self.replaced.append(before)

    def set_command(self, message: LinkCommand, given: int, now: int) -> None:
        """Pass a command given at `given` to the session, or raise CommandError."""
        if not 0.0 < (lives := message.time_to_live) <= 3600.0:
            raise CommandError(f"time_to_live is {lives} s, expected above 0")
        follows = message.mode == LinkCommand.PATH
        self.session.set(
            message.mode,
            message.path if follows else message.set_point,
            message.max_velocity,
            message.max_acceleration,
            given + round(lives * SECOND),
            now,
        )

    def send_soon(self, now: int) -> None:
        """Send the accepted command at once, or as soon as the highest rate allows."""
        if wait := self.pacer.wait(now):
            self.delayed_send.timer_period_ns = wait
            self.delayed_send.reset()
            self.wakeup.trigger()  # wakes the executor
        else:
            self.transmit()

    def on_path(self, message: LinkPath) -> None:
        """Accept a path, and send its first segments to the link."""
        with self.lock:
            now, begin = self.now(), stamp_ns(message.header.stamp) - self.clock.offset
            knots = message.time, message.position, message.velocity
            try:
                self.session.give_path(message.path, begin, *knots, now)
                self.warn("path refused", "")
            except CommandError as error:
                self.report_refusal("path", error, now)
            self.send_path(now)

    def report_refusal(self, what: str, error: CommandError, given: int) -> None:
        """Report that a command or a path is refused."""
        ahead = self.clock.offset
        self.status.publish(command_refused(str(error), given + ahead, self.now() + ahead))
        self.warn(f"{what} refused", f"{what} refused: {error}")

    def on_stop(self, _: Empty) -> None:
        """Stop at once, in a separate thread that does not wait for the executor."""
        with self.lock:
            self.session.stop()
        self.transmit()
        self.wakeup.trigger()

    def describe_state(self) -> str:
        """Return the link's state in words."""
        return describe_state(self.session)

    def on_clear_faults(self, _: Trigger.Request, response: Trigger.Response) -> Any:
        """Disarm and clear the drive's latched faults; telemetry shows those that remain."""
        with self.lock:
            self.session.clear_faults(self.now())
        self.send()
        response.success = not self.session.lost
        response.message = "clearing requested" if response.success else f"{self.name} is lost"
        return response

    def has_pending_answers(self) -> bool:
        """Return True if a request waits, or the last command's status is not yet reported."""
        progress = self.session.progress
        progressed = progress and (progress.given, progress.status) != self.reported
        return bool(self.waiting or progressed)

    def report(self, progress: Progress) -> None:
        """Publish the progress of a command, if it has changed."""
        if (progress.given, progress.status) != self.reported:
            self.reported, ahead = (progress.given, progress.status), self.clock.offset
            if progress.given != self.given[0]:
                self.given = progress.given, progress.given + ahead
            self.status.publish(command_status(progress, self.given[1], self.now() + ahead))

    def answer_requests(self) -> None:
        """Report changes: the progress of the last command, and the end of arming."""
        with self.lock:
            while self.replaced:
                self.report(self.replaced.popleft())
            if self.session.progress:
                self.report(self.session.progress)
        super().answer_requests()

    def health(self) -> Health:
        """Return the status for diagnostics, and log, as a stream of commands delays the timer."""
        self.log_changes()
        with self.lock:
            return self.link_health(self.now())

    def close(self) -> None:
        """Close the threads and the port."""
        self.commands.close()
        super().close()


def make_nodes(kind: type[LinkSettings] = LinkSettings) -> list[LinkNode]:
    """Create nodes that publish what each link measures and send it commands at a steady rate.

    There is one node for the link of `url`, or one for each of `urls`.
    """
    quiet = {"enable_rosout": False, "start_parameter_services": False}
    # With the last node of a process Fast DDS (2.14) deletes its participant. This was seen to hang
    # while other nodes were being discovered, so one node stays until the links' nodes exist.
    keeper = Node("_begins", use_global_arguments=False, **quiet)
    probe = Node("link", **quiet)
    try:
        s = declare(probe, kind)
        probe.destroy_node()  # `__node` would give the probe the links' name
        links = enumerate(s.urls, 1) if s.urls else [(s.link, s.url)]
        return [LinkNode(number, url, kind=kind) for number, url in links]
    finally:
        keeper.destroy_node()


if __name__ == "__main__":
    sys.exit(main())
