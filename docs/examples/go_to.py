"""Move the base of a vehicle, and print each phase until the goal ends. Ctrl-C does not end it."""

import argparse
import os
import sys

import rclpy
from rclpy.action import ActionClient
from rclpy.exceptions import InvalidNamespaceException
from rclpy.executors import ExternalShutdownException

from fss_arm_msgs.action import GoToPose
from fss_arm_msgs.msg import MissionState
from fss_arm_ros.convert import stamp_ns
from fss_arm_ros.qos import LATCHED

HOLD_DURATION = 600.0  # at the goal [s]
SERVER_TIMEOUT = 10.0  # [s]


def main():
    """Send the goal, and print each phase until the end; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "vehicle", metavar="VEHICLE", help="its namespace, such as fss1, or / for a single one"
    )
    for name, unit in (("X", "m"), ("Y", "m"), ("HEADING", "rad")):
        parser.add_argument(name, type=float, help=f"of the goal, in the world [{unit}]")
    options = parser.parse_args()
    vehicle, pose = options.vehicle, [options.X, options.Y, options.HEADING]
    rclpy.init(args=[])
    try:
        node = rclpy.create_node("operator", namespace=vehicle)
    except InvalidNamespaceException:
        parser.error(f"VEHICLE is {vehicle!r}, expected a namespace such as fss1")
    try:
        return send(node, vehicle, GoToPose.Goal(pose=pose, hold_duration=HOLD_DURATION))
    except (KeyboardInterrupt, ExternalShutdownException):
        print(f"{vehicle}: this program ends, a goal that was sent continues")
        return 130


def send(node, vehicle, goal):
    """Send a goal, and print each phase until its end; return the exit code."""
    phases, accepted = [], []  # accepted: the goal, once it is

    def on_state(state):
        # The first state can be that of a former goal.
        if not accepted or stamp_ns(state.header.stamp) < stamp_ns(accepted[0].stamp):
            return
        phase = ": ".join(filter(None, (state.phase, state.reason)))
        if state.mission == "go_to" and phase not in phases[-1:]:
            phases.append(phase)
            print(f"{vehicle} {state.elapsed:5.1f} s  {phase}", flush=True)

    node.create_subscription(MissionState, "mission/state", on_state, LATCHED)
    client = ActionClient(node, GoToPose, "base/go_to")
    if not client.wait_for_server(timeout_sec=SERVER_TIMEOUT):
        domain = os.environ.get("ROS_DOMAIN_ID", "0")
        print(f"no /{vehicle}/base/go_to in ROS domain {domain}: scripts/fss_up.sh", flush=True)
        return 1
    sent = client.send_goal_async(goal)
    rclpy.spin_until_future_complete(node, sent)
    accepted.append(sent.result())
    ended = sent.result().get_result_async()
    rclpy.spin_until_future_complete(node, ended)
    result = ended.result().result
    print(f"{vehicle} reached: {result.reached} {result.message}")
    return 0 if result.reached else 1


if __name__ == "__main__":
    sys.exit(main())
