"""Outlines, gaps and predictions of other vehicles, and the right of way."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from traffic import arm_of

from fss_arm_model.extents import Extents
from fss_arm_model.kinematics import joint_positions
from fss_arm_model.units import SECOND
from fss_gnc.guidance.other_vehicles import (
    DIRECTIONS,
    SIDES,
    SIGMAS,
    SILENCE,
    SPEED_DEVIATION,
    Conflict,
    OtherVehicle,
    VehicleTrack,
    announced,
    conflicts,
    facing_announced_plan,
    gives_way,
    outline,
    outline_gap,
    path_conflicts,
)
from fss_gnc.reference import Body, Path, Reference

EXTENTS = Extents()
REST = np.zeros(3)
SQUARE = np.array([0.3 + 0.2j, -0.3 + 0.2j, -0.3 - 0.2j, 0.3 - 0.2j])


def vehicle(pose=None, twist=(0.0, 0.0, 0.0), **known):
    if pose is None:  # at the start of its plan
        pose = known["plan"].knots[0, 0] if known.get("plan") else REST
    body = Body(np.array(pose, dtype=float), np.array(twist, dtype=float))
    known = {"precedes": True, "outline": SQUARE} | known
    return OtherVehicle(name="fss2", body=body, **known)


def straight(start, goal, duration=60.0):
    return Path.between(Reference.at_rest(start), np.array(goal, dtype=float), 0.0, duration)


def boundary(outline, pose, count=400):
    """Points on the sides of an outline at a pose."""
    corners = complex(*pose[:2]) + outline * np.exp(1j * pose[2])
    share = np.linspace(0.0, 1.0, count)
    return np.concatenate(
        [a + share * (b - a) for a, b in zip(corners, np.roll(corners, -1), strict=True)]
    )


def distance(one, other):
    """Distance of two sets of points, by trying all pairs."""
    return min(float(np.abs(other - point).min()) for point in one)


@pytest.mark.parametrize("n", [1, 3, 4, 8])
def test_outline_contains_all_bodies_and_touches_them_on_each_side(n):
    rng = np.random.default_rng(n)
    arm = arm_of(n)
    for q_m in rng.uniform(-1.5, 1.5, (5, n)):
        corners = outline(arm.vector(), q_m, EXTENTS)
        ends = joint_positions(arm.vector(), [0.0, 0.0, 0.0, *q_m]) @ [1.0, 1j]
        links = [a + s * (b - a) for a, b in pairwise(ends) for s in (0.0, 0.4, 1.0)]
        circle = np.exp(2j * np.pi * np.arange(360) / 360)
        bodies = np.concatenate(
            [EXTENTS.base_radius * circle, *(one + EXTENTS.link_radius * circle for one in links)]
        )
        inside = (np.conj(DIRECTIONS)[:, None] * bodies).real.max(axis=1)
        allowed = (np.conj(DIRECTIONS)[:, None] * corners).real.max(axis=1)
        np.testing.assert_allclose(inside, allowed, atol=2e-4)
        assert (np.imag(np.conj(corners) * np.roll(corners, -1)) > 0.0).all()  # counter-clockwise


def test_outline_contains_a_held_target():
    arm = arm_of(4)
    free = outline(arm.vector(), np.zeros(4), EXTENTS)
    held = outline(arm.vector(), np.zeros(4), EXTENTS, np.array([0.6, 0.0, 0.0]), 0.2)
    assert abs(held).max() > abs(free).max() + 0.3


@settings(max_examples=30)
@given(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.floats(-7.0, 7.0), st.floats(-7.0, 7.0))
def test_gap_is_the_distance_of_two_outlines_or_slightly_less(x, y, turn, other_turn):
    own, pose, other_pose = 0.8 * SQUARE, np.array([x, y, turn]), np.array([0.0, 0.0, other_turn])
    (found,) = outline_gap(own, pose[None], SQUARE, other_pose[None])
    exhaustive = distance(boundary(own, pose, 60), boundary(SQUARE, other_pose, 60))
    assert found <= exhaustive + 1e-9
    if found > 0.0:
        assert found >= exhaustive * np.cos(0.25 * np.pi) - 0.01  # of four sides, with corners


def test_gap_between_outlines_of_vehicles_is_their_distance_within_a_hundredth():
    p = arm_of(4).vector()
    one, other = (outline(p, np.array(q), EXTENTS) for q in ([0.0] * 4, [0.8, 0.5, -0.4, 1.0]))
    for pose in np.random.default_rng(1).uniform(-3.0, 3.0, (20, 3)):
        (found,) = outline_gap(one, np.zeros((1, 3)), other, pose[None])
        exhaustive = distance(boundary(one, np.zeros(3), 60), boundary(other, pose, 60))
        if found > 0.0:
            assert exhaustive * np.cos(np.pi / SIDES) - 0.01 <= found <= exhaustive + 1e-9


def test_least_gap_on_the_way_is_that_of_an_exhaustive_search():
    own, path = 0.8 * SQUARE, straight([-1.2, 0.1, 0.0], [1.2, -0.2, 1.0])
    plan = straight([0.9, -1.3, 1.5], [0.9, 1.3, 2.0], 60.0)
    found = path_conflicts(own, path, 0.0, [vehicle(plan=announced(plan, 0.0))], 3.0)
    assert len(found) == 1
    times = np.linspace(0.0, 60.0, 301)
    exhaustive = min(
        distance(boundary(own, path.at(t).pose, 12), boundary(SQUARE, plan.at(t).pose, 12))
        for t in times
    )
    assert found[0].gap == pytest.approx(exhaustive, abs=0.02)


def test_first_conflict_is_the_first_time_within_the_margin():
    path = straight([-1.5, 0.0, 0.0], [1.5, 0.0, 0.0])
    (found,) = path_conflicts(SQUARE, path, 0.0, [vehicle(plan=straight(REST, REST))], 0.1)
    t = np.linspace(0.0, 60.0, 6001)
    close = path.states(t)[:, 0, 0] > -0.7  # two half lengths and the margin
    assert found.ahead == pytest.approx(t[close][0], abs=1.0)


def test_gap_that_is_too_small_already_may_grow_but_not_shrink():
    here, others = np.array([-0.65, 0.0, 0.0]), [vehicle(plan=straight(REST, REST))]
    assert not path_conflicts(SQUARE, straight(here, [-1.5, 0.0, 0.0]), 0.0, others, 0.1)
    assert not path_conflicts(SQUARE, straight(here, here), 0.0, others, 0.1)
    assert path_conflicts(SQUARE, straight(here, [-0.6, 0.0, 0.0]), 0.0, others, 0.1)


def test_motion_of_another_vehicle_counts_after_the_own_arrival():
    path, plan = straight([-0.5, -1.0, 0.0], [0.0, 0.0, 0.0], 40.0), [2.0, 0.0, 0.0]
    late = vehicle(plan=straight(plan, [-2.0, 0.0, 0.0], 100.0))
    (found,) = path_conflicts(SQUARE, path, 0.0, [late], 0.1)
    assert found.ahead > 40.0


def test_drifting_vehicle_keeps_its_twist_and_grows_uncertain():
    drifting = vehicle((1.0, 0.0, 0.0), (-0.02, 0.01, 0.1), deviation=0.004, speed_deviation=0.003)
    (found,) = replace(drifting, age=1.0).predict(np.array([0.0, 9.0]))
    np.testing.assert_allclose(found.poses, [[0.98, 0.01, 0.1], [0.8, 0.1, 1.0]])
    np.testing.assert_allclose(found.deviation, np.hypot(0.004, 0.003 * np.array([1.0, 10.0])))


def test_silent_vehicle_keeps_its_plan_and_its_twist_and_grows_uncertain():
    plan, twist = straight(REST, [1.0, 0.0, 0.0], 40.0), [0.0, 0.02, 0.0]
    speaking = vehicle(plan=plan, twist=twist)
    silent = replace(speaking, age=SILENCE + 1.0)
    ahead = np.array([0.0, 20.0, 40.0])
    assert len(speaking.predict(ahead)) == 1
    planned, drifting = silent.predict(ahead)
    np.testing.assert_allclose(planned.poses, plan.states(ahead)[:, 0], atol=1e-12)
    np.testing.assert_allclose(drifting.poses[:, 1], 0.02 * (3.0 + ahead))
    np.testing.assert_allclose(planned.deviation, SPEED_DEVIATION * (3.0 + ahead))
    away = Path(np.zeros(1), np.array([[[0.5, 1.0, 0.0]]]))
    assert not path_conflicts(SQUARE, away, 0.0, [speaking], 0.1)
    beside = straight([-1.0, 0.7, 0.0], [0.5, 0.7, 0.0], 40.0)
    assert not path_conflicts(SQUARE, beside, 0.0, [speaking], 0.1)
    (found,) = path_conflicts(SQUARE, beside, 0.0, [silent], 0.1)
    assert gives_way(found)
    assert not gives_way(found._replace(vehicle=replace(silent, precedes=False)))
    assert gives_way(found._replace(vehicle=replace(silent, plan=None, precedes=False)))


def test_announced_plan_is_not_changed_for_the_silence_of_a_vehicle_that_must_give_way():
    silent = vehicle(plan=straight(REST, [1.0, 0.0, 0.0], 40.0), precedes=False, age=3.0)
    beside = straight([-1.0, 0.7, 0.0], [0.5, 0.7, 0.0], 40.0)

    def conflicts_with(other):
        return path_conflicts(SQUARE, beside, 0.0, facing_announced_plan([other]), 0.1)

    assert path_conflicts(SQUARE, beside, 0.0, [silent], 0.1)  # a new plan
    assert not conflicts_with(silent)
    assert conflicts_with(replace(silent, precedes=True))
    assert conflicts_with(replace(silent, plan=PLANS["holds"]))
    assert conflicts_with(replace(silent, body=Body(REST, np.array([0.0, 0.01, 0.0]))))  # drifts


def test_margin_includes_the_deviation():
    other, at = vehicle(plan=straight(REST, REST)), np.array([[-0.8, 0.0, 0.0], [-0.75, 0.0, 0.0]])
    for deviation, expected in ((0.0, 0), (0.03, 1)):
        others = [replace(other, deviation=deviation)]
        assert len(conflicts(SQUARE, np.array([0.0, 5.0]), at, others, 0.1)) == expected
    assert SIGMAS * 0.03 + 0.1 > 0.15


PLANS = {
    "moves": straight(REST, [1.0, 0.0, 0.0]),
    "holds": Path(np.zeros(1), np.zeros((1, 1, 3))),
    "drifts": None,
}


@pytest.mark.parametrize("own", PLANS)
@pytest.mark.parametrize("its", PLANS)
@pytest.mark.parametrize("silent", [False, True])
def test_exactly_one_of_two_gives_way_if_any_can(own, its, silent):
    age = 5.0 if silent else 0.0
    seen_by_second = vehicle(plan=PLANS[own], precedes=True)
    seen_by_first = vehicle(plan=PLANS[its], precedes=False, age=age)
    first = gives_way(Conflict(seen_by_first, 30.0, 0.0)) and seen_by_second.can_give_way
    second = gives_way(Conflict(seen_by_second, 30.0, 0.0)) and seen_by_first.can_give_way
    assert first + second == (seen_by_first.can_give_way or seen_by_second.can_give_way)
    assert first <= (not seen_by_first.can_give_way)


def test_vehicle_brakes_for_one_that_does_not_give_way_in_time():
    late = Conflict(vehicle(plan=PLANS["moves"], precedes=False), 10.0, 0.0)
    assert not gives_way(late, stopping_time=9.0)
    assert gives_way(late, stopping_time=11.0)


def test_track_predicts_from_the_newest_messages():
    track, second = VehicleTrack("fss2", True), SECOND
    assert track.predicted(0) is None
    track.store_state(10 * second, Body(np.array([1.05, 0.0, 0.0]), np.zeros(3)), 0.01, 0.001)
    assert track.predicted(10 * second) is None  # its extent is unknown
    track.outline = SQUARE
    plan = straight([1.0, 0.0, 0.0], [2.0, 0.0, 0.0], 40.0)
    track.store_plan(9 * second, announced(plan, 0.0))
    found = track.predicted(11 * second)
    assert (found.age, found.deviation, found.speed_deviation) == (1.0, 0.01, 0.001)
    ahead = np.array([0.0, 20.0])
    offset = 1.05 - plan.at(1.0).pose[0]  # of its base from its plan, when the state was new
    expected = plan.states(ahead + 2.0)[:, 0, 0] + offset
    np.testing.assert_allclose(found.predict(ahead)[0].poses[:, 0], expected, atol=2e-3)


def test_plan_of_a_guidance_that_has_ended_is_dropped_but_not_that_of_a_silent_vehicle():
    track = VehicleTrack("fss2", True)
    track.outline, body = SQUARE, Body(np.zeros(3), np.zeros(3))
    track.store_plan(0, straight(REST, [1.0, 0.0, 0.0]))
    track.store_state(round(2.9 * SECOND), body, 0.0, 0.0)
    assert track.predicted(3 * SECOND).plan is None
    assert track.predicted(6 * SECOND).plan is not None
