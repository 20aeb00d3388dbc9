"""Base reaction against the free-floating equations of motion integrated step by step."""

from copy import copy

import numpy as np
import pytest
from view_flight import STEP, Flight, paper_flight

from fss_arm_model.description import paper_arm
from fss_arm_model.description_file import load
from fss_arm_model.dynamics import bias, inertia_matrix
from fss_arm_model.layout import kinematic_index
from fss_arm_model.units import GRAVITY, SECOND
from fss_arm_ros.calibrated import vector_covariance
from fss_arm_view.base_reaction import BaseReaction
from fss_arm_view.settings import ReactionSettings
from fss_gnc.navigation import BodyState


def simulate(reaction, flight, every, step=100, end=None):
    """Feed one joint's reading per millisecond, each joint `every` ms, and poses at 100 Hz.

    A reaction is computed once a step [ms], until the flight's end or an earlier one [ms].
    """
    found = []
    n = len(reaction.joints)
    for k in range(end or len(flight.t)):
        t = k * 1_000_000
        for i in range(n):
            if (k - i) % every == 0:
                reaction.add_reading(i, t, flight.q[k, i], flight.qd[k, i], 0.1)
        if k % 10 == 0:
            still = 1e-6 * np.eye(6)
            reaction.add_base_state(BodyState(t, flight.pose[k], flight.twist[k], still))
        if k % step == 0 and (until := reaction.last_known_time()) > reaction.t:
            got = reaction.advance(until)
            if got:
                found.append(got)
    return found


@pytest.fixture(scope="module")
def flight():
    return paper_flight()


@pytest.fixture(scope="module")
def reactions(flight):
    """The reactions to the flight, with readings of each joint every 2 ms."""
    return simulate(BaseReaction(paper_arm()), flight, 2)


@pytest.mark.parametrize(("every", "bound"), [(200, 2e-3), (2, 5e-6)])
def test_the_prediction_follows_the_base(flight, reactions, every, bound):
    found = reactions if every == 2 else simulate(BaseReaction(paper_arm()), flight, every)
    assert len(found) > 40
    for r in found:
        k = flight.index(r.t)
        np.testing.assert_allclose(r.predicted, flight.pose[k], rtol=0, atol=bound)
        np.testing.assert_allclose(r.measured, flight.pose[k], rtol=0, atol=1e-4)
    moved = flight.pose[flight.index(found[-1].t), 2]
    assert abs(moved) > 0.3  # the test needs a large motion
    assert len({r.anchor for r in found}) > 1  # the prediction restarts before the motion


def test_momentum_equals_that_of_the_flight(flight, reactions):
    for r in reactions:
        # Twists 10 ms apart are interpolated, over jumps of the acceleration.
        np.testing.assert_allclose(r.momentum, flight.momentum, rtol=0, atol=5e-3)
    np.testing.assert_allclose(reactions[-1].momentum_drift, 0.0, atol=1e-4)


def test_the_force_at_the_first_joint_accelerates_the_base(flight, reactions):
    arm = paper_arm()
    p = arm.vector()
    ramps = 0
    for r in reactions:
        k = flight.index(r.t)
        qdd = flight.qdd[k - 110 : k + 111]
        if k < 120 or k + 120 > len(flight.t) or (qdd != qdd[0]).any():
            continue  # accelerations jump within the difference
        ramps += bool(qdd.any())
        x = np.concatenate([flight.pose[k], flight.q[k]])
        xd = np.concatenate([flight.twist[k], flight.qd[k]])
        base = (flight.twist[k + 5] - flight.twist[k - 5]) / (10 * STEP)
        tau = inertia_matrix(p, x) @ np.concatenate([base, flight.qdd[k]]) + bias(p, x, xd)
        assert r.torque == pytest.approx(tau[3], abs=1e-3)
        # The whole base's momentum changes by what link 1 does to it; its centre is its origin.
        np.testing.assert_allclose(r.force, -arm.base.mass * base[:2], rtol=0, atol=2e-3)
        np.testing.assert_allclose(r.torque_measured, 0.1)
    assert ramps >= 3


@pytest.mark.parametrize("half", [0.2, 1.5])
def test_the_torque_does_not_depend_on_the_rate_of_computation(flight, half):
    settings = ReactionSettings(half_difference=half)
    frequent, rare = (
        {
            r.t: r
            for r in simulate(BaseReaction(paper_arm(), settings=settings), flight, 10, step, 5000)
        }
        for step in (50, 400)
    )
    both = sorted(frequent.keys() & rare.keys())
    assert max(abs(rare[t].torque) for t in both) > 0.02
    for t in both:
        assert frequent[t].torque == pytest.approx(rare[t].torque, abs=1e-9)
        np.testing.assert_allclose(frequent[t].force, rare[t].force, rtol=0, atol=1e-9)


def test_the_band_covers_a_wrong_parameter(flight):
    arm = paper_arm()
    covariance = vector_covariance(arm, ["a"], [0.005**2])
    exact = ReactionSettings(position_error=1e-9, heading_error=1e-9)
    kinematics = arm.vector()[kinematic_index(arm.n)]
    kinematics[:3] += 0.005  # lengths of all links but the last
    wrong = arm.with_kinematics(kinematics)
    right, off = (
        simulate(BaseReaction(a, covariance, exact), flight, 20)[-1] for a in (arm, wrong)
    )
    difference = np.abs(off.predicted - right.predicted)
    # One parameter, wrong by its deviation: as far off as the band is wide, to first order.
    np.testing.assert_allclose(right.predicted_deviation, difference, rtol=0.05)
    assert (difference > 5e-5).all()


def test_the_band_grows_with_the_time_since_the_drift_was_fitted(flight):
    settings = ReactionSettings(position_error=0.01, heading_error=0.02)
    found = simulate(BaseReaction(paper_arm(), settings=settings), flight, 20)
    same_anchor = [r for r in found if r.anchor == found[-1].anchor]
    band = np.array([r.predicted_deviation for r in same_anchor])
    assert (np.diff(band[:, :2], axis=0) > 0.0).all()
    # A line through 200 poses of 2 s: its slope's deviation times 6 s, and its height's.
    slope = 0.01 * np.sqrt(12 / 200) / 2.0
    since = (same_anchor[-1].t - same_anchor[-1].anchor) * 1e-9
    assert band[-1, 0] == pytest.approx(np.hypot(slope * (since + 1.0), 0.01 / 200**0.5), rel=0.1)


def test_a_tilt_accelerates_and_its_uncertainty_widens_the_band(flight):
    """A uniform acceleration is added to any motion."""
    tilt, tilted = (2e-4, -1e-4), copy(flight)
    g, t = GRAVITY * np.array(tilt), flight.t[:, None]
    fall = np.hstack([0.5 * t**2 * g, np.zeros_like(t)])
    tilted.pose = flight.pose + fall
    tilted.twist = flight.twist + np.hstack([t * g, np.zeros_like(t)])
    known = BaseReaction(paper_arm(), settings=ReactionSettings(tilt=tilt))
    last = simulate(known, tilted, 2)[-1]
    k = tilted.index(last.t)
    np.testing.assert_allclose(last.predicted, tilted.pose[k], rtol=0, atol=5e-5)
    unknown = BaseReaction(paper_arm(), settings=ReactionSettings(tilt_deviation=2e-4))
    missed = simulate(unknown, tilted, 2)[-1]
    since = (missed.t - missed.anchor) * 1e-9
    added = np.sqrt(missed.predicted_deviation**2 - last.predicted_deviation**2)
    np.testing.assert_allclose(added[:2], 0.5 * since**2 * GRAVITY * 2e-4, rtol=0.02)


def test_a_base_without_poses_has_no_reaction():
    reaction = BaseReaction(paper_arm())
    assert reaction.last_known_time() == -1
    for i in range(4):
        assert reaction.add_reading(i, 0, 0.0, 0.0, 0.0)
    assert not reaction.add_reading(0, 0, 0.0, 0.0, 0.0)  # not newer
    assert reaction.last_known_time() == -1
    assert reaction.advance(0) is None


def test_readings_do_not_accumulate_before_the_first_rest():
    reaction, moving = BaseReaction(paper_arm()), 0.1
    for k in range(3000):
        t = k * SECOND // 50
        reaction.add_base_state(BodyState(t, np.zeros(3), np.zeros(3), 1e-6 * np.eye(6)))
        for i in range(4):
            reaction.add_reading(i, t, moving * 1e-9 * t, moving, 0.0)
        assert list(reaction.due(SECOND // 10)) == []
    assert max(len(joint.t) for joint in reaction.joints) < 200


def test_different_links_and_an_offset_center_of_mass():
    arm = load("config/truth.yaml")
    flight = Flight(arm, end=5.0)
    found = simulate(BaseReaction(arm), flight, 4)
    np.testing.assert_allclose(
        found[-1].predicted, flight.pose[flight.index(found[-1].t)], rtol=0, atol=5e-6
    )


def test_poses_at_a_single_time_give_no_drift():
    """The filter gives such states after stamps have jumped back."""
    reaction = BaseReaction(paper_arm())
    for t in range(0, 6_000_000_000, 200_000_000):
        for i in range(4):
            reaction.add_reading(i, t, 0.1, 0.0, 0.0)
    for _ in range(5):
        reaction.add_base_state(
            BodyState(5_000_000_000, np.zeros(3), np.zeros(3), 1e-6 * np.eye(6))
        )
    reaction.resting_since = 0
    assert reaction.advance(5_000_000_000) is None


@pytest.mark.parametrize(
    ("fired", "lasts", "known"),
    [(-10.0, 0.2, True), (2.6, 0.2, False), (2.6, np.inf, True), (2.6, 0.0, True)],
)
def test_the_difference_is_unknown_after_thrusters_fired(flight, fired, lasts, known):
    reaction = BaseReaction(paper_arm())
    reaction.add_thrust(int(fired * SECOND), [0.0, lasts])
    last = simulate(reaction, flight, 20, end=4000)[-1]
    assert np.isfinite(last.difference).all() == known
    if known:
        np.testing.assert_array_equal(last.difference, last.measured - last.predicted)


def test_reactions_are_due_in_equal_steps_and_gaps_are_skipped(monkeypatch):
    reaction, known = BaseReaction(paper_arm()), [SECOND // 4]
    monkeypatch.setattr(reaction, "last_known_time", lambda: known[0])
    monkeypatch.setattr(reaction, "advance", lambda t: setattr(reaction, "t", t) or t)
    period = SECOND // 10
    assert list(reaction.due(period)) == [period - 1, 2 * period - 1]
    assert list(reaction.due(period)) == []
    known[0] = 5 * SECOND
    assert list(reaction.due(period)) == [5 * SECOND]
