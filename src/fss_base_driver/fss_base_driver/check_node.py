"""Implementation of the command `check`."""

import argparse
import json
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from math import isfinite
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rich.console import Console
from rich.table import Table
from sensor_msgs.msg import Imu, JointState
from std_srvs.srv import SetBool

from fss_arm_model.description import Arm
from fss_arm_model.description_file import described
from fss_arm_model.settings import default_in
from fss_arm_model.thrusters import COUNT, layout
from fss_arm_msgs.msg import BaseTelemetry, ThrusterCommand
from fss_arm_ros.command_line import in_words, interrupt_at_end
from fss_arm_ros.convert import SECOND, joint_readings, seen_pose, stamp_ns
from fss_arm_ros.qos import COMMAND, subscribe_sensor
from fss_arm_ros.run import spin_once
from fss_base_driver.check_options import BASE_TOPIC, parser
from fss_base_driver.thrust import Body, Floats, Thrust, TrackError, estimate, valve_order, verdict

PASS, FAIL, NOT_TRIED = "pass", "fail", "not tried"
EXIT_CODES = {PASS: 0, FAIL: 2, NOT_TRIED: 3}
NOT_POSSIBLE, INTERRUPTED = 1, 130
ANSWER_TIMEOUT = 10.0  # longest wait for an answer [s]
DISCOVERY = 1.0  # time to discover the topics [s]


class CheckError(RuntimeError):
    """Failure to carry out the check; the message says why."""


class Finding(NamedTuple):
    """Result for one valve, numbered from 1."""

    valve: int
    verdict: str
    words: str
    thrust: Thrust | None = None


class Tester(Node):
    """Node that opens valves through the node `base` and records the base's motion."""

    def __init__(self, namespace: str, base_topic: str) -> None:
        super().__init__(
            "check", namespace=namespace, enable_rosout=False, start_parameter_services=False
        )
        self.poses: list[tuple[float, float, float, float]] = []  # [s], [m], [m], [rad]
        self.rates: list[tuple[float, float]] = []  # [s], [rad/s]
        self.telemetry: list[BaseTelemetry] = []
        self.sent: list[ThrusterCommand] = []
        self.joints: dict[int, float] = {}
        subscribe_sensor(self, PoseStamped, base_topic, self.on_pose)
        subscribe_sensor(self, Imu, "fog/imu", self.on_imu)
        subscribe_sensor(self, JointState, "joint_states", self.on_joints)
        subscribe_sensor(self, BaseTelemetry, "base/telemetry", self.telemetry.append)
        subscribe_sensor(self, ThrusterCommand, "thrusters/pulses", self.sent.append)
        self.command = self.create_publisher(ThrusterCommand, "thrusters/command", COMMAND)
        self.arming = self.create_client(SetBool, "base/arm")

    def on_pose(self, message: PoseStamped) -> None:
        """Store a valid pose."""
        if pose := seen_pose(message):
            self.poses.append((stamp_ns(message.header.stamp) / SECOND, *pose))

    def on_imu(self, message: Imu) -> None:
        """Store a turn rate."""
        rate = message.angular_velocity.z
        if isfinite(rate):
            self.rates.append((stamp_ns(message.header.stamp) / SECOND, rate))

    def on_joints(self, message: JointState) -> None:
        """Store the joints' last angles."""
        self.joints |= {i: q for i, q, _, _ in joint_readings(message) if isfinite(q)}

    def wait(self, condition: Callable[[], Any], timeout: float) -> bool:
        """Spin until the condition holds or the timeout passes; return True if it holds."""
        until = time.monotonic() + timeout
        while not (holds := bool(condition())) and (left := until - time.monotonic()) > 0.0:
            spin_once(self, min(left, 0.1))
        return holds

    def arm(self, data: bool) -> None:
        """Arm the board, or disarm it.

        Raises:
            CheckError: it fails.
        """
        if not self.arming.wait_for_service(ANSWER_TIMEOUT):
            raise CheckError("no node `base` answers on base/arm: does it run in this ROS domain?")
        answer = self.arming.call_async(SetBool.Request(data=data))
        if not self.wait(answer.done, ANSWER_TIMEOUT):
            raise CheckError("the node `base` does not answer on base/arm")
        if not answer.result().success:
            raise CheckError(answer.result().message)

    @contextmanager
    def armed(self) -> Iterator[None]:
        """Arm the board for a block, and disarm it however the block ends.

        Raises:
            CheckError: arming or disarming fails.
        """
        try:
            self.arm(True)
            yield
        except BaseException:  # it matters more than a failure to disarm
            if self.arming.service_is_ready():
                try:
                    self.arm(False)
                except CheckError as error:
                    print(f"check: {error}", file=sys.stderr)
            raise
        self.arm(False)

    def angles(self, arm: Arm) -> list[float]:
        """Return the angles of the arm's joints.

        Raises:
            CheckError: not all joints have sent readings.
        """
        self.wait(lambda: len(self.joints) >= arm.n, DISCOVERY + ANSWER_TIMEOUT)
        if missing := [i for i in range(1, arm.n + 1) if i not in self.joints]:
            raise CheckError(f"joint_states have no readings of joints {missing}: pass --q")
        return [self.joints[i] for i in range(1, arm.n + 1)]

    def pulse(self, valve: int, on_time: float) -> float:
        """Open a valve, numbered from 0; return when the pulse was sent [s].

        Raises:
            CheckError: the node `base` did not send it.
        """
        self.sent.clear()
        message = ThrusterCommand()
        message.on_time[valve] = on_time
        message.header.stamp = self.get_clock().now().to_msg()
        self.command.publish(message)
        if not self.wait(lambda: self.sent, 1.0):
            raise CheckError("the node `base` sent no pulse: see its log for the reason")
        return stamp_ns(self.sent[0].header.stamp) / SECOND

    def try_valve(self, valve: int, body: Body, rows: Floats, given: argparse.Namespace) -> Finding:
        """Open one valve, numbered from 0, and evaluate it by the base's motion."""
        for record in (self.poses, self.rates, self.telemetry):
            record.clear()
        self.wait(lambda: False, given.before)
        begin = self.pulse(valve, given.on_time)
        self.wait(lambda: False, given.on_time + given.after)
        if not any(frame.valves >> valve & 1 for frame in self.telemetry):
            return Finding(valve + 1, FAIL, "the board did not open it")
        poses = np.array(sorted(self.poses)).reshape(-1, 4)
        poses[:, 3] = np.unwrap(poses[:, 3])
        try:
            found = estimate(body, poses, sorted(self.rates), begin, given.on_time)
        except TrackError as error:
            return Finding(valve + 1, NOT_TRIED, str(error))
        words = verdict(found, rows, valve, given.tolerance)
        return Finding(valve + 1, FAIL if words else PASS, words, found)


def as_yaml(findings: list[Finding], when: str) -> str:
    """Return the result as YAML; with all valves measured, also as the node's parameter."""
    lines = ["# Findings of `ros2 run fss_base_driver check`.", f"when: {json.dumps(when)}"]
    lines += ["valves:"]
    for found in sorted(findings):
        lines += [f"  - valve: {found.valve}", f"    verdict: {json.dumps(found.verdict)}"]
        lines += [f"    words: {json.dumps(found.words)}"] if found.words else []
        if thrust := found.thrust:
            lines += [f"    force: [{thrust.force[0]:.4f}, {thrust.force[1]:.4f}]  # [N]"]
            lines += [f"    torque: {thrust.torque:.5f}  # about the base's origin [N m]"]
            lines += [f"    deviation: [{thrust.deviation[0]:.4f}, {thrust.deviation[1]:.5f}]"]
    rows = {f.valve: [*f.thrust.force, f.thrust.torque] for f in findings if f.thrust}
    if len(rows) == COUNT:
        numbers = [f"{x:.5f}" for valve in sorted(rows) for x in rows[valve]]
        lines += [
            "# The parameter of the node `base`, as measured:",
            f"layout: [{', '.join(numbers)}]",
        ]
    return "\n".join(lines) + "\n"


def table(findings: list[Finding]) -> Table:
    """Return the result as a table."""
    shown = Table("valve", "force x, y [N]", "torque [N m]", "1 sigma [N, N m]", "", box=None)
    for found in sorted(findings):
        cells = ["-", "-", "-"]
        if thrust := found.thrust:
            cells[0] = f"{thrust.force[0]:+.3f}, {thrust.force[1]:+.3f}"
            cells[1] = f"{thrust.torque:+.4f}"
            cells[2] = f"{thrust.deviation[0]:.3f}, {thrust.deviation[1]:.4f}"
        words = f"{found.verdict}: {found.words}" if found.words else found.verdict
        shown.add_row(str(found.valve), *cells, words)
    return shown


def main(args: Sequence[str] | None = None) -> int:
    """Run as `ros2 run fss_base_driver check`."""
    command = parser()
    given = command.parse_args(args)
    for name in ("thrust", "lever", "on_time", "before", "after", "tolerance"):
        if not 0.0 < getattr(given, name) < 60.0:
            command.error(f"--{name.replace('_', '-')} is {getattr(given, name)}, expected above 0")
    if not set(given.valves or [1]) <= set(range(1, COUNT + 1)):
        command.error(f"--valves is {given.valves}, expected 1 to {COUNT}")
    findings: list[Finding] = []
    interrupt_at_end()
    try:
        arm = described(given.arm)
        if given.q and len(given.q) != arm.n:
            command.error(f"--q has {len(given.q)} angles, expected {arm.n}")
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
    verdicts = {found.verdict for found in findings}
    return next(EXIT_CODES[v] for v in (FAIL, NOT_TRIED, PASS) if v in verdicts)


def run(arm: Arm, given: argparse.Namespace, findings: list[Finding]) -> None:
    """Test the requested valves, and leave the board disarmed.

    Raises:
        CheckError: the check cannot be carried out.
    """
    rows = np.reshape(given.layout, (COUNT, 3)) if given.layout else None
    rows = layout(given.thrust, given.lever) if rows is None else rows
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)  # to disarm at the end
    try:
        topic = given.base_topic or default_in(BASE_TOPIC, given.namespace)
        tester = Tester(given.namespace, topic)
        # Without telemetry, the answer to arming gives the reason.
        tester.wait(lambda: tester.telemetry, ANSWER_TIMEOUT)
        body = Body.of(arm, given.q or tester.angles(arm))
        with tester.armed():
            if not tester.wait(lambda: tester.poses, ANSWER_TIMEOUT):
                raise CheckError(f"no poses on {topic}: is the base visible to motion capture?")
            for valve in valve_order(rows):
                if valve + 1 in (given.valves or range(1, COUNT + 1)):
                    findings.append(tester.try_valve(valve, body, rows, given))
                    print(f"valve {valve + 1}: {findings[-1].verdict} {findings[-1].words}")
    finally:
        rclpy.try_shutdown()


if __name__ == "__main__":
    sys.exit(main())
