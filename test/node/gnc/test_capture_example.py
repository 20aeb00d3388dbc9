"""The example that sends the goal of a capture: Ctrl-C aborts the mission."""

import os
import signal
import subprocess
import sys
from pathlib import Path

from rclpy.action import ActionServer, CancelResponse
from rclpy.node import Node
from rclpy.task import Future

from fss_arm_msgs.action import Capture

EXAMPLE = Path(__file__).parents[3] / "docs/examples/capture.py"


def test_ctrl_c_cancels_the_goal_and_prints_the_result(spin, domain):
    guidance, started, cancelled = Node("guidance"), [], Future()

    async def fly(handle):
        started.append(handle)
        await cancelled
        handle.canceled()
        return Capture.Result(message="cancelled by the client")

    def on_cancel(_):
        cancelled.set_result(True)
        return CancelResponse.ACCEPT

    ActionServer(guidance, Capture, "mission/capture", fly, cancel_callback=on_cancel)
    program = subprocess.Popen(
        [sys.executable, EXAMPLE],
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | {"ROS_DOMAIN_ID": str(domain)},
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    try:
        spin(guidance, lambda: started, timeout=120.0)
        program.send_signal(signal.SIGINT)
        spin(guidance, lambda: program.poll() is not None, timeout=60.0)
    finally:
        program.kill()
    text = "captured: False, stopped: False (cancelled by the client)"
    assert text in program.communicate()[0]
    assert program.returncode == 1
