"""Topics of the node `control`."""

import numpy as np
import pytest
from control_bench import ZERO, Bench, at
from gnc_bench import FOLDED
from nav_msgs.msg import Odometry
from rclpy.duration import Duration
from rclpy.node import Node
from std_msgs.msg import Float64
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from fss_arm_model.description import paper_arm
from fss_arm_model.dynamics import inertia_matrix
from fss_arm_model.kinematics import tip_pose
from fss_arm_msgs.msg import MassProperties
from fss_arm_ros.convert import SECOND, to_time
from fss_arm_ros.validation import refusals

ARM = paper_arm()


@pytest.fixture
def bench(spin):
    return Bench(spin)


def test_age_counts_from_the_stamp_and_not_from_the_arrival(bench):
    bench.acts()
    keys = bench.control.diagnostics.timing.values().keys()
    assert {"period p50 [ms]", "latency p50 [ms]"} <= keys
    bench.late = 2.0
    bench.stops("thrusters idle: base/state is 2.0 s old", within=1.0)


def test_states_with_nan_are_ignored(bench):
    bench.acts()
    bench.twist = np.full(3, np.nan)
    bench.stops("s old", within=1.0)


def test_invalid_trajectories_and_plans_are_counted_and_ignored(bench):
    bench.acts()
    bench.silent |= {"base/trajectory"}
    bench.guide(at(5.0, 0.0, 0.0))
    bench.planned.publish(JointTrajectory(joint_names=["joint_1"]))
    expected = {"refused on base/trajectory": 1, "refused on arm/planned": 1}
    bench.until(lambda: refusals(bench.control) == expected)
    bench.stops("no new base/trajectory for ")
    assert np.abs(bench.wrenches).max() < 1.0  # 5 m would be 13 N


def test_duplicate_publishers_of_the_base_state_are_reported(bench):
    other = Node("other")
    other.create_publisher(Odometry, "base/state", 1)
    bench.run([other], lambda: "base/state has 2 sources: /fake_craft, /other" in bench.words)


def planned(bench, rates):
    message = JointTrajectory(joint_names=[f"joint_{i}" for i in range(1, 5)])
    message.header.stamp = to_time(bench.now())
    for k, rate in enumerate(rates):
        since = Duration(seconds=1.0 * k).to_msg()
        message.points.append(JointTrajectoryPoint(velocities=[rate] * 4, time_from_start=since))
    return message


def test_feedforward_compensates_planned_accelerations(bench):
    bench.path, bench.plan = at(0.0, 0.0, 0.0), planned(bench, [0.0, 0.0])
    bench.acts()
    assert np.abs(bench.wrenches).max() < 1e-3
    bench.plan = planned(bench, [0.0, 3.0])  # 3 rad/s^2 from now on
    count = len(bench.wrenches)
    bench.until(lambda: len(bench.wrenches) > count + 10)
    q = np.array([0.0, 0.0, 0.0, *FOLDED])
    expected = inertia_matrix(ARM.vector(), q)[:3, 3:] @ np.full(4, 3.0)
    # Each wrench acts for one period and compensates the time since the last one.
    lasted = (bench.stamps[count + 10] - bench.stamps[count + 3]) / SECOND
    given = np.sum(bench.wrenches[count + 4 : count + 11], axis=0) / bench.control.settings.rate
    np.testing.assert_allclose(given / lasted, expected, rtol=0.1, atol=1e-3)


def test_model_receives_the_held_target_and_the_propellant(bench):
    model, (x, y, heading) = (
        bench.control.controller.model,
        tip_pose(ARM.vector(), [0, 0, 0, *FOLDED]),
    )
    bench.target = np.array([x + 0.1, y, heading]), np.zeros(3)
    bench.propellant, bench.holds = -20.0, True  # a sensor with an offset: the tank is empty
    bench.acts()
    bench.until(lambda: model.place is not None)
    assert model.propellant_used == pytest.approx(0.1)
    bench.control.on_propellant(Float64(data=20.0))  # more than a full tank holds
    assert model.propellant_used == 0.0
    publisher = bench.create_publisher(MassProperties, "target/mass_properties", 1)
    bench.until(lambda: publisher.get_subscription_count())
    publisher.publish(MassProperties(mass=20.0, com=[0.4, 0.05], inertia=0.6))
    publisher.publish(MassProperties(mass=-1.0, inertia=0.6))
    bench.until(lambda: refusals(bench.control) == {"refused on target/mass_properties": 1})
    target, place = model.measured
    assert (target.mass, target.inertia, *place) == (20.0, 0.6, 0.4, 0.05, 0.0)
    bench.holds = False
    bench.until(lambda: not model.is_loaded)


def test_clock_that_jumps_back_closes_the_valves_until_new_messages_arrive(spin):
    bench = Bench(spin, time=100 * SECOND, use_sim_time=True)
    bench.acts()
    bench.time = 10 * SECOND
    bench.silent |= {"base/state", "base/trajectory"}
    bench.until(lambda: bench.wrenches[-1] == ZERO)
    count = len(bench.wrenches)
    bench.until(lambda: "s in the future" in bench.words)
    assert len(bench.wrenches) == count
    bench.silent -= {"base/state"}
    bench.acts()
