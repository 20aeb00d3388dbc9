"""The node of one link: its telemetry to topics, commands to its electronics.

A thread waits for datagrams and wakes the executor; all else happens in the executor.
"""

import sys
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty
from std_srvs.srv import SetBool

from fss_arm_driver.link import SECOND, TROUBLES, Arming, LinkSession
from fss_arm_driver.messages import joint_state, telemetry
from fss_arm_driver.protocol import State
from fss_arm_driver.scale import CommandError
from fss_arm_driver.settings import LinkSettings
from fss_arm_driver.transport import Transport, open_transport
from fss_arm_driver.waker import Waker
from fss_arm_msgs.msg import LinkCommand, LinkTelemetry
from fss_arm_ros.convert import stamp_ns
from fss_arm_ros.diagnostics import ERROR, OK, WARN, Diagnostics, Health
from fss_arm_ros.qos import COMMAND, SENSOR
from fss_arm_ros.run import run
from fss_arm_ros.settings import declare

SIMULATED_STEP = 0.01  # of /clock [s]
LATCHED_WORDS = {State.STOPPED: "the link is stopped", State.WATCHDOG: "its watchdog tripped"}


class LinkNode(Node):
    """Publishes what one link measures, as it comes, and sends it commands at a steady rate.

    Args:
        number: of the link.
        url: where its electronics are.
        transport: instead of `url`.
    """

    def __init__(
        self, number: int = 1, url: str = "", transport: Transport | None = None, **options: Any
    ) -> None:
        overrides = [Parameter("link", value=number), *options.pop("parameter_overrides", ())]
        if url:
            overrides.append(Parameter("url", value=url))
        super().__init__(f"link_{number}", parameter_overrides=overrides, **options)
        self.settings = settings = declare(self, LinkSettings)
        simulated = self.get_parameter("use_sim_time").value
        self.session = LinkSession(
            number,
            settings.description(),
            settings.timeout,
            settings.watchdog,
            SIMULATED_STEP if simulated else 0.0,
            settings.key(),
        )
        self.transport = transport or open_transport(settings.url)
        self.name = f"link_{number}"
        self.warned, self.trouble = "", self.transport.trouble
        self.reported = dict(self.session.counts), 0
        self.waiting: list[Future] = []

        if settings.is_exposed():
            self.get_logger().warning(
                f"{settings.url}: frames are not signed, so anybody on this network can move the "
                "link; see docs/security.md"
            )
        self.joint_states = self.create_publisher(JointState, "joint_states", SENSOR)
        self.telemetry = self.create_publisher(LinkTelemetry, f"{self.name}/telemetry", SENSOR)
        self.create_subscription(LinkCommand, f"{self.name}/command", self.on_command, COMMAND)
        self.create_subscription(Empty, "arm/stop", self.on_stop, 10)
        group = ReentrantCallbackGroup()  # the answer waits for the link's; all else goes on
        self.create_service(SetBool, f"{self.name}/arm", self.on_arm, callback_group=group)
        self.create_timer(1.0 / settings.rate, self.send)
        self.waker = Waker(self.transport, self.create_guard_condition(self.poll))
        self.diagnostics = Diagnostics(self, self.health, self.settings.url)

    def now(self) -> int:
        """The node's clock [ns]; 0 before the first /clock if that is followed."""
        return int(self.get_clock().now().nanoseconds)

    def poll(self) -> None:
        """Take what has come. Without a clock yet nothing can be stamped: it is dropped."""
        datagrams, now = self.transport.receive(), self.now()
        self.waker.taken()
        for data in datagrams if now else ():
            if sample := self.session.feed(data, now):
                self.joint_states.publish(joint_state(self.session.number, sample))
                self.telemetry.publish(telemetry(sample))
        self.answer_arming()

    def send(self) -> None:
        """Send the command of the moment."""
        self.transport.send(self.session.command(self.now()))
        self.answer_arming()
        if self.transport.trouble not in ("", self.trouble):
            self.get_logger().warning(f"{self.settings.url}: {self.transport.trouble}")
        self.trouble = self.transport.trouble

    def on_command(self, message: LinkCommand) -> None:
        """Take a command, from the time that its stamp says it was given."""
        now = self.now()
        given = min(stamp_ns(message.header.stamp) or now, now)
        try:
            if not 0.0 < message.time_to_live <= 3600.0:
                raise CommandError(f"time_to_live is {message.time_to_live} s, expected above 0")
            self.session.set(
                message.mode,
                message.set_point,
                message.max_velocity,
                message.max_acceleration,
                given + round(message.time_to_live * SECOND),
                now,
            )
        except CommandError as error:
            self.warn(f"command refused: {error}")

    def on_stop(self, _: Empty) -> None:
        """Stop at once."""
        self.session.stop()
        self.send()

    async def on_arm(self, request: SetBool.Request, response: SetBool.Response) -> Any:
        """Arm or disarm; answer when the link has."""
        if not request.data:
            self.session.disarm()
            self.send()
            response.success, response.message = True, f"{self.name} is {self.session.arming.value}"
            return response
        try:
            self.session.arm(self.now())
            self.waiting.append(settled := Future())
            self.send()
            await settled
            response.success, response.message = self.session.armed, self.state()
        except CommandError as error:
            response.success, response.message = False, str(error)
        return response

    def answer_arming(self) -> None:
        """Once arming has ended, let those who asked for it know."""
        while self.waiting and self.session.arming is not Arming.ARMING:
            self.waiting.pop().set_result(None)

    def state(self) -> str:
        """In words, for people."""
        frame = self.session.frame
        flags = frame.flags if frame else 0
        latches = [words for latch, words in LATCHED_WORDS.items() if flags & latch]
        return ": ".join([f"{self.name} is {self.session.arming.value}", *latches])

    def warn(self, text: str) -> None:
        """Log a warning once in a row, as commands are repeated."""
        if text != self.warned:
            self.get_logger().warning(text)
        self.warned = text

    def health(self) -> Health:
        """For diagnostics."""
        session, now = self.session, self.now()
        session.tick(now)
        (before, then), counts = self.reported, dict(session.counts)
        self.reported = counts, now
        values = {
            "state": session.arming.value,
            "signed": bool(self.settings.keys),
            "age [s]": session.silence(now),
            "round trip [s]": session.round_trip,
            "clock deviation [s]": session.deviation(now),
            "clock drift [ppm]": 1e6 * session.drift,
            **counts,
            **self.transport.counts,
        }
        if now == then:
            return Health(WARN, "the clock stands still", values)
        if session.lost:
            why = self.transport.trouble
            return Health(ERROR, f"{self.name} is lost{': ' * bool(why)}{why}", values)
        if any(counts[key] > before[key] for key in TROUBLES):
            return Health(WARN, f"{self.state()}; frames were lost or refused", values)
        return Health(OK, self.state(), values)

    def close(self) -> None:
        """Give the port back."""
        self.waker.close()
        self.transport.close()


def make_nodes() -> list[LinkNode]:
    """The nodes that the parameters ask for: one link, or all of `urls`."""
    probe = Node("link", enable_rosout=False, start_parameter_services=False)
    try:
        settings = declare(probe, LinkSettings)
    finally:
        probe.destroy_node()
    if not settings.urls:
        return [LinkNode(settings.link, settings.url)]
    return [LinkNode(number, url) for number, url in enumerate(settings.urls, 1)]


def main() -> int:
    """Run as `ros2 run fss_arm_driver link`."""
    return run(make_nodes, LinkSettings)


if __name__ == "__main__":
    sys.exit(main())
