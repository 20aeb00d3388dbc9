"""Capture a target and stop its motion; print each phase and the result. Ctrl-C cancels."""

import rclpy
from rclpy.action import ActionClient

from fss_arm_msgs.action import Capture
from fss_arm_msgs.msg import MissionState
from fss_arm_ros.qos import LATCHED


def main():
    """Send the goal, and print each phase until the end."""
    rclpy.init()
    node = rclpy.create_node("operator")
    phases = []

    def on_state(state):
        phase = ": ".join(filter(None, (state.phase, state.reason)))
        if state.mission == "capture" and phase not in phases[-1:]:
            phases.append(phase)
            print(f"{state.elapsed:6.1f} s  {phase}", flush=True)

    node.create_subscription(MissionState, "mission/state", on_state, LATCHED)
    client = ActionClient(node, Capture, "mission/capture")
    print("waiting for mission/capture", flush=True)
    client.wait_for_server()
    sent = client.send_goal_async(Capture.Goal(detumble=True))
    rclpy.spin_until_future_complete(node, sent)
    ended = sent.result().get_result_async()
    try:
        rclpy.spin_until_future_complete(node, ended)
    except KeyboardInterrupt:
        rclpy.spin_until_future_complete(node, sent.result().cancel_goal_async())
        rclpy.spin_until_future_complete(node, ended)
    result = ended.result().result
    print(f"captured: {result.captured}, stopped: {result.stopped} {result.message}")
    print(f"{result.duration:.1f} s, {1e3 * result.propellant:.1f} g of gas")


if __name__ == "__main__":
    main()
