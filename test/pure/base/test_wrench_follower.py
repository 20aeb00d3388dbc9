"""A wrench becomes pulses once a period, until it is too old; stuck valves get no share."""

from collections import Counter
from math import inf, nan
from types import SimpleNamespace

import numpy as np
import pytest
from geometry_msgs.msg import WrenchStamped

from fss_arm_model.units import SECOND
from fss_base_driver.protocol import VALVES
from fss_base_driver.settings import BaseSettings, ValveSettings
from fss_base_driver.stuck_valves import describe_stuck_valves, stuck_valves
from fss_base_driver.wrench_follower import WrenchFollower
from fss_link.session import CommandError

START = 100 * SECOND
SETTINGS = BaseSettings()  # a period of 0.1 s, a lifetime of 0.3 s


def push(x):
    """A wrench along the base's x axis."""
    message = WrenchStamped()
    message.header.frame_id, message.wrench.force.x = "fss", x
    return message


class Session:
    """A session that takes all pulses, if it is armed."""

    def __init__(self):
        self.counts, self.armed, self.on_times = Counter(), True, []

    def thrust(self, on_times, given, now):
        if not self.armed:
            raise CommandError("not armed")
        assert given == now
        self.on_times.append(on_times)


@pytest.fixture
def follower():
    return WrenchFollower(SETTINGS)


@pytest.fixture
def session():
    return Session()


def test_a_wrench_is_allocated_until_it_is_too_old(follower, session):
    assert not follower.command_pulses(session, START)
    follower.follow(push(-0.05), START)
    for age in (0.0, 0.1, 0.2, 0.3):
        assert follower.command_pulses(session, START + round(age * SECOND))
        assert follower.active
        assert (np.array(session.on_times[-1]) @ SETTINGS.valves())[0] < 0.0
    assert not follower.command_pulses(session, START + round(0.3 * SECOND) + 1)
    assert not follower.active
    assert len(session.on_times) == 4


def test_a_zero_wrench_closes_once(follower, session):
    follower.follow(push(0.0), START)
    assert follower.command_pulses(session, START)
    assert session.on_times == [VALVES * [0.0]]
    assert not follower.active


def test_a_wrench_that_is_not_valid_replaces_none(follower, session):
    follower.follow(push(-0.05), START)
    for x in (nan, inf, 1.01 * SETTINGS.max_wrench()):
        with pytest.raises(CommandError, match=r"force\.x is"):
            follower.follow(push(x), START)
    assert follower.command_pulses(session, START)


def test_a_canceled_wrench_opens_nothing(follower, session):
    follower.follow(push(-0.05), START)
    follower.cancel()
    assert not follower.command_pulses(session, START)
    assert session.on_times == []


def test_a_wrench_from_before_the_clock_was_set_back_opens_nothing(follower, session):
    """Otherwise it would stay active until the clock reaches its time again."""
    follower.follow(push(-0.05), START)
    assert follower.command_pulses(session, START)
    assert follower.is_due(START - 50 * SECOND)
    assert not follower.command_pulses(session, START - 50 * SECOND)
    assert not follower.active
    assert len(session.on_times) == 1


def test_a_rejected_wrench_opens_nothing_after_the_board_is_armed_again(follower, session):
    follower.follow(push(-0.05), START)
    session.armed = False
    with pytest.raises(CommandError):
        follower.command_pulses(session, START)
    session.armed = True
    assert not follower.command_pulses(session, START)
    assert session.on_times == []


def test_the_next_pulses_are_due_after_a_period(follower, session):
    assert follower.is_due(START)
    follower.follow(push(-0.05), START)
    session.armed = False
    with pytest.raises(CommandError):
        follower.command_pulses(session, START)
    assert follower.is_due(START)  # none were commanded
    session.armed = True
    follower.follow(push(-0.05), START)
    follower.command_pulses(session, START)
    assert not follower.is_due(START + SECOND // 10 - 1)
    assert follower.is_due(START + SECOND // 10)


def test_an_impulse_is_carried_over_but_not_beyond_the_wrench(follower, session):
    def opened():
        """In which of four periods a valve opens."""
        session.on_times.clear()
        follower.follow(push(0.01), START)
        for _ in range(4):
            follower.command_pulses(session, START)
        return [any(times) for times in session.on_times]

    first = opened()
    assert any(first)
    assert not all(first)
    follower.command_pulses(session, START + SECOND)
    assert opened() == first


def test_a_wrench_beyond_the_working_valves_is_counted(follower, session):
    follower.follow(push(0.31), START)
    follower.command_pulses(session, START)
    assert session.counts["wrenches_clipped"] == 0
    follower.exclude((), [int(SETTINGS.valves()[:, 0].argmax())])
    follower.command_pulses(session, START)
    assert session.counts["wrenches_clipped"] == 1


def test_valves_are_stuck_by_parameter_or_as_detected():
    configured = {f"valve_{i}": ValveSettings() for i in range(1, VALVES + 1)}
    configured["valve_2"] = ValveSettings(stuck_open=1.0)
    detected = SimpleNamespace(stuck_open=VALVES * [False], stuck_closed=VALVES * [False])
    detected.stuck_open[7] = detected.stuck_closed[0] = detected.stuck_closed[7] = True
    assert stuck_valves(configured, detected) == ([1, 7], [0, 7])
    assert describe_stuck_valves(configured, detected) == {
        "valve_2 is configured as": "stuck open",
        "valve_8 is detected as": "stuck open and stuck closed",
        "valve_1 is detected as": "stuck closed",
    }
