"""Activities of the base, on an ideal base that follows its reference exactly."""

from dataclasses import replace

import numpy as np
import pytest

from fss_arm_model.description import paper_arm
from fss_arm_model.kinematics import tip_pose
from fss_arm_model.units import SECOND
from fss_gnc import messages
from fss_gnc.guidance.activity import ActivityError, Craft, Observation
from fss_gnc.guidance.base_motion import follow, go_to, hold
from fss_gnc.guidance.limits import limit_use
from fss_gnc.reference import Body, Path

CRAFT = Craft(paper_arm())
FOLDED = np.array([1.5, -1.5, -1.5, 1.5])
PERIOD = 0.1


def observed(t=0.0, pose=(0.0, 0.0, 0.0), twist=(0.0, 0.0, 0.0), target=None, **known):
    base = Body(np.array(pose, dtype=float), np.array(twist, dtype=float))
    body = None if target is None else Body(np.array(target[0]), np.array(target[1]))
    return Observation(t, base, body, FOLDED, np.zeros(4), **known)


def fly(activity, until=lambda t: None, start=None, target_at=lambda t: None):
    """Step an activity to its end; return its phases, last commands and last observation."""
    now, phases = start or observed(), []
    while now.t < 300.0:
        until(now.t)
        commands = activity.step(replace(now, target=target_at(now.t)))
        if commands.phase not in phases:
            phases.append(commands.phase)
        if commands.outcome:
            break
        reference = commands.path.at(now.t + PERIOD)
        now = replace(now, t=now.t + PERIOD, base=Body(reference.pose, reference.twist))
    return phases, commands, now


def test_follow_must_end_at_rest():
    poses = [0.0, 0.0, 0.0, 0.3, 0.0, 0.0]
    with pytest.raises(
        ActivityError, match=r"the last twist is \[0\.03, 0\.0, 0\.0\] m/s, rad/s, "
    ):
        follow(CRAFT, observed(), [0.0, 30.0], poses, [0.0, 0.0, 0.0, 0.03, 0.0, 0.0])


def test_message_of_a_path_that_ends_in_motion_does_not_command_a_stop():
    path = Path(
        np.array([0.0, 1.0]), np.array([[[0.0] * 3] * 3, [[0.1, 0, 0], [0.2, 0, 0], [0] * 3]])
    )
    for t in (0.0, 0.6, 0.95):
        seen = messages.path(messages.trajectory(path, t, SECOND, 2.0, 0.25))
        times = np.linspace(0.0, 0.999 - t, 50)
        np.testing.assert_allclose(seen.states(times), path.states(t + times), atol=1e-4)
    assert len(messages.trajectory(path, 3.0, SECOND, 2.0, 0.25).points) == 1


@pytest.mark.parametrize("more", [0.0, 1e-12, 1e-9, 1.2e-9, 1e-6, 2e-6, 2.1e-6, 0.1])
def test_points_of_a_message_have_increasing_times(more):
    end = 0.5 + more
    path = Path(np.array([0.0, end]), np.zeros((2, 3, 3)))
    times = messages.path(messages.trajectory(path, 0.0, SECOND, 2.0, 0.25)).times
    assert times[-1] == pytest.approx(end, abs=2e-6)
    assert np.diff(times).max() < 0.2501


def test_go_to_stays_within_the_limits_and_holds():
    motion = go_to(CRAFT, observed(), [0.8, -0.5, 3.0], 0.0, 5.0)
    assert 0.98 < limit_use(CRAFT.settings, motion.path).share <= 1.0
    phases, commands, last = fly(motion)
    assert phases == ["go_to", "hold"]
    assert commands.outcome.success
    assert not commands.outcome.message
    np.testing.assert_allclose(last.base.pose, [0.8, -0.5, 3.0], atol=1e-6)
    assert last.t == pytest.approx(motion.path.end_time + 5.0, abs=2 * PERIOD)


def test_go_to_starts_from_a_moving_base_and_takes_the_shorter_turn():
    start = observed(pose=(0.0, 0.0, 3.0), twist=(0.0, 0.03, 0.02))
    motion = go_to(CRAFT, start, [0.5, 0.0, -3.0], 0.0, 0.0)
    np.testing.assert_allclose(motion.path.at(0.0).twist, [0.0, 0.03, 0.02])
    assert motion.path.knots[-1, 0, 2] == pytest.approx(2 * np.pi - 3.0)


def test_given_duration_is_kept_or_rejected():
    assert go_to(CRAFT, observed(), [0.5, 0.0, 0.0], 90.0, 0.0).path.end_time == 90.0
    with pytest.raises(ActivityError, match=r"duration is 3 s, expected at least \d+\.\d s"):
        go_to(CRAFT, observed(), [0.5, 0.0, 0.0], 3.0, 0.0)


def test_path_through_the_keep_out_zone_is_rejected_unless_the_target_is_held_or_leaves():
    state, goal = observed(pose=(-1.5, 0.0, 0.0)), [0.8, 0.0, 0.0]
    go_to(CRAFT, state, goal, 0.0, 0.0)
    for target in (([0.0, 0.1, 0.0], [0.0, 0.0, 0.1]), ([0.0, -0.8, 0.0], [0.0, 0.05, 0.0])):
        body = Body(*map(np.array, target))
        with pytest.raises(ActivityError, match="from the keep-out zone"):
            go_to(CRAFT, replace(state, target=body), goal, 0.0, 0.0)
    go_to(CRAFT, gripping(state), [0.5, 0.0, 0.0], 0.0, 0.0)
    leaves = Body(np.array([0.0, 0.6, 0.0]), np.array([0.0, 0.1, 0.0]))
    go_to(CRAFT, replace(state, target=leaves), goal, 0.0, 0.0)


def gripping(state):
    """Add a held target, 0.2 m from the tip."""
    tip = tip_pose(CRAFT.arm.vector(), state.floating_state[0])
    ahead = 0.2 * np.array([np.cos(tip[2]), np.sin(tip[2]), 0.0])
    return replace(state, target=Body(tip + ahead, np.zeros(3)), holds=True)


def test_held_target_is_not_carried_beyond_the_edge():
    state = observed(pose=(0.5, 0.0, 0.0))
    x = float(gripping(state).target.pose[0])
    assert x > 1.2  # it is ahead of all else
    goal = [0.5 + 1.9 - x, 0.0, 0.0]  # 0.1 m from the edge to its centre, of 0.19 m in radius
    go_to(CRAFT, state, goal, 0.0, 0.0)
    with pytest.raises(ActivityError, match=r"the held target would be -0\.09.* m from the"):
        go_to(CRAFT, gripping(state), goal, 0.0, 0.0)


def test_base_too_near_the_edge_may_only_move_away():
    state = observed(pose=(-1.79, 0.0, 0.0))
    go_to(CRAFT, state, [-1.0, 0.0, 0.0], 0.0, 0.0)
    with pytest.raises(ActivityError, match="the table's edge"):
        go_to(CRAFT, state, [-1.85, 0.0, 0.0], 0.0, 0.0)


@pytest.mark.parametrize(("error", "arrives"), [(-1e-3, True), (1e-3, True), (0.05, False)])
def test_a_path_that_just_fits_is_followed_despite_small_errors_of_joints(error, arrives):
    lowest, highest = 0.0, 2.0
    for _ in range(40):
        y = 0.5 * (lowest + highest)
        try:
            motion, lowest = go_to(CRAFT, observed(), [0.3, y, 0.0], 0.0, 1.0), y
        except ActivityError:
            highest = y
    _, commands, _ = fly(motion, start=replace(observed(), q=FOLDED + error))
    assert commands.outcome.success == arrives
    assert arrives or "the table's edge" in commands.outcome.message


def test_base_brakes_before_a_target_on_its_path():
    start, body = observed(pose=(-1.5, 0.0, 0.0)), Body(np.array([0.4, 0.0, 0.0]), np.zeros(3))
    motion = go_to(CRAFT, start, [0.8, 0.0, 0.0], 0.0, 0.0)
    _, commands, now = fly(motion, start=start, target_at=lambda t: body if t > 8.0 else None)
    assert not commands.outcome.success
    assert "from the keep-out zone" in commands.outcome.message
    np.testing.assert_allclose(now.base.twist, 0.0, atol=1e-9)
    assert now.base.pose[0] < -0.4


def test_cancel_brakes_a_motion_and_ends_a_hold():
    motion = go_to(CRAFT, observed(), [0.8, 0.0, 0.0], 0.0, 60.0)
    phases, commands, last = fly(motion, lambda t: t > 8.0 and motion.cancel("canceled"))
    assert phases == ["go_to", "brake"]
    assert commands.outcome == (False, "canceled")
    assert last.t > 9.0
    np.testing.assert_allclose(last.base.twist, 0.0, atol=1e-9)

    motion = hold(CRAFT, observed(), [0.0, 0.0, 0.05], 0.0)
    assert motion.step(observed(1e5)).outcome is None  # endless
    motion.cancel("canceled")
    assert motion.step(observed(1e5 + 1)).outcome == (True, "")


@pytest.mark.parametrize("arrived", [False, True])
def test_an_interruption_brakes_and_fails_a_motion_and_a_hold(arrived):
    motion = go_to(CRAFT, observed(), [0.8, 0.0, 0.0], 0.0, 60.0)
    when = motion.path.end_time + 5.0 if arrived else 8.0
    phases, commands, last = fly(motion, lambda t: t > when and motion.interrupt("stalled"))
    assert phases == ["go_to", *["hold"] * arrived, "brake"]
    assert commands.outcome == (False, "stalled")
    np.testing.assert_allclose(last.base.twist, 0.0, atol=1e-9)


def test_an_interruption_brakes_a_base_that_has_left_its_reference():
    motion = go_to(CRAFT, observed(), [0.8, 0.0, 0.0], 0.0, 60.0)
    motion.step(observed())
    motion.interrupt("stalled")
    commands = motion.step(observed(8.0, pose=(-0.5, 0.0, 0.0), twist=(0.02, 0.0, 0.0)))
    assert (commands.phase, commands.outcome) == ("brake", None)
    np.testing.assert_allclose(commands.path.at(8.0).pose, [-0.5, 0.0, 0.0])


def test_hold_stops_and_holds_a_moving_base():
    moving = observed(twist=(0.02, 0.0, 0.02))
    motion = hold(CRAFT, moving, [], 10.0)
    assert limit_use(CRAFT.settings, motion.path).share <= 1.0
    _, commands, now = fly(motion, start=moving)
    assert commands.outcome.success
    np.testing.assert_allclose(now.base.pose, motion.path.knots[-1, 0])
    assert motion.largest_offset.max() < 1e-9


@pytest.mark.parametrize(
    ("armed", "cause"),
    [
        (None, ""),
        (True, ""),
        (False, "; its board is disarmed: scripts/fss_arm.sh valves"),
    ],
)
def test_base_far_from_its_reference_aborts_the_hold(armed, cause):
    motion = hold(CRAFT, observed(), [0.0, 0.0, 0.0], 0.0)
    outcome = motion.step(observed(2.0, pose=(0.0, 0.2, 0.1), armed=armed)).outcome
    reason = "the base is 0.200 m and 5.7 deg off its reference"
    assert outcome == (False, f"{reason}, expected at most 0.15 m and 20 deg{cause}")


def test_goal_not_reached_in_time_is_aborted():
    motion = go_to(CRAFT, observed(), [0.5, 0.0, 0.0], 0.0, 0.0)
    near = observed(motion.path.end_time + CRAFT.settings.max_overrun + 0.1, pose=(0.45, 0.0, 0.0))
    assert motion.step(near).outcome == (
        False,
        "the base is 0.050 m and 0.0 deg off its goal, or not at rest, 30 s after the planned time",
    )


TIME_FRACTIONS = np.linspace(0.0, 1.0, 25)
CIRCLE = 2 * np.pi * TIME_FRACTIONS**2 * (3.0 - 2.0 * TIME_FRACTIONS)
CIRCLE_POSES = np.stack([0.3 - 0.3 * np.cos(CIRCLE), 0.3 * np.sin(CIRCLE), CIRCLE], axis=1)


def test_follow_takes_the_shorter_turns():
    wrapped = CIRCLE_POSES.copy()
    wrapped[:, 2] = (wrapped[:, 2] + np.pi) % (2 * np.pi) - np.pi
    motion = follow(CRAFT, observed(), np.linspace(0.0, 120.0, 25), wrapped.ravel(), [])
    phases, commands, last = fly(motion)
    assert phases == ["follow", "hold"]
    assert commands.outcome.success
    np.testing.assert_allclose(last.base.pose, CIRCLE_POSES[-1], atol=1e-6)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"times": np.linspace(0.0, 30.0, 25)}, "the path's .* expected at most"),
        ({"poses": (CIRCLE_POSES + 0.5).ravel()}, "the first pose is 0.707 m and 28.6 deg"),
        ({"poses": (3.15 * CIRCLE_POSES * [1, 1, 0]).ravel(), "times": np.linspace(0.0, 900.0, 25)},
         "the table's edge"),
    ],
)  # fmt: skip
def test_infeasible_path_is_rejected(changes, message):
    goal = {
        "times": np.linspace(0.0, 120.0, 25),
        "poses": CIRCLE_POSES.ravel(),
        "twists": [],
    } | changes
    with pytest.raises(ActivityError, match=message):
        follow(CRAFT, observed(), **goal)


def test_long_path_that_leaves_the_table_briefly_is_rejected():
    times, rest = [0.0, 2000.0, 2032.0, 2064.0, 4000.0], np.zeros(15)
    within, outside = (np.outer([0.7, 0.7, x, 0.7, 0.7], [1.0, 0.0, 0.0]) for x in (0.8, 1.2))
    follow(CRAFT, observed(pose=within[0]), times, within.ravel(), rest)
    with pytest.raises(ActivityError, match=r"gripper would be -0\.\d* m from the table's edge"):
        follow(CRAFT, observed(pose=outside[0]), times, outside.ravel(), rest)


def test_long_path_that_is_too_fast_briefly_is_rejected():
    poses = np.outer([0.0, 0.0, 0.2, 0.2], [1.0, 0.0, 0.0])
    with pytest.raises(ActivityError, match=r"the path's acceleration after 2010\.\d s is"):
        follow(CRAFT, observed(), [0.0, 2010.0, 2010.5, 4000.0], poses.ravel(), np.zeros(12))


@pytest.mark.parametrize("unknown", [{"q": None}, {"base": None}])
def test_unknown_base_or_joints_reject_or_end_an_activity(unknown):
    motion = hold(CRAFT, observed(), [], 0.0)
    for call in (motion.step, lambda s: go_to(CRAFT, s, [0.1, 0.0, 0.0], 0.0, 0.0)):
        with pytest.raises(ActivityError, match="not known"):
            call(replace(observed(), **unknown))


def test_joints_that_become_unknown_are_assumed_at_rest_for_a_while():
    motion = hold(CRAFT, observed(), [], 0.0)
    unknown = replace(observed(1.0), q=None, qd=None, last_q=FOLDED, joints_age=2.9)
    commands = motion.step(unknown)
    assert commands.path is not None
    assert (commands.outcome, commands.reason) == (None, "joints are unknown and assumed at rest")
    assert motion.tolerates(unknown)
    for age in (3.1, -3.1):
        assert not motion.tolerates(replace(unknown, joints_age=age))
    assert not motion.tolerates(replace(unknown, base=None))
    assert not motion.step(observed(2.0)).reason
