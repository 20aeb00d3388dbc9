"""Topics between the arm's node and the links: their telemetry, commands and paths."""

from collections.abc import Callable, Iterable, Mapping

from rclpy.node import Node
from rclpy.task import Future

from fss_arm_driver.arm.arbiter import Arbiter, Motion
from fss_arm_driver.arm.state import LinkState, link_state
from fss_arm_driver.arm.trajectory import Trajectory
from fss_arm_driver.liveness import ClockSteps, Stall
from fss_arm_driver.scale import Scale
from fss_arm_driver.settings import ArmSettings
from fss_arm_model.description import Arm
from fss_arm_msgs.msg import CommandStatus, LinkCommand, LinkPath, LinkTelemetry
from fss_arm_ros.convert import SECOND, stamp_ns, to_time
from fss_arm_ros.qos import command, subscribe_sensor
from fss_arm_ros.timers import timer_clock
from fss_link.host_clock import HostClock

CommandSink = Callable[[LinkCommand], None]

MAX_PATH_NUMBER = 65_535  # the next number after it is 1
MIN_CLOCK_STEP = 0.1  # change of the time of day that ends a motion [s]

#: What the operator does about a problem.
REMEDIES = {
    "not armed": ": scripts/fss_arm.sh arm",
    "not referenced": ": scripts/fss_arm.sh home",
}


class MotionError(ValueError):
    """Error of a motion that cannot start, or must end; the message says why."""


class LinkTopics:
    """Links of the arm: their last states, and the motion that commands them.

    Args:
        node: of the arm.
        arm: the arm.
        settings: of the node.
        local: callbacks for the commands of links whose drivers are in this process, by number.
    """

    def __init__(
        self,
        node: Node,
        arm: Arm,
        settings: ArmSettings,
        local: Mapping[int, CommandSink] | None = None,
    ) -> None:
        self.node, self.arm, self.settings = node, arm, settings
        self.numbers = range(1, arm.n + 1)
        self.states: dict[int, LinkState] = {}
        self.refusals: dict[int, str] = {}  # why links refused the newest path, by number
        self.arbiter, self.path, self.path_stamp = Arbiter(), 0, 0
        self.clock, self.stall = timer_clock(node), Stall(settings.time_to_live)
        self.steps = ClockSteps(MIN_CLOCK_STEP, settings.time_to_live)
        self.host = HostClock(self.steady, lambda: self.now())
        self.ticked: Future = Future()
        lifespan = command(settings.time_to_live)
        self.commands: dict[int, CommandSink] = {
            i: node.create_publisher(LinkCommand, f"link_{i}/command", lifespan).publish
            for i in self.numbers
        } | dict(local or {})
        self.paths = {
            i: node.create_publisher(LinkPath, f"link_{i}/path", 10) for i in self.numbers
        }
        for i, link in enumerate(arm.links, 1):
            self._subscribe(i, Scale(link))

    def _subscribe(self, number: int, scale: Scale) -> None:
        def on_telemetry(message: LinkTelemetry) -> None:
            measured = stamp_ns(message.header.stamp)
            self.states[number] = link_state(message, scale, measured, self.steady())

        def on_status(message: CommandStatus) -> None:
            is_newer = stamp_ns(message.header.stamp) >= self.path_stamp
            if message.status == CommandStatus.REFUSED and is_newer:
                self.refusals.setdefault(number, message.reason)

        subscribe_sensor(self.node, LinkTelemetry, f"link_{number}/telemetry", on_telemetry)
        subscribe_sensor(self.node, CommandStatus, f"link_{number}/command_status", on_status)

    def now(self) -> int:
        """Return the time of the node's clock [ns]."""
        return int(self.node.get_clock().now().nanoseconds)

    def steady(self) -> int:
        """Return the time of a clock that is never set, or the simulated time [ns]."""
        return int(self.clock.now().nanoseconds)

    def interruption(self) -> str:
        """Describe a recent pause of this node beyond a command's life, or a step of its clock.

        Messages received just after that may be old, or seem so.
        """
        now = 1e-9 * self.steady()
        return self.stall.check(now) or self.steps.check(1e-9 * self.host.offset, now)

    def tick(self) -> None:
        """Continue the current motion."""
        self.interruption()
        self.wake()

    def wake(self) -> None:
        """Resume the current motion at once, so that it checks whether it must end."""
        with self.arbiter.lock:  # several threads call this
            self.ticked, ticked = Future(), self.ticked
        ticked.set_result(None)

    def stop(self) -> None:
        """End the current motion; the links' drivers stop by themselves."""
        self.arbiter.stop()
        self.wake()

    @property
    def unconnected(self) -> list[int]:
        """Links that have not sent telemetry since this node started."""
        return [i for i in self.numbers if i not in self.states]

    def problems(
        self, numbers: Iterable[int] | None = None, referenced: bool = True
    ) -> dict[int, str]:
        """Return the links that cannot move, of all or of these, with the most basic problem."""
        chosen = self.numbers if numbers is None else sorted(numbers)
        oldest = self.steady() - self.settings.time_to_live * SECOND
        missing = {i: "not connected yet" for i in self.unconnected if i in chosen}
        known = {} if missing else {i: self.states[i] for i in chosen}
        silent = {i: "silent" for i, s in known.items() if s.received < oldest}
        states = {} if silent else known
        lost = {i: "not referenced" for i, s in states.items() if not s.referenced}
        return (
            missing
            or silent
            or (referenced and lost)
            or {i: "not armed" for i, s in states.items() if not s.armed}
        )

    def check(self, motion: Motion | None = None) -> None:
        """Raise MotionError if the arm cannot move, or `motion` shall end."""
        if why := self.interruption() or (motion.end_reason if motion else ""):
            raise MotionError(why)
        if problems := self.problems():
            raise MotionError(describe_problems(problems))

    def q(self) -> tuple[float, ...]:
        """Return the present readings (n) [rad]; empty until all links have sent telemetry."""
        received = len(self.states) == self.arm.n
        return tuple(self.states[i].q for i in self.numbers if received)

    def send(
        self,
        messages: Mapping[int, LinkCommand],
        start: int,
        motion: Motion,
        time_to_live: float | None = None,
    ) -> None:
        """Send the commands of a motion to the links, unless the motion must end.

        Args:
            messages: by link; stamp and time to live are filled in.
            start: stamp of the commands, the start of their time to live [ns].
            motion: that the commands belong to.
            time_to_live: of the commands [s]; time_to_live by default.
        """
        stamp = to_time(start)
        lifetime = self.settings.time_to_live if time_to_live is None else time_to_live
        with self.arbiter.lock:
            for i, message in messages.items() if not motion.end_reason else ():
                message.header.stamp = stamp
                message.time_to_live = lifetime
                self.commands[i](message)

    def stop_joints(self, motion: Motion, numbers: Iterable[int] | None = None) -> None:
        """Command all links, or these, to decelerate to rest, unless the motion must end."""
        chosen = self.numbers if numbers is None else numbers
        commands = {i: LinkCommand(mode=LinkCommand.VELOCITY) for i in chosen}
        self.send(commands, self.now(), motion)

    def publish_path(self, trajectory: Trajectory) -> dict[int, LinkCommand]:
        """Publish each link's path of a trajectory; return the commands to follow it."""
        self.path = next_path_number([self.path, *(s.path for s in self.states.values())])
        self.path_stamp, self.refusals = self.now(), {}
        for i, publisher in self.paths.items():
            message = LinkPath(
                path=self.path,
                time=trajectory.times.tolist(),
                position=trajectory.q[:, i - 1].tolist(),
                velocity=trajectory.qd[:, i - 1].tolist(),
            )
            message.header.stamp = to_time(trajectory.begin)
            publisher.publish(message)
        return {i: LinkCommand(mode=LinkCommand.PATH, path=self.path) for i in self.numbers}


def describe_problems(problems: Mapping[int, str]) -> str:
    """Return the common problem of these links as text, with its remedy."""
    problem = next(iter(problems.values()))
    numbers = ", ".join(map(str, problems))
    links_are = f"link {numbers} is" if len(problems) == 1 else f"links {numbers} are"
    return f"{links_are} {problem}{REMEDIES.get(problem, '')}"


def next_path_number(numbers: Iterable[int]) -> int:
    """Return the next path number after all of these, which count modulo 65536 without 0."""
    newest = 0
    for number in numbers:
        if not newest or 0 < (number - newest) % 65_536 < 32_768:
            newest = number or newest
    return newest % MAX_PATH_NUMBER + 1
