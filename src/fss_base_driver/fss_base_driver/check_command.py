"""Implementation of the command `check`."""

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rclpy
from rclpy.signals import SignalHandlerOptions
from rich.console import Console

from fss_arm_model.description import Arm
from fss_arm_model.description_file import described
from fss_arm_model.settings import default_in
from fss_arm_model.thrusters import THRUSTER_COUNT, thruster_wrenches
from fss_arm_ros.command_line import in_words, interrupt_at_end
from fss_base_driver.check_node import ANSWER_TIMEOUT, CheckError, CheckNode
from fss_base_driver.check_options import BASE_TOPIC, parse
from fss_base_driver.findings import Finding, as_yaml, exit_code, judge_valve, table
from fss_base_driver.thrust import Body, valve_order

NOT_POSSIBLE, INTERRUPTED = 1, 130


def main(args: Sequence[str] | None = None) -> int:
    """Run as `ros2 run fss_base_driver check`."""
    given = parse(args)
    findings: list[Finding] = []
    interrupt_at_end()
    try:
        arm = described(given.arm)
        if given.q and len(given.q) != arm.n:
            raise CheckError(f"--q has {len(given.q)} angles, expected {arm.n}")
        if not given.yes:
            input("Let the base float freely, hold all joints, stand clear, press Enter to start: ")
        run(arm, given, findings)
    except (CheckError, ValueError, OSError) as error:
        print(f"check: {in_words(error)}", file=sys.stderr)
        return NOT_POSSIBLE
    except (EOFError, KeyboardInterrupt) as end:
        why = "end of input" if isinstance(end, EOFError) else "interrupted"
        print(f"check: {why}", file=sys.stderr)
        return NOT_POSSIBLE if isinstance(end, EOFError) else INTERRUPTED
    finally:  # the results are saved even after an error
        if findings:
            when = time.strftime("%Y-%m-%dT%H:%M:%S%z")
            Path(given.output).write_text(as_yaml(findings, when), encoding="utf-8")
            Console().print(table(findings))
            print(f"written to {given.output}")
    return exit_code(findings)


def run(arm: Arm, given: argparse.Namespace, findings: list[Finding]) -> None:
    """Test the requested valves, and leave the board disarmed.

    Raises:
        CheckError: the check cannot be carried out.
    """
    rows = np.reshape(given.layout, (THRUSTER_COUNT, 3)) if given.layout else None
    rows = thruster_wrenches(given.thrust, given.lever) if rows is None else rows
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)  # to disarm at the end
    try:
        topic = given.base_topic or default_in(BASE_TOPIC, given.namespace)
        node = CheckNode(given.namespace, topic)
        # Without telemetry, the answer to arming gives the reason.
        node.wait(lambda: node.trial.open_valves, ANSWER_TIMEOUT)
        body = Body.of(arm, given.q or node.angles(arm))
        with node.armed():
            if not node.wait(lambda: node.trial.poses, ANSWER_TIMEOUT):
                raise CheckError(f"no poses on {topic}: is the base visible to motion capture?")
            for valve in valve_order(rows):
                if valve + 1 in (given.valves or range(1, THRUSTER_COUNT + 1)):
                    trial = node.try_valve(valve, given)
                    findings.append(judge_valve(trial, body, rows, given.tolerance))
                    print(f"valve {valve + 1}: {findings[-1].verdict} {findings[-1].words}")
    finally:
        rclpy.try_shutdown()
