"""Capture a target and stop its motion; print each phase and the result. Ctrl-C aborts."""

import sys

import rclpy
from rclpy.action import ActionClient
from rclpy.signals import SignalHandlerOptions

from fss_arm_msgs.action import Capture
from fss_arm_msgs.msg import MissionState
from fss_arm_ros.convert import stamp_ns
from fss_arm_ros.qos import LATCHED
from fss_arm_ros.run import deferred_signals


def wait(node, future):
    """Wait for a future; Ctrl-C takes effect between two short waits."""
    while not future.done():
        with deferred_signals():
            rclpy.spin_until_future_complete(node, future, timeout_sec=0.1)
    return future.result()


def fly(node, client, accepted):
    """Send the goal, and return the mission's result; Ctrl-C aborts the mission.

    Args:
        node: the client's node.
        client: of the action.
        accepted: list to which the goal is added once the mission has started.
    """
    sent = None
    try:
        with deferred_signals():  # a goal that was sent can be canceled
            sent = client.send_goal_async(Capture.Goal(detumble=True))
        accepted.append(wait(node, sent))
        return wait(node, accepted[0].get_result_async()).result
    except KeyboardInterrupt:
        if sent is None:
            raise
        goal = wait(node, sent)
        wait(node, goal.cancel_goal_async())
        return wait(node, goal.get_result_async()).result


def main():
    """Send the goal, and print each phase until the end; return the exit code."""
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)  # Ctrl-C must not end ROS
    node = rclpy.create_node("operator")
    phases, accepted = [], []

    def on_state(state):
        # The first state can be that of a former mission.
        if not accepted or stamp_ns(state.header.stamp) < stamp_ns(accepted[0].stamp):
            return
        phase = ": ".join(filter(None, (state.phase, state.reason)))
        if state.mission == "capture" and phase not in phases[-1:]:
            phases.append(phase)
            print(f"{state.elapsed:6.1f} s  {phase}", flush=True)

    node.create_subscription(MissionState, "mission/state", on_state, LATCHED)
    client = ActionClient(node, Capture, "mission/capture")
    print("waiting for mission/capture", flush=True)
    client.wait_for_server()
    result = fly(node, client, accepted)
    reason = f" ({result.message})" if result.message else ""
    print(f"captured: {result.captured}, stopped: {result.stopped}{reason}")
    print(f"{result.duration:.1f} s, {1e3 * result.propellant:.1f} g of gas")
    return 0 if result.stopped else 1


if __name__ == "__main__":
    sys.exit(main())
