"""The example that sends the goal of a capture: its phases, and Ctrl-C, which aborts it."""

import os
import signal
import subprocess
import sys
from pathlib import Path
from threading import Thread

from rclpy.action import ActionServer, CancelResponse
from rclpy.node import Node
from rclpy.task import Future

from fss_arm_msgs.action import Capture
from fss_arm_msgs.msg import MissionState
from fss_arm_ros.qos import LATCHED

EXAMPLE = Path(__file__).parents[3] / "docs/examples/capture.py"


def test_it_prints_its_own_mission_and_ctrl_c_aborts_it(spin, domain):
    guidance, started, phases, canceled = Node("guidance"), [], [], Future()

    def publish(**fields):
        state = MissionState(mission="capture", **fields)
        state.header.stamp = guidance.get_clock().now().to_msg()
        states.publish(state)

    async def fly(handle):
        started.append(handle)
        await canceled
        handle.canceled()
        return Capture.Result(message="canceled by the client")

    def on_cancel(_):
        canceled.set_result(True)
        return CancelResponse.ACCEPT

    states = guidance.create_publisher(MissionState, "mission/state", LATCHED)
    publish(phase="abort", reason="of a former mission", elapsed=31.4)
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
        guidance.create_timer(0.1, lambda: publish(phase="wait"))
        assert program.stdout.readline() == "waiting for mission/capture\n"
        reader = Thread(target=lambda: phases.append(program.stdout.readline()))
        reader.start()
        spin(guidance, lambda: phases, timeout=60.0)
        assert phases == ["   0.0 s  wait\n"]
        program.send_signal(signal.SIGINT)
        spin(guidance, lambda: program.poll() is not None, timeout=60.0)
    finally:
        program.kill()
    text = "captured: False, stopped: False (canceled by the client)"
    assert text in program.communicate()[0]
    assert program.returncode == 1
