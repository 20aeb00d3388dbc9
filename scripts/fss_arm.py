"""Tell the arm something, and print its answer.

arm, disarm: all links (arm/arm). stop: all links at once; those that are on hold, under power,
until disarmed or armed anew (arm/stop). home: each armed link without a reference finds it, one
after the other. clear: all links disarm and clear their drives' latched faults.
solve: each calibration that runs closes its present datum and solves. forget: they drop
all that they have observed.
"""

import argparse
import sys
from collections.abc import Callable
from time import monotonic
from typing import Any

import rclpy
from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from std_msgs.msg import Empty
from std_srvs.srv import SetBool, Trigger

from fss_arm_driver.protocol import State
from fss_arm_msgs.msg import LinkCommand, LinkTelemetry
from fss_arm_ros.qos import command, subscribe_sensor
from fss_arm_ros.run import RCLError

PATIENCE = 10.0  # for an answer [s]
SETTLED = 1.0  # without a new one, all are known [s]
LINKS = range(1, 13)  # numbers that a link may have
WORDS = ("arm", "disarm", "stop", "home", "clear", "solve", "forget")
CALIBRATIONS = ("kinematic", "dynamic", "drift")
LIVES = 2.0  # a HOME, so that the link holds soon after this has ended [s]

Answer = tuple[bool, str]


class NoAnswerError(RuntimeError):
    """Nobody is there, or nobody answers."""


def call(node: Node, kind: Any, name: str, request: Any, wait: float) -> Answer:
    """Call a service; whether it succeeded, and its words.

    Raises:
        NoAnswerError: it is not there or silent.
    """
    client = node.create_client(kind, name)
    if not client.wait_for_service(wait):
        raise NoAnswerError(f"nobody offers {name}")
    future = client.call_async(request)
    rclpy.spin_until_future_complete(node, future, timeout_sec=PATIENCE)
    if not future.done():
        raise NoAnswerError(f"{name} did not answer within {PATIENCE:.0f} s")
    return future.result().success, future.result().message


def settled(node: Node, known: Callable[[], Any], nobody: str, wait: float) -> Any:
    """Spin until what is known, once there is something, has not changed for a while; return it.

    Raises:
        NoAnswerError: there is nothing.
    """
    begin = since = monotonic()
    seen = None
    while not seen or monotonic() - since < SETTLED:
        rclpy.spin_once(node, timeout_sec=0.05)
        if (now := known()) != seen:
            seen, since = now, monotonic()
        if not seen and monotonic() - begin > wait:
            raise NoAnswerError(nobody)
    return seen


def stop(node: Node, wait: float) -> Answer:
    """Publish arm/stop again and again until no new listener has shown up for a while.

    Raises:
        NoAnswerError: nobody listens.
    """
    publisher = node.create_publisher(Empty, "arm/stop", 10)

    def listeners() -> int:
        publisher.publish(Empty())
        return int(publisher.get_subscription_count())

    count = settled(node, listeners, "nobody listens to arm/stop", wait)
    heard = publisher.wait_for_all_acked(Duration(seconds=PATIENCE))
    return heard, f"stop sent to {count} listeners"


def links(node: Node, wait: float) -> list[int]:
    """The numbers of the links that somebody drives.

    Raises:
        NoAnswerError: there is none.
    """

    def driven() -> list[int]:
        return [i for i in LINKS if node.count_publishers(f"link_{i}/telemetry")]

    return list(settled(node, driven, "nobody drives a link", wait))


def home(node: Node, wait: float, within: float) -> Answer:
    """Have each armed link without a reference find it, one after the other.

    Raises:
        NoAnswerError: there is no link.
    """
    heard: dict[int, LinkTelemetry] = {}
    for i in LINKS:
        subscribe_sensor(
            node, LinkTelemetry, f"link_{i}/telemetry", lambda m: heard.update({m.link: m})
        )
    present = links(node, wait)
    troubles = [trouble for i in present if (trouble := home_link(node, i, heard, within))]
    return not troubles, "; ".join(troubles) or f"all {len(present)} links are referenced"


def home_link(node: Node, i: int, heard: dict[int, LinkTelemetry], within: float) -> str:
    """Repeat HOME to one link until it is referenced; else what is wrong."""
    if i not in heard:
        return f"link {i} is silent"
    publisher = node.create_publisher(LinkCommand, f"link_{i}/command", command(LIVES))
    end, due = monotonic() + within, 0.0
    while not heard[i].flags & State.REFERENCED:
        if not heard[i].armed:
            return f"link {i} is not referenced: it is not armed"
        if (now := monotonic()) > end:
            return f"link {i} is not referenced after {within:.0f} s"
        if not due:
            print(f"link {i} looks for its reference", flush=True)
        if now > due:
            publisher.publish(LinkCommand(mode=LinkCommand.HOME, time_to_live=LIVES))
            due = now + 0.1 * LIVES
        rclpy.spin_once(node, timeout_sec=0.05)
    return ""


def clear(node: Node, wait: float) -> Answer:
    """Disarm all links and clear their drives' faults; telemetry tells what remains.

    Raises:
        NoAnswerError: there is no link, or one's driver is silent.
    """
    names = [f"link_{i}/clear_faults" for i in links(node, wait)]
    return together({name: call(node, Trigger, name, Trigger.Request(), wait) for name in names})


def calibrations(node: Node, what: str, wait: float) -> Answer:
    """Have all calibrations that run solve, which succeeds if they pass, or forget.

    Raises:
        NoAnswerError: none runs, or one is silent.
    """

    def offered() -> list[str]:
        here = {name for name, _ in node.get_service_names_and_types()}
        names = [f"{kind}/{what}" for kind in CALIBRATIONS]
        return [name for name in names if node.resolve_service_name(name) in here]

    names = settled(node, offered, "no calibration runs", wait)
    return together({name: call(node, Trigger, name, Trigger.Request(), wait) for name in names})


def together(answers: dict[str, Answer]) -> Answer:
    """All answers as one, a line each."""
    lines = [f"{name}: {words}" for name, (_, words) in answers.items()]
    return all(done for done, _ in answers.values()), "\n".join(lines)


def tell(node: Node, what: str, wait: float, within: float) -> Answer:
    """Do as told.

    Raises:
        NoAnswerError: nobody is there, or nobody answers.
    """
    if what == "home":
        return home(node, wait, within)
    if what in ("arm", "disarm"):
        return call(node, SetBool, "arm/arm", SetBool.Request(data=what == "arm"), wait)
    if what in ("stop", "clear"):
        return {"stop": stop, "clear": clear}[what](node, wait)
    return calibrations(node, what, wait)


def main() -> int:
    """Run; the exit code is 0 if the arm did as told."""
    parser = argparse.ArgumentParser("fss_arm.sh", description=__doc__.replace("\n\n", "\n"))
    parser.add_argument("what", choices=WORDS)
    parser.add_argument("--wait", type=float, default=10.0, help="for somebody to be there [s]")
    parser.add_argument("--within", type=float, default=60.0, help="a link must be referenced [s]")
    options = parser.parse_args()
    rclpy.init()
    node = Node("fss_arm")
    try:
        done, words = tell(node, options.what, options.wait, options.within)
    except NoAnswerError as error:
        done, words = False, str(error)
    except (KeyboardInterrupt, ExternalShutdownException):
        done, words = False, "interrupted"
    except RCLError:
        if rclpy.ok():
            raise
        done, words = False, "interrupted"
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    print(words, file=sys.stdout if done else sys.stderr)
    return 0 if done else 1


if __name__ == "__main__":
    sys.exit(main())
