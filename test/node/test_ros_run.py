"""How a node's program ends."""

import subprocess
import sys

TOLD = """
import os, signal, sys, time
import rclpy
from rclpy.node import Node
from fss_arm_ros.run import run

def make():
    os.kill(os.getpid(), signal.SIGTERM)
    while rclpy.ok():
        time.sleep(0.01)
    return Node("late")

sys.exit(run(make))
"""


def test_told_to_end_while_it_is_made_it_ends_well():
    ended = subprocess.run([sys.executable, "-c", TOLD], capture_output=True, text=True, timeout=30)
    assert (ended.returncode, ended.stderr) == (0, "")
