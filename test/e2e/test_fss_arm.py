"""The person's commands, against the real driver and simulator."""

import os
import re
import runpy
import signal
import subprocess
import sys
from argparse import Namespace
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from driver_link import RATE, FakeTransport
from model_arms import short_arm
from rclpy.action import ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.task import Future
from rosgraph_msgs.msg import Clock
from running import DOMAIN, free_port, run_command
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty, String
from std_srvs.srv import SetBool, Trigger

from fss_arm_driver.arm_node import ArmNode
from fss_arm_driver.link_node import LinkNode
from fss_arm_driver.protocol import LinkCommandFlag, State
from fss_arm_model.description import paper_arm
from fss_arm_motion.plan import Plan, Prediction, Start
from fss_arm_motion.plan_file import written
from fss_arm_msgs.action import ExecuteMotion
from fss_arm_msgs.msg import BaseTelemetry, LinkCommand, LinkTelemetry, MotionReport, SimTruth
from fss_arm_ros.convert import stamp_ns, to_time
from fss_arm_ros.qos import LATCHED, SENSOR
from fss_base_driver.protocol import BaseState

SCRIPT = Path(__file__).resolve().parents[2] / "scripts/fss_arm.py"
PYTHON, SHELL = (sys.executable, SCRIPT), (SCRIPT.with_suffix(".sh"),)


def test_nobody_there_is_said_in_one_line(domain):
    said = {
        "arm": "no node offers arm/enable",
        "home": "no driver of a link runs",
        "solve": "no calibration runs",
    }
    with ThreadPoolExecutor() as pool:
        got = pool.map(lambda command: shell(command, "--wait", "1"), said)
    remedy = "name the configuration that runs, or start one with scripts/fss_up.sh CONFIG"
    for words, answer in zip(said.values(), got, strict=True):
        assert answer == (1, "", f"{words} in ROS domain {DOMAIN}: {remedy}\n")


def shell(*words, **env):
    """Run fss_arm.sh; return its exit code, output and errors."""
    done = run_command(*SHELL, *words, env=os.environ | env)
    return done.returncode, done.stdout, done.stderr


NAME = (
    "expected a letter and then letters, digits and _, as fss2; without it, stop is for all "
    "vehicles\n"
)
BAD_NAMES = ("a b", "é", "", "1a", "..", "a/", "a//b", "__x", "a\nb", "-x", "x" * 1000)


@pytest.fixture(scope="module")
def program():
    """The names of the program."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(SCRIPT.parent)
        yield runpy.run_path(str(SCRIPT))


@pytest.fixture
def refusal(program, monkeypatch, capsys):
    """refusal(*words): the one line in which the program refuses a command line."""

    def refuse(*words):
        monkeypatch.setattr(sys, "argv", [str(SCRIPT), *words])
        with pytest.raises(SystemExit) as ended:
            program["parsed"]()
        out, err = capsys.readouterr()
        assert (ended.value.code, out, err.count("\n")) == (2, "", 1)
        return err

    return refuse


@pytest.mark.parametrize("name", BAD_NAMES)
def test_a_bad_name_of_a_vehicle_is_refused_in_one_line(refusal, name):
    said = f"fss_arm.sh: argument --vehicle/--namespace: {name!r} is no namespace of a vehicle, "
    assert refusal("stop", f"--vehicle={name}") == said + NAME
    assert refusal(f"--namespace={name}", "stop") == said + NAME


def test_a_bad_name_is_refused_before_the_configuration_is_read(domain):
    said = "fss_arm.sh: argument --vehicle/--namespace: 'a b' is no namespace of a vehicle, "
    assert shell("--vehicle", "a b", "stop", "config/fss_sim.sh") == (2, "", said + NAME)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--vehicle",), "argument --vehicle/--namespace: expected one argument"),
        (("stop", "--vehicle"), "argument --vehicle/--namespace: expected one argument"),
        (("--vehicle", "stop"), "COMMAND is missing (--vehicle is 'stop'), expected one of move, "),
        ((), "COMMAND is missing, expected one of move, execute, arm, disarm, "),
        (("execute",), "execute has 0 files, expected one, as `plan` writes it"),
        (("execute", "a", "b"), "execute has 2 files, expected one, as `plan` writes it"),
        (("stpo",), "argument COMMAND: invalid choice: 'stpo' (choose from "),
        (("stop", "--vehicel", "fss2"), "unrecognized arguments: --vehicel fss2"),
        (("stop", "10"), "stop has 1 angles, expected none"),
        (("move",), "move has 0 angles, expected one for each joint [deg]"),
        (("stop", ""), "argument ANGLE: '' is given, expected an angle in degrees"),
        (("move", "0", "nan"), "argument ANGLE: 'nan' is given, expected an angle in degrees"),
        (("move", "0", "1e18"), "argument ANGLE: '1e18' is given, expected an angle in degrees"),
        *(
            ((what, option, value), f"argument {option}: {value!r} is given, expected 0 to 3600 s")
            for what, option, *values in (
                ("stop", "--wait", "nan", "inf", "-1", "1e18", "x", ""),
                ("home", "--within", "-1"),
                ("arm", "--seconds", "nan"),
            )
            for value in values
        ),
        *(
            (("stop", option), f"argument {option}: expected one argument")
            for option in ("--wait", "--within", "--seconds")
        ),
    ],
)
def test_a_wrong_command_line_is_refused_in_one_line(refusal, words, said):
    assert refusal(*words).startswith(f"fss_arm.sh: {said}")


def test_a_stop_of_all_vehicles_needs_no_name(domain):
    """The name in the environment is for all other commands."""
    no_link = f"no link in ROS domain {DOMAIN} confirms the stop; use the emergency stop\n"
    assert shell("stop", "--wait", "0.1", FSS_NAMESPACE="a b") == (1, "", no_link)
    said = "fss_arm.sh: FSS_NAMESPACE: 'a b' is no namespace of a vehicle, "
    assert shell("arm", FSS_NAMESPACE="a b") == (2, "", said + NAME)


@pytest.fixture
def telling(spin):
    """telling(nodes, *words, **env): exit code, output and errors while these nodes are run.

    It is interrupted once `interrupt_when()` holds.
    """
    running = []

    def run(nodes, *words, program=PYTHON, cwd=None, interrupt_when=None, how=signal.SIGINT, **env):
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        command = list(map(str, (*program, *words)))
        process = subprocess.Popen(command, env=os.environ | env, cwd=cwd, **pipes)
        running.append(process)
        if interrupt_when:
            spin(nodes, interrupt_when, 60.0)
            process.send_signal(how)
        spin(nodes, lambda: process.poll() is not None, 60.0)
        return (process.returncode, *process.communicate())

    yield run
    for process in running:
        process.kill()
        process.wait()


@pytest.fixture
def bench(spin):
    """Two links that have lost their reference, behind their drivers."""
    transports = [FakeTransport(i) for i in (1, 2)]
    parameters = [Parameter("rate", value=RATE), Parameter("timeout", value=5.0)]
    nodes = []
    for i, transport in enumerate(transports, 1):
        transport.link.referenced = False
        nodes.append(LinkNode(i, transport=transport, parameter_overrides=parameters))
    spin(nodes, lambda: not any(node.session.lost for node in nodes))
    return nodes, transports


def arm(spin, nodes, node):
    with node.lock:
        node.session.arm(node.now())
    spin(nodes, lambda: node.session.armed)


def test_links_that_are_armed_are_homed(spin, bench, telling):
    nodes, transports = bench
    home = "home", "--within", "2"
    looks = "link {} searches for its reference\n"
    arm(spin, nodes, nodes[0])
    unarmed = "link 2 is not referenced: it is not armed\n"
    assert telling(nodes, *home) == (1, looks.format(1), unarmed)
    assert [transport.link.referenced for transport in transports] == [True, False]

    arm(spin, nodes, nodes[1])
    transports[1].hears = False
    said = "link 2 is not referenced after 2 s\n"
    assert telling(nodes, *home) == (1, looks.format(2), said)
    transports[1].hears = True  # the last HOME may still be in force
    code, out, err = telling(nodes, *home)
    assert (code, err) == (0, "")
    assert out.endswith("all 2 links are referenced\n")


@pytest.fixture
def moving(bench, spin, tmp_path):
    """The bench with the node of its arm, and what arms all of it."""
    nodes, transports = bench
    for transport in transports:
        transport.link.referenced = True
    given = {"arm": str(short_arm(2, tmp_path)), "rate": RATE, "time_to_live": 2.5}
    whole = ArmNode(parameter_overrides=[Parameter(k, value=v) for k, v in given.items()])
    spin([*nodes, whole], lambda: len(whole.links.states) == 2)
    return [*nodes, whole], transports


def test_the_arm_is_moved_in_degrees(spin, moving, telling):
    nodes, transports = moving
    for node in nodes[:2]:
        arm(spin, nodes, node)
    said = "moving for 2.0 s\nthe joints are at 10.0, -20.0 deg\n"
    assert telling(nodes, "move", "10", "-20", "--seconds", "2") == (0, said, "")
    turned = [transport.link.position / 240_000 * 360 for transport in transports]
    assert turned == pytest.approx([10.0, -20.0], abs=0.3)
    code, out, _ = telling(nodes, "move", "--seconds", "0.1", "30", "0")  # options may come first
    assert code == 0
    assert re.match(r"moving for \d\.\d s \(as fast as its limits allow\)\n", out)


def test_moves_are_refused_in_degrees_with_the_reason(moving, telling):
    nodes, _ = moving
    for angles, words in (
        (("10",), "1 angles are given, but the arm has 2 joints"),
        (("10", "95"), "joint 2 cannot go to 95 deg: its limits are -90 to 90 deg"),
    ):
        assert telling(nodes, "move", *angles) == (1, "", f"{words}\n")
    unarmed = "links 1, 2 are not armed: scripts/fss_arm.sh arm; the joints are at 0.0, 0.0 deg\n"
    assert telling(nodes, "move", "10", "20") == (1, "", unarmed)


def test_hints_repeat_the_vehicle_and_the_configuration(program, monkeypatch):
    repeat_options = program["repeat_options"]
    said = "link 1 is not armed: scripts/fss_arm.sh arm; move there: scripts/fss_arm.sh move 1 2"
    assert repeat_options(said, Namespace(vehicle=None)) == said
    there = said.replace("arm.sh", "arm.sh --vehicle fss2")
    assert repeat_options(said, Namespace(vehicle="fss2")) == there
    monkeypatch.setenv("FSS_ARM_CONFIG", r"my\1.sh")
    assert repeat_options(said, Namespace(vehicle=None)) == (
        r"link 1 is not armed: scripts/fss_arm.sh arm my\1.sh; move there: "
        r"scripts/fss_arm.sh move my\1.sh 1 2"
    )


class FakeMotion(Node):
    """The nodes arm and motion as topics: two links that are armed, and a plan's execution."""

    def __init__(self, message="", joints=2):
        super().__init__("motion")
        self.declare_parameter("arm", "")
        self.message, self.files, self.canceled = message, [], False
        self.states = self.create_publisher(JointState, "arm/joint_states", SENSOR)
        self.telemetry = {
            i: self.create_publisher(LinkTelemetry, f"link_{i}/telemetry", SENSOR) for i in (1, 2)
        }
        self.armed = {1: True, 2: True}
        self.description = self.create_publisher(String, "robot_description", LATCHED)
        urdf = "".join(f'<joint name="joint_{i}"/>' for i in range(1, joints + 1))
        self.description.publish(String(data=f'<robot name="other">{urdf}</robot>'))
        self.create_timer(0.1, self.report)
        self.server = ActionServer(
            self,
            ExecuteMotion,
            "arm/execute",
            self.on_execute,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            callback_group=ReentrantCallbackGroup(),
        )
        self.next_report = Future()

    def close(self):
        self.server.destroy()

    def report(self):
        names = ["joint_1", "joint_2"]
        self.states.publish(JointState(name=names, position=[0.0] * 2, velocity=[0.0] * 2))
        for i, publisher in self.telemetry.items():
            publisher.publish(LinkTelemetry(link=i, armed=self.armed[i]))
        self.next_report, due = Future(), self.next_report
        due.set_result(None)

    async def on_execute(self, handle):
        self.files.append(handle.request.file)
        handle.publish_feedback(ExecuteMotion.Feedback(remaining=3.0))
        while self.message == "cancel" and not handle.is_cancel_requested:
            await self.next_report
        if handle.is_cancel_requested:
            self.canceled = True
            handle.canceled()
            return ExecuteMotion.Result(message="canceled")
        (handle.abort if self.message else handle.succeed)()
        report = MotionReport(arm="other", predicted=[0.01, -0.02, 0.5],
                              predicted_deviation=[0.001, 0.001, 0.01],
                              measured=[0.012, -0.02, 0.49])  # fmt: skip
        return ExecuteMotion.Result(reached=not self.message, message=self.message, report=report)


@pytest.fixture
def plan_file(tmp_path):
    """A plan of two joints."""
    description = paper_arm()
    start = Start(replace(description, links=description.links[:2]), [0.0, 0.0])
    q = np.array([[0.0, 0.0], [0.1, 0.2]])
    base = Prediction(np.array([0.0, 3.0]), np.zeros((2, 3)), np.zeros((2, 3)))
    times, used = np.array([0.0, 3.0]), np.full((3, 2), 0.5)
    plan = Plan("point_to_point", {}, times, q, np.zeros((2, 2)), base, used)
    path = tmp_path / "plan.yaml"
    path.write_text(written(start, plan))
    return path


def test_a_plan_is_executed_and_its_effect_on_the_base_compared(telling, plan_file):
    motion = FakeMotion()
    given = {"program": SHELL, "cwd": plan_file.parent}
    code, out, err = telling([motion], "execute", plan_file.name, **given)
    assert (code, err) == (0, "")
    assert motion.files == [str(plan_file)]
    warning, *lines = out.splitlines()[1:]
    assert warning == "warning: 'paper' has changed since planning: the prediction is made again"
    assert lines[:2] == ["the arm is ready", "moving for 3.0 s"]
    assert lines[3] == "  x [mm]                   10.0      1.0      12.0      2.0 (2.0 sigma)"
    assert lines[-2:] == [
        "predicted with 'other', planned for 'paper'",
        "the plan is executed",
    ]
    assert max(map(len, out.splitlines()[1:])) <= 80


def test_a_plan_waits_for_the_arm_and_names_what_is_missing(telling, plan_file):
    motion = FakeMotion()
    motion.armed[2] = False
    words = "execute", plan_file, "--wait", "2", "--vehicle", "/"
    code, out, err = telling([motion], *words)
    missing = "waiting for link 2 to be armed: scripts/fss_arm.sh --vehicle / arm"
    assert code == 1
    assert missing in out
    assert err == f"not ready after 2 s: {missing}\n"
    assert not motion.files


ELSEWHERE = "joint 1 is at 9.00 deg, plan.yaml starts at 0.00 deg"


@pytest.mark.parametrize(
    ("message", "joints", "said"),
    [
        ("", 1, "the plan has 2 joints, the arm 'other' has 1"),
        ("", 3, "the plan has 2 joints, the arm 'other' has 3"),
        (ELSEWHERE, 2, f"{ELSEWHERE}; move there: scripts/fss_arm.sh move 0 0"),
    ],
)
def test_a_plan_that_does_not_fit_the_arm_is_refused(telling, plan_file, message, joints, said):
    motion = FakeMotion(message, joints)
    code, _, err = telling([motion], "execute", plan_file)
    assert (code, err) == (1, f"{said}\n")
    assert bool(motion.files) == bool(message)


def test_a_plan_that_is_interrupted_is_canceled(telling, plan_file):
    motion = FakeMotion("cancel")  # by SIGTERM, as SIGINT is ignored in the background
    given = {"interrupt_when": lambda: motion.files, "how": signal.SIGTERM}
    assert telling([motion], "execute", plan_file, **given)[0] == 130
    assert motion.canceled


def test_a_move_that_is_interrupted_comes_to_rest(spin, moving, telling):
    nodes, transports = moving
    for node in nodes[:2]:
        arm(spin, nodes, node)
    words = "move", "80", "80", "--seconds", "60"
    moves = {"interrupt_when": lambda: transports[0].link.position > 100}
    assert telling(nodes, *words, **moves)[0] == 130
    spin(nodes, lambda: not nodes[2].links.arbiter.current_name(nodes[2].links.now()))
    assert transports[0].link.position < 240_000 / 360 * 70


def test_homing_that_is_interrupted_says_so(spin, bench, telling):
    nodes, transports = bench
    arm(spin, nodes, nodes[0])
    transports[0].link.take = lambda *_: None  # it never finds its reference
    said = 130, "link 1 searches for its reference\n", "interrupted\n"
    searches = {"interrupt_when": lambda: nodes[0].session.progress is not None}
    assert telling(nodes, "home", **searches) == said


STOPPED = r"stopped after [01]\.\d\d s\n"


def assert_confirmed(told, names):
    """Check that a stop has been confirmed by all of these at once."""
    code, out, err = told
    assert (code, err) == (0, "")
    assert re.fullmatch(f"{names}: {STOPPED}", out)


def test_a_stop_is_confirmed_by_all_links_or_names_those_that_are_silent(spin, bench, telling):
    nodes, transports = bench
    arm(spin, nodes, nodes[0])
    assert_confirmed(telling(nodes, "stop"), "link_1, link_2")
    for node, transport in zip(nodes, transports, strict=True):
        assert transport.link.flags == State.STOPPED
        assert not node.session.armed

    transports[0].talks = False
    silent = "link_1: stop not confirmed (link_2: stopped); use the emergency stop\n"
    assert telling(nodes, "stop") == (1, "", silent)
    transports[0].talks, transports[0].hears = True, False
    transports[0].link.flags = 0
    assert telling(nodes, "stop") == (1, "", silent)


def test_a_stop_that_only_a_recorder_hears_is_none(spin, telling):
    recorder = Node("recorder")
    recorder.create_subscription(Empty, "arm/stop", lambda _: None, 10)
    recorder.create_subscription(LinkTelemetry, "link_1/telemetry", lambda _: None, SENSOR)
    nobody = f"no link in ROS domain {DOMAIN} confirms the stop; use the emergency stop\n"
    assert telling([recorder], "stop") == (1, "", nobody)


def test_a_stop_names_links_of_the_arm_whose_drivers_are_gone(spin, bench, telling, tmp_path):
    nodes, _ = bench
    whole = [Parameter("arm", value=str(short_arm(3, tmp_path)))]
    told = telling([*nodes, ArmNode(parameter_overrides=whole)], "stop")
    silent = "link_3: stop not confirmed (link_1, link_2: stopped); use the emergency stop\n"
    assert told == (1, "", silent)


def test_a_stop_is_for_all_namespaces_unless_one_is_given(spin, bench, telling):
    nodes, transports = bench
    there = FakeTransport(1)
    parameters = [Parameter("rate", value=RATE), Parameter("timeout", value=5.0)]
    node = LinkNode(1, transport=there, namespace="/fss2", parameter_overrides=parameters)
    nodes = [*nodes, node]
    spin(nodes, lambda: not node.session.lost)
    assert_confirmed(telling(nodes, "stop", "--namespace", "fss2"), "fss2/link_1")
    assert there.link.flags & State.STOPPED
    assert not any(transport.link.flags & State.STOPPED for transport in transports)
    narrow = {"FSS_NAMESPACE": "fss2"}  # all commands else
    assert_confirmed(telling(nodes, "stop", **narrow), "fss2/link_1, link_1, link_2")
    code, _, err = telling(nodes, "arm", "--wait", "0.5", **narrow)
    nobody = f"no node offers arm/enable in /fss2, in ROS domain {DOMAIN}"
    assert (code, err) == (1, f"{nobody}; --vehicle is one of /\n")


def test_a_stop_is_confirmed_by_the_bases_boards_too(spin, telling):
    """A base without an arm, in a namespace."""
    board = Node("board", namespace="fss3")
    telemetry = board.create_publisher(BaseTelemetry, "base/telemetry", SENSOR)
    flags, stamps = [0], []

    def tell():
        message = BaseTelemetry(flags=flags[0])
        message.header.stamp = stamps[0] if stamps else board.get_clock().now().to_msg()
        telemetry.publish(message)

    board.create_timer(0.05, tell)
    silent = "fss3/base: stop not confirmed; use the emergency stop\n"
    assert telling([board], "stop") == (1, "", silent)
    board.create_subscription(
        Empty, "arm/stop", lambda _: flags.__setitem__(0, int(BaseState.STOPPED)), 10
    )
    assert_confirmed(telling([board], "stop"), "fss3/base")
    stamps.append(board.get_clock().now().to_msg())  # delayed: from before the next stop
    assert telling([board], "stop") == (1, "", silent)


def test_a_stop_is_confirmed_in_simulated_time(spin, telling):
    bed, now = Node("bed"), [10 * 10**9]
    clock = bed.create_publisher(Clock, "/clock", SENSOR)
    transport = FakeTransport(1, clock=lambda: now[0])
    simulated = [Parameter("rate", value=RATE), Parameter("use_sim_time", value=True)]
    node = LinkNode(1, transport=transport, parameter_overrides=simulated)

    def pass_time():
        now[0] += 10**7
        clock.publish(Clock(clock=to_time(now[0])))

    bed.create_timer(0.01, pass_time)
    spin([node, bed], lambda: not node.session.lost)
    assert_confirmed(telling([node, bed], "stop"), "link_1")


@pytest.mark.slow
def test_a_hundred_stops_tell_the_truth_each_time(spin, start, telling, capsys):
    ports = [free_port() for _ in range(4)]
    start("fss_sim.testbed_node", "--ros-args", "-p", f"ports:={ports}")
    urls = [f"udp://127.0.0.1:{port}?bind=0" for port in ports]
    start("fss_arm_driver.link_node", "--ros-args", "-p", f"urls:={urls[:3]}")
    driver = start(
        "fss_arm_driver.link_node", "--ros-args", "-p", "link:=4", "-p", f"url:={urls[3]}"
    )
    arm, watch, recorder, armed = ArmNode(), Node("watch"), Node("recorder"), {}
    for i in range(1, 5):
        watch.create_subscription(
            LinkTelemetry, f"link_{i}/telemetry", lambda m: armed.update({m.link: m.armed}), SENSOR
        )
    recorder.create_subscription(Empty, "/nobody/arm/stop", lambda _: None, 10)
    rates, told, rested = [], [], []  # of the joints now; when a stop was told, until all rest [s]

    def look(truth):
        rates[:] = truth.qd[3:]
        if told and len(rested) < len(told) and max(map(abs, rates)) < 0.01:
            rested.append(1e-9 * stamp_ns(truth.header.stamp) - told[-1])

    def hear(_):
        if len(told) == len(rested) and max(map(abs, rates)) > 0.05:  # it is repeated
            told.append(1e-9 * watch.get_clock().now().nanoseconds)

    watch.create_subscription(SimTruth, "sim/truth", look, SENSOR)
    watch.create_subscription(Empty, "arm/stop", hear, 10)
    turners = [watch.create_publisher(LinkCommand, f"link_{i}/command", 1) for i in range(1, 5)]
    nodes, bed = [arm, watch, recorder], AsyncParameterClient(watch, "testbed")
    spin(nodes, lambda: len(armed) == 4, 60.0)
    clients, answers = arm.armers, []

    def arm_all():
        if all(answer.done() for answer in answers):
            answers[:] = [client.call_async(SetBool.Request(data=True)) for client in clients]
        return all(armed.values())

    def turn():
        if not arm_all():  # a busy machine loses links
            return False
        for turner in turners:
            turner.publish(
                LinkCommand(mode=LinkCommand.VELOCITY, set_point=speed, time_to_live=10.0)
            )
        return rates and min(map(abs, rates)) > 0.05

    took, refused = [], []
    for k in range(50):
        speed = 0.1 * (-1) ** k
        spin(nodes, turn, 60.0)
        code, out, err = telling(nodes, "stop")
        if code:  # a busy machine may silence links
            assert re.match(r"link_\d.*: stop not confirmed", err)
            refused.append(err)
        else:
            assert re.fullmatch(f"link_1, link_2, link_3, link_4: {STOPPED}", out)
            took.append(float(out.split()[-2]))
            assert not any(armed.values())
        spin(nodes, lambda: len(rested) == len(told))
    assert len(refused) <= 5, refused
    spin(nodes, bed.set_parameters([Parameter("link_2.dead", value=1.0)]).done)
    for _ in range(15):
        code, _, err = telling(nodes, "stop")
        assert code == 1
        assert "link_2" in err.partition(": ")[0]  # a busy machine may silence others, too
    spin(nodes, bed.set_parameters([Parameter("link_2.dead", value=0.0)]).done)
    armed.clear()
    spin(nodes, lambda: len(armed) == 4)
    for how in (signal.SIGSTOP, signal.SIGKILL):
        driver.process.send_signal(how)
        for _ in range(10):
            code, _, err = telling(nodes, "stop")
            assert code == 1
            assert "link_4" in err.partition(": ")[0]
    for _ in range(15):
        code, _, err = telling(nodes, "stop", "--namespace", "nobody")
        assert (code, err[:16]) == (1, "there is no link")
    with capsys.disabled():
        print(f"\n{len(took)} stops of 4 links that turn confirmed, {len(refused)} refused")
        for what, times in (("confirmed", took), ("all joints at rest", rested)):
            p50, p99 = np.quantile(times, [0.5, 0.99])
            print(f"{what} after p50 {p50:.2f} s, p99 {p99:.2f} s")
        print("50 refused, as a link, its driver or all links were not there")


def test_faults_of_all_links_are_cleared(spin, bench, telling):
    nodes, transports = bench
    arm(spin, nodes, nodes[0])
    said = "".join(f"link_{i}/clear_faults: clearing requested\n" for i in (1, 2))
    assert telling(nodes, "clear") == (0, said, "")
    assert not nodes[0].session.armed
    for transport in transports:
        assert transport.link.taken.flags & LinkCommandFlag.CLEAR_FAULTS


def test_the_valves_are_armed(ros, telling):
    node, asked = Node("base"), []
    answers = [(True, "the base's board is armed"), (False, "")]

    def on_arm(request, response):
        response.success, response.message = answers[len(asked)]
        asked.append(request.data)
        return response

    node.create_service(SetBool, "base/arm", on_arm)
    said = "the base's board is armed\n"
    assert telling([node], "valves") == (0, said, "")
    refused = "base/arm: refused; the log of its node has the reason\n"
    assert telling([node], "valves") == (1, "", refused)
    assert asked == [True, True]


def test_an_arm_without_the_bases_board_has_no_valves(ros, telling):
    node = Node("link")
    node.create_publisher(LinkTelemetry, "link_1/telemetry", SENSOR)
    remedy = "it needs a node base that runs, as config/fss_gnc_sim.sh has"
    said = f"no node offers base/arm in ROS domain {DOMAIN}: {remedy}\n"
    assert telling([node], "valves", "--wait", "1") == (1, "", said)


def test_all_calibrations_that_run_solve_in_the_domain_of_the_configuration(ros, telling, tmp_path):
    node, answers = Node("calibrations"), {"kinematic": "pass: fits", "drift": "fail: a push"}

    def answer(words):
        def solve(_, response):
            response.success, response.message = words.startswith("pass"), words
            return response

        return solve

    for kind, words in answers.items():
        node.create_service(Trigger, f"{kind}/solve", answer(words))
    config = tmp_path / "lab.sh"
    config.write_text(
        f"export ROS_DOMAIN_ID={DOMAIN}\nFSS_LOGS={tmp_path / 'logs'}\n"
        "node kinematic fss_arm_calib kinematic\n"
    )
    said = "kinematic/solve: pass: fits\ndrift/solve: fail: a push\n"
    assert telling(node, "solve", config, program=SHELL, ROS_DOMAIN_ID="0") == (1, "", said)
    node.create_service(Trigger, "kinematic/forget", answer("pass: 13 observations forgotten"))
    said = "kinematic/forget: pass: 13 observations forgotten\n"
    assert telling(node, "forget") == (0, said, "")
