"""The links' topics, as the arm's node has them: what they report, and what they are told."""

from collections.abc import Callable, Iterable, Mapping

from rclpy.node import Node
from rclpy.task import Future

from fss_arm_driver.arm.arbiter import Arbiter, Motion
from fss_arm_driver.arm.state import LinkState, link_state
from fss_arm_driver.arm.trajectory import Trajectory
from fss_arm_driver.liveness import Stall, Steps
from fss_arm_driver.scale import Scale
from fss_arm_driver.settings import ArmSettings
from fss_arm_model.description import Arm
from fss_arm_msgs.msg import LinkCommand, LinkPath, LinkTelemetry
from fss_arm_ros.convert import SECOND, stamp_ns, to_time
from fss_arm_ros.qos import command, subscribe_sensor
from fss_arm_ros.timer_clock import timer_clock
from fss_link.host_clock import HostClock

Take = Callable[[LinkCommand], None]

LAST_PATH = 65_535  # the number after which they begin anew
STEP = 0.1  # of the time of day that spoils a motion [s]

#: What a person does about a trouble.
HELP = {
    "not armed": ": scripts/fss_arm.sh arm",
    "not referenced": ": scripts/fss_arm.sh home",
}


class MotionError(ValueError):
    """A motion cannot be begun, or must end; the message says why."""


class LinkTopics:
    """All links of the arm, and whose turn it is to move them.

    Args:
        node: whose topics they are.
        arm: the arm.
        settings: the node's.
        local: what takes the commands of links whose drivers are in this process, by number.
    """

    def __init__(
        self, node: Node, arm: Arm, settings: ArmSettings, local: Mapping[int, Take] | None = None
    ) -> None:
        self.node, self.arm, self.settings = node, arm, settings
        self.numbers = range(1, arm.n + 1)
        self.states: dict[int, LinkState] = {}
        self.arbiter, self.path = Arbiter(), 0
        self.clock, self.stall = timer_clock(node), Stall(settings.time_to_live)
        self.steps = Steps(STEP, settings.time_to_live)
        self.host = HostClock(self.steady, lambda: self.now())
        self.ticked: Future = Future()
        lifespan = command(settings.time_to_live)
        self.commands: dict[int, Take] = {
            i: node.create_publisher(LinkCommand, f"link_{i}/command", lifespan).publish
            for i in self.numbers
        } | dict(local or {})
        self.paths = {
            i: node.create_publisher(LinkPath, f"link_{i}/path", 10) for i in self.numbers
        }
        for i, link in enumerate(arm.links, 1):
            self._listen(i, Scale(link))

    def _listen(self, number: int, scale: Scale) -> None:
        def take(message: LinkTelemetry) -> None:
            measured = stamp_ns(message.header.stamp)
            self.states[number] = link_state(message, scale, measured, self.steady())

        subscribe_sensor(self.node, LinkTelemetry, f"link_{number}/telemetry", take)

    def now(self) -> int:
        """The node's clock [ns]."""
        return int(self.node.get_clock().now().nanoseconds)

    def steady(self) -> int:
        """A clock that nobody sets, or the simulated one [ns]."""
        return int(self.clock.now().nanoseconds)

    def interruption(self) -> str:
        """Describe a recent pause of this node beyond a command's life, or a step of its clock.

        Messages received just after that may be old, or seem so.
        """
        now = 1e-9 * self.steady()
        return self.stall.check(now) or self.steps.check(1e-9 * self.host.ahead, now)

    def tick(self) -> None:
        """Let a motion under way go on."""
        self.interruption()
        self.wake()

    def wake(self) -> None:
        """Have a motion see at once that it shall end."""
        self.ticked, ticked = Future(), self.ticked
        ticked.set_result(None)

    def stop(self) -> None:
        """End a motion; the links' drivers stop by themselves."""
        self.arbiter.stop()
        self.wake()

    def troubles(
        self, numbers: Iterable[int] | None = None, referenced: bool = True
    ) -> dict[int, str]:
        """What keeps links from moving, if anything does, all of them or these: one trouble."""
        wanted = self.numbers if numbers is None else sorted(numbers)
        oldest = self.steady() - self.settings.time_to_live * SECOND
        silent = {
            i: "silent" for i in wanted if i not in self.states or self.states[i].heard < oldest
        }
        states = {i: self.states[i] for i in wanted if not silent}
        lost = {i: "not referenced" for i, s in states.items() if not s.referenced}
        return (
            silent
            or (referenced and lost)
            or {i: "not armed" for i, s in states.items() if not s.armed}
        )

    def check(self, motion: Motion | None = None) -> None:
        """Raise MotionError if the arm cannot move, or `motion` shall end."""
        if why := self.interruption() or (motion.ended if motion else ""):
            raise MotionError(why)
        if troubles := self.troubles():
            raise MotionError(in_words(troubles))

    def q(self) -> tuple[float, ...]:
        """Present readings (n) [rad]; () while a link has never been heard."""
        heard = len(self.states) == self.arm.n
        return tuple(self.states[i].q for i in self.numbers if heard)

    def send(
        self,
        messages: Mapping[int, LinkCommand],
        given: int,
        motion: Motion,
        lives: float | None = None,
    ) -> None:
        """Send links commands of a motion, unless it shall end.

        Args:
            messages: by link; stamp and time to live are filled in.
            given: when, from which on they live [ns].
            motion: whose they are.
            lives: how long [s]; time_to_live by default.
        """
        stamp = to_time(given)
        with self.arbiter.lock:
            for i, message in messages.items() if not motion.ended else ():
                message.header.stamp = stamp
                message.time_to_live = self.settings.time_to_live if lives is None else lives
                self.commands[i](message)

    def rest(self, motion: Motion, numbers: Iterable[int] | None = None) -> None:
        """Have links come to rest by a motion, unless it shall end: all of them, or these."""
        wanted = self.numbers if numbers is None else numbers
        rest = {i: LinkCommand(mode=LinkCommand.VELOCITY) for i in wanted}
        self.send(rest, self.now(), motion)

    def give_path(self, trajectory: Trajectory) -> dict[int, LinkCommand]:
        """Give each link its part of a trajectory; return the commands that make it follow."""
        self.path = following([self.path, *(s.path for s in self.states.values())])
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


def in_words(troubles: Mapping[int, str]) -> str:
    """The trouble that links have, the same for all, and what helps against it."""
    trouble = next(iter(troubles.values()))
    those = ", ".join(map(str, troubles))
    they = f"link {those} is" if len(troubles) == 1 else f"links {those} are"
    return f"{they} {trouble}{HELP.get(trouble, '')}"


def following(numbers: Iterable[int]) -> int:
    """The number for a path after all of these, which count modulo 65536 without 0."""
    newest = 0
    for number in numbers:
        if not newest or 0 < (number - newest) % 65_536 < 32_768:
            newest = number or newest
    return newest % LAST_PATH + 1
