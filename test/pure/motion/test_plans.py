"""Properties of plans of every kind: limits, rest at both ends, prediction of the base."""

from dataclasses import replace

import numpy as np
import pytest
from model_arms import random_arm
from numpy.testing import assert_allclose
from plan_oracle import held, open_loop

from fss_arm_model.base_motion import base_poses
from fss_arm_model.clearance import clearance
from fss_arm_model.description import paper_arm
from fss_arm_model.joint_path import path, sampled
from fss_arm_model.kinematics import tip_pose
from fss_arm_motion.kinds import KINDS
from fss_arm_motion.limits import Limits, LimitSettings
from fss_arm_motion.plan import PlanError, Start, finished, predicted
from fss_arm_motion.point_to_point import PointToPoint, point_to_point
from fss_arm_motion.reorientation import Reorientation
from fss_arm_motion.tip_path import TipPath, tip_path, tips
from fss_arm_motion.zero_reaction import ZeroReaction

BENT = np.radians([-50.0, 55.0, 45.0, 40.0])
ASKED = {
    "point_to_point": {"goal": (0.8, -0.9, 0.4, 1.0)},
    "zero_reaction": {"direction": (1.0, 0.0, 0.0, 0.0)},
    "reorientation": {"angle": np.radians(30.0)},
    "tip_path": {"by": (-0.43, -0.25)},
    "best_posture": {"direction": 0.8, "place": (0.9, 0.3)},
}


def rigid_start(**fields):
    """Rotors left out, as MuJoCo's model has none."""
    arm = paper_arm()
    limits = Limits.of(arm, LimitSettings(rotor_inertia=0.0))
    return Start(arm, BENT, limits=limits, **fields)


def base_along(start, times, q, qd, marks, states):
    """Poses of the base at some times of a path of cubics."""
    law, edges = sampled([times] * 4, list(q.T), list(qd.T))
    return base_poses(start.arm.vector(), path(law, edges, marks), states), law


@pytest.fixture(scope="module")
def plans():
    start = rigid_start()
    return start, {
        name: kind.plan(start, kind.settings(**ASKED[name])) for name, kind in KINDS.items()
    }


@pytest.mark.parametrize("name", KINDS)
def test_limits_hold_between_the_knots_and_a_path_fits_what_links_keep(plans, name):
    start, plan = plans[0], plans[1][name]
    used, gap, outside = held(start, plan)
    assert used <= 1.0 + 1e-4
    assert used > 0.95  # it is as fast as it can
    assert gap >= start.limits.margin - 1e-3
    assert not outside
    assert_allclose(plan.qd[[0, -1]], 0.0)
    assert_allclose(plan.q[0], BENT, atol=1e-12)
    assert np.diff(plan.times).min() > 0.12
    assert len(plan.times) <= 33 or len(plan.times) / plan.duration <= 8.0


@pytest.mark.parametrize("name", KINDS)
def test_mujoco_in_open_loop_follows_and_its_base_does_as_predicted(plans, name):
    """The torques alone drive it: no momentum arises, and the base goes where it is said to go."""
    start, made = plans
    plan = made[name]
    times, states, momenta = open_loop(start, plan)
    assert np.abs(momenta).max() < 1e-9
    marks = np.append(0.0, times[99::100])
    poses, law = base_along(start, plan.times, plan.q, plan.qd, marks, np.zeros(8))
    assert_allclose(states[99::100, 3:], law(marks[1:])[0], atol=4e-3)
    assert_allclose(states[99::100, :3], poses[1:], atol=4e-3)
    said = plan.prediction
    assert_allclose(said.pose[-1], states[-1, :3], atol=4e-3)


def test_the_largest_turn_of_the_base_is_that_of_the_whole_path(plans):
    """Not of samples, between which the base may turn back."""
    start, made = plans
    for plan in made.values():
        marks = np.linspace(0.0, plan.duration, 2001)
        poses, _ = base_along(start, plan.times, plan.q, plan.qd, marks, np.zeros(8))
        largest = np.abs(poses[:, 2] - poses[0, 2]).max()
        assert largest - 1e-9 < plan.prediction.excursion < largest + 1e-5  # [rad]


def test_zero_reaction_leaves_the_heading_that_a_straight_move_turns(plans):
    start, made = plans
    plan = made["zero_reaction"]
    assert plan.ended.startswith("joint ")
    assert np.degrees(plan.prediction.excursion) < 0.1
    x = np.linspace(0.0, 1.0, 60)[:, None]
    q = plan.q[0] + x * (plan.q[-1] - plan.q[0])
    rates = np.tile(q[-1] - q[0], (60, 1))
    straight, _ = base_along(start, x[:, 0], q, rates, x[:, 0], np.zeros(8))
    assert np.degrees(np.abs(straight[:, 2]).max()) > 2.0


def test_zero_reaction_reaches_a_goal_by_a_way_around():
    start = rigid_start()
    goal = BENT + np.radians([10.0, -30.0, 20.0, 20.0])
    kind = KINDS["zero_reaction"]
    plan = kind.plan(start, ZeroReaction(goal=tuple(goal)))
    assert_allclose(plan.q[-1], goal, atol=1e-12)
    assert np.degrees(plan.prediction.excursion) < 0.1
    assert np.degrees(plan.notes["fastest_turn"]) > 1.0


@pytest.mark.parametrize("angle", [-30.0, 60.0])
def test_reorientation_turns_the_base_and_brings_the_arm_back(angle):
    start = rigid_start()
    plan = KINDS["reorientation"].plan(start, Reorientation(np.radians(angle)))
    assert_allclose(plan.q[-1], BENT, atol=1e-12)
    assert np.degrees(plan.prediction.turn) == pytest.approx(angle, abs=0.05)


@pytest.mark.parametrize("momentum", [(0.0, 0.0, 0.0), (0.3, -0.2, 0.05)])
def test_the_end_effector_goes_half_a_metre_along_a_line_in_the_world(momentum):
    start = rigid_start(pose=np.array([0.2, -0.1, 0.4]), momentum=np.array(momentum))
    begin = tip_pose(start.arm.vector(), np.concatenate([start.pose, BENT]))[:2]
    by = 0.5 * np.array([np.cos(0.4 + 3.7), np.sin(0.4 + 3.7)])
    plan = tip_path(start, TipPath(by=tuple(by)))
    places = tips(start, plan, "world")[:, :2]
    along = (places - begin) @ by / 0.5
    across = np.abs((places - begin) @ [-by[1], by[0]]) / 0.5
    share = plan.prediction.times / plan.duration
    assert across[(share > 0.3) & (share < 0.8)].max() < 2e-4  # a fifth of a millimetre
    assert across.max() < (2e-4 if not any(momentum) else 5e-3)
    assert along[-1] == pytest.approx(0.5, abs=2e-4 if not any(momentum) else 5e-3)


def test_a_way_that_ends_early_names_its_joint_and_the_part_of_it_is_had_for_asking():
    start = rigid_start()
    with pytest.raises(
        PlanError,
        match=r"joint \d reaches its limit, -90 deg to 90 deg: "
        r"ends after 0\.\d+ m of 0\.\d+ m; --partial accepts",
    ):
        tip_path(start, TipPath(by=(-0.35, 0.35)))
    plan = tip_path(start, TipPath(by=(-0.35, 0.35), partial=True))
    assert 0.05 < plan.notes["length"] < 0.4
    assert plan.ended.startswith("joint ")


def test_in_the_bases_frame_the_base_may_do_what_it_will():
    start = rigid_start(momentum=np.array([0.2, 0.1, 0.1]))
    plan = tip_path(start, TipPath(by=(-0.35, 0.35), frame="base"))
    assert plan.notes["error"] < 2e-4
    assert abs(plan.prediction.turn) > 0.1


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        (PointToPoint((0.5, 0.5, 0.5, 1.7)), "joint 4 at 97.4 deg"),
        (
            PointToPoint((0.5, 0.5, 0.5)),
            "goal has 3 angles, expected 4, as the arm '.*' has 4 joints",
        ),
        (PointToPoint((0.5, 0.5, 0.5, 0.5), 0.3), "expected 2.* s or more: .* of joint"),
        (PointToPoint(tuple(BENT)), "where the arm is"),
    ],
)
def test_what_cannot_be_had_is_said_with_joint_value_and_limit(asked, words):
    with pytest.raises(PlanError, match=words):
        point_to_point(rigid_start(), asked)


def test_bodies_that_come_too_near_and_joints_beyond_a_limit_are_named():
    start = rigid_start()
    folded = np.radians([-85.0, -85.0, -85.0, -85.0])
    knots = np.array([BENT, folded])
    words = r"(base|link \d) and link 4 come within -?0\.\d+ m of each other, joints at \["
    with pytest.raises(PlanError, match=r"q: joint 2 at 114.6 deg"):
        Start(paper_arm(), np.array([0.0, 2.0, 0.0, 0.0]))
    with pytest.raises(PlanError, match=words):
        finished(start, "point_to_point", {}, np.array([0.0, 30.0]), knots, 0.0 * knots)


def test_a_longer_time_turns_the_base_less():
    start, goal = rigid_start(), (0.1, 0.2, 0.9, 0.2)
    asked = [PointToPoint(goal, d, least_rotation=True) for d in (12.0, 3.0)]
    turns = [
        point_to_point(start, each).prediction.excursion for each in (*asked, PointToPoint(goal))
    ]
    assert turns[0] < turns[1] < turns[2]


@pytest.mark.parametrize("n", [2, 6])
def test_arms_of_other_sizes_are_planned_for(n):
    rng = np.random.default_rng(n)
    arm = random_arm(n, rng)
    limits = Limits.of(arm, LimitSettings(base_radius=0.0, link_radius=0.0, margin=0.0))
    start = Start(arm, rng.uniform(-0.3, 0.3, n), limits=limits)
    plan = point_to_point(start, PointToPoint(tuple(rng.uniform(-1.0, 1.0, n))))
    assert held(start, plan)[0] <= 1.0 + 1e-4
    assert plan.duration < 2.0 * plan.notes["least_possible"]


def test_momentum_is_planned_with():
    """The base drifts and turns meanwhile; limits hold with the torques that this asks for."""
    start = rigid_start(momentum=np.array([0.2, -0.1, 0.3]))
    plan = point_to_point(start, PointToPoint((0.8, -0.9, 0.4, 1.0)))
    assert held(start, plan)[0] <= 1.0 + 1e-4
    still = point_to_point(rigid_start(), PointToPoint((0.8, -0.9, 0.4, 1.0)))
    assert plan.prediction.turn - still.prediction.turn > 0.1


def test_the_deviation_is_that_of_arms_drawn_from_the_covariance():
    start, rng = rigid_start(), np.random.default_rng(0)
    p = start.arm.vector()
    sigma = np.where(np.isin(np.arange(len(p)), [0, 1, 16, 17, 22, 23, 28]), 0.01 * np.abs(p), 0.0)
    state = np.diag([1e-3, 1e-3, 2e-3, 0.01, 0.01, 0.005]) ** 2
    start = replace(start, covariance=np.diag(sigma**2), state_covariance=state)
    plan = point_to_point(start, PointToPoint((0.8, -0.9, 0.4, 1.0)))
    said = predicted(start, plan.times, plan.q, plan.qd)
    law, edges = sampled([plan.times] * 4, list(plan.q.T), list(plan.qd.T))
    way = path(law, edges, plan.times[[0, -1]])
    states = np.zeros((4000, 8))
    states[:, :6] = rng.standard_normal((4000, 6)) * np.sqrt(np.diag(state))
    ends = base_poses(p + sigma * rng.standard_normal((4000, len(p))), way, states)[:, -1]
    assert_allclose(said.deviation[-1], ends.std(axis=0), rtol=0.06)


def test_the_gap_is_the_models_clearance():
    start, rng = rigid_start(), np.random.default_rng(0)
    q = rng.uniform(-np.pi / 2, np.pi / 2, (500, 4))
    state = np.concatenate([np.zeros((500, 3)), q], axis=1)
    assert_allclose(start.gap(q), clearance(start.arm.vector(), state, *start.limits.radii))


# Bodies may pass through each other, and rotors are left out: the oracle knows neither.
# --- the fastest motion, against a direct transcription that shares nothing -----------------------

SETTINGS = LimitSettings(share=1.0, rotor_inertia=0.0, base_radius=0.0, link_radius=0.0, margin=0.0)
#: Seconds that `bench/direct_transcription.py` finds with 40 nodes, by seed.
LEAST_TIMES = {0: 2.3520, 2: 2.1275, 4: 1.3724, 7: 2.5030}


@pytest.mark.parametrize(("seed", "least_time"), LEAST_TIMES.items())
def test_it_is_within_two_percent_of_the_transcriptions(seed, least_time):
    arm = paper_arm()
    begin, end = np.random.default_rng(seed).uniform(-1.3, 1.3, (2, 4))
    start = Start(arm, begin, limits=Limits.of(arm, SETTINGS))
    plan = point_to_point(start, PointToPoint(tuple(end)))
    assert least_time > 0.99 * plan.notes["least_possible"]
    assert plan.duration == pytest.approx(least_time, rel=0.02)


@pytest.mark.parametrize("way", [0.02, 0.3])
def test_a_short_way_takes_what_its_acceleration_takes(way):
    start = Start(paper_arm(), np.zeros(4), limits=Limits.of(paper_arm(), SETTINGS))
    plan = point_to_point(start, PointToPoint((0.0, 0.0, 0.0, way)))
    assert plan.duration < max(0.27, 1.1 * 2.0 * np.sqrt(way / 2.0))
