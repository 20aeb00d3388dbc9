"""Every field of every command of the node `base`, at values that must open no valve."""

from math import inf, nan
from operator import attrgetter

import pytest
from base_bench import Bench
from builtin_interfaces.msg import Time
from geometry_msgs.msg import WrenchStamped
from rclpy.serialization import serialize_message
from std_msgs.msg import Bool

from fss_arm_msgs.msg import ThrusterCommand
from fss_base_driver.protocol import Gripper

DENORMAL = 5e-324
NOT_FINITE = (nan, inf, -inf)
HUGE = (1e9, -1e9, 1e18, -1e18, 1e300)
IN_PLANE = ("wrench.force.x", "wrench.force.y", "wrench.torque.z")
OUT_OF_PLANE = ("wrench.force.z", "wrench.torque.x", "wrench.torque.y")
STAMPS = (Time(), Time(sec=-1), Time(sec=1), Time(sec=2_000_000_000), Time(nanosec=4_000_000_000))
VALVES = range(8)

#: Field and value, on top of a command that opens a valve.
WRENCHES = [
    *[(name, value) for name in IN_PLANE + OUT_OF_PLANE for value in NOT_FINITE + HUGE],
    *[(name, value) for name in OUT_OF_PLANE for value in (-1.0, 0.002)],
    *[("header.stamp", stamp) for stamp in STAMPS],
    *[("header.frame_id", frame) for frame in ("", "world", 70_000 * "x")],
]
THRUSTS = [
    *[(i, value) for i in VALVES for value in (*NOT_FINITE, *HUGE, -0.1, -DENORMAL, 1.01)],
    *[("header.stamp", stamp) for stamp in STAMPS],
    ("header.frame_id", 70_000 * "x"),
]
#: On top of a command that opens none.
DENORMAL_WRENCHES = [(name, DENORMAL) for name in IN_PLANE + OUT_OF_PLANE]
DENORMAL_THRUSTS = [(i, DENORMAL) for i in VALVES]


@pytest.fixture
def armed(spin):
    bench = Bench(spin, {"timeout": 5.0, "watchdog": 2.0})
    answer = bench.arm()
    assert answer.success, answer.message
    return bench


def changed(message, field, value):
    """The message with one field changed: a valve's number, or a path."""
    if isinstance(field, int):
        message.on_time[field] = value
    else:
        *path, last = field.split(".")
        setattr(attrgetter(".".join(path))(message), last, value)
    return message


def wrench(bench, x):
    message = WrenchStamped()
    message.header.stamp, message.header.frame_id = bench.user.stamp(), "fss"
    message.wrench.force.x = x
    return message


def thrust(bench, on_time):
    message = ThrusterCommand(on_time=8 * [on_time])
    message.header.stamp = bench.user.stamp()
    return message


def refuses(bench, publisher, message, what):
    """Publish a message or bytes; the node counts it, and no valve opens."""
    before = bench.refused
    publisher.publish(message)
    try:
        bench.until(lambda: bench.refused > before, 2.0)
    except pytest.fail.Exception:
        pytest.fail(f"{what} is not refused")
    assert bench.refused == before + 1, what
    assert bench.opened == 8 * [0], what


def still_answers(bench):
    """Diagnostics show the count, and valid commands have their effect."""
    bench.until(lambda: bench.values()["commands_refused"] == str(bench.refused))
    assert bench.opened == 8 * [0]
    assert not bench.user.pulses
    bench.user.grip.publish(Bool(data=True))
    bench.until(lambda: bench.board.state.gripper is Gripper.CLOSE)
    bench.user.open(0.05)
    bench.until(lambda: bench.opened == [50_000, *7 * [0]])


def test_no_wrench_that_makes_no_sense_opens_a_valve(armed):
    for field, value in WRENCHES:
        message = changed(wrench(armed, 1.0), field, value)
        refuses(armed, armed.user.wrench, message, f"{field} = {str(value)[:40]}")
    for field, value in DENORMAL_WRENCHES:
        armed.node.on_wrench(changed(wrench(armed, 0.0), field, value))
    assert armed.refused == len(WRENCHES)
    still_answers(armed)


def test_no_thrust_that_makes_no_sense_opens_a_valve(armed):
    for field, value in THRUSTS:
        message = changed(thrust(armed, 0.1), field, value)
        refuses(armed, armed.user.thrust, message, f"{field} = {str(value)[:40]}")
    for field, value in DENORMAL_THRUSTS:
        armed.node.on_thrust(changed(thrust(armed, 0.0), field, value))
    assert armed.refused == len(THRUSTS)
    still_answers(armed)


def test_bytes_that_are_no_command_open_nothing(armed):
    user = armed.user
    for publisher, message in (
        (user.wrench, wrench(armed, 1.0)), (user.thrust, thrust(armed, 0.1)), (user.grip, Bool()),
    ):  # fmt: skip
        whole = serialize_message(message)
        for size in (0, 1, 4, len(whole) // 2):
            refuses(armed, publisher, whole[:size], f"{size} bytes of {type(message).__name__}")
    still_answers(armed)
