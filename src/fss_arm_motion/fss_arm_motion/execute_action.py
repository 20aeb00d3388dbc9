"""Client of `arm/execute` for a plan's file: the command `fss_arm.sh execute`.

It waits until the arm is ready, and says what it waits for. If it is interrupted, the motion is
canceled: the arm comes to rest.
"""

import re
from collections.abc import Callable
from math import degrees
from pathlib import Path
from time import monotonic
from typing import Any

from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.parameter_client import AsyncParameterClient
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from fss_arm_model.description import Arm
from fss_arm_model.description_file import described
from fss_arm_motion.execution import ArmState, format_report, other_description
from fss_arm_motion.figures import title
from fss_arm_motion.plan_file import Stored, parsed
from fss_arm_msgs.action import ExecuteMotion
from fss_arm_msgs.msg import LinkTelemetry
from fss_arm_ros.command_line import in_words
from fss_arm_ros.convert import joint_readings
from fss_arm_ros.described_arm import count_joints
from fss_arm_ros.qos import LATCHED, sensor
from fss_arm_ros.run import deferred_signals, spin_once
from fss_arm_ros.validation import subscribe

QUIET_TIME = 1.0  # wait without a word [s]
CANCEL_TIMEOUT = 5.0  # for the arm to come to rest [s]
ROBOT_NAME = re.compile(r"<robot\b[^>]*\bname=[\"']([^\"']*)[\"']")

Say = Callable[[str], None]


class NoMotionNodeError(RuntimeError):
    """No node offers `arm/execute`."""


class PlanExecution:
    """Execution of a plan's file by the node `motion`.

    Args:
        node: in the namespace of the vehicle.
        stored: the plan.
        say: prints a line.
    """

    def __init__(self, node: Node, stored: Stored, say: Say) -> None:
        self.node, self.stored, self.say = node, stored, say
        self.state = state = ArmState(stored.plan.q.shape[1])
        self.joints = 0  # of the arm that runs; 0: not known
        self.client = ActionClient(node, ExecuteMotion, "arm/execute")
        best_effort = sensor(best_effort=True)
        subscribe(node, JointState, "arm/joint_states", self.on_joints, best_effort)
        subscribe(node, String, "robot_description", self.on_description, LATCHED)
        for i in range(1, state.n + 1):
            topic = f"link_{i}/telemetry"
            subscribe(node, LinkTelemetry, topic, self.on_telemetry, best_effort)

    def on_joints(self, message: JointState) -> None:
        """Store how fast the joints move."""
        self.state.received = monotonic()
        rates = (abs(qd) for _, _, qd, _ in joint_readings(message))
        self.state.rate = max(rates, default=0.0)

    def on_telemetry(self, message: LinkTelemetry) -> None:
        """Store whether a link is armed."""
        self.state.armed[message.link] = monotonic(), bool(message.armed)

    def on_description(self, message: String) -> None:
        """Store the name of the arm that runs, and its number of joints."""
        found = ROBOT_NAME.search(message.data)
        self.state.description = found[1] if found else ""
        self.joints = count_joints(message.data)

    def wait_until_ready(self, wait: float) -> str:
        """Wait until the arm is ready; return why it is not after `wait` [s], or empty.

        Raises:
            NoMotionNodeError: no node executes plans.
        """
        start, said = monotonic(), set()
        while missing := self.missing():
            waited = monotonic() - start
            if other := self.other_joints():
                return other
            if waited > wait:
                if not self.client.server_is_ready():
                    raise NoMotionNodeError("no node offers arm/execute: start the node motion")
                return f"not ready after {wait:.0f} s: waiting for {missing}"
            if waited > QUIET_TIME and missing not in said:
                self.say(f"waiting for {missing}")
                said.add(missing)
            spin_once(self.node, 0.05)
        return ""

    def other_joints(self) -> str:
        """Return the difference if the arm that runs has another number of joints; else empty."""
        n, name = self.state.n, self.state.description
        if self.joints in (0, n):
            return ""
        return f"the plan has {n} joints, the arm {name!r} has {self.joints}"

    def missing(self) -> str:
        """Return what is missing until a plan can be executed; empty: nothing."""
        if not self.client.server_is_ready():
            return "the node motion: ros2 run fss_arm_motion motion"
        return self.state.missing(monotonic())

    def running_description(self) -> str:
        """Wait for the name of the arm that runs, and return it; empty: unknown."""
        end = monotonic() + QUIET_TIME
        while not self.state.description and monotonic() < end:
            spin_once(self.node, 0.05)
        return self.state.description

    def initial_description(self) -> Arm | None:
        """Return the initial description of the node `motion`; None: it cannot be read here."""
        parameters = AsyncParameterClient(self.node, "motion")
        if not parameters.wait_for_services(QUIET_TIME):
            return None
        self.after(answer := parameters.get_parameters(["arm"]))
        try:
            return described(answer.result().values[0].string_value)
        except (ValueError, OSError, IndexError):
            return None

    def run(self, path: Path) -> tuple[bool, str]:
        """Execute the plan of a file; return whether the arm got there, and the last message."""
        moving: list[float] = []

        def on_feedback(message: Any) -> None:
            if not moving:
                moving.append(message.feedback.remaining)
                self.say(f"moving for {moving[0]:.1f} s")

        sent: Future | None = None
        try:
            with deferred_signals():  # a goal that was sent can be canceled
                sent = self.client.send_goal_async(ExecuteMotion.Goal(file=str(path)), on_feedback)
            self.after(sent)
            if not (handle := sent.result()).accepted:
                return False, "the node motion rejected this plan; its log gives the reason"
            self.after(ended := handle.get_result_async(), lambda: bool(moving))
        except KeyboardInterrupt:
            if sent:
                self.cancel(sent)
            raise
        result = ended.result().result
        if not result.reached:
            return False, self.advice(result.message)
        self.say(format_report(result.report))
        if result.report.arm != self.stored.arm:
            self.say(f"predicted with {result.report.arm!r}, planned for {self.stored.arm!r}")
        return True, "the plan is executed"

    def cancel(self, sent: Future) -> None:
        """Cancel the motion, even if its goal is not answered yet, and wait until it has ended."""
        end, ended = monotonic() + CANCEL_TIMEOUT, None
        while monotonic() < end and not (ended and ended.done()):
            spin_once(self.node, 0.05)
            if ended is None and sent.done():
                if not (handle := sent.result()).accepted:
                    return
                handle.cancel_goal_async()
                ended = handle.get_result_async()

    def after(self, future: Future, moving: Callable[[], bool] = lambda: True) -> None:
        """Spin until a future is done; announce a long computation before the motion."""
        start, said = monotonic(), False
        while not future.done():
            if not said and not moving() and monotonic() - start > 2.0 * QUIET_TIME:
                said = True
                self.say("planning takes seconds, or a minute or two if kernels must be compiled")
            spin_once(self.node, 0.05)

    def advice(self, message: str) -> str:
        """Return why a motion failed, with the move to the plan's start if the arm is elsewhere."""
        if "starts at" not in message:
            return message
        angles = " ".join(f"{round(degrees(q), 2) + 0.0:g}" for q in self.stored.plan.q[0])
        return f"{message}; move there: scripts/fss_arm.sh move {angles}"


def execute_plan(node: Node, path: Path, wait: float, say: Say) -> tuple[bool, str]:
    """Execute a plan's file; return whether the arm got there, and the last message.

    Args:
        node: in the namespace of the vehicle.
        path: of the file, the same for the node `motion`.
        wait: timeout for the arm to become ready [s].
        say: prints a line.

    Raises:
        NoMotionNodeError: no node executes plans.
        KeyboardInterrupt: interrupted; the motion is canceled.
    """
    try:
        stored = parsed(path)
    except (ValueError, OSError) as error:
        return False, in_words(error)
    say(f"{path.name}, for {stored.arm!r}: {title(stored.plan).replace('°', ' deg')}")
    execution = PlanExecution(node, stored, say)
    if problem := execution.wait_until_ready(wait):
        return False, problem
    running, initial = execution.running_description(), execution.initial_description()
    if problem := execution.other_joints():
        return False, problem
    if warning := other_description(stored, running, initial):
        say(warning)
    say("the arm is ready")
    return execution.run(path)
