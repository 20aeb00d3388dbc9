"""The capture and its parts, flown on the plant with late and noisy senses."""

from dataclasses import replace

import numpy as np
import pytest
from capturing import POSTURE, SETTINGS, Case, Flight

from fss_arm_model.description import paper_arm
from fss_arm_model.dynamics import inertia_matrix
from fss_arm_model.held import Target, held, held_at, hold
from fss_arm_model.kinematics import tip_pose
from fss_arm_model.settings import SettingError
from fss_gnc.guidance.abort import Abort
from fss_gnc.guidance.activity import Craft, Seen
from fss_gnc.guidance.approach import Planner, coasted
from fss_gnc.guidance.capture import Capture
from fss_gnc.guidance.detumble import Detumble
from fss_gnc.guidance.drift import Drifting
from fss_gnc.guidance.mission_settings import MissionSettings
from fss_gnc.guidance.reach import Reach, fixtures
from fss_gnc.guidance.rest import braking, slowing
from fss_gnc.reference import Body

ARM = paper_arm()
P = ARM.vector()
CRAFT = Craft(ARM, SETTINGS)
AT_REST = np.zeros(7)


def state(heading=0.5, spin=0.1, drift=(0.0, 0.0)):
    return np.array([[0.0, 0.0, heading], [*drift, spin]])


def at(x, y, heading, posture=POSTURE):
    return np.array([x, y, heading, *posture])


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


def of_unknown_mass(assumed, mass, learns=True, inertia=None, **case):
    settings = MissionSettings(target_mass=assumed, target_inertia=assumed / 40.0)
    truth = Target(mass, mass / 40.0 if inertia is None else inertia)
    flight = Flight(Case(distance=1.4, **case), None, settings, truth, learns)
    return flight, flight.fly()


def errors_of_found(flight):
    """Of what was known of the target in the end, in its deviations (4,), and the NEES."""
    truth, found = flight.plant.world.target, flight.navigation.found
    place = hold(P, flight.plant.q, flight.plant.target[0])
    off = found.values - [truth.mass, *place[:2], truth.inertia]
    return off / found.deviations, off @ np.linalg.solve(found.covariance, off) / 4


@pytest.mark.parametrize("mass", [5.0, pytest.param(20.0, marks=pytest.mark.slow)])
def test_a_target_of_another_mass_than_assumed_is_weighed_and_stopped(mass):
    flight, flown = of_unknown_mass(10.0, mass)
    assert flown.well
    assert flown.safe
    found = flight.navigation.found
    assert np.abs(errors_of_found(flight)[0]).max() < 3.0
    assert found.deviations[0] < 0.5 * found.values[0]  # 0.7 of it before
    assert (found.deviations[1:3] < 0.035).all()


@pytest.mark.slow
def test_twelve_captured_targets_are_known_as_well_as_is_said():
    nees = []
    for seed in range(12):
        rng = np.random.default_rng(100 + seed)
        mass = 10.0 * 2.0 ** rng.uniform(-1.0, 1.0)
        inertia = mass / 40.0 * np.exp(0.3 * rng.standard_normal())
        spin = rng.choice([-1.0, 1.0]) * rng.uniform(0.05, 0.15)
        flight, flown = of_unknown_mass(10.0, mass, inertia=inertia, spin=spin, seed=seed)
        assert flown.well
        off, found = errors_of_found(flight)
        assert np.abs(off).max() < 3.0
        nees.append(found)
    assert np.mean(nees) < 1.5  # 0.2: the base's twist is better than its covariance says


@pytest.mark.parametrize("learns", [False, True])
def test_a_target_six_times_as_heavy_is_stopped_only_by_who_weighs_it(learns):
    _, flown = of_unknown_mass(5.0, 30.0, learns, spin=0.25, drift=(-0.025, 0.02))
    assert flown.captured
    assert flown.well == learns
    assert learns or "off the reference" in flown.message


@pytest.mark.slow
@pytest.mark.parametrize("phase", ["approach", "reach", "detumble"])
@pytest.mark.parametrize("fault", ["outage", "link", "open"])
def test_what_fails_ends_the_mission_safely(fault, phase):
    flown = Flight(Case(spin=0.1, distance=1.4, fault=fault, phase=phase, lasts=10.0)).fly()
    assert "abort" in flown.phases
    assert flown.safe


@pytest.mark.parametrize(
    ("phase", "case"),
    [
        ("reach", Case(spin=0.1, heading=2.0, seed=2)),
        ("grip", Case(spin=-0.1, heading=1.0)),  # what may be held is not fled from
    ],
)
def test_who_does_not_hear_the_gripper_reaches_no_further(phase, case):
    flown = Flight(replace(case, fault="gripper", phase=phase)).fly()
    assert flown.phases[-2:] == [phase, "abort"]
    assert flown.message.startswith("gripper/state is not known; ")
    assert flown.safe


@pytest.mark.parametrize("holds", [True, None])
def test_what_is_held_or_may_be_is_not_let_go_while_a_mission_waits(holds):
    q = at(-1.0, -1.0, -1.4)
    mission, base = Capture(CRAFT), Body(q[:3], np.zeros(3))
    target = None if holds else Body(np.zeros(3), np.array([0.0, 0.0, 0.1]))
    unknown = Seen(0.0, None, target, q[3:], np.zeros(4), holds=holds)
    for seen in (unknown, replace(unknown, base=base, target=target)):
        assert mission.step(seen).close is not False
    assert Capture(CRAFT).step(replace(unknown, holds=False)).close is False


def test_a_mission_does_not_wait_for_its_target_while_a_valve_is_open():
    q = at(-1.0, -1.0, -1.4)
    base = Body(q[:3], np.zeros(3))
    orders = Capture(CRAFT).step(Seen(0.0, base, None, q[3:], np.zeros(4), holds=False,
                                      open_valves=(3,)))  # fmt: skip
    assert (orders.phase, orders.reason) == ("abort", "valve 3 does not close")


def test_a_posture_that_the_arm_cannot_take_is_refused_at_once():
    for posture, words in (((0.1, 0.2), "posture has 2 angles, expected 4 or none"),
                           ((0.1, 0.2, 0.3, 4.0), "posture has 4 rad for joint 4")):  # fmt: skip
        with pytest.raises(SettingError, match=words):
            Craft(ARM, MissionSettings(posture=posture))


def test_a_target_larger_than_its_keep_out_zone_is_refused():
    with pytest.raises(SettingError, match=r"keep_out is 0\.26 m, expected at least target_rad"):
        MissionSettings(target_radius=0.3)


def test_a_way_ends_before_the_fixture_and_meets_nothing_whenever_thrust_ends():
    planner, q, target = Planner(P, SETTINGS), at(-1.0, -1.0, -1.4), state()
    way = planner.find(q, AT_REST, target, SETTINGS.lead)
    end = way.points(way.duration)
    t = way.duration + SETTINGS.lead
    facing = fixtures(target, SETTINGS, np.array([t]))[0]
    tip = tip_pose(P, np.concatenate([end.pose[0], POSTURE]))
    assert np.hypot(*(tip[:2] - facing[:2])) == pytest.approx(SETTINGS.stand_off, abs=1e-6)
    assert np.cos(tip[2] - facing[2]) == pytest.approx(1.0, abs=1e-6)
    np.testing.assert_allclose(end.twist, 0.0, atol=1e-9)
    times = np.linspace(0.0, way.duration, 60)
    points = way.points(times)
    np.testing.assert_allclose(points.pose[0], q[:3], atol=1e-9)
    for ahead in np.linspace(0.0, SETTINGS.coast, 7):
        poses = coasted(points.pose, points.twist, way.body.com, ahead)
        gaps = planner.gaps_of(poses, way.body, np.zeros((60, 2)))
        assert gaps.min() > 0.0


def test_a_way_is_as_its_rates_and_accelerations_say():
    way = Planner(P, SETTINGS).find(at(-1.0, -1.0, -1.4), AT_REST, state(), 3.0)
    t, step = np.linspace(1.0, way.duration - 1.0, 9), 1e-4
    ahead, now, behind = (way.points(t + k * step) for k in (1, 0, -1))
    np.testing.assert_allclose(now.twist, (ahead.pose - behind.pose) / (2 * step), atol=1e-7)
    np.testing.assert_allclose(
        now.acceleration, (ahead.twist - behind.twist) / (2 * step), atol=1e-7
    )


def test_there_is_no_way_where_there_is_no_room():
    target = state(spin=0.0, heading=0.0)
    target[0, :2] = 1.8, 0.0  # its fixture faces the edge
    assert Planner(P, SETTINGS).find(at(-1.0, 0.0, 0.0), AT_REST, target, 3.0) is None


def test_a_reach_goes_to_the_fixture():
    guide = Reach(ARM, SETTINGS)
    q = at(0.0, 0.0, 0.0)
    x, y, heading = tip_pose(P, q)
    centre = complex(x, y) + 0.25 * np.exp(1j * heading)
    target = np.array([[centre.real, centre.imag, heading + np.pi], [0.0, 0.0, 0.0]])
    guide.begin(q, AT_REST)
    from fss_arm_model.momentum import generalized_jacobian

    tip = generalized_jacobian(P, q) @ guide.rates(q, target)
    inward = np.array([np.cos(heading), np.sin(heading)])
    assert tip[:2] @ inward > 0.01


def test_joints_slow_down_within_their_torques():
    q, qd = at(0.0, 0.0, 0.0), np.concatenate([np.zeros(3), [1.0, -1.0, 1.0, -1.0]])
    gentle, hard = (slowing(P, q, qd, np.full(4, torque)) for torque in (0.2, 1.0))
    assert gentle > hard


def test_the_base_brakes_within_the_valves_authority():
    q, qd = at(0.0, 0.0, 0.0), np.concatenate([[0.05, 0.0, 0.0], np.zeros(4)])
    path = braking(P, q, qd, SETTINGS, 2.0)
    assert path.at(path.end).pose[0] == pytest.approx(0.025 * (path.end - 2.0))
    assert 0.05 / (path.end - 2.0) < 0.32 / 21.5


def test_an_abort_turns_away_from_the_target_and_then_drifts():
    q = at(-0.75, -0.75, -1.9)
    closing = np.array([0.03, 0.03, 0.0])
    seen = Seen(
        0.0, Body(q[:3], closing), Body(np.zeros(3), np.zeros(3)), q[3:], np.zeros(4), holds=False
    )
    orders = Abort(CRAFT, "test").step(seen)
    assert orders.phase == "abort"
    assert orders.path is not None
    end = orders.path.knots[-1, 1]
    after = np.concatenate([orders.path.knots[-1, 0], q[3:]])
    assert Drifting(P, SETTINGS).as_is(after, np.concatenate([end, np.zeros(4)]), seen.target).safe


def test_an_abort_leaves_the_valves_closed_where_the_base_is_not_known_or_drifts_safely():
    q = at(-0.75, -0.75, -1.9)
    away = Body(q[:3], np.array([-0.01, -0.01, 0.0]))
    rest = Body(np.zeros(3), np.zeros(3))
    for base in (None, away):
        orders = Abort(CRAFT, "test").step(Seen(0.0, base, rest, q[3:], np.zeros(4), holds=False))
        assert orders.path is None
        np.testing.assert_allclose(orders.rates, 0.0)


def test_an_abort_takes_the_joints_reaction_for_no_drift():
    q, rates = at(-0.75, -0.75, -1.9), np.full(4, 0.3)
    H = inertia_matrix(P, q)[:3]
    turned = -np.linalg.solve(H[:, :3], H[:, 3:] @ rates)  # no momentum: it ends with the motion
    assert not Drifting(P, SETTINGS).as_is(q, np.append(turned, rates), None).safe
    abort = Abort(CRAFT, "test")
    moving = Seen(0.0, Body(q[:3], turned), None, q[3:], rates, holds=False)
    assert abort.step(moving).path is None
    rest = replace(moving, t=1.0, base=Body(q[:3], np.zeros(3)), qd=np.zeros(4))
    assert abort.step(rest).path is None
    assert abort.safe


def test_a_held_target_keeps_off_the_edge_too():
    q = at(-0.9, 0.0, 1.0)
    x, y, _ = tip_pose(P, q)
    place = hold(P, q, (x - 0.15, y + 0.1, 0.3))
    states = np.stack([q, at(-0.2, 0.5, 0.7)])
    there = [held(P, each, AT_REST, place)[0, :2] for each in states]
    np.testing.assert_allclose(held_at(P, states, place), there, atol=1e-12)
    alone, both = (Drifting(P, SETTINGS, one).clearances(q, None)[0] for one in (None, place))
    assert both == pytest.approx(2.0 - np.abs(there[0]).max() - SETTINGS.target_radius)
    assert both < alone


def test_an_abort_takes_what_joints_do_that_fell_silent_for_no_drift():
    flown = Flight(Case(fault="link", phase="reach", after=0.5)).fly()
    assert flown.phases[-2:] == ["reach", "abort"]
    assert flown.safe
    assert flown.edge > 0.2  # 0.33 as it began: it drifts, but does not push itself away


def drifting_under(force, propellant, **known):
    """Paths of an abort, as a valve pushes along y [N], which is known."""
    return [orders.path for orders in aborted(force, propellant, **known)]


def aborted(force, propellant, end=6.0, unseen=(), **known):
    """Orders of an abort, as a valve pushes along y [N], which is known, but at some times."""
    abort, found = Abort(CRAFT, "test"), []
    far = Body(np.array([1.5, 1.5, 0.0]), np.zeros(3))
    for t in np.arange(0.0, end, 0.1):
        at_y, v = 0.5 * force / 21.5 * t**2, force / 21.5 * t
        base = Body(np.array([-0.75, -0.75 + at_y, -1.9]), np.array([0.0, v, 0.0]))
        seen = Seen(t, base, far, np.array(POSTURE), np.zeros(4), None, False, propellant)
        seen = replace(seen, **known)
        found.append(abort.step(replace(seen, base=None) if t in unseen else seen))
        if found[-1].ended:
            break
    return found


@pytest.mark.parametrize("known", [{"open_valves": (2,)}, {"pushed": True}])
def test_an_abort_holds_where_a_valve_leaks_while_there_is_gas(known):
    held = drifting_under(0.16, 0.04, **known)
    assert held[-1] is not None
    np.testing.assert_array_equal(held[-1].knots[-1, 1], 0.0)  # it ends at rest
    assert drifting_under(0.0, 0.04)[-1] is None
    assert len(drifting_under(0.0, 0.04)) < len(held)  # over after three quiet seconds
    assert drifting_under(0.0, 0.0, **known)[-1] is None


def test_an_abort_goes_on_holding_once_it_knows_the_base_again():
    orders = aborted(0.16, 0.04, unseen=[2.0], open_valves=(2,))
    assert [k for k, one in enumerate(orders) if one.path is None] == [20]


@pytest.mark.parametrize("propellant", [0.04, np.nan])
def test_an_abort_whose_tank_is_not_heard_holds_until_the_base_is_gone(propellant):
    orders = aborted(0.02, propellant, 40.0, open_valves=(2,))  # much weaker: the tank is empty
    assert (orders[-1].ended is None) == np.isfinite(propellant)
    if orders[-1].ended:
        words = "test; the valves do not hold the base any more"
        assert orders[-1].ended == (False, words)


def test_an_abort_says_why_the_drift_is_not_safe():
    q, gone = at(-0.75, -0.75, -1.9), np.array([-0.06, 0.0, 0.0])
    abort, orders = Abort(CRAFT, "enough", asked=True), None
    for t in (0.0, 4.0):
        base = Body(q[:3], gone)
        orders = abort.step(
            Seen(t, base, None, q[3:], np.zeros(4), holds=False, propellant=0.0)  # no gas
        )
    assert not orders.ended.well
    assert orders.ended.message.startswith("enough; it drifts to within -")
    assert orders.ended.message.endswith(" m from the table's edge in 30 s")


def test_a_detumble_does_not_end_well_where_a_valve_leaks():
    q, mission, orders = at(0.0, 0.0, 0.0), Detumble(CRAFT), []
    base = Body(q[:3], np.zeros(3))
    for t in np.arange(0.0, 12.0, 0.1):
        alone = bool(orders) and orders[-1].path is None and t > 4.0
        seen = Seen(t, base, None, q[3:], np.zeros(4), holds=True, pushed=alone)
        orders.append(mission.step(seen))
    assert orders[-1].phase == "abort"
    assert mission.abort.reason == "something pushes that is not known"


def test_an_abort_that_is_asked_for_ends_well_when_the_drift_is_safe():
    q = at(-0.75, -0.75, -1.9)
    abort = Abort(CRAFT, "test", asked=True)
    base, rest = Body(q[:3], np.array([-0.01, -0.01, 0.0])), Body(np.zeros(3), np.zeros(3))
    ends = [
        abort.step(Seen(t, base, rest, q[3:], np.zeros(4), holds=False)).ended for t in (0.0, 4.0)
    ]
    assert ends[0] is None
    assert ends[1].well


def test_a_detumble_that_is_cancelled_is_aborted():
    q = at(0.0, 0.0, 0.0)
    mission = Detumble(CRAFT)
    seen = Seen(0.0, Body(q[:3], np.zeros(3)), None, q[3:], np.zeros(4), holds=True)
    assert mission.step(seen).phase == "detumble"
    mission.cancel("enough")
    assert mission.step(replace(seen, t=0.1)).phase == "abort"


def test_what_rests_is_detumbled_once_it_was_left_alone_twice():
    q, mission = at(0.0, 0.0, 0.0), Detumble(CRAFT)
    seen = Seen(0.0, Body(q[:3], np.zeros(3)), None, q[3:], np.zeros(4), holds=True)
    orders = [mission.step(replace(seen, t=0.5 * k)) for k in range(17)]
    assert all(each.path is None for each in orders[:5])
    assert next(each.ended for each in orders if each.ended).well
