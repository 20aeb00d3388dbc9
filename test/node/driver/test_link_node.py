"""The node of one link: a link behind a fake transport or a UDP port, and real topics."""

import re
import time
from dataclasses import replace

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from driver_link import RATE, FakeTransport
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from running import wait_until
from sensor_msgs.msg import BatteryState, JointState
from std_msgs.msg import Empty
from std_srvs.srv import SetBool, Trigger

from fss_arm_driver import links_node
from fss_arm_driver.link_node import LinkNode
from fss_arm_driver.protocol import LinkCommandFlag, Mode, Slow, State
from fss_arm_model.description import paper_arm
from fss_arm_model.description_file import save
from fss_arm_model.units import SECOND
from fss_arm_msgs.msg import CommandStatus, LinkCommand, LinkPath, LinkTelemetry
from fss_arm_ros.convert import stamp_ns, to_time
from fss_link.host_clock import HostClock

KEY = bytes(range(16))


class User(Node):
    """Hears all that a link's node publishes, and asks of it."""

    def __init__(self):
        super().__init__("user")
        self.joints, self.telemetry, self.health = [], [], []
        self.create_subscription(JointState, "joint_states", self.joints.append, 100)
        self.create_subscription(LinkTelemetry, "link_1/telemetry", self.telemetry.append, 100)
        self.create_subscription(DiagnosticArray, "/diagnostics", self.health.append, 10)
        self.command = self.create_publisher(LinkCommand, "link_1/command", 1)
        self.path = self.create_publisher(LinkPath, "link_1/path", 10)
        self.stop = self.create_publisher(Empty, "arm/stop", 10)
        self.arm = self.create_client(SetBool, "link_1/arm")
        self.clear, self.status = self.create_client(Trigger, "link_1/clear_faults"), []
        self.create_subscription(CommandStatus, "link_1/command_status", self.status.append, 10)

    def level(self):
        return self.health[-1].status[0].level if self.health else None

    def values(self):
        return {pair.key: pair.value for pair in self.health[-1].status[0].values}


def options(**parameters):
    parameters = {"rate": RATE, "timeout": 5.0, **parameters}
    return {"parameter_overrides": [Parameter(name, value=v) for name, v in parameters.items()]}


def start_bench(spin, transport=None, clock=None, **parameters):
    """Return a link's node with these parameters, its user, the transport, and what spins both."""
    transport = transport or FakeTransport()
    node = LinkNode(1, transport=transport, clock=clock, **options(**parameters))
    user = User()

    def until(condition, timeout=10.0):
        return spin([node, user], condition, timeout)

    until(lambda: user.telemetry and user.joints and user.health)
    until(lambda: user.arm.service_is_ready() and user.command.get_subscription_count())
    until(lambda: user.stop.get_subscription_count() and user.clear.service_is_ready())
    until(user.path.get_subscription_count)
    until(lambda: node.status.get_subscription_count())
    return node, user, transport, until


@pytest.fixture
def bench(spin, request):
    return start_bench(spin, **getattr(request, "param", {}))


def arm(user, until, data=True):
    answer = user.arm.call_async(SetBool.Request(data=data))
    until(answer.done)
    return answer.result()


def order(user, age=0.0, **fields):
    message = LinkCommand(**{"mode": Mode.POSITION, "time_to_live": 10.0, **fields})
    message.header.stamp = (user.get_clock().now() - Duration(seconds=age)).to_msg()
    user.command.publish(message)


def test_each_frame_is_a_joint_state_and_a_telemetry(bench):
    _, user, transport, until = bench
    transport.link.position = 10_000
    until(lambda: user.telemetry[-1].position == 10_000 and user.joints[-1].position[0] > 0.0)
    joint = user.joints[-1]
    assert joint.name == ["joint_1"]
    assert joint.position[0] == pytest.approx(0.2617993877991494)
    assert (list(joint.velocity), list(joint.effort)) == ([0.0], [0.0])
    message = user.telemetry[-1]
    assert (message.link, message.boot, message.supply) == (1, 5, 240)
    assert message.header.frame_id == "link_1"
    assert message.clock_deviation < 0.05
    assert message.round_trip < 0.05
    assert not message.armed
    stamps = [stamp_ns(m.header.stamp) for m in user.telemetry]
    assert stamps == sorted(set(stamps))
    assert abs(stamps[-1] - transport.link.born - 1000 * message.clock) < 0.05 * SECOND


def test_under_overload_telemetry_is_shed_and_joint_states_are_not(bench):
    node, user, transport, until = bench
    node.receiver.close()
    joints, telemetry = len(user.joints), len(user.telemetry)
    waiting = []
    until(lambda: waiting.extend(transport.receive()) or len(waiting) > 4)
    until(lambda: joints == len(user.joints) and telemetry == len(user.telemetry))
    node.process_datagrams(waiting, True)
    until(lambda: len(user.joints) == joints + len(waiting))
    until(lambda: len(user.telemetry) == telemetry + 1)
    assert user.telemetry[-1].header.stamp == user.joints[-1].header.stamp
    assert transport.counts["telemetry_shed"] == len(waiting) - 1


def test_commands_move_an_armed_link_only(bench):
    _, user, transport, until = bench
    order(user, set_point=0.5)
    until(lambda: transport.link.taken.sequence > 10)
    assert transport.link.position == 0
    assert arm(user, until).message == "link_1 is armed"
    until(lambda: user.telemetry[-1].armed)
    order(user, set_point=0.05, max_velocity=0.1, time_to_live=60.0)
    until(lambda: user.joints[-1].position[0] == pytest.approx(0.05, abs=1e-4))
    assert transport.link.taken.velocity == 38197
    order(user, set_point=0.05, time_to_live=0.5)
    until(lambda: transport.link.taken.flags & LinkCommandFlag.HOLD)  # the command has expired
    assert arm(user, until, data=False).success
    until(lambda: not user.telemetry[-1].armed)
    assert transport.link.flags == 0


@pytest.mark.parametrize("bench", [{"timeout": 1.5}], indirect=True)
def test_each_change_of_state_is_one_line_and_the_worst_are_events(bench, monkeypatch, tmp_path):
    node, user, transport, until = bench
    said, events = [], tmp_path / "events.log"
    monkeypatch.setenv("FSS_EVENTS", str(events))
    for level in ("info", "warning"):
        monkeypatch.setattr(node.get_logger(), level, said.append)
    assert arm(user, until).success
    transport.talks = False
    until(lambda: "is lost: silent for" in said[-1])
    transport.talks = True
    until(lambda: "connected again after" in said[-1])
    user.stop.publish(Empty())
    until(lambda: said[-1] == "link 1 is stopped")
    worst = [line for line in said if re.search("lost|again|stopped", line)]
    assert len(worst) == 3
    assert [line.split(" ", 2)[2] for line in events.read_text().splitlines()] == worst


def path(user, number=3, way=0.2, starts=0.3):
    message = LinkPath(path=number, time=[0.0, 0.5, 1.0], position=[0.0, way, 0.0])
    message.velocity, begin = [0.0, 0.0, 0.0], user.get_clock().now() + Duration(seconds=starts)
    message.header.stamp = begin.to_msg()
    user.path.publish(message)


def test_a_path_is_kept_by_the_link_and_told_of(bench):
    node, user, transport, until = bench
    arm(user, until)
    path(user)
    order(user, mode=LinkCommand.PATH, path=3)
    until(lambda: transport.link.paths.report == 3 << 16 | 2)
    until(lambda: user.telemetry[-1].flags & State.FOLLOWING)
    assert user.telemetry[-1].path == 3 << 16 | 2
    until(lambda: user.status and user.status[-1].status == CommandStatus.REACHED)
    assert [s.status for s in user.status] == [1, 2, 3]
    assert max(joint.position[0] for joint in user.joints) > 0.1
    assert user.joints[-1].position[0] == pytest.approx(0.0, abs=0.005)
    assert node.session.armed


@pytest.mark.parametrize("bench", [{"rate": 5.0}], indirect=True)
def test_commands_are_doubled_while_a_path_is_followed(bench):
    node, user, _, until = bench
    arm(user, until)
    assert node.steady.timer_period_ns == SECOND // 5
    order(user, mode=LinkCommand.PATH, path=3)
    until(lambda: node.steady.timer_period_ns == SECOND // 10)
    order(user, mode=LinkCommand.VELOCITY)
    until(lambda: node.steady.timer_period_ns == SECOND // 5)


def test_a_path_that_breaks_off_and_one_that_is_refused_are_said_once(bench, monkeypatch):
    node, user, transport, until = bench
    said = []
    monkeypatch.setattr(node.get_logger(), "warning", said.append)
    arm(user, until)
    path(user, starts=1.0)
    order(user, mode=LinkCommand.PATH, path=3)
    until(lambda: transport.link.paths.report)
    transport.link.position = 30_000
    until(lambda: user.status and user.status[-1].status == CommandStatus.ABORTED)
    words = "path 3 of link 1 was aborted: the joint is 0."
    assert user.status[-1].reason.startswith(words)
    until(lambda: said)
    refusal = "position is 2 rad between knots 0 and 1"
    for _ in range(2):
        user.status.clear()
        path(user, number=4, way=2.0)
        until(lambda: any(s.reason.startswith(refusal) for s in user.status))
        assert {status.status for status in user.status} == {CommandStatus.REFUSED}
    assert [text[: len(words)] for text in said if "was aborted" in text] == [words]
    assert len([text for text in said if f"path refused: {refusal}" in text]) == 1


def test_a_link_without_reference_has_telemetry_and_no_joint_state(bench):
    _, user, transport, until = bench
    transport.link.referenced = False
    until(lambda: user.telemetry[-1].flags & State.REFERENCED == 0)
    heard = len(user.joints)
    assert arm(user, until).message == "link_1 is armed: not referenced"
    until(lambda: user.health[-1].status[0].level == DiagnosticStatus.WARN)
    assert len(user.joints) == heard
    order(user, set_point=0.1)
    until(lambda: user.status and "home it first" in user.status[-1].reason)
    order(user, mode=LinkCommand.HOME)
    until(lambda: len(user.joints) > heard)
    until(lambda: user.status[-1].status == CommandStatus.REACHED)


def test_faults_are_told_and_cleared(bench):
    node, user, transport, until = bench
    assert arm(user, until).success
    transport.link.frame = replace(transport.link.frame, slow_id=Slow.FAULTS, slow_value=1 << 9)
    until(lambda: not node.session.armed)
    assert arm(user, until).message == "link 1 has faults: tracking error"
    until(lambda: user.values()["faults"] == "tracking error")
    assert user.level() == DiagnosticStatus.ERROR
    cleared = user.clear.call_async(Trigger.Request())
    until(cleared.done)
    assert cleared.result().success
    until(lambda: transport.link.taken.flags == LinkCommandFlag.CLEAR_FAULTS)
    transport.link.frame = replace(transport.link.frame, slow_value=0)
    until(lambda: not node.session.faults)
    assert arm(user, until).success


def test_a_link_of_another_serial_number_is_refused_and_told(spin, tmp_path):
    arm_file = tmp_path / "arm.yaml"
    save(replace(paper_arm(), links=(replace(paper_arm().links[0], serial=7),)), arm_file)
    transport = FakeTransport()
    transport.link.frame = replace(transport.link.frame, slow_id=Slow.SERIAL, slow_value=8)
    node, user, _, until = start_bench(spin, transport, arm=str(arm_file))
    answer = arm(user, until)
    assert not answer.success
    assert "serial number is 8, expected 7" in answer.message
    assert str(arm_file) in answer.message
    until(lambda: user.values()["serial"] == "8")
    assert user.values()["expected serial"] == "7"
    assert user.level() == DiagnosticStatus.ERROR
    transport.link.frame = replace(transport.link.frame, slow_value=7)
    until(lambda: not node.session.faults)
    assert arm(user, until).success


@pytest.mark.parametrize("bench", [{"timeout": 1.0}], indirect=True)
def test_disarming_that_is_not_confirmed_fails_in_words(bench):
    node, user, transport, until = bench
    arm(user, until)
    transport.hears = False
    answer = arm(user, until, data=False)
    words = "disarming requested, not confirmed"
    assert not answer.success
    assert answer.message == f"link_1 does not confirm that it is off: {words}"
    transport.talks = False
    until(lambda: node.session.lost)
    answer = arm(user, until, data=False)
    assert not answer.success
    assert answer.message == f"link_1 is lost: {words}"


def test_simulated_time_is_waited_for_and_followed(spin):
    simulated = 0
    transport = FakeTransport(clock=lambda: simulated)
    node = LinkNode(1, transport=transport, **options(use_sim_time=True))
    user = User()
    clock = user.create_publisher(Clock, "/clock", 10)
    for _ in range(3):
        transport.put(transport.link.telemetry(SECOND))
    spin([node, user], lambda: user.health and clock.get_subscription_count())
    assert user.health[-1].status[0].message == "the clock is stopped: does /clock advance?"
    assert not node.session.counts["received"]
    simulated = 50 * SECOND

    def tick():
        nonlocal simulated
        simulated += SECOND // 100
        clock.publish(Clock(clock=to_time(simulated)))
        return len(user.telemetry) > 5

    spin([node, user], tick)
    stamps = [stamp_ns(m.header.stamp) for m in user.telemetry]
    # The link here keeps real time, and /clock may lag behind it by the timeout.
    assert all(50 * SECOND < stamp < simulated + 5 * SECOND for stamp in stamps)
    spin(
        [node, user],
        lambda: user.health[-1].status[0].message == "the clock is stopped: does /clock advance?",
    )


@pytest.mark.parametrize(("key", "step"), [(None, -3600.0), (KEY, 30.0)])
def test_a_clock_that_is_set_shows_in_the_stamps_and_nowhere_else(spin, keys_file, key, step):
    off = 0

    def day():
        return time.time_ns() + off

    transport = FakeTransport(key=key, clock=time.monotonic_ns)
    parameters = {"timeout": 1.0} | ({"keys": str(keys_file({1: KEY}))} if key else {})
    node, user, _, until = start_bench(spin, transport, HostClock(day=day), **parameters)

    def command(set_point):
        message = LinkCommand(mode=Mode.POSITION, set_point=set_point, max_velocity=0.1)
        message.header.stamp, message.time_to_live = to_time(day()), 60.0
        user.command.publish(message)

    assert arm(user, until).success
    command(0.02)
    until(lambda: user.status and user.status[-1].status == CommandStatus.REACHED)
    for sign in (1, -1):  # and back
        before, off = transport.link.taken.clock, off + round(sign * step * SECOND)
        heard = len(user.joints)
        until(lambda heard=heard: len(user.joints) > heard + 3)
        for message in user.joints[-2:]:
            assert abs(stamp_ns(message.header.stamp) - day()) < 0.5 * SECOND
        command(-0.02 * sign)
        until(lambda sign=sign: transport.link.position * sign < -700)
        until(lambda: user.status[-1].status == CommandStatus.REACHED)
        assert abs(stamp_ns(user.status[-1].given) - day()) < 5.0 * SECOND
        assert before < transport.link.taken.clock
    assert node.session.counts["lost"] == 0
    assert node.session.armed
    assert arm(user, until, data=False).success


@pytest.mark.parametrize(
    ("number", "values", "words"),
    [
        (1, {}, "url is missing, expected udp://HOST:PORT.bind=PORT or tcp://HOST:PORT or"),
        (1, {"keys": "/no/keys"}, "/no/keys"),
        (2, {"keys": {1: KEY}}, "keys', which has no key for link 2"),
        (5, {}, "link is 5, expected 1 to 4, as arm 'paper' has"),
        (1, {"rate": 0.5}, "watchdog is 2.0 s, expected more than the 2 s"),
    ],
)
def test_wrong_parameters_are_named(ros, keys_file, number, values, words):
    if isinstance(values.get("keys"), dict):
        values = {"keys": str(keys_file(values["keys"]))}
    with pytest.raises((ValueError, OSError), match=words):
        LinkNode(number, **options(**values))


def test_unsigned_frames_over_a_network_are_warned_of(start):
    program = start("fss_arm_driver.link_node", "--ros-args", "-p", "url:=udp://192.0.2.1:9?bind=0")
    words = "frames are not signed, so any computer"
    wait_until(lambda: words in program.output, 20.0, lambda: time.sleep(0.05))
    assert "docs/how-to/security.md" in program.output


def test_signed_frames_are_believed_and_answered(spin, keys_file):
    node, user, *_ = start_bench(spin, FakeTransport(key=KEY), keys=str(keys_file({1: KEY})))
    assert user.values()["signed"] == "True"
    assert KEY.hex() not in repr([node.get_parameter(name).value for name in node._parameters])
    assert not any(node.session.counts[name] for name in ("signature", "unproven"))


def test_a_battery_that_ends_soon_is_a_warning(bench):
    node, user, _, until = bench
    assert "battery lasts" not in user.health[-1].status[0].message
    now = time.time_ns()
    for age in range(600, 0, -10):  # 12.5 V in the end, 5 minutes above 12.0 V
        node.session.battery.add(12.5 + age / 600.0, now - age * SECOND)
    until(lambda: "the battery lasts 5 min" in user.health[-1].status[0].message)
    assert user.level() == DiagnosticStatus.WARN


def test_frames_of_somebody_else_are_shown_and_logged_once(bench, monkeypatch):
    node, user, _, until = bench
    said, sent = [], node.session.counts["sent"]
    monkeypatch.setattr(node.get_logger(), "warning", said.append)
    node.session.echoes.crowded = True
    until(lambda: "; link 1 refuses frames of another sender" in user.health[-1].status[0].message)
    assert user.level() == DiagnosticStatus.WARN
    until(lambda: node.session.counts["sent"] > sent + 10)
    assert len(said) == 1
    assert arm(user, until).success


@pytest.mark.parametrize("bench", [{"rate": 2.0, "max_rate": 20.0}], indirect=True)
def test_commands_are_passed_on_as_they_come_but_not_faster_than_allowed(bench):
    node, user, transport, until = bench
    assert arm(user, until).success
    sent, send = [], transport.send

    def note(data):
        sent.append((time.monotonic(), send(data), transport.link.taken.set_point)[::2])

    transport.send = note
    begun = time.monotonic()
    for count in range(1, 31):
        due = begun + 0.01 * count
        until(lambda due=due: time.monotonic() > due)
        order(user, set_point=1e-3 * count)
    last = node.session.scale.set_point(Mode.POSITION, 0.03).value
    until(lambda: sent and sent[-1][1] == last)
    assert sent[0][0] - begun < 0.1  # a tick is 0.5 s
    assert len(sent) <= 2 + 20.0 * (sent[-1][0] - sent[0][0])
    assert [p for _, p in sent] == sorted({p for _, p in sent})
    until(lambda: time.monotonic() > sent[-1][0] + 0.4)
    assert sent[-1][1] == last
    until(lambda: time.monotonic() - sent[-1][0] < 0.05, 2.0)  # the steady rate continues
    assert sent[-1][1] == last


def test_the_battery_is_what_ros_knows_of_one(bench):
    _, user, transport, until = bench
    heard = []
    user.create_subscription(BatteryState, "link_1/battery", heard.append, 10)
    until(lambda: transport.put(low(transport)) or heard)
    message = heard[-1]
    assert message.voltage == pytest.approx(23.7)
    assert np.isnan([message.percentage, message.temperature, message.current]).all()
    assert (message.location, message.present) == ("link_1", True)


def low(transport):
    return transport.link.telemetry(time.time_ns(), slow_id=Slow.BATTERY, slow_value=237)


def test_a_stop_passes_an_executor_that_is_busy(bench):
    """The node is not spun meanwhile."""
    node, user, transport, until = bench
    arm(user, until)
    user.stop.publish(Empty())
    wait_until(lambda: transport.link.flags & State.STOPPED, 5.0, lambda: time.sleep(0.01))
    assert not node.session.armed


def test_the_process_stays_in_the_graph_from_its_first_node_on(spin, monkeypatch):
    """Fast DDS may hang if the last node is destroyed as others are being discovered."""
    alive, left = [], []
    make, destroy = Node.__init__, Node.destroy_node

    def on_make(self, *args, **options):
        alive.append(self)
        make(self, *args, **options)

    def on_destroy(self):
        alive.remove(self)
        left.append(len(alive))
        destroy(self)

    monkeypatch.setattr(Node, "__init__", on_make)
    monkeypatch.setattr(Node, "destroy_node", on_destroy)
    monkeypatch.setattr(links_node, "LinkNode", lambda *_, **__: alive.append(1) or 1)
    assert links_node.make_nodes() == [1]
    assert left == [1, 1]
    assert alive == [1]
