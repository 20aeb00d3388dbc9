"""The capture and its parts, simulated with delayed and noisy sensors."""

import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from capturing import POSTURE, SETTINGS, Case, Flight
from model_arms import random_arm

from fss_arm_model.description import paper_arm
from fss_arm_model.dynamics import inertia_matrix
from fss_arm_model.held import (
    Target,
    combined_momentum,
    payload_pose,
    payload_positions,
    payload_state,
    with_payload,
)
from fss_arm_model.kinematics import tip_pose
from fss_arm_model.momentum import generalized_jacobian
from fss_arm_model.settings import SettingError
from fss_gnc.guidance.abort import Abort, JointStop
from fss_gnc.guidance.activity import Craft, Observation
from fss_gnc.guidance.approach import Planner
from fss_gnc.guidance.approach_trajectory import (
    FINAL_MOTION_TIME,
    MAX_FINAL_SPEED,
    RAMP_TIME,
    RigidCraft,
    propagate_coast,
)
from fss_gnc.guidance.budget import Budget
from fss_gnc.guidance.capture import Capture
from fss_gnc.guidance.detumble import Detumble
from fss_gnc.guidance.drift import PUSH_MARGIN, DriftPredictor
from fss_gnc.guidance.mission_monitor import MissionMonitor
from fss_gnc.guidance.mission_settings import MissionSettings
from fss_gnc.guidance.other_vehicles import OtherVehicle
from fss_gnc.guidance.reach import RESPONSE_TIME, Reach, fixture_poses
from fss_gnc.guidance.stopping import Grip, braking, grip_load, joint_stop_time
from fss_gnc.reference import Body
from fss_sim.plant.drives import MODE_VELOCITY
from fss_sim.plant.plant import Plant
from fss_sim.plant.target import Gripper
from fss_sim.plant.vehicle import Demand, World

ARM = paper_arm()
P = ARM.vector()
CRAFT = Craft(ARM, SETTINGS)
AT_REST = np.zeros(7)


def state(heading=0.5, spin=0.1, drift=(0.0, 0.0)):
    return np.array([[0.0, 0.0, heading], [*drift, spin]])


def at(x, y, heading, posture=POSTURE):
    return np.array([x, y, heading, *posture])


NEAR_POSE = at(-0.75, -0.75, -1.9)  # the target, in whose way it may drift
RESTING_TARGET = Body(np.zeros(3), np.zeros(3))


def observe(q, twist=(0.0, 0.0, 0.0), t=0.0, target=None, **known):
    """Return what is known of a base with its joints at rest."""
    return Observation(t, Body(q[:3], np.array(twist)), target, q[3:], np.zeros(4), **known)


def test_a_capture_names_the_states_that_it_waited_for():
    mission = Capture(CRAFT)
    observed = Observation(0.0, Body(np.zeros(3), np.zeros(3)))
    assert mission.step(observed).phase == "wait"
    late = SETTINGS.wait_timeout + 1.0
    reasons = "arm/joint_states is 34.1 s old", "waiting for target/state"
    commands = mission.step(replace(observed, t=late, unknown=reasons))
    assert commands.phase == "abort"
    assert commands.reason == (
        f"arm/joint_states and target/state not known within {SETTINGS.wait_timeout:g} s "
        "(arm/joint_states is 34.1 s old, waiting for target/state)"
    )


def test_a_reach_that_misses_states_how_far_away_the_fixture_was():
    never = replace(SETTINGS, grip_distance=1e-5, reach_timeout=2.0, attempts=1)
    flown = Flight(Case(distance=1.4), settings=never).fly()
    assert not flown.captured
    assert flown.safe
    assert flown.phases[:3] == ["wait", "approach", "reach"]
    words = r"target not captured in 1 attempts; reach 1 of 1 missed after 2\.1 s: fixture 0\.\d+ m"
    assert re.match(words, flown.message), flown.message


def test_it_captures_a_tumbling_target_and_stops_it():
    flight = Flight(Case(spin=0.15, distance=1.4))
    flown = flight.fly()
    assert flown.phases == ["wait", "approach", "reach", "grip", "detumble"]
    assert flown.well
    assert flown.captured
    assert flown.safe
    assert abs(flown.spin) < 0.01
    assert np.abs(flight.plant.imbalance).max() < 1e-9
    # Turn rates are known to 2 mrad/s, times 2 kg m^2, and a last pulse may end after that.
    assert flight.activity.momentum[2] == pytest.approx(flown.momentum, abs=5e-3)


def fly_with_unknown_mass(assumed, mass, inertia=None, **case):
    settings = MissionSettings(target_mass=assumed, target_inertia=assumed / 40.0)
    truth = Target(mass, mass / 40.0 if inertia is None else inertia)
    flight = Flight(Case(distance=1.4, **case), None, settings, truth)
    return flight, flight.fly()


def normalized_errors(flight):
    """Final errors of the target's mass properties in standard deviations (4,), and the NEES."""
    truth, estimate = flight.plant.world.target, flight.navigation.mass_properties
    place = payload_pose(P, flight.plant.q, flight.plant.target[0])
    error = estimate.values - [truth.mass, *place[:2], truth.inertia]
    return error / estimate.deviations, error @ np.linalg.solve(estimate.covariance, error) / 4


@pytest.mark.slow
def test_target_six_times_as_heavy_is_estimated_and_stopped():
    """Find the mass while it is stopped: as assumed, the base would leave its reference."""
    flight, flown = fly_with_unknown_mass(5.0, 30.0, spin=0.25, drift=(-0.025, 0.02))
    assert flown.well
    assert flown.captured
    assert flown.safe
    estimate = flight.navigation.mass_properties
    assert np.abs(normalized_errors(flight)[0]).max() < 3.0
    assert estimate.deviations[0] < 0.5 * estimate.values[0]  # 0.7 in the prior
    assert (estimate.deviations[1:3] < 0.035).all()


@pytest.mark.slow
def test_mass_estimates_of_twelve_targets_are_consistent():
    nees = []
    for seed in range(12):
        rng = np.random.default_rng(100 + seed)
        mass = 10.0 * 2.0 ** rng.uniform(-1.0, 1.0)
        inertia = mass / 40.0 * np.exp(0.3 * rng.standard_normal())
        spin = rng.choice([-1.0, 1.0]) * rng.uniform(0.05, 0.15)
        flight, flown = fly_with_unknown_mass(10.0, mass, inertia=inertia, spin=spin, seed=seed)
        assert flown.well
        errors, flight_nees = normalized_errors(flight)
        assert np.abs(errors).max() < 3.0
        nees.append(flight_nees)
    assert np.mean(nees) < 1.5  # 0.2: the covariance of the base's twist is conservative


@pytest.mark.slow
@pytest.mark.parametrize("phase", ["approach", "reach", "detumble"])
@pytest.mark.parametrize("fault", ["outage", "link", "open"])
def test_fault_aborts_the_mission_safely(fault, phase):
    flown = Flight(Case(spin=0.1, distance=1.4, fault=fault, phase=phase, lasts=10.0)).fly()
    assert "abort" in flown.phases
    assert flown.safe


def test_unknown_gripper_state_aborts_without_a_push_away_from_a_target_that_may_be_held():
    flown = Flight(Case(spin=-0.1, heading=1.0, fault="gripper", phase="grip")).fly()
    assert flown.phases[-2:] == ["grip", "abort"]
    assert flown.message.startswith("gripper/state is not known; ")
    assert flown.safe


@pytest.mark.parametrize("holds", [True, None])
def test_waiting_mission_does_not_open_a_gripper_that_may_hold_the_target(holds):
    q = at(-1.0, -1.0, -1.4)
    mission, base = Capture(CRAFT), Body(q[:3], np.zeros(3))
    target = None if holds else Body(np.zeros(3), np.array([0.0, 0.0, 0.1]))
    unknown = Observation(0.0, None, target, q[3:], np.zeros(4), holds=holds)
    for obs in (unknown, replace(unknown, base=base, target=target)):
        assert mission.step(obs).close_gripper is not False
    assert Capture(CRAFT).step(replace(unknown, holds=False)).close_gripper is False


def test_open_valve_aborts_the_wait_for_the_target():
    commands = Capture(CRAFT).step(observe(at(-1.0, -1.0, -1.4), holds=False, open_valves=(3,)))
    assert (commands.phase, commands.reason) == ("abort", "valve 3 does not close")


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"posture": (0.1, 0.2)}, "posture has 2 angles, expected 4 or none"),
        ({"posture": (0.1, 0.2, 0.3, 4.0)}, "posture of joint 4 is 229.2 deg"),
        ({"target_radius": 0.3}, r"keep_out is 0\.26 m, expected at least target_rad"),
    ],
)
def test_infeasible_settings_are_rejected(settings, words):
    with pytest.raises(SettingError, match=words):
        Craft(ARM, MissionSettings(**settings))


def test_approach_ends_at_the_stand_off_and_is_passively_safe():
    planner, q, target = Planner(P, SETTINGS), at(-1.0, -1.0, -1.4), state()
    way = planner.plan(q, AT_REST, target, SETTINGS.lead)
    end = way.points(way.duration)
    t = way.duration + SETTINGS.lead
    facing = fixture_poses(target, SETTINGS, np.array([t]))[0]
    tip = tip_pose(P, np.concatenate([end.pose[0], POSTURE]))
    assert np.hypot(*(tip[:2] - facing[:2])) == pytest.approx(SETTINGS.stand_off, abs=1e-6)
    assert np.cos(tip[2] - facing[2]) == pytest.approx(1.0, abs=1e-6)
    np.testing.assert_allclose(end.twist, 0.0, atol=1e-9)
    times = np.linspace(0.0, way.duration, 60)
    points = way.points(times)
    np.testing.assert_allclose(points.pose[0], q[:3], atol=1e-9)
    for ahead in np.linspace(0.0, SETTINGS.coast, 7):
        poses = propagate_coast(points.pose, points.twist, way.body.com, ahead)
        gaps = planner.gaps_along(poses, way.body, np.zeros((60, 2)))
        assert gaps.min() > 0.0


@pytest.mark.parametrize("cancels", [False, True])
def test_approach_twist_and_acceleration_are_derivatives_of_the_pose(cancels):
    planner = Planner(P, replace(SETTINGS, cancel_momentum=cancels))
    way = planner.plan(at(-1.0, -1.0, -1.4), AT_REST, state(), 3.0)
    assert way.final_rate.any() == cancels
    t, step = np.linspace(1.0, way.duration + 12.0, 30), 1e-4
    ahead, now, behind = (way.points(t + k * step) for k in (1, 0, -1))
    np.testing.assert_allclose(now.twist, (ahead.pose - behind.pose) / (2 * step), atol=1e-7)
    np.testing.assert_allclose(
        now.acceleration, (ahead.twist - behind.twist) / (2 * step), atol=2e-6
    )


@pytest.mark.parametrize("drift", [(0.0, 0.0), (0.004, -0.003), (0.008, 0.008), (-0.01, 0.0)])
def test_approach_that_cancels_momentum_ends_opposite_to_the_target(drift):
    planner = Planner(P, replace(SETTINGS, cancel_momentum=True))
    target = state(spin=0.3, drift=drift)
    way = planner.plan(at(-1.0, -1.0, -1.4), AT_REST, target, SETTINGS.lead)
    assert way.final_rate.any()
    t = way.duration
    end, travelled = way.points(t), np.array([*(t * target[1, :2]), 0.0])
    q = np.concatenate([end.pose[0] + travelled, POSTURE])
    qd = np.concatenate([end.twist[0] + [*drift, 0.0], np.zeros(4)])
    there = np.array([target[0] + t * target[1], target[1]])
    px, py, L = combined_momentum(P, q, qd, SETTINGS.target, there)
    assert abs(L) < 1e-9  # [N m s]; a sum of terms of 0.1
    if way.final_rate[0] > -MAX_FINAL_SPEED:
        assert np.hypot(px, py) < 1e-9
    stopped = way.points(way.duration + FINAL_MOTION_TIME + RAMP_TIME)
    np.testing.assert_allclose(stopped.twist, 0.0, atol=1e-12)


@pytest.mark.parametrize("n", [3, 8])
@pytest.mark.parametrize("inward", [False, True])
def test_final_motion_of_any_arm_has_the_momentum_opposite_to_the_target(n, inward):
    rng = np.random.default_rng(n)
    arm, posture, phi = random_arm(n, rng), rng.uniform(-1.0, 1.0, n), 0.7
    body, target = RigidCraft(arm.vector(), posture), Target()
    drift = (1.0 if inward else -1.0) * 0.02 * np.array([np.cos(phi), np.sin(phi)])
    seen = np.array([[0.3, -0.2, 0.1], [*drift, -0.2]])
    rates = body.canceling_rates(0.4, phi, target, seen)
    assert (rates[0] == pytest.approx(-MAX_FINAL_SPEED)) == inward
    end = body.points(
        *np.array(
            [[[0.4], [rates[0]], [0.0]], [[phi], [rates[1]], [0.0]], [[0.0], [rates[2]], [0.0]]]
        )
    )
    q = np.concatenate([end.pose[0] + [0.3, -0.2, 0.0], posture])
    qd = np.concatenate([end.twist[0] + [*drift, 0.0], np.zeros(n)])
    px, py, L = combined_momentum(arm.vector(), q, qd, target, seen)
    assert abs(L) < 1e-12  # [N m s]
    assert (np.hypot(px, py) < 1e-12) != inward  # [N s]


def test_capture_that_cancels_momentum_leaves_little_to_stop():
    fingers = {"grip_closing_time": 0.3, "grip_force": 5.0, "grip_torque": 0.5}
    settings = replace(SETTINGS, cancel_momentum=True, **fingers)
    gripper = Gripper(closing_time=0.3, force=5.0, torque=0.5)
    flight = Flight(Case(spin=0.3, distance=1.4, gripper=gripper), settings=settings)
    flown = flight.fly()
    assert flown.captured
    assert flown.well
    assert flown.safe
    # The target alone has 0.075 N m s; turn rates are known to 2 mrad/s, and steered to 8.
    assert abs(flown.momentum) < 0.03
    assert flight.activity.momentum[2] == pytest.approx(flown.momentum, abs=5e-3)


def test_joints_keep_their_rates_until_a_grip_is_known(monkeypatch):
    settings, gripper = replace(SETTINGS, grip_closing_time=0.3), Gripper(closing_time=0.3)
    flight = Flight(Case(spin=0.15, distance=1.4, gripper=gripper), settings=settings)
    observe, step, steps = flight.observe, flight.step_activity, []

    def observe_late():
        known, report_time = observe(), flight.flown.grip + 0.25
        return replace(known, holds=bool(known.holds and flight.t > report_time))

    def record_step(observation):
        commands = step(observation)
        steps.append((commands.phase, flight.t, commands.rates))
        return commands

    monkeypatch.setattr(flight, "observe", observe_late)
    monkeypatch.setattr(flight, "step_activity", record_step)
    assert flight.fly().well
    grip = [(t, rates) for phase, t, rates in steps if phase == "grip"]
    closing = [rates for t, rates in grip if t < grip[0][0] + 0.35]
    closed = [rates for _, rates in grip[len(closing) :]]
    assert not any(np.array_equal(a, b) for a, b in pairwise(closing))
    assert len(closed) > 1
    assert all(np.array_equal(rates, closing[-1]) for rates in closed)


def test_no_approach_is_found_without_free_space():
    target = state(spin=0.0, heading=0.0)
    target[0, :2] = 1.8, 0.0  # its fixture faces the edge
    assert Planner(P, SETTINGS).plan(at(-1.0, 0.0, 0.0), AT_REST, target, 3.0) is None


def test_joints_stop_within_their_torque_limits():
    q, qd = at(0.0, 0.0, 0.0), np.concatenate([np.zeros(3), [1.0, -1.0, 1.0, -1.0]])
    gentle, hard = (joint_stop_time(P, q, qd, np.full(4, torque)) for torque in (0.2, 1.0))
    assert gentle > hard


def test_grip_load_of_a_motion_is_that_of_the_simulated_grip():
    gripper = Gripper(force=1e3, torque=1e3)
    world = World(target=Target(), gripper=gripper)
    tip = tip_pose(P, at(0.0, 0.0, 0.0))
    target = tip + np.array([0.19 * np.cos(tip[2]), 0.19 * np.sin(tip[2]), 2.0])
    moving = [0.01, 0.02, 0.1, 0.3, -0.4, 0.2, 0.5]
    plant = Plant(ARM, at(0.0, 0.0, 0.0), moving, world, [target, np.zeros(3)], holds=True)
    for joint, rate in enumerate((0.6, 0.1, -0.5, 0.2)):
        plant.command(joint, Demand(MODE_VELOCITY, rate, abs(rate), 2.0))
    plant.advance(0.02)
    q, qd = plant.q, plant.qd
    plant.advance(0.001)
    p, acceleration = plant.p, (plant.qd - qd)[3:] / 0.001
    place = payload_pose(p, q, plant.target[0] - 0.001 * plant.target[1])
    load = grip_load(p, 0.5 * (q + plant.q), 0.5 * (qd + plant.qd), acceleration, Target(), place)
    np.testing.assert_allclose(load, (plant.fingers.force, plant.fingers.torque), rtol=2e-3)
    assert load[1] > 0.1


def test_joints_stop_within_the_limits_of_the_grip():
    q, qd = at(0.0, 0.0, 0.0), np.array([0.0, 0.0, 0.0, 0.4, 0.3, 0.2, 0.4])
    place = np.array([0.55, 0.0, 1.0])
    p = with_payload(P, Target(), place)
    grip = Grip(Target(), place, np.inf, 0.1)
    duration = joint_stop_time(p, q, qd, np.full(4, np.inf), grip)
    assert duration > joint_stop_time(p, q, qd, np.full(4, np.inf))
    assert grip_load(p, q, qd, -qd[3:] / duration, Target(), place)[1] <= 0.1


def test_joints_that_slow_down_keep_the_limits_of_a_grip_that_is_known_later():
    q, qd, place = at(0.0, 0.0, 0.0), np.array([0.4, 0.3, 0.2, 0.4]), np.array([0.55, 0.0, 1.0])
    p, stop = with_payload(P, Target(), place), JointStop(np.full(4, np.inf))
    obs = Observation(0.0, Body(q[:3], np.zeros(3)), None, q[3:], qd)
    stop.rates(P, obs)
    grip = Grip(Target(), place, np.inf, 0.1)
    for t in (0.1, 0.2):
        stop.rates(p, replace(obs, t=t), grip)
    rates = np.array([0.0, 0.0, 0.0, *qd])
    needed = joint_stop_time(p, q, rates, np.full(4, np.inf), grip)
    assert stop.end_time == pytest.approx(0.1 + needed)


@pytest.mark.parametrize("spin", [-0.3, 0.15])
def test_reach_gives_the_end_effector_the_velocity_of_the_fixture(spin):
    q, reach = at(-0.8, 0.1, 0.2, (0.4, 0.9, -0.6, -0.5)), Reach(ARM, SETTINGS)
    reach.set_momentum(q, AT_REST)
    tip, motion = tip_pose(P, q), np.array([0.01, -0.02, spin])
    arm = SETTINGS.target_fixture[0] * np.array([-np.cos(tip[2]), -np.sin(tip[2])])
    centre = np.array([*(tip[:2] - arm), tip[2] + np.pi])
    rates = reach.rates(q, AT_REST, np.array([centre - RESPONSE_TIME * motion, motion]))
    velocity = (generalized_jacobian(P, q) @ rates)[:2]
    expected = motion[:2] + spin * np.array([-arm[1], arm[0]])
    assert np.hypot(*(velocity - expected)) < 0.15 * np.hypot(*expected)  # by the damping


@pytest.mark.parametrize("spin", [-0.3, 0.3])
def test_reach_does_not_jump_where_a_fixture_becomes_too_fast(spin):
    q, reach = at(-1.0, 0.0, 0.0, (0.4, 0.9, -0.6, -0.5)), Reach(ARM, SETTINGS)
    reach.set_momentum(q, AT_REST)
    tip, arm = tip_pose(P, q), SETTINGS.target_fixture[0]
    heading = tip[2] + np.pi - np.copysign(1.2, spin)
    fixture = tip[:2] - arm * np.array([np.cos(heading), np.sin(heading)])
    rates, meets = [], []
    for distance in np.linspace(0.18, 0.22, 401):
        centre = fixture + distance * np.array([np.cos(tip[2]), np.sin(tip[2])])
        state = np.array([[*centre, heading], [0.0, 0.0, spin]])
        rates.append(reach.rates(q, AT_REST, state))
        later = fixture_poses(state, SETTINGS, np.linspace(1.0, 6.0, 501))[:, :2] - tip[:2]
        speeds = np.hypot(*later.T) / np.linspace(1.0, 6.0, 501)
        meets.append(speeds.min() < SETTINGS.reach_speed)
    assert any(meets)
    assert not all(meets)
    assert np.abs(np.diff(rates, axis=0)).max() < 0.01  # [rad/s] per 0.1 mm; a jump is 0.09


def test_base_brakes_within_the_authority_of_the_valves():
    q, qd = at(0.0, 0.0, 0.0), np.concatenate([[0.05, 0.0, 0.0], np.zeros(4)])
    path = braking(P, q, qd, SETTINGS, 2.0)
    assert path.at(path.end_time).pose[0] == pytest.approx(0.025 * (path.end_time - 2.0))
    assert 0.05 / (path.end_time - 2.0) < 0.32 / 21.5


def test_abort_pushes_away_from_the_target_and_then_drifts():
    commands = Abort(CRAFT, "test").step(
        observe(NEAR_POSE, (0.03, 0.03, 0.0), target=RESTING_TARGET, holds=False)
    )
    assert commands.phase == "abort"
    assert commands.path is not None
    pose, twist = commands.path.knots[-1, :2]
    after = np.append(pose, POSTURE), np.append(twist, np.zeros(4))
    assert DriftPredictor(P, SETTINGS).predict(*after, RESTING_TARGET).safe


@pytest.mark.parametrize("y", [0.0, 0.4, 0.8])
def test_push_away_from_another_vehicle_leaves_room_for_its_duration(y):
    square = 0.2 * np.array([1 + 1j, -1 + 1j, -1 - 1j, 1 - 1j])
    body = Body(np.array([0.9, y, 0.0]), np.zeros(3))
    others = [OtherVehicle("fss2", True, body, square)]
    drifting = DriftPredictor(P, SETTINGS, others=others)
    q, qd = at(-0.4, 0.0, 0.0, (1.3, 1.15, 1.15, 1.1)), np.array([0.03, 0.01, *np.zeros(5)])
    assert not drifting.predict(q, qd, None).safe
    push = drifting.plan_push(q, qd, None)
    assert push.safe
    assert push.vehicles >= SETTINGS.vehicle_gap + PUSH_MARGIN
    assert push.edge >= SETTINGS.min_edge_gap + PUSH_MARGIN


def test_abort_keeps_the_valves_closed_if_the_base_is_unknown_or_drifts_safely():
    away = observe(NEAR_POSE, (-0.01, -0.01, 0.0), target=RESTING_TARGET, holds=False)
    for obs in (replace(away, base=None), away):
        commands = Abort(CRAFT, "test").step(obs)
        assert commands.path is None
        np.testing.assert_allclose(commands.rates, 0.0)


def test_abort_does_not_mistake_the_joint_reaction_for_drift():
    q, rates = NEAR_POSE, np.full(4, 0.3)
    H = inertia_matrix(P, q)[:3]
    turned = -np.linalg.solve(H[:, :3], H[:, 3:] @ rates)  # no momentum: it ends with the motion
    assert not DriftPredictor(P, SETTINGS).predict(q, np.append(turned, rates), None).safe
    abort = Abort(CRAFT, "test")
    assert abort.step(replace(observe(q, turned, holds=False), qd=rates)).path is None
    assert abort.step(observe(q, t=1.0, holds=False)).path is None
    assert abort.safe


def test_edge_clearance_includes_the_held_target():
    q = at(-0.9, 0.0, 1.0)
    x, y, _ = tip_pose(P, q)
    place = payload_pose(P, q, (x - 0.15, y + 0.1, 0.3))
    states = np.stack([q, at(-0.2, 0.5, 0.7)])
    there = [payload_state(P, each, AT_REST, place)[0, :2] for each in states]
    np.testing.assert_allclose(payload_positions(P, states, place), there, atol=1e-12)
    alone, both = (DriftPredictor(P, SETTINGS, p).clearances(q, None)[0] for p in (None, place))
    assert both == pytest.approx(2.0 - np.abs(there[0]).max() - SETTINGS.target_radius)
    assert both < alone


@pytest.mark.slow
def test_abort_does_not_mistake_the_reaction_of_silent_joints_for_drift():
    flown = Flight(Case(fault="link", phase="reach", after=0.5)).fly()
    assert flown.phases[-2:] == ["reach", "abort"]
    assert flown.safe
    assert flown.edge > 0.2  # 0.33 at the start: it drifts, but does not push itself away


def abort_commands(force, propellant, end=6.0, outages=(), **known):
    """Commands of an abort while a leaking valve pushes the base along y [N].

    The base is unknown at the times `outages`.
    """
    abort, found = Abort(CRAFT, "test"), []
    far = Body(np.array([1.5, 1.5, 0.0]), np.zeros(3))
    for t in np.arange(0.0, end, 0.1):
        at_y, v = 0.5 * force / 21.5 * t**2, force / 21.5 * t
        base = Body(np.array([-0.75, -0.75 + at_y, -1.9]), np.array([0.0, v, 0.0]))
        obs = Observation(t, base, far, np.array(POSTURE), np.zeros(4), None, False, propellant)
        obs = replace(obs, **known)
        found.append(abort.step(replace(obs, base=None) if t in outages else obs))
        if found[-1].outcome:
            break
    return found


@pytest.mark.parametrize("known", [{"open_valves": (2,)}, {"unknown_push": True}])
def test_abort_holds_the_base_against_a_leaking_valve_while_there_is_gas(known):
    leaking = abort_commands(0.16, 0.04, **known)
    np.testing.assert_array_equal(leaking[-1].path.knots[-1, 1], 0.0)  # at rest in the end
    drifting = abort_commands(0.0, 0.04)
    assert drifting[-1].path is None
    assert len(drifting) < len(leaking)  # done after 3 s of safe drift
    assert abort_commands(0.0, 0.0, **known)[-1].path is None


def test_abort_resumes_the_hold_when_the_base_is_known_again():
    commands = abort_commands(0.16, 0.04, outages=[2.0], open_valves=(2,))
    assert [k for k, one in enumerate(commands) if one.path is None] == [20]


@pytest.mark.parametrize("propellant", [0.04, np.nan])
def test_abort_without_tank_sensor_holds_until_the_valves_fail_to(propellant):
    # The leak is much weaker than a valve: the tank is empty.
    outcome = abort_commands(0.02, propellant, 40.0, open_valves=(2,))[-1].outcome
    expected = (False, "test; the valves no longer hold the base")
    assert outcome == (None if np.isfinite(propellant) else expected)


@pytest.mark.parametrize("measured", [False, True])
def test_abort_slows_the_joints_down_as_slowly_as_the_grip_requires(measured):
    """As detumbling does: otherwise the target slides out of the fingers."""
    weak = replace(SETTINGS, grip_force=5.0, grip_torque=0.1)
    q = at(0.0, 0.0, 0.0)
    tip = Body(tip_pose(P, q), np.zeros(3))
    obs = replace(observe(q, holds=True, target=tip), qd=np.full(4, 0.4))
    if measured:
        place = payload_pose(P, q, tip.pose)
        obs = replace(obs, target=None, held_body=(weak.target, place))
    ends = []
    for activity in (Detumble(Craft(ARM, weak)), Abort(Craft(ARM, weak), "test")):
        activity.step(obs)
        ends.append(activity.joints.end_time)
    assert ends[1] == pytest.approx(ends[0])
    free = Abort(Craft(ARM, weak), "test")
    free.step(replace(obs, holds=False, held_body=None))
    assert ends[1] > 2.0 * free.joints.end_time


def test_abort_predicts_the_drift_of_a_held_body_without_markers():
    q = at(0.0, 0.0, 0.0)
    place = payload_pose(P, q, tip_pose(P, q))
    abort = Abort(CRAFT, "test")
    abort.step(observe(q, holds=True, held_body=(SETTINGS.target, place)))
    np.testing.assert_allclose(abort.p, with_payload(P, SETTINGS.target, place))


def test_the_propellant_of_a_mission_includes_that_before_the_grip():
    monitor = MissionMonitor(CRAFT)
    q, limit = at(0.0, 0.0, 0.0), SETTINGS.max_propellant
    for used in (0.0, 0.8 * limit):
        obs = observe(q, holds=True, propellant=0.1 - used)
        assert not monitor.abort_reason(obs, None, "grip", 60.0, 0.0)
    mission = Detumble(CRAFT, monitor)
    assert mission.step(replace(obs, t=1.0)).phase == "detumble"
    more = replace(obs, t=1.1, propellant=0.1 - 1.1 * limit)
    assert "of propellant used" in mission.step(more).reason


def test_detumble_keeps_the_held_target_from_the_edge():
    q, place = at(0.0, 0.0, 0.0, np.zeros(4)), np.array([1.2, 0.0, 0.0])
    q[0] += 1.95 - payload_positions(P, q, place)[0]
    obs = observe(q, holds=True, held_body=(Target(), place))
    mission, budget = Detumble(CRAFT), Budget(CRAFT)
    for t in (0.0, 0.1):
        mission.step(replace(obs, t=t))
    assert "table's edge is" in mission.abort.reason
    budget.update(obs)
    assert budget.edge_gap == pytest.approx(0.05 - SETTINGS.target_radius)


def test_detumble_does_not_succeed_in_the_step_that_detects_a_push():
    mission, commands = Detumble(CRAFT), None
    q = at(0.0, 0.0, 0.0)
    for t in np.arange(0.0, 30.0, 0.1):
        commands = mission.step(observe(q, t=t, holds=True))
        if commands.outcome:
            break
    assert commands.outcome.success
    mission, last = Detumble(CRAFT), t
    for t in np.arange(0.0, last + 0.05, 0.1):
        commands = mission.step(observe(q, t=t, holds=True, unknown_push=t > last - 0.05))
    assert commands.phase == "abort"


def test_abort_reports_why_the_drift_is_not_safe():
    abort, commands = Abort(CRAFT, "enough", requested=True), None
    for t in (0.0, 4.0):
        no_gas = observe(NEAR_POSE, (-0.06, 0.0, 0.0), t, holds=False, propellant=0.0)
        commands = abort.step(no_gas)
    assert not commands.outcome.success
    assert commands.outcome.message.startswith("enough; the base drifts to -")
    assert commands.outcome.message.endswith(" m from the table's edge within 30 s")


def test_detumble_fails_if_a_valve_leaks():
    mission, commands = Detumble(CRAFT), None
    for t in np.arange(0.0, 12.0, 0.1):
        coasting = t > 4.0 and commands.path is None
        obs = observe(at(0.0, 0.0, 0.0), t=t, holds=True, unknown_push=coasting)
        commands = mission.step(obs)
    assert commands.phase == "abort"
    assert mission.abort.reason == "an unknown force pushes the base"


def test_requested_abort_succeeds_when_the_drift_is_safe():
    abort = Abort(CRAFT, "test", requested=True)
    away = observe(NEAR_POSE, (-0.01, -0.01, 0.0), target=RESTING_TARGET, holds=False)
    ends = [abort.step(replace(away, t=t)).outcome for t in (0.0, 4.0)]
    assert ends[0] is None
    assert ends[1].success


def test_canceled_detumble_is_aborted():
    mission, obs = Detumble(CRAFT), observe(at(0.0, 0.0, 0.0), holds=True)
    assert mission.step(obs).phase == "detumble"
    mission.cancel("enough")
    assert mission.step(replace(obs, t=0.1)).phase == "abort"
