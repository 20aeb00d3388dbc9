"""The base's activities on an ideal base, which is where the reference was at the last step."""

from dataclasses import replace

import numpy as np
import pytest

from fss_arm_model.description import paper_arm
from fss_arm_model.kinematics import tip_pose
from fss_gnc.guidance.activity import ActivityError, Craft, Seen
from fss_gnc.guidance.base_motion import braking, follow, go_to, hold, peak
from fss_gnc.guidance.settings import GuidanceSettings
from fss_gnc.reference import Body

CRAFT = Craft(paper_arm())
FOLDED = np.array([1.5, -1.5, -1.5, 1.5])
PERIOD = 0.1
TO_THE_SIDE = np.array([0.12, 0.0, 0.0])


def seen(t=0.0, pose=(0.0, 0.0, 0.0), twist=(0.0, 0.0, 0.0), target=None, **known):
    base = Body(np.array(pose, dtype=float), np.array(twist, dtype=float))
    body = None if target is None else Body(np.array(target[0]), np.array(target[1]))
    return Seen(t, base, body, FOLDED, np.zeros(4), **known)


def flown(activity, until=lambda t: None, target=None, most=300.0):
    """Step it; its phases, the last orders and the base then."""
    now, phases, path = seen(target=target), [], activity.path
    while now.t < most:
        until(now.t)
        orders = activity.step(now)
        if orders.phase not in phases:
            phases.append(orders.phase)
        if orders.ended:
            return phases, orders, now
        path = orders.path
        there = path.at(now.t + PERIOD)
        now = replace(now, t=now.t + PERIOD, base=Body(there.pose, there.twist))
    return phases, orders, now


def test_it_goes_there_within_the_limits_and_holds():
    motion = go_to(CRAFT, seen(), [0.8, -0.5, 3.0], 0.0, 5.0)
    assert 0.98 < peak(CRAFT.settings, motion.path).share <= 1.0
    phases, orders, end = flown(motion)
    assert phases == ["go_to", "hold"]
    assert orders.ended.well
    assert not orders.ended.message
    np.testing.assert_allclose(end.base.pose, [0.8, -0.5, 3.0], atol=1e-6)
    assert end.t == pytest.approx(motion.path.end + 5.0, abs=2 * PERIOD)


def test_a_heading_is_taken_the_shorter_way():
    motion = go_to(CRAFT, seen(pose=(0.0, 0.0, 3.0)), [0.0, 0.0, -3.0], 0.0, 0.0)
    assert motion.path.knots[-1, 0, 2] == pytest.approx(2 * np.pi - 3.0)


def test_a_base_that_moves_is_taken_up_where_it_is():
    motion = go_to(CRAFT, seen(twist=(0.0, 0.03, 0.02)), [0.5, 0.0, 0.0], 0.0, 0.0)
    np.testing.assert_allclose(motion.path.at(0.0).twist, [0.0, 0.03, 0.02])
    assert flown(motion)[1].ended.well


def test_a_given_duration_is_kept_or_refused():
    assert go_to(CRAFT, seen(), [0.5, 0.0, 0.0], 90.0, 0.0).path.end == 90.0
    with pytest.raises(ActivityError, match=r"duration is 3 s, expected at least \d+\.\d s"):
        go_to(CRAFT, seen(), [0.5, 0.0, 0.0], 3.0, 0.0)
    with pytest.raises(ActivityError, match="duration is inf s, expected 0 to 86400 s"):
        go_to(CRAFT, seen(), [0.5, 0.0, 0.0], np.inf, 0.0)


@pytest.mark.parametrize(
    ("pose", "words"),
    [
        ((1.9, 0.0, 0.0), "would be -?0.* m from the table's edge in .* s, expected at least 0.05"),
        ((1e300, 0.0, 0.0), r"pose\[0\] is 1e.300 m, expected -2 to 2 m"),
        ((0.0, -2.01, 0.0), r"pose\[1\] is -2.01 m, expected -2 to 2 m"),
        ((np.nan, 0.0, 0.0), r"pose\[0\] is nan m, expected -2 to 2 m"),
        ((0.0, 0.0, 1e18), r"pose\[2\] is 1e.18 rad, expected -1000 to 1000 rad"),
        ((0.0, 0.0), "pose has 2 numbers, expected 3"),
    ],
)
def test_a_goal_beyond_the_edge_or_that_is_none_is_refused(pose, words):
    with pytest.raises(ActivityError, match=words):
        go_to(CRAFT, seen(), pose, 0.0, 0.0)


def test_a_way_through_the_keep_out_zone_is_refused_unless_the_target_is_held_or_has_left():
    here, goal = seen(pose=(-1.5, 0.0, 0.0)), [0.8, 0.0, 0.0]
    go_to(CRAFT, here, goal, 0.0, 0.0)
    for target in (([0.0, 0.1, 0.0], [0.0, 0.0, 0.1]), ([0.0, -0.8, 0.0], [0.0, 0.05, 0.0])):
        body = Body(*map(np.array, target))
        with pytest.raises(ActivityError, match="from the keep-out zone"):
            go_to(CRAFT, replace(here, target=body), goal, 0.0, 0.0)
    go_to(CRAFT, gripping(here), [0.5, 0.0, 0.0], 0.0, 0.0)
    leaves = Body(np.array([0.0, 0.6, 0.0]), np.array([0.0, 0.1, 0.0]))
    go_to(CRAFT, replace(here, target=leaves), goal, 0.0, 0.0)


def gripping(known):
    """The same, with the target in the gripper, 0.2 m from it."""
    tip = tip_pose(CRAFT.arm.vector(), known.floating[0])
    ahead = 0.2 * np.array([np.cos(tip[2]), np.sin(tip[2]), 0.0])
    return replace(known, target=Body(tip + ahead, np.zeros(3)), holds=True)


def test_what_is_held_is_not_carried_beyond_the_edge():
    here = seen(pose=(0.5, 0.0, 0.0))
    x = float(gripping(here).target.pose[0])
    assert x > 1.2  # it is ahead of all else
    goal = [0.5 + 1.9 - x, 0.0, 0.0]  # 0.1 m from the edge to its centre, of 0.19 m in radius
    go_to(CRAFT, here, goal, 0.0, 0.0)
    with pytest.raises(ActivityError, match=r"the held target would be -0\.09.* m from the"):
        go_to(CRAFT, gripping(here), goal, 0.0, 0.0)


@pytest.mark.parametrize(
    ("here", "target", "words"),
    [
        (seen(pose=(-1.72, 0.0, 0.0)), None, "base would be -0.0.* m from the table's edge"),
        (seen(pose=(-0.6, 0.0, 0.0)), (np.array([-1.15, 0.0, 0.0]), np.zeros(3)), "keep-out zone"),
    ],
)
def test_a_pose_to_hold_without_room_is_refused(here, target, words):
    with pytest.raises(ActivityError, match=words):
        hold(CRAFT, replace(here, target=target and Body(*target)),
             here.base.pose - TO_THE_SIDE, 0.0)  # fmt: skip
    hold(CRAFT, here, here.base.pose + TO_THE_SIDE, 0.0)


def test_what_is_too_near_to_the_edge_already_may_go_away_from_it_only():
    here = seen(pose=(-1.79, 0.0, 0.0))
    go_to(CRAFT, here, [-1.0, 0.0, 0.0], 0.0, 0.0)
    with pytest.raises(ActivityError, match="the table's edge"):
        go_to(CRAFT, here, [-1.85, 0.0, 0.0], 0.0, 0.0)


def test_it_brakes_before_a_target_that_comes_in_its_way():
    motion = go_to(CRAFT, seen(pose=(-1.5, 0.0, 0.0)), [0.8, 0.0, 0.0], 0.0, 0.0)
    orders, now = None, seen(pose=(-1.5, 0.0, 0.0))
    while not (orders and orders.ended):
        target = Body(np.array([0.4, 0.0, 0.0]), np.zeros(3)) if now.t > 8.0 else None
        orders = motion.step(replace(now, target=target))
        there = orders.path.at(now.t + PERIOD)
        now = replace(now, t=now.t + PERIOD, base=Body(there.pose, there.twist))
    assert not orders.ended.well
    assert "from the keep-out zone" in orders.ended.message
    np.testing.assert_allclose(now.base.twist, 0.0, atol=1e-9)
    assert now.base.pose[0] < -0.4


def test_cancelled_on_the_way_it_brakes_first_and_while_it_holds_it_ends_at_once():
    motion = go_to(CRAFT, seen(), [0.8, 0.0, 0.0], 0.0, 60.0)
    phases, orders, end = flown(motion, lambda t: t > 8.0 and motion.cancel("cancelled"))
    assert phases == ["go_to", "brake"]
    assert orders.ended == (False, "cancelled")
    assert end.t > 9.0
    np.testing.assert_allclose(end.base.twist, 0.0, atol=1e-9)

    motion = go_to(CRAFT, seen(), [0.1, 0.0, 0.0], 0.0, 60.0)
    late = motion.path.end + 5.0
    phases, orders, end = flown(motion, lambda t: t > late and motion.cancel("cancelled"))
    assert orders.ended == (True, "")
    assert end.t == pytest.approx(late, abs=2 * PERIOD)


def test_hold_stops_the_base_where_it_can_and_keeps_it_there():
    moving = seen(twist=(0.02, 0.0, 0.02))
    motion = hold(CRAFT, moving, [], 10.0)
    assert peak(CRAFT.settings, motion.path).share <= 1.0
    now, orders = moving, motion.step(moving)
    while not orders.ended:
        there = orders.path.at(now.t + PERIOD)
        now = replace(now, t=now.t + PERIOD, base=Body(there.pose, there.twist))
        orders = motion.step(now)
    assert orders.ended.well
    np.testing.assert_allclose(now.base.pose, motion.path.knots[-1, 0])
    assert motion.largest_offset.max() < 1e-9


def test_a_hold_without_end_ends_well_when_it_is_cancelled():
    motion = hold(CRAFT, seen(), [0.0, 0.0, 0.05], 0.0)
    assert motion.step(seen(1e5)).ended is None
    motion.cancel("cancelled")
    assert motion.step(seen(1e5 + 1)).ended.well


def test_a_pose_to_hold_must_be_near():
    with pytest.raises(
        ActivityError, match=r"pose is 0.500 m and 0.0 deg .* base/go_to goes there"
    ):
        hold(CRAFT, seen(), [0.5, 0.0, 0.0], 0.0)


def test_a_base_far_from_its_reference_is_given_up():
    motion = hold(CRAFT, seen(), [0.0, 0.0, 0.0], 0.0)
    ended = motion.step(seen(2.0, pose=(0.0, 0.2, 0.1))).ended
    assert ended == (
        False, "the base is 0.200 m and 5.7 deg off its reference, expected at most 0.15 m and "
        "20 deg",
    )  # fmt: skip


def test_a_goal_that_is_not_reached_in_time_is_given_up():
    motion = go_to(CRAFT, seen(), [0.5, 0.0, 0.0], 0.0, 0.0)
    near = seen(motion.path.end + CRAFT.settings.max_overrun + 0.1, pose=(0.45, 0.0, 0.0))
    assert motion.step(near).ended == (
        False, "the base is 0.050 m and 0.0 deg off its goal, or not at rest, 30 s after the "
        "planned time",
    )  # fmt: skip


SHARE = np.linspace(0.0, 1.0, 25)
CIRCLE = 2 * np.pi * SHARE**2 * (3.0 - 2.0 * SHARE)
ROUND = np.stack([0.3 - 0.3 * np.cos(CIRCLE), 0.3 * np.sin(CIRCLE), CIRCLE], axis=1)


def test_it_follows_knots_smoothly_headings_the_shorter_way():
    wrapped = ROUND.copy()
    wrapped[:, 2] = (wrapped[:, 2] + np.pi) % (2 * np.pi) - np.pi
    motion = follow(CRAFT, seen(), np.linspace(0.0, 120.0, 25), wrapped.ravel(), [])
    phases, orders, end = flown(motion)
    assert phases == ["follow", "hold"]
    assert orders.ended.well
    np.testing.assert_allclose(end.base.pose, ROUND[-1], atol=1e-6)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"times": np.linspace(0.0, 30.0, 25)}, "the path .* expected at most"),
        ({"times": np.linspace(1.0, 120.0, 25)}, r"time\[0\] is 1 s, expected 0 s"),
        ({"times": np.zeros(25)}, r"time\[1\] is 0 s, expected more than 0.001 s"),
        ({"times": [0.0]}, "time has 1 knots, expected 2"),
        ({"poses": ROUND.ravel()[:-1]}, "pose has 74 numbers, expected 75 for 25 knots"),
        ({"poses": (ROUND + 0.5).ravel()}, "the first pose is 0.707 m and 28.6 deg"),
        ({"twists": [0.0, 0.0]}, "twist has 2 numbers, expected 75, or none"),
        ({"poses": np.full(75, np.nan)}, r"pose\[0\] is nan m"),
        ({"poses": np.eye(75)[50] * 1e18}, r"pose\[50\] is 1e.18 rad, expected -1000 to 1000"),
        ({"twists": np.eye(75)[4] * -2.0}, r"twist\[4\] is -2 m/s, expected -1 to 1 m/s"),
        ({"poses": (3.15 * ROUND * [1, 1, 0]).ravel(), "times": np.linspace(0.0, 900.0, 25)},
         "the table's edge"),
    ],
)  # fmt: skip
def test_what_cannot_be_followed_is_refused_with_the_reason(changed, words):
    given = {"times": np.linspace(0.0, 120.0, 25), "poses": ROUND.ravel(), "twists": []} | changed
    with pytest.raises(ActivityError, match=words):
        follow(CRAFT, seen(), **given)


def test_a_short_way_beyond_the_edge_on_a_long_path_is_refused():
    times, rest = [0.0, 2000.0, 2032.0, 2064.0, 4000.0], np.zeros(15)
    near, beyond = (np.outer([0.7, 0.7, x, 0.7, 0.7], [1.0, 0.0, 0.0]) for x in (0.8, 1.2))
    follow(CRAFT, seen(pose=near[0]), times, near.ravel(), rest)
    with pytest.raises(ActivityError, match=r"gripper would be -0\.\d* m from the table's edge"):
        follow(CRAFT, seen(pose=beyond[0]), times, beyond.ravel(), rest)


def test_a_short_haste_on_a_long_path_is_refused():
    poses = np.outer([0.0, 0.0, 0.2, 0.2], [1.0, 0.0, 0.0])
    with pytest.raises(ActivityError, match=r"the path accelerates with .* after 2010\.\d s"):
        follow(CRAFT, seen(), [0.0, 2010.0, 2010.5, 4000.0], poses.ravel(), np.zeros(12))


@pytest.mark.parametrize("known", [{"q": None}, {"base": None}])
def test_without_base_or_joints_nothing_begins_or_goes_on(known):
    motion = hold(CRAFT, seen(), [], 0.0)
    for what in (motion.step, lambda s: go_to(CRAFT, s, [0.1, 0.0, 0.0], 0.0, 0.0)):
        with pytest.raises(ActivityError, match="not known"):
            what(replace(seen(), **known))


def test_braking_keeps_the_limits_and_ends_at_rest():
    settings = GuidanceSettings()
    base = Body(np.array([0.1, 0.2, 0.3]), np.array([-0.06, 0.0, 0.05]))
    path = braking(settings, base, 7.0)
    assert peak(settings, path).share <= 1.0 + 1e-9
    np.testing.assert_allclose(path.at(7.0).twist, base.twist)
    np.testing.assert_allclose(path.at(path.end - 1e-9).twist, 0.0, atol=1e-9)
