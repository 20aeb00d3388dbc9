"""The node `navigation`, with simulated sensors of base and target, in simulated time."""

from functools import partial
from math import cos, sin

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from rclpy.clock import ClockType
from rclpy.node import Node
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, JointState
from tf2_msgs.msg import TFMessage

from fss_arm_model.description import paper_arm
from fss_arm_model.dynamics import inertia_matrix
from fss_arm_model.thrusters import thruster_wrenches
from fss_arm_msgs.msg import GripperState, MassProperties, ThrusterCommand, ThrusterHealth
from fss_arm_ros.convert import SECOND, pose_stamped, stamp_ns, to_time
from fss_arm_ros.diagnostics import OK
from fss_arm_ros.qos import LATCHED, SENSOR, sensor
from fss_arm_ros.validation import refusals
from fss_gnc.navigation_node import NavigationNode

START = 500 * SECOND
FRAME = SECOND // 100
BASE, TARGET = (0.1, -0.2, 0.3), (1.2, 0.9, -1.0)  # at the start
DRIFT, TUMBLE = (0.02, 0.01, 0.05), (-0.01, 0.02, 0.15)


def pose(at, by, t):
    return tuple(np.add(at, np.multiply(by, t)).tolist())


class Bench(Node):
    """Publishers of the sensors, and the messages that navigation publishes."""

    def __init__(self):
        super().__init__("bench")
        self.k = 0  # frames published
        self.clock = self.create_publisher(Clock, "/clock", SENSOR)
        self.base = self.create_publisher(PoseStamped, "vicon/fss/fss", SENSOR)
        self.target = self.create_publisher(PoseStamped, "vicon/target/target", SENSOR)
        self.gyro = self.create_publisher(Imu, "fog/imu", SENSOR)
        self.joints = self.create_publisher(JointState, "joint_states", SENSOR)
        self.pulses = self.create_publisher(ThrusterCommand, "thrusters/pulses", SENSOR)
        self.gripper = self.create_publisher(GripperState, "gripper/state", SENSOR)
        self.states, self.targets, self.transforms, self.masses = [], [], [], []
        for kind, topic, received in (
            (MassProperties, "target/mass_properties", self.masses),
            (Odometry, "base/state", self.states),
            (Odometry, "target/state", self.targets),
            (TFMessage, "/tf", self.transforms),
        ):
            self.create_subscription(kind, topic, received.append, sensor())

    def ready(self):
        sensors = self.base, self.target, self.gyro, self.joints, self.pulses, self.gripper
        return all(p.get_subscription_count() for p in (*sensors, self.clock))

    @property
    def t(self):
        """Time since the start [s]."""
        return 0.01 * self.k

    @property
    def now(self):
        return START + self.k * FRAME

    def turn(self, stamp, rate):
        imu = Imu()
        imu.header.stamp, imu.angular_velocity.z = to_time(stamp), float(rate)
        self.gyro.publish(imu)

    def step(self, seen=True, gyro=True, joints=True, swapped=False, stamp=None):
        """Publish one frame."""
        self.k += 1
        stamp = self.now if stamp is None else stamp
        self.clock.publish(Clock(clock=to_time(self.now)))
        base, target = pose(BASE, DRIFT, self.t), pose(TARGET, TUMBLE, self.t)
        if swapped:
            base, target = target, base
        if gyro:
            self.turn(stamp, DRIFT[2])
        if seen:
            self.base.publish(pose_stamped(stamp, "world", base))
            self.target.publish(pose_stamped(stamp, "world", target))
        if joints and self.k % 20 == 1:
            message = JointState(
                name=[f"joint_{i}" for i in range(1, 5)], position=[0.1] * 4, velocity=[0.0] * 4
            )
            message.header.stamp = to_time(stamp)
            self.joints.publish(message)


def is_up_to_date(node, now, expects_pose):
    done = not expects_pose or node.stamps.newest == node.base.filter.last_pose_time == now
    return done and node.get_clock().now().nanoseconds == now


@pytest.fixture
def fly(spin):
    """fly(seconds, **how): let time pass; the nodes keep up."""
    made = []

    def start(**settings):
        given = {"use_sim_time": True, **settings}
        node = NavigationNode(parameter_overrides=[Parameter(k, value=v) for k, v in given.items()])
        made[:] = [node, Bench()]
        spin(made, made[1].ready)
        return made

    def advance(seconds, **how):
        node, bench = made or start()
        for _ in range(round(100 * seconds)):
            bench.step(**how)
            expects_pose = how.get("seen", True) and not how.get("swapped")
            spin(made, partial(is_up_to_date, node, bench.now, expects_pose))
        return node, bench

    advance.start = start
    return advance


def off(message, at, by):
    """Return the errors of a state: position [m], heading [rad], velocity [m/s], rate [rad/s]."""
    x, y, heading = pose(at, by, (stamp_ns(message.header.stamp) - START) / SECOND)
    p, o = message.pose.pose.position, message.pose.pose.orientation
    twist = message.twist.twist
    velocity = complex(by[0], by[1]) * complex(cos(heading), -sin(heading))
    return (
        abs(complex(p.x - x, p.y - y)),
        abs(np.angle(np.exp(1j * (2.0 * np.arctan2(o.z, o.w) - heading)))),
        abs(complex(twist.linear.x, twist.linear.y) - velocity),
        abs(twist.angular.z - by[2]),
    )


def test_states_and_covariances_of_base_and_target_are_published(fly, spin):
    node, bench = fly(2.0)
    spin([node, bench], lambda: len(bench.states) > 150 and len(bench.targets) > 150)
    for message, at, by in ((bench.states[-1], BASE, DRIFT), (bench.targets[-1], TARGET, TUMBLE)):
        assert max(off(message, at, by)) < 1e-3
        pose_of, twist_of = (
            np.reshape(m.covariance, (6, 6)) for m in (message.pose, message.twist)
        )
        for covariance in (pose_of, twist_of):
            seen = covariance[np.ix_([0, 1, 5], [0, 1, 5])]
            assert (np.linalg.eigvalsh(seen) > 0.0).all()
            assert np.count_nonzero(covariance) <= 9
        assert np.sqrt(pose_of[0, 0]) < 3e-4  # better than a single pose
    state, transform = bench.states[-1], bench.transforms[-1].transforms[0]
    for m in (state, transform):
        assert (m.header.frame_id, m.child_frame_id) == ("world", "fss")
    assert bench.targets[-1].child_frame_id == "target"
    assert transform.transform.rotation == state.pose.pose.orientation
    assert transform.transform.translation.x == state.pose.pose.position.x
    health = node.health()
    assert (health.level, health.message) == (OK, "tracking")
    assert {"period p50 [ms]", "latency p50 [ms]"} <= node.diagnostics.timing.values().keys()


def test_swapped_poses_of_base_and_target_are_reported_and_rejected(fly, spin):
    node, bench = fly(1.0)
    fly(1.0, swapped=True)
    words = node.health().message
    assert "pose of the base fits the target" in words
    assert "pose of the target fits the base" in words
    spin([node, bench], lambda: max(off(bench.states[-1], BASE, DRIFT)[:2]) < 2e-3)
    assert max(off(bench.targets[-1], TARGET, TUMBLE)[:2]) < 5e-3
    fly(3.0, swapped=True)
    assert node.health().message.startswith("base not observed for")
    assert max(off(bench.states[-1], BASE, DRIFT)[:2]) < 5e-3  # of the last published state
    fly(0.3)
    assert node.base.filter.start_count == node.target_body.filter.start_count == 1
    spin([node, bench], lambda: node.health().values["base: pose of the target rejected"] == 400)


def test_known_thrust_is_predicted_through_an_outage(fly, spin):
    node, bench = fly(1.0)
    on_time = np.zeros(8)
    on_time[[2, 4]] = 1.0  # two valves that push forward, left and right
    command = ThrusterCommand(on_time=on_time)
    command.header.stamp = to_time(bench.now)
    bench.pulses.publish(command)
    spin([node, bench], lambda: node.pulses == 1)
    fly(1.0, seen=False)
    spin([node, bench], lambda: stamp_ns(bench.states[-1].header.stamp) > bench.now - SECOND // 10)
    gained = bench.states[-1].twist.twist.linear.x - DRIFT[0]
    assert gained == pytest.approx(2 * 0.16 / 21.52, rel=0.5)  # the arm is off-center


def test_open_valve_is_reported(fly, spin):
    node, bench = fly(1.0)
    reports = []
    bench.create_subscription(ThrusterHealth, "thrusters/health", reports.append, LATCHED)
    spin([node, bench], lambda: reports)
    assert not any((*reports[-1].stuck_open, *reports[-1].stuck_closed, reports[-1].pushed))
    p, (fx, fy, torque) = paper_arm().vector(), thruster_wrenches(0.16, 0.11)[2]
    q, twist = np.array([*pose(BASE, DRIFT, bench.t), *4 * [0.1]]), np.array(DRIFT)
    for _ in range(800):
        force = complex(fx, fy) * np.exp(1j * q[2])
        H = inertia_matrix(p, q)[:3, :3]
        twist = twist + 0.01 * np.linalg.solve(H, [force.real, force.imag, torque])
        q[:3] += 0.01 * twist
        bench.step(seen=False, gyro=False)
        bench.base.publish(pose_stamped(bench.now, "world", q[:3].tolist()))
        bench.turn(bench.now, twist[2])
        spin([node, bench], lambda now=bench.now: node.base.filter.last_pose_time == now)
        if any(reports[-1].stuck_open):
            break
    assert np.flatnonzero(reports[-1].stuck_open).tolist() == [2]
    assert not any(reports[-1].stuck_closed)
    assert "valve 3 does not close" in node.health().message
    count = len(reports)
    node.reset(node.navigation.valves.faults)  # as after a jump of the stamps
    spin([node, bench], lambda: len(reports) > count)
    assert np.flatnonzero(reports[-1].stuck_open).tolist() == [2]


def test_invalid_messages_are_rejected(fly, spin):
    node, bench = fly(1.0)
    nan, far = float("nan"), (1e300, -1e300, 0.0)
    for k in range(5):
        for bad in ((nan, 0.0, 0.0), far):
            bench.base.publish(pose_stamped(bench.now + k, "world", bad))
            bench.target.publish(pose_stamped(bench.now + k, "world", bad))
        for stamp in (bench.now + 1000 * SECOND, 0):
            bench.base.publish(pose_stamped(stamp, "world", (1.0, 1.0, 1.0)))
        imu = Imu()
        imu.header.stamp, imu.angular_velocity.z = to_time(bench.now), nan
        bench.gyro.publish(imu)
        joint = JointState(name=["joint_1", "joint_99"], position=[nan], velocity=[nan])
        joint.header.stamp = to_time(bench.now + k)
        bench.joints.publish(joint)
        command = ThrusterCommand(on_time=np.full(8, nan))
        command.header.stamp = to_time(bench.now + k)
        bench.pulses.publish(command)
        fly(0.02)
    fly(0.2)
    assert max(off(bench.states[-1], BASE, DRIFT)) < 2e-3
    assert max(off(bench.targets[-1], TARGET, TUMBLE)) < 2e-3
    values = node.health().values
    assert values["filter restarts"] == 0
    assert values["vicon/fss/fss from the future"] == 5
    assert values["vicon/fss/fss occluded"] == 5
    rejected = refusals(node)
    assert rejected["refused on fog/imu"] == 5
    assert rejected["refused on vicon/fss/fss"] == rejected["refused on vicon/target/target"] == 5
    assert values["thrusters/pulses rejected"] == 5
    assert values["base: late rejected"] >= 5


def test_timers_use_the_steady_clock(spin):
    node = NavigationNode()
    spin(node, lambda: True)
    assert {timer.clock.clock_type for timer in node.timers} == {ClockType.STEADY_TIME}


def test_clock_that_jumps_back_resets_the_filters(fly, spin, capfd):
    node, bench = fly(1.0)
    for k in range(60):
        stamp = START - 100 * SECOND + k * FRAME
        bench.step(stamp=stamp)
        spin([node, bench], lambda now=bench.now: node.get_clock().now().nanoseconds == now)
    spin([node, bench], lambda: stamp_ns(bench.states[-1].header.stamp) == stamp)
    assert capfd.readouterr().err.count("filters reset") == 1


def test_held_target_moves_with_the_gripper(fly, spin):
    fly.start(frame_prefix="fss2/")
    node, bench = fly(1.0)
    assert not bench.masses  # it holds nothing
    bench.gripper.publish(GripperState(holds=True))
    spin([node, bench], lambda: node.navigation.holds)
    rest = (0.0, 0.0, 0.0)
    still = {"base": pose(BASE, DRIFT, bench.t), "target": pose(TARGET, TUMBLE, bench.t)}
    for k in range(150):  # both rest, then only the base is seen to move
        moved = max(0.0, 2e-4 * (k - 50))
        bench.step(seen=False, gyro=False)
        bench.base.publish(pose_stamped(bench.now, "world", pose(still["base"], (1, 0, 0), moved)))
        if k < 50:
            bench.target.publish(pose_stamped(bench.now, "world", still["target"]))
        spin([node, bench], lambda now=bench.now: node.base.filter.last_pose_time == now)
    assert node.health().values["target"] == "held"
    spin([node, bench], lambda: stamp_ns(bench.targets[-1].header.stamp) > bench.now - SECOND // 10)
    there = pose(still["target"], (1, 0, 0), moved)
    assert off(bench.targets[-1], there, rest)[0] < 5e-3
    assert bench.targets[-1].twist.twist.linear.x != 0.0
    spin([node, bench], lambda: bench.masses)
    found = bench.masses[-1]
    assert found.header.frame_id == "fss2/link_4"
    assert bench.now - 2 * SECOND < stamp_ns(found.header.stamp) <= bench.now
    assert found.samples >= 1
    assert np.linalg.eigvalsh(found.covariance.reshape(4, 4)).min() > 0.0
    assert min(found.mass, found.inertia) > 0.0
