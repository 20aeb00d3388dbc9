"""Move the base of a vehicle, and print what it does: go_to.py VEHICLE X Y HEADING [m, m, rad]."""

import sys

import rclpy
from rclpy.action import ActionClient
from rclpy.executors import ExternalShutdownException

from fss_arm_msgs.action import GoToPose
from fss_arm_msgs.msg import MissionState
from fss_arm_ros.qos import LATCHED

HOLD_DURATION = 600.0  # at the goal [s]


def main(vehicle, *pose):
    """Send the goal, and print each phase until the end."""
    rclpy.init(args=[])
    node = rclpy.create_node("operator", namespace=vehicle)
    said = []

    def on_state(state):
        phase = ": ".join(filter(None, (state.phase, state.reason)))
        if state.mission == "go_to" and phase not in said[-1:]:
            said.append(phase)
            print(f"{vehicle} {state.elapsed:5.1f} s  {phase}", flush=True)

    node.create_subscription(MissionState, "mission/state", on_state, LATCHED)
    client = ActionClient(node, GoToPose, "base/go_to")
    client.wait_for_server()
    sent = client.send_goal_async(
        GoToPose.Goal(pose=list(map(float, pose)), hold_duration=HOLD_DURATION)
    )
    rclpy.spin_until_future_complete(node, sent)
    ended = sent.result().get_result_async()
    try:
        rclpy.spin_until_future_complete(node, ended)
    except (KeyboardInterrupt, ExternalShutdownException):
        print(f"{vehicle}: this program ends, the goal continues")
        return
    result = ended.result().result
    print(f"{vehicle} reached: {result.reached} {result.message}")


if __name__ == "__main__":
    main(*sys.argv[1:])
