"""The node of the base's board: a board behind a fake transport, and real topics."""

import signal
import time
from math import inf, isnan, nan

import pytest
from base_bench import Bench
from base_link import GYRO_RATE, FakeBoardTransport
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from running import wait_until
from std_msgs.msg import Bool, Empty
from std_srvs.srv import Trigger

from fss_arm_model.units import SECOND
from fss_arm_msgs.msg import ThrusterCommand, ThrusterHealth
from fss_arm_ros.convert import stamp_ns
from fss_arm_ros.qos import LATCHED
from fss_base_driver.base_node import BaseNode
from fss_base_driver.protocol import BaseSlow, BaseState, Gripper
from fss_link.host_clock import HostClock
from fss_link.session import Arming


@pytest.fixture
def bench(spin, request):
    return Bench(spin, {"timeout": 5.0, "watchdog": 2.0} | getattr(request, "param", {}))


@pytest.fixture
def armed(bench):
    answer = bench.arm()
    assert answer.success, answer.message
    return bench


def test_telemetry_is_published_as_it_is_and_in_si_units(bench):
    user = bench.user
    bench.until(lambda: user.propellant and user.battery and user.telemetry[-1].supply)
    message = user.telemetry[-1]
    assert (message.boot, message.supply, message.temperature) == (5, 7000, 198)
    assert message.header.frame_id == "fss"
    assert message.clock_deviation < 0.05
    assert not message.armed
    assert list(message.open) == 8 * [0]
    assert user.pressure[-1].fluid_pressure == 19.5e6
    assert user.battery[-1].voltage == pytest.approx(24.0)
    frames = [m.header.frame_id for m in (user.pressure[-1], user.battery[-1])]
    assert frames == ["fss", "fss"]  # of /tf
    left = 19.5e6 * 0.43e-3 / (287.0 * (273.15 + 19.8))
    assert user.propellant[-1].data == pytest.approx(left)
    gripper = user.gripper[-1]
    assert not gripper.closed
    assert isnan(gripper.distance)
    stamps = [stamp_ns(m.header.stamp) for m in user.telemetry]
    assert stamps == sorted(set(stamps))
    assert abs(stamps[-1] - bench.board.born - 1000 * message.clock) < 0.05 * SECOND


@pytest.mark.parametrize("bench", [{"gyro.scale": -2e-6, "gyro.bias": 0.001}], indirect=True)
def test_the_gyro_is_scaled_and_its_bias_taken_off(bench):
    user = bench.user
    bench.board.counts = -50_000
    bench.until(lambda: user.imu and user.imu[-1].angular_velocity.z > 0.09)
    user.imu.clear()
    bench.until(lambda: len(user.imu) > 3)
    imu = user.imu[-1]
    assert imu.angular_velocity.z == pytest.approx(0.1 - 0.001)
    assert imu.orientation_covariance[0] == imu.linear_acceleration_covariance[0] == -1.0
    samples = GYRO_RATE / 20
    deviation = imu.angular_velocity_covariance[8] ** 0.5
    assert deviation == pytest.approx(1.75e-4 / samples**0.5, rel=0.3)
    bench.board.dead = True
    told = len(user.telemetry)
    bench.until(lambda: len(user.telemetry) > told + 5)
    user.imu.clear()
    bench.until(lambda: len(user.telemetry) > told + 10)
    assert not user.imu  # a gyro that does not answer says nothing


@pytest.mark.parametrize("bench", [{"bias_time": 0.5}], indirect=True)
def test_the_gyros_bias_is_found_at_rest_and_taken_off(bench):
    bench.board.counts = 3000
    bench.until(lambda: bench.user.find.service_is_ready())
    answer = bench.call(bench.user.find, Trigger.Request())
    if not answer.success:  # begun before the count was changed
        answer = bench.call(bench.user.find, Trigger.Request())
    assert answer.success, answer.message
    assert bench.node.get_parameter("gyro.bias").value == pytest.approx(0.003)
    bench.user.imu.clear()
    bench.until(lambda: len(bench.user.imu) > 2)
    assert abs(bench.user.imu[-1].angular_velocity.z) < 1e-9
    bench.board.counts = 90_000
    bench.until(lambda: bench.user.imu[-1].angular_velocity.z > 0.08)
    answer = bench.call(bench.user.find, Trigger.Request())
    assert not answer.success
    assert "the base turns" in answer.message


@pytest.mark.parametrize("bench", [{"timeout": 1.0}], indirect=True)
def test_a_bias_is_not_sought_for_ever_of_a_gyro_that_does_not_answer(bench):
    bench.board.dead = True
    bench.until(lambda: bench.user.find.service_is_ready())
    for _ in range(2):  # the second is not told that the first is still under way
        answer = bench.call(bench.user.find, Trigger.Request())
        assert (answer.success, answer.message) == (False, "the gyro is silent")
    bench.until(lambda: float(bench.values()["gyro's age [s]"]) > 1.0)


@pytest.mark.parametrize("bench", [{"bias_time": 2.0}], indirect=True)
@pytest.mark.parametrize("step", [-3600, 3600])
def test_a_step_of_the_time_of_day_falsifies_neither_rates_nor_the_bias(bench, step):
    bench.until(lambda: bench.user.find.service_is_ready() and bench.user.imu)
    begin = time.monotonic()
    answer = bench.user.find.call_async(Trigger.Request())
    bench.until(lambda: bench.node.gyro.search)
    bench.node.clock = HostClock(day=lambda: time.time_ns() + step * SECOND)

    def leads():
        now = time.time_ns()
        return [(stamp_ns(imu.header.stamp) - now) / SECOND for imu in bench.user.imu]

    bench.until(lambda: answer.done() and leads()[-1] == pytest.approx(step, abs=60.0))
    assert answer.result().success, answer.result().message
    assert time.monotonic() - begin > 1.0
    assert all(min(abs(lead), abs(lead - step)) < 60.0 for lead in leads())  # none is between


def test_a_request_for_the_bias_is_not_a_rate_of_the_gyro(bench):
    bench.board.dead = True
    bench.until(lambda: bench.user.find.service_is_ready())
    bench.until(lambda: bench.node.gyro.silence() > 1.0)
    bench.user.find.call_async(Trigger.Request())
    bench.until(lambda: bench.node.gyro.search)
    assert bench.node.gyro.silence() > 1.0


def test_a_flood_of_commands_does_not_keep_a_stop_waiting_in_the_line(armed):
    """A serial port of 115200 baud takes 140 frames a second."""
    begin, told = time.monotonic(), len(armed.board.taken)
    for k in range(400):
        on_time = [0.01 + 1e-4 * (k % 2), *(7 * [0.0])]
        message = ThrusterCommand(on_time=on_time)
        message.header.stamp = armed.user.stamp()
        armed.node.on_thrust(message)
    seconds = time.monotonic() - begin
    assert len(armed.board.taken) - told <= 2 + 50.0 * seconds
    last = armed.node.session.pulse.number
    armed.until(lambda: armed.board.state.pulse == last, 0.3)


def test_a_stop_passes_an_executor_that_is_busy(armed):
    """The node is not spun meanwhile."""
    stop = armed.user.create_publisher(Empty, "arm/stop", 10)
    armed.until(stop.get_subscription_count)
    armed.user.open(1.0)
    armed.until(armed.is_open)
    stop.publish(Empty())
    wait_until(lambda: not armed.is_open(), 0.25, lambda: time.sleep(0.01))
    assert armed.opened[0] < 900_000  # [us], before the end of the pulse
    assert armed.node.session.arming is Arming.STOPPED


def test_a_pulse_is_given_and_told_as_it_was_sent(armed):
    armed.user.open(0.03, 0.0, 0.12)
    armed.until(lambda: armed.opened[2] == 120_000)
    assert armed.opened == [30_000, 0, 120_000, 0, 0, 0, 0, 0]
    pulses = armed.user.pulses
    armed.until(lambda: pulses)
    assert list(pulses[0].on_time) == [0.03, 0.0, 0.12, 0.0, 0.0, 0.0, 0.0, 0.0]
    assert len(pulses) == 1
    armed.until(lambda: armed.user.telemetry[-1].pulse == 1)


HALF_COMMAND = serialize_message(ThrusterCommand(on_time=8 * [0.1]))[:40]
REFUSED = {
    "without stamp": lambda user: user.open(0.1, stamped=False),
    "old": lambda user: user.open(0.1, age=0.8),
    "infinite": lambda user: user.open(inf),
    "an old wrench": lambda user: user.push(1.0, age=0.5),
    "a wrench that is no number": lambda user: user.push(1.0, nan),
    "a frame of 70,000 letters": lambda user: user.push(1.0, frame=70_000 * "x"),
    "half a command": lambda user: user.thrust.publish(HALF_COMMAND),
}


def refuses(bench, ask, what):
    """Ask for something; the node counts it, and no valve opens."""
    before, told = bench.refused, len(bench.board.taken)
    ask(bench.user)
    bench.until(lambda: bench.refused == before + 1 and len(bench.board.taken) > told + 3)
    assert bench.opened == 8 * [0], what
    assert not bench.user.pulses, what


def test_what_must_not_open_a_valve_is_refused_and_counted(bench):
    refuses(bench, lambda user: user.open(0.1), "unarmed")
    assert bench.arm().success
    for what, ask in REFUSED.items():
        refuses(bench, ask, what)
    bench.until(lambda: bench.values()["commands refused"] == str(1 + len(REFUSED)))


@pytest.mark.parametrize("topic", ["base/stop", "arm/stop"])
def test_a_stop_closes_and_latches_even_from_a_best_effort_publisher(armed, topic):
    best_effort = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    stop = armed.user.create_publisher(Empty, topic, best_effort)
    armed.until(stop.get_subscription_count)
    armed.user.open(1.0)
    armed.until(armed.is_open)
    stop.publish(Empty())
    armed.until(lambda: armed.board.state.flags() == BaseState.STOPPED, 0.25)
    assert not armed.is_open()
    assert armed.opened[0] < 900_000
    assert armed.node.session.arming is Arming.STOPPED
    armed.until(lambda: len(armed.user.pulses) == 2)  # that it was closed before its time
    assert list(armed.user.pulses[1].on_time) == 8 * [0.0]
    before = armed.refused
    armed.user.open(0.1)
    armed.until(lambda: armed.refused == before + 1)
    assert armed.arm().success
    armed.user.open(0.1)
    armed.until(lambda: armed.board.state.pulse == 2)


def test_a_wrench_beyond_what_the_valves_give_is_reported(armed):
    def reported(x, words):
        armed.user.push(x)
        return armed.status().message == words

    beyond = "the base's board is armed; base/wrench exceeds the thrust of the valves"
    armed.until(lambda: reported(0.3, "the base's board is armed"))
    assert armed.values()["wrenches clipped"] == "0"
    armed.until(lambda: reported(0.4, beyond))
    assert int(armed.values()["wrenches clipped"]) > 0
    armed.until(lambda: reported(0.3, "the base's board is armed"))


def test_wrenches_do_without_a_valve_that_is_said_or_found_to_be_stuck(armed):
    health = armed.user.create_publisher(ThrusterHealth, "thrusters/health", LATCHED)
    health.publish(ThrusterHealth(stuck_closed=7 * [False] + [True]))
    armed.until(lambda: armed.values().get("valve_8 is detected as") == "stuck closed")
    armed.node.set_parameters([Parameter("valve_1.stuck_closed", value=1.0)])
    armed.until(lambda: armed.values().get("valve_1 is configured as") == "stuck closed")
    begin = armed.transport.clock()

    def push_back():  # valves 1 and 7
        armed.user.push(-0.05)
        return armed.transport.clock() - begin > 0.5 * SECOND

    armed.until(push_back)
    assert armed.opened[0] == armed.opened[7] == 0
    assert armed.opened[6] > 50_000
    health.publish(ThrusterHealth())
    armed.until(lambda: "valve_8 is detected as" not in armed.values())


def test_parameters_that_are_set_together_are_all_taken_or_none(bench):
    stuck = Parameter("valve_1.stuck_closed", value=1.0)
    answer = bench.node.set_parameters_atomically([stuck, Parameter("gyro.scale", value=nan)])
    assert not answer.successful
    assert bench.node.get_parameter("valve_1.stuck_closed").value == 0.0
    assert bench.node.live["valve_1"].stuck_closed == 0.0


def test_the_gripper_closes_and_says_so(armed):
    armed.user.grip.publish(Bool(data=True))
    armed.until(lambda: armed.board.state.gripper is Gripper.CLOSE)
    armed.board.holds = True
    armed.until(lambda: armed.user.gripper[-1].closed and armed.user.gripper[-1].holds)


def test_diagnostics_name_what_is_wrong(armed):
    armed.until(lambda: armed.status().level == DiagnosticStatus.OK)
    assert armed.status().message == "the base's board is armed"
    armed.board.slow[BaseSlow.FAULTS] = 1 << 2 | 1 << 12
    wanted = "valve 3 draws no current, valve 5 draws current without a command"
    armed.until(lambda: wanted in armed.status().message)
    assert armed.status().level == DiagnosticStatus.WARN


def test_a_silent_board_is_reported(spin):
    bench = Bench(spin, {})
    bench.transport.talks = False
    bench.until(lambda: "the base's board is lost: silent for" in bench.status().message)
    assert bench.status().level == DiagnosticStatus.ERROR
    answer = bench.arm()
    assert not answer.success
    assert "lost" in answer.message


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"url": "copley://ttyUSB0"}, "or serial://DEVICE.baud=RATE: unknown scheme"),
        ({"layout": [1.0]}, "layout has 1 numbers, expected 24"),
        ({"watchdog": 0.04}, "watchdog is 0.04 s, expected more than the 0.05 s"),
        ({"minimum_on_time": 0.1}, "minimum_on_time is 0.1 s, expected below wrench_period"),
        ({"max_on_time": 0.05}, "max_on_time is 0.05 s, expected at least wrench_period, 0.1 s"),
        ({"valve_9.stuck_open": 1.0}, "no parameter valve_9.stuck_open"),
        ({"valve_1.stuck_open": 1.0, "valve_1.stuck_closed": 2.0}, "0 to 1"),
        ({}, "url is missing, expected udp://.* or serial://DEVICE.baud=RATE$"),
    ],
)
def test_wrong_parameters_are_named(ros, parameters, words):
    transport = FakeBoardTransport() if parameters and "url" not in parameters else None
    overrides = [Parameter(name, value=value) for name, value in parameters.items()]
    with pytest.raises(ValueError, match=words):
        BaseNode(transport, parameter_overrides=overrides)


def test_a_node_that_ends_closes_the_valves(armed):
    armed.user.open(1.0)
    armed.until(armed.is_open)
    armed.node.close()
    assert not armed.is_open()
    assert armed.board.state.flags() == 0


def test_a_check_that_is_interrupted_leaves_the_board_disarmed(bench, start):
    check = start("fss_base_driver.check_node", "--q", 0, 0, 0, 0, "--yes")
    bench.until(lambda: bench.node.session.armed, 60.0)
    check.process.send_signal(signal.SIGTERM)
    bench.until(lambda: check.process.poll() is not None, 30.0)
    assert check.process.returncode == 130, check.output
    assert check.output == "check: interrupted\n"
    assert not bench.board.state.armed
