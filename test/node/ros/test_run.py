"""How a node's program ends."""

import os
import signal
import sys
import time

import pytest
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from running import run_command, wait_until
from std_msgs.msg import Header

from fss_arm_ros.convert import stamp_ns, to_time
from fss_arm_ros.lockstep import REACHED_TOPIC
from fss_arm_ros.run import END_SIGNALS, spin_once

TOLD = """
import os, signal, sys, time
import rclpy
from rclpy.action import ActionClient
from rclpy.node import Node
from fss_arm_msgs.action import MoveArm
from fss_arm_ros.run import run

def make():
    node = Node("early")
    os.kill(os.getpid(), signal.SIGTERM)
    while rclpy.ok():
        time.sleep(0.01)
    return %s

sys.exit(run(make))
"""


@pytest.mark.parametrize("late", ["Node('late')", "ActionClient(node, MoveArm, 'late')"])
def test_told_to_end_while_it_is_made_it_ends_well(late):
    ended = run_command(sys.executable, "-W", "ignore", "-c", TOLD % late)
    assert (ended.returncode, ended.stderr) == (0, "")


MISSING = """
import sys
from pathlib import Path
from fss_arm_ros.run import run

sys.exit(run(lambda: Path("/nowhere/arm.yaml").read_text(), ["lib/arm"]))
"""


def test_a_file_that_a_node_lacks_is_named_as_commands_do():
    ended = run_command(sys.executable, "-c", MISSING)
    assert ended.returncode == 1
    assert ended.stderr == "arm: /nowhere/arm.yaml: No such file or directory\n"


HELD = """
import ctypes, os, signal, sys
from rclpy.node import Node
from fss_arm_ros import run

class Held(Node):
    def __init__(self):
        super().__init__("held")
        self.create_timer(0.01, lambda: os.kill(os.getpid(), signal.SIGTERM))

    def destroy_node(self):
        ctypes.PyDLL(None).sleep(60)  # with Python's lock

run.MAX_SHUTDOWN_TIME = 0.5
sys.exit(run.run(Held))
"""


def test_a_node_that_cannot_leave_is_ended_and_says_where():
    ended = run_command(sys.executable, "-c", HELD)
    assert ended.returncode == 1
    assert "in destroy_node" in ended.stderr


IMPATIENT = """
import os, signal, sys, time
from rclpy.node import Node
from fss_arm_ros.run import run
from fss_arm_ros.subscriptions import SubscriptionThread, stop_topics

def interrupt():
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(0.01)

class Closing(Node):
    def __init__(self):
        super().__init__("closing")
        self.thread = SubscriptionThread(self, stop_topics(print, "stop"))
        self.create_timer(0.01, interrupt)

    def close(self):
        for _ in range(3):
            interrupt()
        self.thread.close()
        print("closed")

sys.exit(run(Closing))
"""


def test_further_interrupts_do_not_keep_a_node_from_closing():
    ended = run_command(sys.executable, "-W", "ignore", "-c", IMPATIENT)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "closed\n", "")


EARLY = """
import os, signal, sys
import rclpy
from rclpy.node import Node
from fss_arm_ros.run import run

init = rclpy.init

def interrupted_init(**options):
    os.kill(os.getpid(), signal.SIGINT)
    init(**options)

rclpy.init = interrupted_init
sys.exit(run(lambda: Node("early")))
"""


def test_an_interrupt_just_before_rclpy_handles_them_is_not_lost():
    ended = run_command(sys.executable, "-W", "ignore", "-c", EARLY)
    assert (ended.returncode, ended.stderr) == (0, "")


NAMED = """
import sys
from dataclasses import dataclass
from rclpy.node import Node
from std_srvs.srv import Trigger
from fss_arm_ros.run import run
from fss_arm_ros.parameters import declare

@dataclass(frozen=True)
class Nothing:
    pass

class Named(Node):
    def __init__(self):
        super().__init__("named")
        declare(self, Nothing)
        self.create_service(Trigger, "do", lambda request, response: response)
        print("made", flush=True)
        self.create_timer(0.1, lambda: print("spun", flush=True))

    def unfinished(self):
        return "after 2 of 3"

def main():
    return run(Named)
"""
# As if nodes that start together saw each other only after they spin, as on a busy machine, and
# did not know the services of a name, because another node has it, too.
SEES_LATE = """
from fss_arm_ros import duplicates
duplicates.REPEATS = 100
duplicates.Claims._refuse = lambda *_: None
duplicates._services = lambda *_: set()
"""


# A line for each later look for duplicates.
LOOKS_OFTEN = """
from fss_arm_ros import duplicates
duplicates.REPEATS, duplicates.REPEAT_PERIOD = 1000, 0.5
look = duplicates.Claims.check_again
def check_again(claims, nodes):
    look(claims, nodes)
    print("looked", flush=True)
duplicates.Claims.check_again = check_again
"""


@pytest.fixture
def named(start, tmp_path, request):
    """named(*args): the process of a node `named` that offers `do` and has a job to finish."""
    (tmp_path / "named.py").write_text(NAMED + getattr(request, "param", ""))
    path = f"{tmp_path}:{os.environ.get('PYTHONPATH', '')}"
    return lambda *args: start("named", "--ros-args", *args, PYTHONPATH=path)


def spun(program):
    wait_until(lambda: "spun" in program.output, 20.0, lambda: time.sleep(0.02))


def ended(program, domain, what):
    allows = "-p allow_duplicate:=true allows it"
    assert program.wait() == 1
    assert program.output.endswith(f"-c: {what} already in ROS domain {domain}; {allows}\n")


def test_a_second_node_of_a_name_is_refused_unless_allowed(named, domain):
    first = named()
    spun(first)
    second = named()
    ended(second, domain, "/named is there")
    assert "made" not in second.output
    spun(named("-r", "__ns:=/elsewhere"))
    spun(named("-p", "allow_duplicate:=true"))
    assert first.process.poll() is None


@pytest.mark.parametrize("named", [LOOKS_OFTEN], ids=[""], indirect=True)
def test_an_allowed_duplicate_does_not_end_the_node_that_was_there_first(named):
    """A recorder beside that of a laboratory which has just started, for example."""
    first = named()
    spun(first)
    spun(named("-p", "allow_duplicate:=true"))
    looks = first.output.count("looked")
    wait_until(
        lambda: first.output.count("looked") > looks + 5 or first.process.poll() is not None,
        20.0,
        lambda: time.sleep(0.02),
    )
    assert first.process.poll() is None


def test_a_node_that_offers_what_another_does_is_refused_before_it_spins(named, domain):
    spun(named())
    other = named("-r", "__node:=other")
    ended(other, domain, "/named offers /do")
    assert "spun" not in other.output
    spun(named("-r", "__node:=other", "-r", "do:=do_other"))


def test_a_node_that_was_killed_is_started_again_at_once(named):
    for _ in range(2):
        program = named()
        spun(program)
        program.stop(signal.SIGKILL)


@pytest.mark.parametrize("named", ["", SEES_LATE], ids=["", "late"], indirect=True)
def test_of_nodes_that_start_together_one_stays(named, domain):
    together = [named() for _ in range(3)]
    gone = wait_until(
        lambda: len(over := [p for p in together if p.process.poll() is not None]) == 2 and over,
        20.0,
        lambda: time.sleep(0.02),
    )
    for program in gone:
        ended(program, domain, "/named is there")
    spun(next(p for p in together if p not in gone))


def test_a_node_reports_the_simulated_time_that_it_has_reached(named, spin):
    simulator, reached = Node("simulator"), []
    simulator.create_subscription(Header, REACHED_TOPIC, reached.append, 10)
    clock, now = simulator.create_publisher(Clock, "/clock", 10), [0]

    def advance():
        now[0] += 20_000_000  # more often than it reports
        clock.publish(Clock(clock=to_time(now[0])))

    simulator.create_timer(0.02, advance)
    named("-p", "use_sim_time:=true")
    spin(simulator, lambda: len(reached) >= 3, 30.0)
    assert {message.frame_id for message in reached} == {"/named"}
    stamps = [stamp_ns(message.stamp) for message in reached]
    assert stamps == sorted(set(stamps))
    assert stamps[0] > 0
    assert stamps[-1] <= now[0]


def test_a_node_with_another_time_than_the_simulator_is_warned(named, spin):
    simulator = Node("simulator")
    simulator.create_publisher(Clock, "/clock", 10)
    program = named()
    words = "simulator simulates time, but this node uses the computer's: start it again with"
    spin(simulator, lambda: words in program.output, 30.0)


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_a_job_that_is_interrupted_says_how_far_it_came(named, how):
    program = named()
    spun(program)
    assert program.stop(how) == 130
    assert program.output.endswith("-c: interrupted after 2 of 3\n")


@pytest.mark.parametrize("number", END_SIGNALS)
def test_a_command_is_interrupted_at_the_end_of_a_turn(ros, number):
    node, done, before = Node("turning"), [], signal.getsignal(number)

    def interrupt():
        signal.raise_signal(number)
        done.append(number)  # what was begun is not left halfway

    def turn():
        while not done:
            spin_once(node, 10.0)

    node.create_timer(0.0, interrupt)
    signal.signal(number, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            turn()
        assert signal.getsignal(number) is signal.default_int_handler
    finally:
        signal.signal(number, before)
        node.destroy_node()
    assert done == [number]
