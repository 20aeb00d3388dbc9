"""The node `controller` with a fake craft: commands of a law, and the end of laws that fail."""

import os
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from gnc_bench import FOLDED, FakeCraft
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Header

from fss_arm_msgs.msg import BaseTelemetry
from fss_arm_ros.convert import SECOND, stamp_ns, to_time
from fss_arm_ros.qos import SENSOR
from fss_gnc.controller_node import ControllerNode

ROOT = Path(__file__).parents[3]
FAULTY = ROOT / "test/support/faulty_laws.py"
PD = f"{ROOT}/docs/examples/laws/pd_hold.py:PdHold"
TIME_TO_LIVE = 0.3  # default [s]
TOLERANCE = 0.3  # of a busy computer [s]


class Bench(FakeCraft):
    """A craft, the node with a law, and the commands that the node publishes."""

    def __init__(self, spin, law, **parameters):
        super().__init__()
        values = {"law": law, "rate": 50.0, **parameters}
        overrides = [Parameter(name, value=value) for name, value in values.items()]
        self.controller = ControllerNode(parameter_overrides=overrides)
        self.run, self.wrenches, self.rates, self.status = spin, [], [], None
        self.create_subscription(WrenchStamped, "base/wrench", self.on_wrench, 100)
        self.create_subscription(JointState, "arm/joint_commands", self.on_rates, 100)
        self.create_subscription(DiagnosticArray, "/diagnostics", self.on_health, 10)

    def on_wrench(self, message):
        w = message.wrench
        self.wrenches.append((self.now(), np.array([w.force.x, w.force.y, w.torque.z]), message))

    def on_rates(self, message):
        self.rates.append((self.now(), np.array(message.velocity), message))

    def on_health(self, message):
        for status in message.status:
            if status.name == "/controller":
                self.status = status

    def until(self, condition, timeout=60.0):
        return self.run([self, self.controller], condition, timeout)

    def pass_time(self, seconds):
        end = self.now() + round(seconds * SECOND)
        self.until(lambda: self.now() > end)

    def active(self):
        return [row for row in self.wrenches if row[1].any()]


@pytest.fixture
def bench(spin):
    return lambda law, **parameters: Bench(spin, law, **parameters)


def test_the_gripper_is_commanded_again_once_the_board_is_armed(bench):
    """A board that is not armed refuses commands."""
    craft, commands = bench(f"{FAULTY}:Closing"), []
    craft.create_subscription(Bool, "gripper/command", commands.append, 100)
    board = craft.create_publisher(BaseTelemetry, "base/telemetry", SENSOR)
    craft.until(lambda: craft.controller.law.steps > 5 and commands)
    assert len(commands) == 1

    def report():
        board.publish(BaseTelemetry(armed=True, header=Header(stamp=to_time(craft.now()))))

    craft.create_timer(0.05, report)
    craft.until(lambda: len(commands) > 1)
    craft.pass_time(0.3)
    assert len(commands) == 2
    assert all(message.data for message in commands)


def test_a_law_holds_the_first_pose_and_reports_its_timing(bench):
    craft = bench(PD)
    craft.pose = np.array([0.5, 0.2, 3.0])
    craft.until(lambda: len(craft.wrenches) > 5 and craft.rates)
    assert not craft.active()
    craft.pose[0] += 0.01
    craft.q[0] += 0.01
    craft.until(craft.active)
    craft.pass_time(0.2)
    _, wrench, message = craft.wrenches[-1]
    force = complex(*wrench[:2]) * np.exp(1j * craft.pose[2])
    assert force == pytest.approx(-20.0 * 0.1 * 0.01, rel=0.02)
    assert message.header.frame_id == "fss"
    assert stamp_ns(message.header.stamp) > craft.now() - SECOND
    _, rates, message = craft.rates[-1]
    assert list(message.name) == ["joint_1", "joint_2", "joint_3", "joint_4"]
    np.testing.assert_allclose(rates, [-0.01, 0.0, 0.0, 0.0], atol=1e-9)
    keys = {"latency p99.9 [ms]", "period p50 [ms]", "missed deadlines"}
    craft.until(lambda: craft.status and keys <= {v.key for v in craft.status.values})
    values = {v.key: v.value for v in craft.status.values}
    assert 5.0 < float(values["period p50 [ms]"]) < 100.0
    assert len(values["hash of its file"]) == 12


def test_unknown_base_or_joints_stop_everything_once(bench):
    craft = bench(f"{FAULTY}:Good")
    craft.until(craft.active)
    craft.silent |= {"base/state"}
    craft.until(lambda: not craft.wrenches[-1][1].any() and not craft.rates[-1][1].any())
    count = len(craft.wrenches)
    craft.until(
        lambda: craft.status.message.startswith("valves closed, joints at rest: base/state")
    )
    assert len(craft.wrenches) == count


FAULTS = {
    "Exceptional": "ZeroDivisionError: of the law",
    "Endless": "a step did not end within 1 s",
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_law_that_fails_ends_and_the_node_stops_everything(bench, fault, capfd):
    craft = bench(f"{FAULTY}:{fault}")
    craft.until(craft.active)
    craft.until(lambda: craft.controller.law.failure)
    craft.until(lambda: not craft.wrenches[-1][1].any() and not craft.rates[-1][1].any())
    end = max(craft.wrenches[-1][0], craft.rates[-1][0])
    last = stamp_ns(craft.active()[-1][2].header.stamp)
    assert (end - last) / SECOND < TIME_TO_LIVE + TOLERANCE
    count = len(craft.wrenches), len(craft.rates)
    words = f"law has failed: {FAULTS[fault]}"
    craft.until(lambda: craft.status.message.startswith(words))
    assert craft.status.level == craft.status.ERROR
    assert (len(craft.wrenches), len(craft.rates)) == count
    with pytest.raises(ProcessLookupError):
        os.kill(craft.controller.process.pid, 0)
    log = capfd.readouterr().err
    assert FAULTS[fault] in log
    assert f"its last valid output was for {last / SECOND:.3f} s" in log


def test_a_law_that_never_ran_ends_the_node(bench):
    craft = bench("nowhere.py:Law")
    with pytest.raises(SystemExit, match=r"law nowhere.py:Law has failed: no file nowhere.py in"):
        craft.pass_time(60.0)


def test_inputs_are_those_of_the_topics(bench):
    craft = bench(PD)
    craft.target = np.array([1.0, 0.5, 0.3]), np.array([0.0, 0.01, 0.0])
    shot = craft.controller.snapshot
    craft.until(lambda: shot.target.value and shot.propellant and shot.joints.value is not None)
    inputs = craft.controller.snapshot.at(craft.now())
    np.testing.assert_allclose(inputs.joint_angles, FOLDED)
    np.testing.assert_allclose(inputs.target_pose, [1.0, 0.5, 0.3], atol=0.01)
    np.testing.assert_allclose(inputs.target_twist, [0.0, 0.01, 0.0], atol=1e-12)
    assert inputs.propellant == pytest.approx(0.1)


# --- the example of a user's controller in the documentation --------------------------------------

EXAMPLE = Path(__file__).parents[3] / "docs/examples/own_controller.py"


def test_example_returns_the_base_swings_the_joint_and_stops_without_input(spin):
    spec = spec_from_file_location("own_controller", EXAMPLE)
    example = module_from_spec(spec)
    spec.loader.exec_module(example)
    craft, own = FakeCraft(), example.OwnController()
    wrenches, rates = [], []
    craft.create_subscription(WrenchStamped, "base/wrench", wrenches.append, 10)
    craft.create_subscription(JointState, "arm/joint_commands", rates.append, 10)
    nodes = [craft, own]
    craft.pose = np.array([0.5, 0.2, 3.0])
    spin(nodes, lambda: own.home and wrenches and rates)
    assert own.home == pytest.approx((0.5, 0.2, 3.0))
    away = np.array([0.1, 0.0, 0.2])  # 3.2 rad: beyond the half turn
    craft.pose, craft.twist = craft.pose + away, np.zeros(3)
    spin(nodes, lambda: abs(wrenches[-1].wrench.torque.z) > 0.01)
    w = wrenches[-1].wrench
    force = complex(w.force.x, w.force.y) * np.exp(1j * craft.pose[2])
    assert force == pytest.approx(-example.MASS * example.STIFFNESS * 0.1, rel=0.02)
    assert w.torque.z == pytest.approx(-example.INERTIA * example.STIFFNESS * 0.2, rel=0.02)
    assert wrenches[-1].header.frame_id == "fss"
    assert stamp_ns(wrenches[-1].header.stamp) > craft.now() - SECOND
    assert rates[-1].name == ["joint_1"]
    assert abs(rates[-1].velocity[0]) == pytest.approx(0.01)
    craft.silent |= {"base/state", "arm/joint_states"}
    count, start = len(wrenches), craft.now()
    spin(nodes, lambda: craft.now() > start + SECOND // 2)
    assert len(wrenches) - count < 5
