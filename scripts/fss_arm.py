"""Tell the arm something, and print its answer.

arm, disarm: all links (arm/arm). stop: all links at once, until armed anew (arm/stop).
solve: close the present rest and calibrate (kinematic/solve).
"""

import argparse
import sys
from time import monotonic
from typing import Any

import rclpy
from rclpy.duration import Duration
from rclpy.node import Node
from std_msgs.msg import Empty
from std_srvs.srv import SetBool, Trigger

PATIENCE = 10.0  # for an answer [s]
SETTLED = 1.0  # without a new listener, all are known [s]


class NoAnswerError(RuntimeError):
    """Nobody is there, or nobody answers."""


def call(node: Node, kind: Any, name: str, request: Any, wait: float) -> tuple[bool, str]:
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


def stop(node: Node, wait: float) -> tuple[bool, str]:
    """Publish arm/stop again and again until no new listener has shown up for a while.

    Raises:
        NoAnswerError: nobody listens.
    """
    publisher = node.create_publisher(Empty, "arm/stop", 10)
    begin = since = monotonic()
    listeners = 0
    while not listeners or monotonic() - since < SETTLED:
        publisher.publish(Empty())
        rclpy.spin_once(node, timeout_sec=0.05)
        if (count := publisher.get_subscription_count()) != listeners:
            listeners, since = count, monotonic()
        if not listeners and monotonic() - begin > wait:
            raise NoAnswerError("nobody listens to arm/stop")
    heard = publisher.wait_for_all_acked(Duration(seconds=PATIENCE))
    return heard, f"stop sent to {listeners} listeners"


def main() -> int:
    """Run; the exit code is 0 if the arm did as told."""
    parser = argparse.ArgumentParser("fss_arm.sh", description=__doc__.replace("\n\n", "\n"))
    parser.add_argument("what", choices=("arm", "disarm", "stop", "solve"))
    parser.add_argument("--wait", type=float, default=10.0, help="for somebody to be there [s]")
    options = parser.parse_args()
    what, wait = options.what, options.wait
    rclpy.init()
    node = Node("fss_arm")
    try:
        if what == "stop":
            done, words = stop(node, wait)
        elif what == "solve":
            done, words = call(node, Trigger, "kinematic/solve", Trigger.Request(), wait)
        else:
            request = SetBool.Request(data=what == "arm")
            done, words = call(node, SetBool, "arm/arm", request, wait)
    except NoAnswerError as error:
        done, words = False, str(error)
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    print(words, file=sys.stdout if done else sys.stderr)
    return 0 if done else 1


if __name__ == "__main__":
    sys.exit(main())
