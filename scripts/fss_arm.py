"""Send a command to the arm, and print its answer.

move ANGLE...: move all joints to these angles [deg], arriving together, in --seconds or as fast as
their limits allow (arm/move); if interrupted, they come to rest.
arm, disarm: arm or disarm all links (arm/enable). stop: stop all links of all vehicles at once, or
of the one named; joints that are on hold, under power, until disarmed or armed again (arm/stop).
It fails unless each link, and each base's board, confirms that it has stopped. home: each armed
link without a reference finds it, one after the other. clear: disarm all links and clear their
drives' latched faults. valves: enable the base's valves (base/arm), until stop.
solve: each running calibration closes its present datum and solves. forget: each drops its data.
"""

import argparse
import os
import re
import sys
from collections.abc import Callable, Iterable
from math import degrees, inf, nan, radians
from time import monotonic
from typing import Any, NoReturn
from xml.etree import ElementTree

import rclpy
from rclpy.action import ActionClient
from rclpy.exceptions import InvalidNamespaceException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.validate_namespace import validate_namespace
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Empty, String
from std_srvs.srv import SetBool, Trigger
from unique_identifier_msgs.msg import UUID

from fss_arm_driver.protocol import State
from fss_arm_msgs.action import MoveArm
from fss_arm_msgs.msg import BaseTelemetry, LinkCommand, LinkTelemetry
from fss_arm_ros.command_line import in_words
from fss_arm_ros.convert import stamp_ns
from fss_arm_ros.qos import LATCHED, command, sensor, subscribe_sensor
from fss_arm_ros.rclpy_compat import RCLError
from fss_arm_ros.run import check_domain
from fss_base_driver.protocol import BaseState

ANSWER_TIMEOUT = 10.0  # [s]
DISCOVERY_TIME = 1.0  # without a change, discovery is complete [s]
LINKS = range(1, 13)  # numbers that a link may have
COMMANDS = ("move", "arm", "disarm", "stop", "home", "clear", "valves", "solve", "forget")
CALIBRATIONS = ("kinematic", "dynamic", "drift", "drives", "joint")  # joint: from three of these
STOP_PERIOD = 0.05  # from one stop to the next [s]
GRAPH_DISCOVERY_TIME = 0.5  # after its start, a program knows the other nodes [s]
CONFIRM_TIMEOUT = 1.0  # for a known link to report that it has stopped [s]
MAX_TIME, MAX_ANGLE = 3600.0, 36_000.0  # [s], [deg]
NAMESPACE = re.compile(r"/?[A-Za-z]\w*(/[A-Za-z]\w*)*", re.ASCII)
TOPIC = re.compile(
    r"(?P<namespace>.*)/(?:arm/stop|(?P<link>link_\d+)/(?:telemetry|command)|(?P<base>base)/telemetry)"
)
STOPPED = {LinkTelemetry: State.STOPPED, BaseTelemetry: BaseState.STOPPED}
EMERGENCY = "use the emergency stop"
KEEP_ALIVE = 1.0  # silence of this program that ends a move [s]
HOME_TIME_TO_LIVE = 2.0  # short, so that the link holds soon after this program has ended [s]

Answer = tuple[bool, str]


class NoAnswerError(RuntimeError):
    """A node does not exist, or does not answer."""


def call(node: Node, kind: Any, name: str, request: Any, wait: float) -> Answer:
    """Call a service; return whether it succeeded, and its message.

    Raises:
        NoAnswerError: it is not there or silent.
    """
    client = node.create_client(kind, name)
    if not client.wait_for_service(wait):
        raise NoAnswerError(f"no node offers {name}")
    future = client.call_async(request)
    rclpy.spin_until_future_complete(node, future, timeout_sec=ANSWER_TIMEOUT)
    if not future.done():
        raise NoAnswerError(f"{name} did not answer within {ANSWER_TIMEOUT:.0f} s")
    return future.result().success, future.result().message


def discover(node: Node, find: Callable[[], Any], missing: str, wait: float) -> Any:
    """Spin until `find` returns something that does not change for DISCOVERY_TIME; return it.

    Raises:
        NoAnswerError: nothing was found within `wait` [s]; the message is `missing`.
    """
    start = since = monotonic()
    found = None
    while not found or monotonic() - since < DISCOVERY_TIME:
        rclpy.spin_once(node, timeout_sec=0.05)
        if (latest := find()) != found:
            found, since = latest, monotonic()
        if not found and monotonic() - start > wait:
            raise NoAnswerError(missing)
    return found


class Stop:
    """Command that stops all vehicles in the graph, or one, until each link and base confirms.

    A link exists if a node drives or commands it; the node `arm` commands all links of its arm.
    """

    def __init__(self, node: Node, namespace: str | None) -> None:
        self.node = node
        self.namespace = namespace and f"/{namespace.strip('/')}".rstrip("/")
        self.publishers: dict[str, Publisher] = {}
        self.start = self.last_discovery = monotonic()
        self.since = int(node.get_clock().now().nanoseconds)  # by the clock of telemetry's stamps
        self.after: dict[str, float] = {}  # until each link's report [s]; inf: none
        self.publish(node.resolve_topic_name("arm/stop"))
        node.create_subscription(Clock, "/clock", self.on_clock, sensor())

    def publish(self, topic: str) -> None:
        """Publish a stop."""
        if topic not in self.publishers:
            self.publishers[topic] = self.node.create_publisher(Empty, topic, 10)
        self.publishers[topic].publish(Empty())

    def on_clock(self, message: Clock) -> None:
        """Use simulated time for the stamps, too."""
        self.since = min(self.since, stamp_ns(message.clock))

    def discover(self) -> None:
        """Publish to all arms, and subscribe to new links."""
        for topic, _ in self.node.get_topic_names_and_types():
            found = TOPIC.fullmatch(topic)
            if not found or self.namespace not in (None, found["namespace"]):
                continue
            part = found["link"] or found["base"]
            part = part and f"{found['namespace']}/{part}"
            if not part:
                self.publish(topic)
            elif part not in self.after and self.node.count_publishers(topic):
                self.watch(part, LinkTelemetry if found["link"] else BaseTelemetry)

    def watch(self, part: str, kind: type) -> None:
        """Record when a link, or a base's board, reports that it has stopped since the start."""
        self.last_discovery, self.after[part] = monotonic(), inf
        stopped = STOPPED[kind]

        def on_telemetry(message: Any) -> None:
            if message.flags & stopped and stamp_ns(message.header.stamp) > self.since:
                self.after[part] = min(self.after[part], monotonic() - self.start)

        subscribe_sensor(self.node, kind, f"{part}/telemetry", on_telemetry)

    def __call__(self, wait: float) -> Answer:
        """Stop; return whether all links confirm, and a message."""
        executor = SingleThreadedExecutor()
        executor.add_node(self.node)
        while True:
            self.discover()
            until = (now := monotonic()) + STOP_PERIOD
            while now < until:
                executor.spin_once(timeout_sec=until - now)
                now = monotonic()
            silent = [link for link, after in self.after.items() if after == inf]
            if self.after and not silent and now - self.start > GRAPH_DISCOVERY_TIME:
                seconds = max(self.after.values())
                return True, f"{_name_list(self.after)}: stopped after {seconds:.2f} s"
            if silent and now - self.last_discovery > CONFIRM_TIMEOUT:
                stopped = _name_list(self.after.keys() - silent)
                also = f" ({stopped}: stopped)" if stopped else ""
                return False, f"{_name_list(silent)}: stop not confirmed{also}; {EMERGENCY}"
            if not self.after and now - self.start > wait:
                return False, f"there is no link to confirm the stop; {EMERGENCY}"


def vehicles(node: Node) -> list[str]:
    """Return the namespaces that contain a driven arm."""
    found = (TOPIC.fullmatch(topic) for topic, _ in node.get_topic_names_and_types())
    return sorted({one["namespace"] or "/" for one in found if one and one["link"]})


def _searched_place(node: Node) -> str:
    """Return the ROS domain, and the namespace, that were searched."""
    domain = f" in ROS domain {os.environ.get('ROS_DOMAIN_ID') or 0}"
    return domain if node.get_namespace() == "/" else f" in {node.get_namespace()},{domain}"


def _name_list(links: Iterable[str]) -> str:
    return ", ".join(sorted(link.lstrip("/") for link in links))


def links(node: Node, wait: float) -> list[int]:
    """Return the numbers of the links that have a driver.

    Raises:
        NoAnswerError: there is none.
    """

    def driven() -> list[int]:
        return [i for i in LINKS if node.count_publishers(f"link_{i}/telemetry")]

    return list(discover(node, driven, "no driver of a link runs", wait))


def home(node: Node, wait: float, within: float) -> Answer:
    """Have each armed link without a reference find it, one after the other.

    Raises:
        NoAnswerError: there is no link.
    """
    telemetry: dict[int, LinkTelemetry] = {}
    for i in LINKS:
        subscribe_sensor(
            node, LinkTelemetry, f"link_{i}/telemetry", lambda m: telemetry.update({m.link: m})
        )
    present = links(node, wait)
    failures = [failure for i in present if (failure := home_link(node, i, telemetry, within))]
    return not failures, "; ".join(failures) or f"all {len(present)} links are referenced"


def home_link(node: Node, i: int, telemetry: dict[int, LinkTelemetry], within: float) -> str:
    """Repeat HOME to one link until it is referenced; return what failed, or an empty text."""
    if i not in telemetry:
        return f"link {i} is silent"
    publisher = node.create_publisher(LinkCommand, f"link_{i}/command", command(HOME_TIME_TO_LIVE))
    end, due = monotonic() + within, 0.0
    while not telemetry[i].flags & State.REFERENCED:
        if not telemetry[i].armed:
            return f"link {i} is not referenced: it is not armed"
        if (now := monotonic()) > end:
            return f"link {i} is not referenced after {within:.0f} s"
        if not due:
            print(f"link {i} searches for its reference", flush=True)
        if now > due:
            publisher.publish(LinkCommand(mode=LinkCommand.HOME, time_to_live=HOME_TIME_TO_LIVE))
            due = now + 0.1 * HOME_TIME_TO_LIVE
        rclpy.spin_once(node, timeout_sec=0.05)
    return ""


def move(node: Node, angles: list[float], seconds: float, wait: float) -> Answer:
    """Move all joints to angles [deg] in a time [s]; return whether they did, and a message.

    Raises:
        NoAnswerError: no node offers the action, or it does not answer.
    """
    client = ActionClient(node, MoveArm, "arm/move")
    if not client.wait_for_server(wait):
        raise NoAnswerError("no node offers arm/move")
    if problem := invalid_angles(angles, limits(node, wait)):
        return False, problem
    goal = MoveArm.Goal(q=list(map(radians, angles)), duration=seconds, keep_alive=KEEP_ALIVE)
    durations: list[float] = []

    def on_feedback(message: Any) -> None:
        if not durations:
            durations.append(message.feedback.remaining)
            least = " (as fast as its limits allow)" if durations[0] > 1.01 * seconds else ""
            print(f"moving for {durations[0]:.1f} s{least}", flush=True)

    sent = client.send_goal_async(goal, on_feedback)
    rclpy.spin_until_future_complete(node, sent, timeout_sec=ANSWER_TIMEOUT)
    if not sent.done():
        raise NoAnswerError(f"arm/move did not answer within {ANSWER_TIMEOUT:.0f} s")
    if not (handle := sent.result()).accepted:
        return False, "the node arm rejected this move; its log gives the reason"
    alive, ended = node.create_publisher(UUID, "arm/move/alive", 10), handle.get_result_async()
    while not ended.done():
        alive.publish(handle.goal_id)
        rclpy.spin_until_future_complete(node, ended, timeout_sec=0.2 * KEEP_ALIVE)
    result = ended.result().result
    reached = ", ".join(f"{round(degrees(q), 1) + 0.0:.1f}" for q in result.q)
    position = f"the joints are at {reached} deg" if reached else ""
    return result.reached, "; ".join(filter(None, (result.message, position)))


def limits(node: Node, wait: float) -> list[tuple[float, float]]:
    """Return the lowest and highest angle of each joint [deg], by the arm's description.

    Raises:
        NoAnswerError: no node publishes the description.
    """
    descriptions: list[String] = []
    node.create_subscription(String, "robot_description", descriptions.append, LATCHED)
    end = monotonic() + wait
    while not descriptions:
        if monotonic() > end:
            raise NoAnswerError("no node publishes robot_description")
        rclpy.spin_once(node, timeout_sec=0.05)
    found = ElementTree.fromstring(descriptions[-1].data).iterfind("joint[@type='revolute']/limit")
    return [(degrees(float(k.attrib["lower"])), degrees(float(k.attrib["upper"]))) for k in found]


def invalid_angles(angles: list[float], limits: list[tuple[float, float]]) -> str:
    """Return why the arm cannot move to these angles [deg]; empty: it can."""
    if len(angles) != len(limits):
        return f"{len(angles)} angles are given, but the arm has {len(limits)} joints"
    beyond = [
        f"joint {i} cannot go to {angle:g} deg: its limits are {low:g} to {high:g} deg"
        for i, (angle, (low, high)) in enumerate(zip(angles, limits, strict=True), 1)
        if not low <= angle <= high
    ]
    return "; ".join(beyond)


def clear(node: Node, wait: float) -> Answer:
    """Disarm all links and clear their drives' faults; telemetry shows what remains.

    Raises:
        NoAnswerError: there is no link, or one's driver is silent.
    """
    names = [f"link_{i}/clear_faults" for i in links(node, wait)]
    return join_answers(
        {name: call(node, Trigger, name, Trigger.Request(), wait) for name in names}
    )


def calibrations(node: Node, what: str, wait: float) -> Answer:
    """Have all running calibrations solve, which succeeds if they pass, or forget.

    Raises:
        NoAnswerError: none runs, or one is silent.
    """

    def offered() -> list[str]:
        here = {name for name, _ in node.get_service_names_and_types()}
        names = [f"{kind}/{what}" for kind in CALIBRATIONS]
        return [name for name in names if node.resolve_service_name(name) in here]

    names = discover(node, offered, "no calibration runs", wait)
    return join_answers(
        {name: call(node, Trigger, name, Trigger.Request(), wait) for name in names}
    )


def join_answers(answers: dict[str, Answer]) -> Answer:
    """Join several answers, one line each."""
    lines = [f"{name}: {words}" for name, (_, words) in answers.items()]
    return all(done for done, _ in answers.values()), "\n".join(lines)


def execute(node: Node, options: argparse.Namespace) -> Answer:
    """Execute a command.

    Raises:
        NoAnswerError: a node does not exist, or does not answer.
    """
    what, wait = options.what, 10.0 if options.wait is None else options.wait
    if what == "move":
        return move(node, options.angles, options.seconds, wait)
    if what == "home":
        return home(node, wait, options.within)
    if what in ("arm", "disarm"):
        return call(node, SetBool, "arm/enable", SetBool.Request(data=what == "arm"), wait)
    if what == "valves":
        return call(node, SetBool, "base/arm", SetBool.Request(data=True), wait)
    if what == "clear":
        return clear(node, wait)
    return calibrations(node, what, wait)


def namespace(text: str) -> str:
    """Return the namespace of a vehicle, checked.

    Raises:
        argparse.ArgumentTypeError: it is none.
    """
    try:
        if text != "/" and not NAMESPACE.fullmatch(text):
            raise InvalidNamespaceException(text, "", 0)
        validate_namespace(f"/{text.lstrip('/')}")
    except InvalidNamespaceException:
        raise argparse.ArgumentTypeError(
            f"{text!r} is no namespace of a vehicle, expected a letter and then letters, digits "
            "and _, as fss2; without it, stop is for all vehicles"
        ) from None
    return text


def duration(text: str) -> float:
    """Return a time [s], checked.

    Raises:
        argparse.ArgumentTypeError: it is none.
    """
    return _number(text, 0.0, MAX_TIME, f"0 to {MAX_TIME:.0f} s")


def angle(text: str) -> float:
    """Return an angle [deg], checked.

    Raises:
        argparse.ArgumentTypeError: it is none.
    """
    return _number(text, -MAX_ANGLE, MAX_ANGLE, "an angle in degrees")


def _number(text: str, least: float, greatest: float, expected: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = nan
    if not least <= number <= greatest:
        raise argparse.ArgumentTypeError(f"{text!r} is given, expected {expected}")
    return number


class Parser(argparse.ArgumentParser):
    """Reports an error in one line; an option has one name, not its abbreviations."""

    def error(self, message: str) -> NoReturn:
        """Exit with 2, as ROS nodes do after a wrong command line."""
        self.exit(2, f"{self.prog}: {' '.join(message.split())}\n")


def parsed() -> tuple[argparse.Namespace, str | None]:
    """Read the command line; return its options, and the namespace of the vehicle, if any.

    A wrong one ends the program.
    """
    parser = Parser("fss_arm.sh", allow_abbrev=False, description=__doc__.replace("\n\n", "\n"))
    parser.add_argument(
        "what", nargs="?", choices=COMMANDS, metavar="COMMAND", help=", ".join(COMMANDS)
    )
    parser.add_argument(
        "angles", nargs="*", type=angle, metavar="ANGLE", help="of each joint [deg], to move"
    )
    parser.add_argument(
        "--vehicle",
        "--namespace",
        type=namespace,
        help="namespace of the vehicle; by "
        "default stop is for all vehicles, and other commands for the one in FSS_NAMESPACE",
    )
    parser.add_argument(
        "--wait", type=duration, help="timeout waiting for the node [s] (default 10; stop 2)"
    )
    parser.add_argument(
        "--within", type=duration, default=60.0, help="timeout for a link's reference [s]"
    )
    parser.add_argument("--seconds", type=duration, default=0.0, help="duration of a move [s]")
    options = parser.parse_intermixed_args()
    if options.what is None:
        also = f" (--vehicle is {options.vehicle!r})" if options.vehicle else ""
        parser.error(f"COMMAND is missing{also}, expected one of {', '.join(COMMANDS)}")
    if bool(options.angles) != (options.what == "move"):
        expected = "one for each joint [deg]" if options.what == "move" else "none"
        parser.error(f"{options.what} has {len(options.angles)} angles, expected {expected}")
    if options.vehicle is not None:
        return options, options.vehicle
    try:
        return options, namespace(os.environ.get("FSS_NAMESPACE") or "/")
    except argparse.ArgumentTypeError as error:
        if options.what == "stop":  # for all vehicles, whatever the shell's one is called
            return options, None
        parser.error(f"FSS_NAMESPACE: {error}")


def main() -> int:
    """Run; the exit code is 0 if the arm did so, 1 if not, 130 if interrupted before."""
    options, vehicle = parsed()
    try:
        check_domain()
        rclpy.init()
    except (ValueError, RCLError) as error:
        print(f"fss_arm.sh: {in_words(error).split(', at /')[0]}", file=sys.stderr)
        return 2
    node = Node("fss_arm", namespace=vehicle)
    code = 1
    try:
        if options.what == "stop":
            done, words = Stop(node, options.vehicle)(2.0 if options.wait is None else options.wait)
        else:
            done, words = execute(node, options)
            words = f"{vehicle}: {words}" if vehicle and len(node.get_namespace()) > 1 else words
        code = 0 if done else 1
    except NoAnswerError as error:
        others = [v for v in vehicles(node) if v != node.get_namespace()]
        also = f"; --vehicle is one of {', '.join(others)}" if others else ""
        words = f"{error}{_searched_place(node)}{also}"
    except (KeyboardInterrupt, ExternalShutdownException):
        code, words = 130, "interrupted"
    except RCLError:
        if rclpy.ok():
            raise
        code, words = 130, "interrupted"
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    print(words, file=sys.stderr if code else sys.stdout)
    return code


if __name__ == "__main__":
    sys.exit(main())
