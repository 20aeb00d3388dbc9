"""Commands to one arm: services and actions of its nodes, and their answers."""

from collections.abc import Callable
from math import degrees, radians
from time import monotonic
from typing import Any
from xml.etree import ElementTree

import rclpy
from rclpy.action import ActionClient
from rclpy.node import Node
from std_msgs.msg import String
from std_srvs.srv import Trigger
from unique_identifier_msgs.msg import UUID

from fss_arm_driver.protocol import State
from fss_arm_msgs.action import MoveArm
from fss_arm_msgs.msg import LinkCommand, LinkTelemetry
from fss_arm_ros.qos import LATCHED, command, subscribe_sensor

ANSWER_TIMEOUT = 10.0  # [s]
SIMULATED_ANSWER_TIMEOUT = 35.0  # in simulated time, which may be slow [s]
DISCOVERY_TIME = 1.0  # without a change, discovery is complete [s]
LINKS = range(1, 13)  # numbers that a link may have
CALIBRATIONS = ("kinematic", "dynamic", "drift", "drives", "joint")  # joint: from three of these
KEEP_ALIVE = 1.0  # silence of this program that ends a move [s]
HOME_TIME_TO_LIVE = 2.0  # short, so that the link holds soon after this program has ended [s]

Answer = tuple[bool, str]  # whether it succeeded, and a message


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
    wait_for_answer(node, future, name)
    done, words = future.result().success, future.result().message
    silent = "done" if done else "refused; the log of its node has the reason"
    return done, words or f"{name}: {silent}"


def wait_for_answer(node: Node, future: Any, name: str) -> None:
    """Wait for the answer to a request or goal.

    Raises:
        NoAnswerError: there is none in time.
    """
    simulated = bool(node.count_publishers("/clock"))
    timeout = SIMULATED_ANSWER_TIMEOUT if simulated else ANSWER_TIMEOUT
    rclpy.spin_until_future_complete(node, future, timeout_sec=timeout)
    if not future.done():
        raise NoAnswerError(f"{name} did not answer within {timeout:.0f} s: try again")


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
    wait_for_answer(node, sent, "arm/move")
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
