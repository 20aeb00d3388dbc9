"""Runs of a campaign with all nodes, on the simulated test bed: `loop: graph`.

Each run has its own ROS domain. Time waits for the nodes (lockstep), so that runs on a busy
computer have the same outcome as on an idle one, though not the same digits.
"""

import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from math import inf, nan
from pathlib import Path
from tempfile import mkdtemp
from typing import Annotated, Any

import numpy as np
import rclpy
from rclpy.action import ActionClient

from fss_arm_model.description import Arm
from fss_arm_model.description_file import described, save
from fss_arm_model.settings import Settings
from fss_arm_msgs.action import Capture, HoldBase, MoveArm
from fss_arm_msgs.msg import MissionState, SimTruth
from fss_arm_ros.convert import SECOND, stamp_ns
from fss_arm_ros.qos import SENSOR
from fss_gnc.control.settings import ControlSettings
from fss_gnc.guidance.mission_settings import MissionSettings
from fss_gnc.navigation.settings import NavigationSettings
from fss_rehearsal.capture import CaptureOperator
from fss_rehearsal.loops.capture import OBSERVATION_TIME
from fss_rehearsal.loops.faults import GraphFaultSettings
from fss_rehearsal.loops.holding import MOTION, MotionSettings, outcome
from fss_rehearsal.loops.holding import TESTBED as HOLD_TESTBED
from fss_rehearsal.loops.parameters import WITHOUT_NODES, ArmValues, Without
from fss_rehearsal.loops.settings import CONTROL, GUIDANCE, NAVIGATION, NO_VALUES, TESTBED
from fss_rehearsal.mission_nodes import start_mission_nodes
from fss_rehearsal.operators import isolated_domain
from fss_rehearsal.processes import Nodes, RehearsalError
from fss_sim.settings import TestbedSettings

MAX_SPEED = 5.0  # of the simulation, in multiples of real time
MAX_MISSION_TIME = 1800.0  # in real time [s]
SETTLING_TIME = 5.0  # of a hold before the arm moves [s]
MOVING_RATE = 0.02  # rate above which a joint moves [rad/s]
GRIP_PAIR = "gripper, target"

#: Parameters of the test bed that a run chooses itself.
CHOSEN = Without(*WITHOUT_NODES, "telemetry_rate")
Testbed = Annotated[TestbedSettings, CHOSEN]
NO_FAULT = GraphFaultSettings()


class GraphOperator(CaptureOperator):
    """Operator that records the true states and the phases of a mission."""

    TIMEOUT = 600.0  # [s], in real time

    def __init__(self, nodes: Nodes, links: int, is_silent: bool) -> None:
        self.truths: list[SimTruth] = []
        self.phases: list[str] = []
        self.is_silent = is_silent
        super().__init__(nodes, links)
        self.create_subscription(SimTruth, "sim/truth", self.truths.append, SENSOR)
        self.hold = ActionClient(self, HoldBase, "base/hold")
        self.move = ActionClient(self, MoveArm, "arm/move")

    def on_state(self, message: MissionState) -> None:
        """Record each phase of the mission."""
        if message.mission and message.phase not in self.phases:
            self.phases.append(message.phase)
        if not self.is_silent:
            super().on_state(message)

    def pass_time(self, duration: float) -> None:
        """Wait until a duration of simulated time [s] has passed."""
        self.wait_until(self.now() + round(duration * SECOND))

    def send(self, name: str, client: ActionClient, goal: Any) -> Any:
        """Send a goal to an action, and return its handle.

        Raises:
            RehearsalError: the node does not respond, or rejects the goal.
        """
        self.wait(client.server_is_ready, f"no node offers {name}")
        handle = self.result_of(client.send_goal_async(goal), f"{name} does not respond")
        if not handle.accepted:
            raise RehearsalError(f"{name} rejects the goal")
        return handle

    def states_since(self, start: float) -> list[SimTruth]:
        """Return the true states since a time [s]."""
        return [truth for truth in self.truths if time_of(truth) >= start]


def time_of(truth: SimTruth) -> float:
    """Return the time of a true state [s]."""
    return stamp_ns(truth.header.stamp) / SECOND


def changes(settings: Settings) -> dict[str, Any]:
    """Return the settings that are not defaults, as parameters of a node."""
    default = vars(type(settings)())
    return {
        name: list(value) if isinstance(value, tuple) else value
        for name, value in vars(settings).items()
        if value != default.get(name)
    }


@contextmanager
def running_graph(
    arm: Arm, assumed: str, parameters: Mapping[str, Settings], bag: Path | None
) -> Iterator[tuple[Nodes, GraphOperator]]:
    """Start the test bed and all nodes in a domain of their own, arm links and base.

    Args:
        arm: the true arm.
        assumed: name or file of the description that the drivers use; empty: their default.
        parameters: settings of `testbed`, `navigation`, `control` and `guidance`.
        bag: folder for a recording; with it, the live view is started, too.
    """
    folder = bag.parent if bag else Path(mkdtemp(prefix="fss_campaign_"))
    folder.mkdir(parents=True, exist_ok=True)
    log_line = print if bag else lambda _: None
    try:
        with isolated_domain() as domain, Nodes(folder / "logs", log_line, domain) as nodes:
            given = {name: changes(settings) for name, settings in parameters.items()}
            given["testbed"]["arm"] = nodes.logs / "arm.yaml"
            save(arm, given["testbed"]["arm"])
            given |= {name: {"arm": assumed} for name in ("links", "arm") if assumed}
            start_mission_nodes(nodes, arm.n, given, MAX_SPEED, bag)
            if bag:
                data, page = domain.ports(2 * arm.n + 4)[-2:]  # another view may have the default
                ports = {"port": data, "web_port": page}
                nodes.start("view", "fss_arm_view", "view", use_sim_time=True, **ports)
                print(f"live view: http://127.0.0.1:{page}", flush=True)
            operator = GraphOperator(nodes, arm.n, is_silent=bag is None)
            operator.arm_all()
            yield nodes, operator
            operator.destroy_node()
    finally:
        rclpy.try_shutdown()
    if not bag:
        shutil.rmtree(folder)


def capture(
    seed: int,
    testbed: Testbed = TESTBED,
    guidance: MissionSettings = GUIDANCE,
    navigation: NavigationSettings = NAVIGATION,
    control: ControlSettings = CONTROL,
    fault: GraphFaultSettings = NO_FAULT,
    arm: ArmValues = NO_VALUES,
    bag: Path | None = None,
) -> dict[str, Any]:
    """Fly one capture; it succeeds if the target is held and stopped at the end."""
    fault.check()
    parameters = {
        "testbed": replace(testbed, seed=seed),
        "navigation": navigation,
        "control": control,
        "guidance": guidance,
    }
    true_arm = arm.apply(described(testbed.arm))
    with running_graph(true_arm, navigation.arm, parameters, bag) as (nodes, operator):
        goal = Capture.Goal(detumble=True)
        answer = operator.send("mission/capture", operator.capture, goal).get_result_async()
        started = operator.now() / SECOND
        fault_time = inject(operator, nodes, fault, answer) if fault.kind else inf
        result, reason = None, f"node {fault.node} was killed"
        if not (fault.kind == "kill" and np.isfinite(fault_time)):
            late = "the mission does not end"
            result = operator.result_of(answer, late, MAX_MISSION_TIME).result
            reason = result.message
        if fault.kind or not (result and result.stopped):
            operator.pass_time(OBSERVATION_TIME)
        truths = operator.states_since(started)
    return {
        "success": bool(result and result.captured and result.stopped),
        "reason": reason,
        "phases": ", ".join(operator.phases),
        "time": result.duration if result else nan,
        **figures(truths, started, fault_time),
    }


def inject(operator: GraphOperator, nodes: Nodes, fault: GraphFaultSettings, answer: Any) -> float:
    """Inject a fault in its phase; return its time [s], infinite if the mission ended before."""
    operator.wait(
        lambda: answer.done() or fault.phase in operator.phases,
        f"phase {fault.phase} does not start",
        MAX_MISSION_TIME,
    )
    if answer.done():
        return inf
    operator.pass_time(fault.delay)
    fault_time = operator.now() / SECOND
    if fault.kind == "kill":
        nodes.processes[fault.node].kill()
        return fault_time
    parameters = fault.parameters()
    operator.set_faults(parameters)
    if fault.duration:
        operator.pass_time(fault.duration)
        operator.set_faults(dict.fromkeys(parameters, 0.0))
    return fault_time


def figures(truths: Sequence[SimTruth], started: float, fault_time: float) -> dict[str, Any]:
    """Return the figures of a mission from its true states; times are since its start [s]."""
    gaps = [(body_gap(truth), time_of(truth) - started) for truth in truths]
    held = [time_of(truth) - started for truth in truths if truth.holds]
    contact = next((f"bodies at {t:.1f} s" for gap, t in gaps if gap < 0.0), "")
    after = [truth for truth in truths if time_of(truth) >= fault_time]
    valves = [time_of(truth) - fault_time for truth in after if any(truth.valves)]
    moving = [
        time_of(truth) - fault_time for truth in after if max(map(abs, truth.qd[3:])) > MOVING_RATE
    ]
    return {
        "captured": bool(held),
        "held": bool(truths[-1].holds),
        "grip": held[0] if held else nan,
        "propellant": truths[-1].propellant,
        "torque": max(max(map(abs, truth.torque)) for truth in truths),
        "contact": contact,
        "gap": min(gap for gap, _ in gaps),
        "edge": min(truth.edge_clearance for truth in truths),
        "spin": truths[-1].target_twist[2],
        "valves_open": max(valves, default=0.0),
        "joints_moving": max(moving, default=0.0),
    }


def body_gap(truth: SimTruth) -> float:
    """Return the smallest gap between bodies, except gripper and target [m]."""
    pairs = zip(truth.pairs, truth.gaps, strict=True)
    return min((gap for pair, gap in pairs if pair != GRIP_PAIR), default=inf)


def hold(
    seed: int,
    testbed: Testbed = HOLD_TESTBED,
    navigation: NavigationSettings = NAVIGATION,
    control: ControlSettings = CONTROL,
    motion: MotionSettings = MOTION,
    arm: ArmValues = NO_VALUES,
    bag: Path | None = None,
) -> dict[str, Any]:
    """Hold the base while the arm moves; it succeeds if it stays within 1 cm and 1 degree."""
    parameters = {
        "testbed": replace(testbed, seed=seed),
        "navigation": navigation,
        "control": control,
        "guidance": replace(GUIDANCE, arm=navigation.arm),
    }
    true_arm = arm.apply(described(testbed.arm))
    with running_graph(true_arm, navigation.arm, parameters, bag) as (_, operator):
        handle = operator.send("base/hold", operator.hold, HoldBase.Goal())
        ended = handle.get_result_async()
        operator.pass_time(SETTLING_TIME)
        first, started = operator.truths[-1], operator.now() / SECOND
        for q in motion.path(true_arm)[1:]:
            goal = MoveArm.Goal(q=q.tolist(), duration=motion.duration, keep_alive=0.0)
            moved = operator.send("arm/move", operator.move, goal).get_result_async()
            result = operator.result_of(moved, "arm/move does not end", MAX_MISSION_TIME).result
            if not result.reached:
                raise RehearsalError(f"arm/move: {result.message}")
            operator.pass_time(motion.rest)
            if ended.done():
                raise RehearsalError(f"base/hold ended: {ended.result().result.message}")
        states = np.array([truth.q[:3] for truth in operator.states_since(started)])
        propellant = operator.truths[-1].propellant - first.propellant
    offset = states - np.array(first.q[:3])
    return outcome(
        float(np.hypot(*offset[:, :2].T).max()), float(np.abs(offset[:, 2]).max()), propellant
    )
