"""The guard, against a search everywhere on random paths, and in front of a moving base."""

import re
from collections import Counter
from dataclasses import replace
from itertools import count, islice

import numpy as np
import pytest
from guard_oracle import Flight, least, looks, random_flight, shrinks
from model_arms import random_arm

from fss_arm_model.description import paper_arm
from fss_arm_model.guard.guard import (
    EDGE,
    SELF,
    TARGET,
    Guard,
    GuardError,
    moved,
    trapezoids,
    turning,
)
from fss_arm_model.guard.settings import GuardSettings
from fss_arm_model.guard.sweep import ALLOWED_DECREASE
from fss_arm_model.kinematics import tip_pose
from fss_arm_model.momentum import momentum
from fss_sim.plant.drives import MODE_VELOCITY
from fss_sim.plant.plant import Plant
from fss_sim.plant.vehicle import Demand

BED = GuardSettings()
FOLDED = np.radians([0.0, 85.0, 85.0, 85.0])


def is_clear(guard, flight):
    """Return True if the guard lets a path pass."""
    try:
        guard.check_path(
            flight.times, flight.q, flight.qd, flight.base, flight.twist, flight.target
        )
    except GuardError:
        return False
    return True


def begin_slack(flight, arm):
    """Return the least slack at the begin of a path [m]."""
    return min(row[0] for row in next(looks(flight, arm, BED)).values())


@pytest.mark.parametrize(
    ("n", "paths"), [(7, 50), (4, 150), pytest.param(4, 100_000, marks=pytest.mark.slow)]
)
def test_no_contact_is_missed_and_hardly_any_is_seen_that_is_none(n, paths):
    arm = paper_arm()
    if n != arm.n:  # unlike links, off their lines
        arm = replace(random_arm(n, np.random.default_rng(n)), base=arm.base)
    guard, rng, found = Guard(arm, BED), np.random.default_rng(2026), Counter()
    for _ in range(paths):
        flight = random_flight(arm, rng)
        low, clear = least(flight, arm, BED), is_clear(guard, flight)
        found["clear" if clear else "refused"] += 1
        found["missed"] += clear and low < 0.0
        if not clear and low >= 0.0:
            begun = begin_slack(flight, arm) < 0.0  # refused for what begins too near
            found["begun" if begun else "false"] += 1
            assert begun or low < 1e-4
    print(found)
    assert found["missed"] == 0
    assert min(found["clear"], found["refused"]) > 0.05 * paths
    assert found["false"] <= 1e-3 * paths


@pytest.mark.parametrize("paths", [20, pytest.param(2000, marks=pytest.mark.slow)])
def test_what_grazes_a_margin_is_told_from_what_just_passes(paths):
    """Margins are set to the least gap of each path, 0.1 mm more and 0.1 mm less."""
    arm, rng, tried = paper_arm(), np.random.default_rng(7), 0
    while tried < paths:
        flight = replace(random_flight(arm, rng), target=None)
        low = least(flight, arm, BED)
        if not 0.0 < low < begin_slack(flight, arm) - 0.001:
            continue
        tried += 1
        for by in (low - 1e-4, low + 1e-4):
            s = replace(BED, margin=BED.margin + by, edge_margin=BED.edge_margin + by)
            assert is_clear(Guard(arm, s), flight) == (by < low)


def test_it_names_bodies_joints_distance_and_margin():
    with pytest.raises(GuardError) as caught:
        Guard(paper_arm()).check_path([0.0, 5.0], [np.zeros(4), FOLDED], np.zeros((2, 4)))
    error = caught.value
    assert error.bodies == ("link 4", "base")
    assert error.margin == 0.05
    assert error.distance < 0.0 < error.time < 5.0
    assert error.q == pytest.approx(FOLDED)
    assert error.guards == (SELF,)
    words = r"link 4 and base would be -0.119 m apart .*\(0.0, 85.0, 85.0, 85.0\) deg.* 0.050 m"
    assert re.search(words, str(error))


def test_it_says_what_it_guards():
    guard, q = Guard(paper_arm()), np.zeros(4)
    ahead = (1.8, 0.5, 0.0)
    assert guard.check_posture(q).guards == (SELF,)
    assert guard.check_posture(q, base=(0, 0, 0)).guards == (SELF, EDGE)
    assert guard.check_posture(q, target=ahead).guards == (SELF,)
    with pytest.raises(GuardError, match="target and link 4") as caught:
        guard.check_posture(q, base=(0, 0, 0), target=(1.5, 0.5, 0.0))
    assert caught.value.guards == (SELF, EDGE, TARGET)
    with pytest.raises(GuardError, match="table edge and gripper"):
        guard.check_posture(q, base=(0.6, 0, 0))
    alone = replace(paper_arm(), links=paper_arm().links[:1])
    assert Guard(alone).check_posture([0.0]).bodies == ()


def test_the_gripper_may_touch_the_target_and_no_other_body_may():
    guard, q = Guard(paper_arm()), np.zeros(4)
    x, y, heading = tip_pose(paper_arm().vector(), np.zeros(7))
    touching, in_it = (
        np.array([x - 0.5 + away * np.cos(heading), y + away * np.sin(heading), 0.0])
        for away in (0.17, 0.15)
    )
    guard.check_posture(q, (-0.5, 0.0, 0.0), touching)
    with pytest.raises(GuardError, match="target and gripper"):
        guard.check_posture(q, (-0.5, 0.0, 0.0), in_it)


def test_who_begins_too_near_may_get_clear_and_not_nearer():
    guard, rest = Guard(paper_arm()), np.zeros((2, 4))
    near = np.radians([0.0, 85.0, 75.0, 60.0])
    with pytest.raises(GuardError):
        guard.check_posture(near)
    guard.check_path([0.0, 4.0], [near, np.radians([0.0, 40.0, 40.0, 30.0])], rest)
    guard.check_path([0.0, 4.0], [near, near], rest)
    with pytest.raises(GuardError):
        guard.check_path([0.0, 4.0], [near, near + 0.01], rest)
    back = [near, np.radians([0.0, 60.0, 60.0, 30.0]), near]
    with pytest.raises(GuardError):  # once clear, it has to stay so
        guard.check_path([0.0, 4.0, 8.0], back, np.zeros((3, 4)))


@pytest.mark.slow
def test_random_paths_that_begin_too_near_pass_if_they_only_get_clearer():
    """A gap may also decrease by the motion of the bodies in the 5 ms between two checks."""
    guard, rng, dips, refusals = Guard(paper_arm()), np.random.default_rng(11), [], []
    while len(dips) + len(refusals) < 120:
        flight = replace(random_flight(guard.arm, rng), target=None)
        if begin_slack(flight, guard.arm) >= 0.0 or least(flight, guard.arm, BED) < 0.0:
            continue
        found = dips if is_clear(guard, flight) else refusals
        found.append(shrinks(flight, guard.arm, BED))
    print(f"{len(dips)} pass, dip {max(dips):.4f}; {len(refusals)} do not, {min(refusals):.4f}")
    assert min(len(dips), len(refusals)) > 5
    assert max(dips) < ALLOWED_DECREASE + 0.003
    assert min(refusals) > 0.9 * ALLOWED_DECREASE


def test_a_base_that_is_not_at_rest_takes_the_arm_along():
    guard, hold = Guard(paper_arm()), np.zeros((2, 4))
    guard.check_path([0.0, 4.0], hold, hold, base=(0.2, 0, 0), twist=(0.02, 0, 0))
    with pytest.raises(GuardError, match="table edge and gripper"):
        guard.check_path([0.0, 10.0], hold, hold, base=(0.2, 0, 0), twist=(0.02, 0, 0))
    guard.check_path([0.0, 10.0], hold, hold, base=(0.2, 0, 0), twist=(-0.02, 0, 0))


def test_drift_is_the_time_to_the_margin():
    guard, q = Guard(paper_arm()), np.zeros(4)
    gap = guard.check_posture(q, (0.2, 0, 0)).distance
    assert guard.drift((0.2, 0, 0), (0.05, 0, 0), q) == pytest.approx(
        (gap - BED.edge_margin) / 0.05, rel=1e-3
    )
    back = 2.0 + 0.2 - BED.base_radius - BED.edge_margin  # the base comes first then
    assert guard.drift((0.2, 0, 0), (-0.05, 0, 0), q) == pytest.approx(back / 0.05, rel=1e-3)
    assert guard.drift((0.2, 0, 0), (0, 0, 0), q) == np.inf
    assert guard.drift((0.6, 0, 0), (0.05, 0, 0), q) < 0.1
    assert guard.drift((0.6, 0, 0), (-0.01, 0, 0), q) > 40.0


@pytest.mark.parametrize("seed", range(5))
def test_trapezoids_arrive_within_limits_and_brake_to_rest(seed):
    rng = np.random.default_rng(seed)
    q, way, qd = rng.normal(size=(3, 4)) * [[1.0], [0.5], [0.6]]
    a, top = rng.uniform(0.5, 3.0, (2, 4))
    if seed == 0:
        way[:2], qd[:2] = (0.0, 0.5 * qd[1] * abs(qd[1]) / a[1]), (0.0, qd[1])
    times, angles, rates = moved(q, qd, trapezoids(way, qd, top, a), 0.0)
    np.testing.assert_allclose(angles[[0, -1]], [q, q + way], atol=1e-9)
    np.testing.assert_allclose(rates[[0, -1]], [qd, 0.0 * qd], atol=1e-9)
    assert (np.abs(rates) <= np.maximum(top, np.abs(qd)) + 1e-9).all()
    gain = np.diff(rates, axis=0) / np.diff(times)[:, None]
    assert (np.abs(gain) <= a + 1e-6).all()
    np.testing.assert_allclose(
        np.diff(angles, axis=0), 0.5 * (rates[1:] + rates[:-1]) * np.diff(times)[:, None], atol=1e-9
    )
    times, _, rates = moved(q, qd, turning(qd, -qd, a, a, 0.4), 0.0)
    assert np.interp(0.4, times, rates[:, 0]) * qd[0] <= qd[0] ** 2
    assert times[-1] == pytest.approx(0.4 + (np.abs(rates[times <= 0.4][-1]) / a).max(), abs=1e-5)


def test_a_command_is_refused_for_where_it_leads():
    guard, rest, nan = Guard(paper_arm()), np.zeros(4), np.nan
    bent = np.radians([0.0, 75.0, 75.0, 30.0])
    guard.check_command(bent, rest, 0.2, velocity=0.1 * np.ones(4))
    with pytest.raises(GuardError, match="link 4 and base"):
        guard.check_command(bent, rest, 1.0, velocity=np.ones(4))
    with pytest.raises(GuardError, match="link 4 and base"):  # nor can it brake in time
        guard.check_command(bent + 0.1, np.ones(4), 0.05, velocity=np.zeros(4))
    guard.check_command(bent, rest, position=[nan, 1.0, 1.0, nan])
    with pytest.raises(GuardError, match="link 4 and base"):
        guard.check_command(bent, rest, position=[nan, 1.5, 1.5, nan], velocity=[0, nan, nan, 1])


def test_a_command_leads_nowhere_after_it_is_given_up():
    guard, rest = Guard(paper_arm(), BED), np.zeros(4)
    slow = {"position": [0.0, 0.0, 1e-3, 0.0], "max_velocity": [0.5, 0.5, 1e-5, 0.5]}  # for 100 s
    drifting = {"base": np.zeros(3), "twist": [0.02, 0.0, 0.0]}
    with pytest.raises(GuardError, match="table edge"):
        guard.check_command(rest, rest, **slow, **drifting)
    guard.check_command(rest, rest, **slow, **drifting, until=10.0)
    with pytest.raises(GuardError, match="table edge"):
        guard.check_command(rest, rest, **slow, **drifting, until=60.0)
    times, q, qd = moved(rest, rest, (np.full((3, 4), 2.0), np.full((3, 4), 0.5)), 0.0, 3.0)
    assert times.tolist() == [0.0, 2.0, 3.0]
    np.testing.assert_allclose((q[-1], qd[-1]), (np.full(4, 2.25), np.full(4, 1.5)), atol=1e-12)


def test_many_paths_at_once_are_judged_as_each_alone():
    guard, rng = Guard(paper_arm(), BED), np.random.default_rng(9)
    times = np.cumsum(rng.uniform(0.5, 1.5, (60, 3)), axis=1)
    q, qd = rng.uniform(-1.6, 1.6, (60, 3, 4)), rng.uniform(-0.5, 0.5, (60, 3, 4))
    base = np.array([0.6, 0.4, 0.3])
    alone = [is_clear(guard, Flight(*path, base)) for path in zip(times, q, qd, strict=True)]
    assert 5 < sum(alone) < 55
    assert guard.clear(times, q, qd, base).tolist() == alone


def test_bad_numbers_are_named():
    guard, rest = Guard(paper_arm()), np.zeros((2, 4))
    with pytest.raises(ValueError, match=r"times are \[0. 0.\]"):
        guard.check_path([0.0, 0.0], rest, rest)
    with pytest.raises(ValueError, match="q has the shape"):
        guard.check_path([0.0, 1.0], rest[:, :3], rest)
    with pytest.raises(ValueError, match=r"base is .*nan"):
        guard.check_path([0.0, 1.0], rest, rest, base=(0.0, np.nan, 0.0))
    with pytest.raises(ValueError, match="max_acceleration"):
        guard.check_command(rest[0], rest[0], position=rest[0], max_acceleration=rest[0])


PERIOD, REST = 0.1, 0.01  # of commands [s]; below it a joint is at rest [rad/s]


def stopped(seed: int) -> tuple[bool, float, float]:
    """Move an arm at random, its base near the edge, until a command is refused for the edge.

    Then the drives brake. Half of the bases drift, half move with their arms alone. Return whether
    it was refused; the least gap to the edge [m] until all joints rest and, without momentum, ten
    seconds beyond; the largest joint rate in the end [rad/s].
    """
    rng, arm, drifts = np.random.default_rng(seed), paper_arm(), seed % 2 == 1
    guard = Guard(arm, BED)
    while True:
        twist = rng.normal(0.0, [0.04, 0.04, 0.05]) if drifts else np.zeros(3)
        pose, q = rng.uniform([-1.2, -1.2, -3.0], [1.2, 1.2, 3.0]), rng.uniform(-0.6, 0.6, 4)
        try:
            near = guard.check_posture(q, pose)
        except GuardError:
            continue
        late = guard.drift(pose, twist, q) if drifts else 100.0 * (near.distance - BED.edge_margin)
        if "table edge" in near.bodies and 0.5 < late < 6.0:
            break
    plant = Plant(arm, np.concatenate([pose, q]), np.concatenate([twist, np.zeros(4)]))
    nearest, ended, wanted = np.inf, False, np.zeros(4)
    for tick in range(2000):
        q, qd = plant.q[3:], plant.qd[3:]
        if tick % 10 == 0:
            wanted = rng.uniform(-0.8, 0.8, 4)
        wanted = np.where(np.abs(q) > 1.2, -0.5 * np.sign(q), wanted)
        state = {"base": plant.q[:3], "twist": plant.qd[:3]}
        try:
            guard.check_command(q, qd, PERIOD, velocity=wanted, **state)
        except GuardError as error:
            ended, wanted = ended or "table edge" in error.bodies, np.zeros(4)
        for joint, rate in enumerate(0.0 * wanted if ended else wanted):
            plant.command(joint, Demand(MODE_VELOCITY, rate, abs(rate), 2.0))
        for _ in range(10):
            plant.advance(0.1 * PERIOD)
            nearest, rate = min(nearest, plant.edge_clearance), np.abs(plant.qd[3:]).max()
            if ended and rate < REST:
                break
        if ended and rate < REST:
            break
    if not drifts:
        assert np.abs(momentum(arm.vector(), plant.q, plant.qd)).max() < 0.01
        plant.advance(10.0)
        nearest = min(nearest, plant.edge_clearance)
    return ended, nearest, float(rate)


@pytest.mark.parametrize("runs", [2, pytest.param(100, marks=pytest.mark.slow)])
def test_the_drifting_base_stops_before_the_edge(runs):
    """If the base keeps drifting, which no arm can stop, the arm rests before the margin."""
    found = islice((run for seed in count() if (run := stopped(seed))[0]), runs)
    _, nearest, rates = zip(*found, strict=True)
    print(f"{runs} runs, nearest {sorted(nearest)[:3]} m")
    assert max(rates) < REST
    assert min(nearest) > BED.edge_margin - 0.002
