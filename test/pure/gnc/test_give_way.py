"""Paths that give way: pauses, and vehicles with ideal bases that meet."""

import numpy as np
import pytest
from traffic import Ideal, fly, gap

from fss_gnc.guidance.base_motion import follow
from fss_gnc.guidance.give_way import pause, resumed
from fss_gnc.guidance.limits import limit_use
from fss_gnc.guidance.mission_settings import MissionSettings
from fss_gnc.reference import Path, Reference

LEAST_GAP = 0.04  # half of the planned one, and what is between two steps [m]
WAY = Path.between(Reference.at_rest([-1.0, 0.2, 0.0]), [1.0, -0.2, 1.0], 0.0, 64.0)


def meeting(*starts, n=4, until=3.0):
    """Return vehicles that rest at these poses, once each has announced its plan to the others."""
    names = tuple(f"fss{k}" for k in range(1, len(starts) + 1))
    vehicles = [Ideal(name, names, start, n) for name, start in zip(names, starts, strict=True)]
    fly(vehicles, until=until)
    return vehicles


def test_pause_stays_on_the_way_and_within_the_limits():
    paused = pause(WAY, 20.0, 25.0, 10.0)
    assert paused.end_time == pytest.approx(64.0 + 25.0 + 10.0)
    times = np.linspace(20.0, paused.end_time, 500)
    poses, way = paused.states(times)[:, 0], WAY.states(np.linspace(20.0, 64.0, 2000))[:, 0]
    nearest = [np.abs(way - pose).max(axis=1).min() for pose in poses]
    assert max(nearest) < 2e-3
    np.testing.assert_allclose(paused.at(20.0).twist, WAY.at(20.0).twist, atol=1e-12)
    np.testing.assert_allclose(paused.at(50.0).twist, 0.0, atol=1e-12)  # it waits
    np.testing.assert_allclose(paused.at(90.0).pose, WAY.at(55.0).pose, atol=1e-3)
    assert limit_use(MissionSettings(), paused, WAY.at(20.0).twist).share < 1.05


def test_pause_without_end_and_the_rest_of_the_way():
    stopped = pause(WAY, 20.0, 25.0, np.inf)
    assert stopped.end_time == 45.0
    np.testing.assert_allclose(stopped.knots[-1], [WAY.at(32.5).pose, np.zeros(3)], atol=1e-12)
    rest = resumed(WAY, 32.5, 100.0, 25.0)
    np.testing.assert_allclose(rest.at(0.0).pose, stopped.at(60.0).pose, atol=1e-12)
    np.testing.assert_allclose(rest.at(rest.end_time).pose, WAY.at(64.0).pose, atol=1e-12)


COURSES = {
    "crossing": [([-1.3, 0.1, 0.0], [1.3, 0.1, 0.5]), ([0.0, -1.3, 1.5], [0.1, 1.3, 1.0])],
    "head-on": [([-1.3, 0.1, 0.0], [1.3, 0.1, 0.5]), ([1.3, -0.1, 3.1], [-1.3, 0.0, 2.5])],
    "swap": [([-1.2, 0.0, 0.0], [1.2, 0.0, 0.0]), ([1.2, 0.0, 0.0], [-1.2, 0.0, 0.0])],
}


@pytest.mark.parametrize("n", [3, 4, 8])
@pytest.mark.parametrize("courses", COURSES)
def test_two_vehicles_pass_each_other(n, courses):
    starts, goals = zip(*COURSES[courses], strict=True)
    vehicles = meeting(*starts, n=n)
    for one, goal in zip(vehicles, goals, strict=True):
        one.go_to(3.0, goal)
    t, least = fly(vehicles, start=3.0)
    print(f"{courses}, {n} links: {t:.0f} s, {least:.3f} m")
    assert all(one.arrived for one in vehicles)
    assert least > LEAST_GAP
    first, second = (set(filter(None, one.reasons)) for one in vehicles)
    assert second & {"gives way to fss1", "waits for fss1"}  # the second in the list
    assert not first or courses != "crossing"  # elsewhere its goal is occupied at first


@pytest.mark.parametrize("count", [1, 3, 4])
def test_up_to_three_vehicles_arrive_and_a_fourth_holds(count):
    places = [[1.2, 0.0], [0.0, 1.2], [-1.2, 0.0], [1.25, 1.25]][:count]
    vehicles = meeting(*([*place, 0.0] for place in places))
    for one, place in zip(vehicles[:3], places, strict=False):
        one.go_to(3.0, [-place[0], -place[1], 0.3])
    t, least = fly(vehicles, start=3.0)
    print(f"{count} vehicles: {t:.0f} s, {least:.3f} m")
    assert all(one.arrived for one in vehicles)
    assert least > LEAST_GAP


def test_vehicle_that_holds_is_passed_by_the_one_before_it_in_the_list():
    first, second = meeting([-1.3, 0.0, 0.0], [0.0, 0.0, 0.0])
    first.go_to(3.0, [1.3, 0.0, 0.0])
    _, least = fly([first, second], start=3.0)
    assert first.arrived
    assert least > LEAST_GAP
    np.testing.assert_allclose(second.base.pose, 0.0)


def test_goal_that_is_occupied_is_waited_for_and_the_vehicle_is_named():
    first, second = meeting([-1.3, 0.0, 0.0], [1.0, 0.0, 0.0])
    first.go_to(3.0, [1.0, 0.0, 0.0])
    fly([first, second], start=3.0, until=60.0)
    assert (first.commands.phase, first.commands.reason) == ("wait", "waits for fss2")
    np.testing.assert_allclose(first.base.pose, [-1.3, 0.0, 0.0])
    second.go_to(60.0, [0.9, 1.2, 0.0])
    fly([first, second], start=60.0)
    assert first.arrived


@pytest.mark.parametrize("silent", ["fss1", "fss2"])
def test_silent_vehicle_is_kept_clear_of(silent):
    first, second = meeting([-1.3, 0.0, 0.0], [0.0, -1.3, 1.5])
    first.go_to(3.0, [1.3, 0.0, 0.0])
    second.go_to(3.0, [0.0, 1.3, 1.5])
    _, least = fly([first, second], start=3.0, silent=lambda name, t: name == silent and t > 30.0)
    assert least > LEAST_GAP


def test_right_of_way_is_kept_before_a_vehicle_that_falls_silent_and_still_receives():
    first, second = meeting([-1.3, 0.0, 0.0], [0.0, -1.3, 1.6], until=5.0)
    first.go_to(5.0, [1.3, 0.0, 0.6])
    fly([first, second], start=5.0, until=8.5)
    second.go_to(8.5, [0.0, 1.3, 2.1])
    fly([first, second], start=8.5, until=30.0)
    fly([first, second], start=30.0, until=40.0, silent=lambda name, t: name == "fss2")
    assert set(first.reasons) == {""}  # it flies as announced, on which the other one relies
    _, least = fly([first, second], start=40.0, silent=lambda name, t: name == "fss2")
    assert first.arrived
    assert second.arrived
    assert least > LEAST_GAP


def test_follow_that_moved_aside_returns_to_its_path_before_it_continues():
    _, second = meeting([0.0, -1.3, 1.5], [-1.3, 0.0, 0.0])
    poses = [[-1.3, 0.0, 0.0], [0.0, -0.2, 0.0], [1.3, 0.0, 0.0]]
    motion = follow(second.craft, second.observe(3.0), [0.0, 45.0, 90.0], np.ravel(poses), [])
    give_way, path = motion.give_way, motion.path
    give_way._rest = path, 40.0
    aside = Reference.at_rest(path.at(40.0).pose + np.array([0.1, 0.4, 0.0]))
    departures = give_way._all_departures(aside)
    for _, found in departures:
        times = np.linspace(0.0, found.end_time, 2000)
        states = found.states(times)
        np.testing.assert_allclose(states[0, 0], aside.pose, atol=1e-12)
        np.testing.assert_allclose(found.knots[-1, 0], poses[-1], atol=1e-9)
        assert np.abs(np.diff(states[:, 0, :2], axis=0)).max() < 0.01
        back = np.abs(states[:, 0] - path.at(40.0).pose).max(axis=1).argmin()
        assert np.abs(states[back, 1]).max() < 1e-3  # it is at rest where it left the path
        way = path.states(np.linspace(40.0, 90.0, 2000))[:, 0]
        assert max(np.abs(way - pose).max(axis=1).min() for pose in states[back:, 0]) < 2e-3
        assert limit_use(second.craft.settings, found).share < 1.05


def test_follow_waits_and_then_keeps_to_its_path():
    first, second = meeting([0.0, -1.3, 1.5], [-1.3, 0.0, 0.0])
    first.go_to(3.0, [0.0, 1.3, 1.5])
    poses = [[-1.3, 0.0, 0.0], [0.0, -0.2, 0.0], [1.3, 0.0, 0.0]]
    second.start, second.moves = 3.0, True
    second.activity = follow(
        second.craft, second.observe(3.0), [0.0, 45.0, 90.0], np.ravel(poses), []
    )
    way = second.activity.path.states(np.linspace(0.0, 90.0, 2000))[:, 0]
    t, least, off = 3.0, np.inf, 0.0
    while not (first.arrived and second.arrived) and t < 400.0:
        t, gap_now = fly([first, second], start=t, until=t + 0.5)
        least = min(least, gap_now, gap(first, second))
        off = max(off, float(np.abs(way - second.base.pose).max(axis=1).min()))
    assert second.arrived
    assert least > LEAST_GAP
    assert off < 0.01
    assert "waits for fss1" in second.reasons or "gives way to fss1" in second.reasons
