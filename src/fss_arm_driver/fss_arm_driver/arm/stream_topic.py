"""Topics that act at once: `arm/joint_commands` commands the links, `arm/stop` ends motions."""

from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState

from fss_arm_driver.arm.arbiter import Motion, Plan
from fss_arm_driver.arm.guard_topics import GuardTopics
from fss_arm_driver.arm.link_topics import LinkTopics, describe_problems
from fss_arm_driver.arm.stream import Ramp, SetPoint, Stream, StreamError
from fss_arm_driver.protocol import Mode
from fss_arm_model.guard.guard import GuardError
from fss_arm_msgs.msg import LinkCommand
from fss_arm_ros.convert import SECOND, stamp_ns
from fss_arm_ros.subscriptions import SubscriptionThread, Topic, stop_topics

TOPIC = "arm/joint_commands"
#: Matches any publisher; keeps only the newest message and does not resend a lost one.
NEWEST_ONLY = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)


class StreamTopic:
    """Subscriber that passes a stream to the links or ends a motion, in a separate thread."""

    def __init__(self, links: LinkTopics, guard: GuardTopics) -> None:
        self.links, self.guard = links, guard
        self.time_to_live = links.settings.stream_time_to_live
        self.stream = Stream(links.arm, self.time_to_live)
        self.motion: Motion | None = None
        self.ramps: dict[int, Ramp] = {}  # of the joints that follow rates, by number
        self.commands = {i: LinkCommand() for i in links.numbers}  # reused, as creation is slow
        self.thread = SubscriptionThread(
            links.node,
            [
                *stop_topics(lambda _: links.stop(), "arm/stop"),
                Topic(JointState, TOPIC, NEWEST_ONLY, self.on_command),
            ],
        )
        self.close = self.thread.close

    def on_command(self, message: JointState) -> None:
        """Pass a message on, or refuse it; repeated refusals for one reason are logged once."""
        now = self.links.now()
        try:
            start = self.stream.start_time(stamp_ns(message.header.stamp), now)
            points = self.stream.parse(message)
            self.check(points)
        except StreamError as error:
            if self.stream.count_refusal(error):
                self.links.node.get_logger().warning(f"{TOPIC} refused: {error}")
            return
        self.stream.count_accepted()
        with self.links.arbiter.lock:
            if not self.links.arbiter.is_current(self.motion, now):
                self.ramps.clear()  # a new stream starts its ramps from the measured rates
            commands = {point.link: self.command(point, start, now) for point in points}
            motion = self.start_or_extend(points, start, now)
            motion.plan = self.plan(points)
            self.links.send(commands, start, motion, self.time_to_live)

    def command(self, point: SetPoint, start: int, now: int) -> LinkCommand:
        """Return the command of a link from a time `start` [ns]."""
        command = self.commands[point.link]
        command.mode, command.set_point = int(point.mode), point.value
        if point.mode == Mode.VELOCITY:
            ramp = self.ramp(point.link, now)
            command.max_acceleration = ramp.acceleration(point.value, start / SECOND)
        else:
            command.max_acceleration = 0.0
            self.ramps.pop(point.link, None)
        return command

    def ramp(self, joint: int, now: int) -> Ramp:
        """Return a joint's ramp; a new one from the measured rate if the joint follows no rate."""
        ramp = self.ramps.get(joint)
        if ramp is None or not ramp.is_current(now / SECOND, self.time_to_live):
            limit = self.links.arm.links[joint - 1].drive.max_acceleration
            ramp = self.ramps[joint] = Ramp(self.links.states[joint].qd, limit)
        return ramp

    def check(self, points: list[SetPoint]) -> None:
        """Raise StreamError if the joints cannot or must not move."""
        if why := self.links.interruption():
            raise StreamError("links", why)
        referenced = any(point.mode == Mode.POSITION for point in points)
        if problems := self.links.problems([p.link for p in points], referenced):
            raise StreamError("links", describe_problems(problems))
        try:
            self.guard.check_stream(self.links.states, points)
        except GuardError as error:
            raise StreamError("guard", str(error)) from None

    def plan(self, points: list[SetPoint]) -> Plan | None:
        """Return the function of time [ns] that gives the commanded angles and rates.

        It extrapolates from the newest telemetry, with all other joints at rest. Commanded angles
        and currents have no plan, because the drives determine the motion.
        """
        if any(point.mode != Mode.VELOCITY for point in points):
            return None
        rates = dict.fromkeys(self.links.numbers, 0.0) | {p.link: p.value for p in points}

        def at(t: int) -> tuple[list[float], list[float]]:
            states = [(self.links.states[i], rate) for i, rate in rates.items()]
            q = [state.q + (t - state.measured) / SECOND * rate for state, rate in states]
            return q, list(rates.values())

        return at

    def start_or_extend(self, points: list[SetPoint], start: int, now: int) -> Motion:
        """Extend the stream's motion, or preempt another one and stop all other joints."""
        arbiter, until = self.links.arbiter, start + round(self.time_to_live * SECOND)
        if self.motion and arbiter.is_current(self.motion, now):
            self.motion.expiry = until
            return self.motion
        preempts = bool(arbiter.current_name(now))
        self.motion = arbiter.start(TOPIC, now, until)
        if preempts:
            self.links.wake()
            others = set(self.links.numbers) - {point.link for point in points}
            self.links.stop_joints(self.motion, others)
        return self.motion
