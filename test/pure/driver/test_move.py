"""Moves in which all joints arrive together."""

from dataclasses import replace
from math import inf, nan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fss_arm_driver.arm.move import MoveError, check, plan
from fss_arm_driver.protocol import Mode
from fss_arm_driver.scale import Scale
from fss_arm_model.description import Drive, paper_arm
from fss_arm_model.free_floating import free_torques
from fss_arm_model.straight_moves import TORQUE_SHARE

ARM = paper_arm()
ANGLE = st.floats(-1.5, 1.5)


def time_of(way, velocity, acceleration):
    """Duration of a trapezoid from rest to rest."""
    if velocity**2 < way * acceleration:
        return way / velocity + velocity / acceleration
    return 2.0 * (way / acceleration) ** 0.5


def arrivals(q, move):
    """Arrival and velocity of each moving joint, from the values in a frame."""
    for a, link, part in zip(q, ARM.links, move.profiles, strict=True):
        if part.velocity:
            scale = Scale(link)
            order = scale.set_point(Mode.POSITION, part.target, part.velocity, part.acceleration)
            assert not order.clamped
            velocity = order.velocity * scale.velocity_step
            acceleration = order.acceleration * scale.acceleration_step
            yield time_of(abs(part.target - a), velocity, acceleration), velocity


@given(st.tuples(*[ANGLE] * 4), st.tuples(*[ANGLE] * 4), st.floats(0.0, 3600.0))
def test_all_joints_take_the_same_time_within_their_limits(q, goal, duration):
    move = plan(ARM, q, goal, duration)
    if any(abs(a - b) > 1e-9 for a, b in zip(q, goal, strict=True)):
        assert move.duration >= duration
    for part in move.profiles:
        assert part.velocity <= 1.0
        assert part.acceleration <= 2.0
    step = Scale(ARM.links[0]).velocity_step
    for time, velocity in arrivals(q, move):
        assert move.duration * (0.99 - step / velocity) <= time <= move.duration * 1.01


@pytest.mark.parametrize("duration", [0.0, 10.0, 60.0])
def test_long_and_short_ways_arrive_together(duration):
    q = (0.0,) * 4
    move = plan(ARM, q, (1.5, 0.1, -0.02, 0.0), duration)
    times = [time for time, _ in arrivals(q, move)]
    assert times == pytest.approx([move.duration] * 3, rel=0.01)


@given(st.tuples(*[ANGLE] * 4), st.tuples(*[ANGLE] * 4), st.floats(0.0, 60.0))
def test_where_the_joints_are_to_be_in_between(q, goal, duration):
    move, h = plan(ARM, q, goal, duration), 1e-3
    assert move.at(-1.0) == (pytest.approx(q, abs=1e-9), (0.0,) * 4)
    assert move.at(move.duration + 1.0)[0] == pytest.approx(goal, abs=1e-9)
    for share in (0.1, 0.4, 0.5, 0.9):
        t = share * move.duration
        (here, rates), after = move.at(t), move.at(t + h)[0]
        for a, b, rate, part in zip(here, after, rates, move.profiles, strict=True):
            assert abs(rate) <= part.velocity + 1e-12
            assert abs((b - a) / h - rate) <= part.acceleration * h + 1e-9


def test_the_slowest_joint_sets_the_pace():
    links = (replace(ARM.links[0], drive=Drive(max_velocity=0.1)), *ARM.links[1:])
    move = plan(replace(ARM, links=links), (0.0,) * 4, (0.5, 1.0, -1.5, 0.0))
    assert [part.target for part in move.profiles] == [0.5, 1.0, -1.5, 0.0]
    velocities = [part.velocity for part in move.profiles]
    assert velocities == pytest.approx([0.1, 0.2, 0.3, 0.0], abs=3e-6)
    assert move.duration == pytest.approx(5.0 + 0.3 / 2.0)


def torque_share(arm, move, frames=400):
    """Largest share of the drives' torque that a move of an arm without momentum uses."""
    t = (np.arange(frames) + 0.5) / frames * move.duration
    states, h = [move.at(time) for time in t], 1e-6
    rates = [(np.array(move.at(x + h)[1]) - move.at(x - h)[1]) / (2.0 * h) for x in t]
    angles, speeds = (np.array(part) for part in zip(*states, strict=True))
    torques = free_torques(arm.vector(), angles, speeds, np.array(rates))[0]
    limits = [k.drive.torque_constant * k.drive.max_current for k in arm.links]
    return float(np.max(np.abs(torques) / limits))


def test_no_move_needs_more_torque_than_the_drives_have():
    """A drive that cannot follow its profile stops with a tracking error."""
    rng, shares, factors = np.random.default_rng(1), [], []
    strong = replace(ARM, links=tuple(replace(k, drive=Drive(max_current=1e6)) for k in ARM.links))
    for _ in range(100):
        q, goal = (tuple(row) for row in rng.uniform(-1.5, 1.5, (2, 4)))
        move = plan(ARM, q, goal)
        shares.append(torque_share(ARM, move))
        factors.append(move.duration / plan(strong, q, goal).duration)
    # The torque is sampled at 31 times of a move; profiles are rounded to steps of frames.
    assert max(shares) < 1.02 * TORQUE_SHARE
    assert min(s for s, f in zip(shares, factors, strict=True) if f > 1.001) > 0.99 * TORQUE_SHARE
    assert max(factors) > 1.2
    assert sum(f == 1.0 for f in factors) > 5


def test_no_way_takes_no_time():
    assert plan(ARM, (0.1,) * 4, (0.1,) * 4).duration == 0.0


@pytest.mark.parametrize(
    ("goal", "duration", "words"),
    [
        ((0.0,) * 3, 0.0, "q has 3 joints, expected 4"),
        ((0.0, 0.0, 1.7, 0.0), 0.0, "q of joint 3 is 97.4 deg, expected -90 to 90"),
        ((0.0, nan, 0.0, 0.0), 0.0, "q of joint 2 is nan"),
        *(((0.1,) * 4, time, "duration is")
          for time in (nan, inf, -inf, 1e18, -1e18, -1.0, -5e-324)),
        ((0.1,) * 4, 1e200, r"duration is 1e\+200 s, expected 0 to 3600"),
        ((), 0.0, "q has 0 joints, expected 4"),
        ((0.0,) * 1_000_000, 0.0, "q has 1000000 joints, expected 4"),
        *((tuple(q if i == k else 0.0 for i in range(4)), 0.0, f"q of joint {k + 1} is")
          for k in range(4) for q in (nan, inf, -inf, 1e18, -1e18)),
    ],
)  # fmt: skip
def test_moves_that_must_not_be_begun_are_refused(goal, duration, words):
    with pytest.raises(MoveError, match=words):
        plan(ARM, (0.0,) * 4, goal, duration)


def test_denormal_numbers_of_a_move_count_as_zero():
    assert plan(ARM, (0.0,) * 4, (5e-324,) * 4).duration == 0.0
    assert plan(ARM, (0.0,) * 4, (0.1,) * 4, 5e-324) == plan(ARM, (0.0,) * 4, (0.1,) * 4)


@pytest.mark.parametrize("keep_alive", [nan, inf, -inf, 1e18, -1.0, 5e-324, 0.04])
def test_a_client_promises_to_confirm_within_reason(keep_alive):
    with pytest.raises(MoveError, match="keep_alive is"):
        check(ARM, (0.0,) * 4, keep_alive=keep_alive)
    for possible in (0.0, 0.05, 3600.0):
        check(ARM, (0.0,) * 4, keep_alive=possible)
