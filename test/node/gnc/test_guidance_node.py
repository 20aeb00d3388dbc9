"""Actions and topics of the node `guidance`: one activity at a time, and its outcome."""

import signal
import time
from dataclasses import replace

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from action_msgs.srv import CancelGoal
from geometry_msgs.msg import PolygonStamped, PoseStamped, WrenchStamped
from gnc_bench import odometry
from guidance_bench import Bench
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_msgs.msg import Empty

from fss_arm_model.dynamics import inertia_matrix
from fss_arm_model.settings import SettingError
from fss_arm_msgs.msg import BaseTelemetry, MassProperties, ThrusterHealth
from fss_arm_ros.convert import SECOND, stamp_ns, to_time
from fss_arm_ros.diagnostics import WARN
from fss_arm_ros.qos import LATCHED, SENSOR, STOPS
from fss_gnc import guidance_node, vehicle_topics
from fss_gnc.guidance.activity import Commands, Outcome
from fss_gnc.guidance.budget import Budget
from fss_gnc.guidance.execution import Kind
from fss_gnc.guidance.kinds import BASE, MISSIONS, HoldBase
from fss_gnc.guidance.other_vehicles import VehicleTrack
from fss_gnc.guidance_node import GuidanceNode
from fss_gnc.reference import Body, Path

HOLD, GO_TO, FOLLOW = BASE
CAPTURE, DETUMBLE, ABORT = MISSIONS
ENDED = GoalStatus.STATUS_SUCCEEDED, GoalStatus.STATUS_ABORTED, GoalStatus.STATUS_CANCELED
DONE, ABORTED, CANCELED = ENDED


@pytest.fixture
def bench(spin):
    return Bench(spin)


def test_go_to_reaches_its_goal_and_then_coasts(bench):
    ended = bench.does(GO_TO, pose=[0.02, 0.01, 0.1], hold_duration=0.5)
    assert ended.status == DONE
    assert ended.result.reached
    assert not ended.result.message
    np.testing.assert_allclose(ended.result.offset, 0.0, atol=1e-3)
    assert ended.result.propellant == 0.0
    np.testing.assert_allclose(bench.pose, [0.02, 0.01, 0.1], atol=1e-3)
    bench.coasts()
    phases = [state.phase for state in bench.states]
    assert list(dict.fromkeys(phases)) == ["idle", "go_to", "hold", "done"]
    assert {state.mission for state in bench.states[1:]} == {"go_to"}
    on_the_way = next(state for state in bench.states if state.phase == "go_to")
    assert len(on_the_way.path) % 3 == 0
    np.testing.assert_allclose(on_the_way.path[-3:], [0.02, 0.01, 0.1], atol=1e-6)
    assert 0.5 < on_the_way.edge_clearance < 2.0
    assert on_the_way.largest_torque == pytest.approx(0.4)
    assert np.isnan(on_the_way.target_clearance)
    assert bench.feedback[0].feedback.remaining > bench.feedback[-1].feedback.remaining


def test_rejected_goal_gives_a_reason_and_the_running_action_continues(bench):
    bench.holding()
    ended = bench.does(GO_TO, pose=[1.9, 0.0, 0.0])
    assert ended.status == ABORTED
    assert not ended.result.reached
    assert "from the table's edge" in ended.result.message
    count = len(bench.paths)
    bench.until(lambda: len(bench.paths) > count)
    assert bench.paths[-1] is not None


def test_base_action_preempts_another_without_a_gap(bench):
    handle = bench.holding()
    bench.begin(GO_TO, pose=[0.3, 0.0, 0.0])
    ended = bench.end(handle)
    assert (ended.status, ended.result.message) == (ABORTED, "preempted by base/go_to")
    bench.until(lambda: bench.states[-1].phase == "go_to")
    assert None not in bench.paths


def test_canceled_hold_counts_as_held(bench):
    handle = bench.holding()
    bench.until(lambda: bench.states[-1].elapsed > 1.1)
    assert {
        "period p50 [ms]",
        "latency p50 [ms]",
    } <= bench.guidance.diagnostics.timing.values().keys()
    bench.after(handle.cancel_goal_async())
    ended = bench.end(handle)
    assert ended.status == CANCELED
    assert ended.result.held
    assert bench.coasts().phase == "done"


@pytest.mark.parametrize("topic", ["base/stop", "arm/stop"])
def test_stop_ends_the_action_at_once(bench, topic):
    handle = bench.holding()
    bench.stops[topic].publish(Empty())
    ended = bench.end(handle)
    assert (ended.status, ended.result.message) == (ABORTED, f"stopped by {topic}")
    state = bench.coasts()
    assert (state.phase, state.reason) == ("abort", f"stopped by {topic}")


@pytest.mark.parametrize("topic", ["base/stop", "arm/stop"])
def test_stop_of_a_best_effort_publisher_ends_the_action_too(bench, topic):
    handle = bench.holding()
    stop = bench.create_publisher(Empty, topic, STOPS[1])
    bench.until(lambda: stop.get_subscription_count() > 0)
    stop.publish(Empty())
    assert bench.end(handle).result.message == f"stopped by {topic}"


def test_an_unknown_state_ends_the_action_and_rejects_the_next(bench):
    handle = bench.holding()
    bench.silent |= {"arm/joint_states"}
    bench.until(lambda: bench.states[-1].reason == "joints are unknown and assumed at rest")
    assert bench.paths[-1] is not None
    ended = bench.end(handle)
    assert ended.status == ABORTED
    assert ended.result.message.startswith("arm/joint_states is 3.")
    bench.coasts()
    assert bench.does(HOLD).result.message.startswith("arm/joint_states is ")


def test_another_client_can_cancel_an_action(bench):
    bench.holding()
    bench.clients_.pop(HOLD.name).destroy()
    client = bench.create_client(CancelGoal, "base/hold/_action/cancel_goal")
    bench.until(client.service_is_ready)
    bench.until(lambda: bench.states[-1].elapsed > 1.1)
    assert bench.paths[-1] is not None  # it outlives its client
    assert bench.after(client.call_async(CancelGoal.Request())).goals_canceling
    bench.until(lambda: bench.states[-1].phase == "done")


def test_clock_that_jumps_back_ends_the_action(spin):
    bench = Bench(spin, time=100 * SECOND, use_sim_time=True)
    handle = bench.holding()
    bench.time = 10 * SECOND
    ended = bench.end(handle)
    assert ended.result.message == "the clock jumped back"
    bench.coasts()


# --- missions ---------------------------------------------------------------------------------


class Reach:
    """A mission that moves the joints and closes the gripper, until it is canceled."""

    outcome = None

    def tolerates(self, obs):
        return False

    def step(self, obs):
        return Commands("reach", rates=np.full(4, 0.1), close_gripper=True, outcome=self.outcome)

    def cancel(self, reason):
        self.outcome = Outcome(False, reason)


def reach(name, preempts):
    return Kind(
        name, HoldBase, lambda craft, obs, goal: Reach(), lambda *_: {}, lambda *_: {}, preempts
    )


def test_mission_commands_joints_and_gripper_and_is_preempted_only_by_an_abort(spin, monkeypatch):
    capture = reach("mission/capture", ("base/",))
    abort = reach("mission/abort", ("base/", "mission/"))
    monkeypatch.setattr(guidance_node, "KINDS", (*BASE, capture, abort))
    bench = Bench(spin)
    hold = bench.holding()
    running = bench.begin(capture)
    assert bench.end(hold).result.message == "preempted by mission/capture"
    bench.until(lambda: bench.rates and bench.grips)
    assert bench.grips[-1].data
    assert bench.rates[-1].name == ["joint_1", "joint_2", "joint_3", "joint_4"]
    for kind in (HOLD, capture):
        ended = bench.does(kind)
        assert (ended.status, ended.result.message) == (
            ABORTED,
            "mission/capture is running, cancel it first",
        )
    aborting = bench.begin(abort)
    assert bench.end(running).result.message == "preempted by mission/abort"
    count = len(bench.rates)
    bench.until(lambda: len(bench.rates) > count + 2)
    assert {rate for message in bench.rates for rate in message.velocity} == {0.1}  # no jerk
    bench.after(aborting.cancel_goal_async())
    assert bench.end(aborting).status == CANCELED
    bench.until(lambda: list(bench.rates[-1].velocity) == [0.0] * 4)


def before_a_target(bench):
    """The base at rest, arm folded, with a target on the table."""
    bench.pose, bench.q = np.array([-1.0, -1.0, -1.4]), np.array([0.95, 1.3, 1.36, -1.23])
    bench.target = np.zeros(3), np.array([0.0, 0.0, 0.1])
    bench.until(lambda: bench.guidance.measured.target.value is not None)


def test_capture_without_target_ends_with_valves_closed_and_joints_at_rest(bench):
    before_a_target(bench)
    handle = bench.begin(CAPTURE, detumble=True)
    bench.until(lambda: bench.states[-1].phase == "approach", 60.0)
    bench.target = None
    ended = bench.end(handle)
    assert (ended.status, ended.result.phase) == (ABORTED, "abort")
    assert ended.result.message == "target/state is not known"
    bench.coasts()
    assert np.abs(bench.rates[-1].velocity).max() == 0.0


def test_held_body_is_the_navigation_s_estimate_until_its_release(bench):
    publisher = bench.create_publisher(MassProperties, "target/mass_properties", 1)
    bench.holds = True
    bench.until(lambda: bench.guidance.measured.holds.value and publisher.get_subscription_count())
    publisher.publish(MassProperties(mass=-1.0, inertia=0.6))  # invalid
    publisher.publish(MassProperties(mass=20.0, com=[0.4, 0.05], inertia=0.6))
    bench.until(lambda: bench.guidance.observe(bench.now())[0].held_body is not None)
    target, place = bench.guidance.observe(bench.now())[0].held_body
    assert (target.mass, target.inertia, *place) == (20.0, 0.6, 0.4, 0.05, 0.0)
    budget, obs = Budget(bench.guidance.craft), bench.guidance.observe(bench.now())[0]
    budget.update(replace(obs, base=Body(np.zeros(3), np.array([1.0, 0.0, 0.0]))))
    alone = inertia_matrix(bench.guidance.craft.arm.vector(), np.zeros(7))[0, 0]
    assert budget.momentum[0] == pytest.approx(alone + 20.0)
    bench.holds = False
    bench.until(lambda: bench.guidance.observe(bench.now())[0].held_body is None)


def test_hold_with_a_disarmed_board_names_the_cause(bench):
    publisher = bench.create_publisher(BaseTelemetry, "base/telemetry", SENSOR)
    bench.until(publisher.get_subscription_count)
    handle = bench.holding()
    publisher.publish(BaseTelemetry(armed=False))
    bench.until(lambda: bench.guidance.observe(bench.now())[0].armed is False)
    bench.obeys, bench.pose = False, np.add(bench.pose, [0.3, 0.0, 0.0])
    ended = bench.end(handle)
    assert ended.result.message.endswith("; its board is disarmed: scripts/fss_arm.sh valves")


def test_open_valve_aborts_a_mission(bench):
    publisher = bench.create_publisher(ThrusterHealth, "thrusters/health", LATCHED)
    publisher.publish(ThrusterHealth(stuck_open=[i == 2 for i in range(8)]))
    bench.until(lambda: bench.guidance.observe(bench.now())[0].open_valves == (3,))
    bench.holds = True
    handle = bench.begin(DETUMBLE)
    bench.until(lambda: bench.states[-1].phase == "abort" and bench.paths[-1])
    assert bench.states[-1].reason == "valve 3 does not close"
    health = bench.guidance.health()
    assert (health.level, health.message) == (
        WARN,
        "mission/detumble: abort: valve 3 does not close",
    )
    bench.stops["base/stop"].publish(Empty())  # the fake tank is never empty
    ended = bench.end(handle)
    assert (ended.status, ended.result.stopped) == (ABORTED, False)


# --- other vehicles -----------------------------------------------------------------------------


class Neighbour(Node):
    """Another vehicle that holds its place, with a square outline."""

    def __init__(self, name, pose):
        super().__init__("neighbour", namespace=name)
        self.pose, kinds = pose, vehicle_topics.KINDS
        self.topics = {n: self.create_publisher(kind, n, SENSOR) for n, kind in kinds.items()}
        self.create_timer(0.1, self.report)

    def report(self):
        now = self.get_clock().now().nanoseconds
        state = odometry(self.pose, np.zeros(3))
        state.header.stamp = to_time(now)
        here = Path(np.zeros(1), np.reshape(self.pose, (1, 1, 3)).astype(float))
        self.topics["base/state"].publish(state)
        self.topics["base/plan"].publish(vehicle_topics.plan_message(here, 0.0, now))
        square = 0.1 * np.array([1 + 1j, -1 + 1j, -1 - 1j, 1 - 1j])
        self.topics["base/footprint"].publish(vehicle_topics.footprint(square))


def test_go_to_waits_for_another_vehicle_and_then_continues(spin):
    bench, plans, outlines = (
        Bench(spin, namespace="fss2", vehicles=["fss1", "fss2"], max_age=3.0),
        [],
        [],
    )
    assert bench.guidance.health().message == "waiting for fss1/base/footprint"
    other = Neighbour("fss1", [1.3, 0.25, 0.0])  # before the arm
    spin([other], lambda: not bench.guidance.health().message.startswith("waiting"))
    bench.create_subscription(vehicle_topics.PathMessage, "base/plan", plans.append, SENSOR)
    bench.create_subscription(PolygonStamped, "base/footprint", outlines.append, SENSOR)
    handle = bench.begin(GO_TO, pose=[0.15, 0.0, 0.0])
    bench.until(lambda: bench.states[-1].phase == "wait" and plans)
    assert bench.states[-1].reason == "waits for fss1"
    assert bench.guidance.health().message == "base/go_to: wait: waits for fss1"
    assert np.abs(bench.pose).max() < 0.01
    other.pose = [1.3, -1.5, 0.0]
    ended = bench.end(handle)
    assert ended.status == DONE, ended.result.message
    np.testing.assert_allclose(bench.pose, [0.15, 0.0, 0.0], atol=1e-3)
    assert plans[-1].header.frame_id == "world"
    assert max(plan.poses[-1].pose.position.x for plan in plans if plan.poses) > 0.14
    assert outlines[-1].header.frame_id == "fss2/fss"
    assert max(point.x for point in outlines[-1].polygon.points) > 0.9  # its arm


def outline_of(count, radius):
    return vehicle_topics.footprint(radius * np.exp(2j * np.pi * np.arange(count) / count))


def plan_of(count=1, frame="world", step=1.0):
    """Return a plan with poses at the origin, some time apart [s]."""
    message = vehicle_topics.plan_message(None, 0.0, SECOND)
    message.header.frame_id = frame
    for k in range(count):
        message.poses.append(PoseStamped())
        message.poses[-1].pose.orientation.w = 1.0
        message.poses[-1].header.stamp = to_time(SECOND + round(k * step * SECOND))
    return message


@pytest.mark.parametrize(
    ("store", "message", "words"),
    [
        (vehicle_topics.store_footprint, outline_of(2, 0.1), "2 vertices, expected 3 to 1000"),
        (vehicle_topics.store_footprint, outline_of(1001, 0.1), "1001 vertices"),
        (vehicle_topics.store_footprint, outline_of(4, 11.0), "a vertex is 11 m from the base"),
        (vehicle_topics.store_footprint, outline_of(4, 0.0), "the outline has no area"),
        (vehicle_topics.store_plan, plan_of(frame="table"), "frame_id is 'table'"),
        (vehicle_topics.store_plan, plan_of(1001), "1001 poses, expected at most 1000"),
        (vehicle_topics.store_plan, plan_of(2, step=0.0), "time of point 1 is 0 s"),
        (vehicle_topics.store_state, Odometry(), "."),  # a quaternion of zeros
    ],
)
def test_invalid_messages_of_another_vehicle_are_rejected(store, message, words):
    if isinstance(message, Odometry):
        message.pose.pose.orientation.w = 0.0
    with pytest.raises(ValueError, match=words):
        store(VehicleTrack("fss1", precedes=True), message)


@pytest.mark.parametrize("order", [1, -1])
def test_footprint_is_stored_counter_clockwise(order):
    square = 0.1 * np.array([1 + 1j, -1 + 1j, -1 - 1j, 1 - 1j])
    track = VehicleTrack("fss1", precedes=True)
    vehicle_topics.store_footprint(track, vehicle_topics.footprint(square[::order]))
    np.testing.assert_allclose(track.outline, square, atol=1e-7)


def test_guidance_outlives_invalid_states_of_another_vehicle(spin):
    bench = Bench(spin, namespace="fss2", vehicles=["fss1", "fss2"], max_age=3.0)
    other = Node("neighbour", namespace="fss1")
    states = other.create_publisher(Odometry, "base/state", SENSOR)
    spin([other], states.get_subscription_count)
    invalid, early = odometry([0.0, 0.0, 0.0], np.zeros(3)), odometry([0.0, 0.0, 0.0], np.zeros(3))
    invalid.pose.pose.orientation.z = invalid.pose.pose.orientation.w = 0.0
    early.header.stamp = to_time(other.get_clock().now().nanoseconds + 3600 * SECOND)
    for message in (invalid, early):
        if message is invalid:
            message.header.stamp = other.get_clock().now().to_msg()
        states.publish(message)
        handle = bench.begin(GO_TO, pose=[0.0, 0.0, 0.0])  # it receives the state meanwhile
        assert bench.end(handle).status == DONE
    (track,) = bench.guidance.vehicles.tracks
    track.outline = np.array([0.1, 0.1j, -0.1])
    assert track.predicted(other.get_clock().now().nanoseconds) is None  # no state was stored


def test_idle_guidance_announces_its_outline_after_its_clock_was_set_back(spin):
    outlines = []
    bench = Bench(
        spin, 100 * SECOND, namespace="fss2", vehicles=["fss1", "fss2"], use_sim_time=True
    )
    bench.create_subscription(PolygonStamped, "base/footprint", outlines.append, SENSOR)
    bench.until(lambda: outlines)
    bench.time = 10 * SECOND
    bench.until(lambda: outlines[-1].header.stamp.sec < 50)


@pytest.mark.parametrize("names", [["fss1", "fss3"], ["fss2", "fss2"]])
def test_list_of_vehicles_must_name_each_once_with_this_one(ros, names):
    given = [Parameter("vehicles", value=names)]
    with pytest.raises(SettingError, match="expected each vehicle once, with this one, 'fss2'"):
        GuidanceNode(namespace="fss2", parameter_overrides=given)


def test_alone_it_announces_nothing(bench):
    topics = {name for name, _ in bench.get_topic_names_and_types()}
    assert "/base/trajectory" in topics
    assert not topics & {"/base/plan", "/base/footprint"}


# --- a process `control` that is stopped during a motion, and continued --------------------------

PAUSE = 1.5  # [s]
MIN_FORCE = 0.01  # of a chase after the reference [N]


def test_control_does_not_chase_the_reference_after_a_stall(spin, start):
    bench = Bench(spin, max_age=3.0)  # of a busy computer
    control = start("fss_gnc.control_node", "--ros-args", "-p", "max_pause:=1.0")
    wrenches = []
    bench.create_subscription(WrenchStamped, "base/wrench", wrenches.append, 10)
    bench.until(lambda: bench.count_publishers("base/wrench"), 60.0)
    bench.obeys = False  # the base stays where it is found
    handle = bench.begin(GO_TO, pose=[0.5, 0.0, 0.0])
    ended = handle.get_result_async()
    bench.until(lambda: wrenches and wrenches[-1].wrench.force.x > MIN_FORCE)

    control.process.send_signal(signal.SIGSTOP)
    stopped = time.monotonic()
    bench.until(lambda: time.monotonic() > stopped + PAUSE)
    continued = bench.get_clock().now().nanoseconds
    control.process.send_signal(signal.SIGCONT)
    bench.until(ended.done)
    message = ended.result().result.message
    # One of a step that the stop interrupted is older; the base's driver rejects it.
    forces = [m.wrench.force.x for m in wrenches if stamp_ns(m.header.stamp) >= continued]
    print(message, np.round(forces, 3))
    assert ended.result().status == GoalStatus.STATUS_ABORTED
    assert message.startswith("control paused for ")
    assert PAUSE - 0.2 < float(message.split()[3]) < PAUSE + 2.0
    assert np.abs(forces).max() < MIN_FORCE  # it holds

    handle = bench.begin(GO_TO, pose=[0.5, 0.0, 0.0])
    bench.until(lambda: wrenches[-1].wrench.force.x > MIN_FORCE)
