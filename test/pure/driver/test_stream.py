"""Streamed commands: what is understood, and what is refused and counted."""

import math

import pytest
from sensor_msgs.msg import JointState

from fss_arm_driver.arm.arbiter import Arbiter
from fss_arm_driver.arm.stream import MAX_LEAD, Ramp, SetPoint, Stream, StreamError
from fss_arm_driver.protocol import Mode
from fss_arm_driver.scale import Scale
from fss_arm_model.description import paper_arm
from fss_arm_model.units import SECOND

START_TIME = 1_000 * SECOND


def state(names=("joint_1",), **fields):
    return JointState(name=list(names), **{name: list(v) for name, v in fields.items()})


@pytest.fixture
def stream():
    return Stream(paper_arm(), 0.5)


def test_any_joints_in_any_order_by_what_is_filled(stream):
    names = ("joint_3", "joint_1")
    assert stream.parse(state(names, position=(0.1, -0.2))) == [
        SetPoint(3, Mode.POSITION, 0.1),
        SetPoint(1, Mode.POSITION, -0.2),
    ]
    assert stream.parse(state(names, velocity=(0.1, 9.0)))[1] == SetPoint(1, Mode.VELOCITY, 9.0)
    ((link, mode, current),) = stream.parse(state(("joint_4",), effort=(0.4,)))
    assert (link, mode, current) == (4, Mode.CURRENT, pytest.approx(0.5))  # 0.8 N m/A


REFUSED = {
    "nothing is filled": ("fields", state()),
    "position and velocity is filled": ("fields", state(position=[0.1], velocity=[0.1])),
    "position has 1 numbers for 2 names": ("fields", state(("joint_1", "joint_2"), position=[0.1])),
    "name has 'joint_2' twice": (
        "names",
        state(("joint_1", "joint_2", "joint_2"), position=[0.1, 0.1, 0.1]),
    ),
    "'joint_5', expected joint_1 to joint_4": ("names", state(("joint_5",), position=[0.1])),
    "velocity of joint_1 is nan": ("number", state(velocity=[math.nan])),
    "effort of joint_1 is inf": ("number", state(effort=[math.inf])),
    "velocity of joint_1 is 1e.18, expected a finite number of at most 1e.12": (
        "number",
        state(velocity=[1e18]),
    ),
    "effort of joint_1 is -1e.18": ("number", state(effort=[-1e18])),
    "velocity has 1000000 numbers for 1 names": ("fields", state(velocity=1_000_000 * [0.1])),
    "is 91.67 deg, expected -90 to 90 deg": ("limits", state(position=[1.6])),
}


def test_denormal_rates_and_torques_count_as_zero(stream):
    for field in ("velocity", "effort"):
        ((link, mode, value),) = stream.parse(state(**{field: [5e-324]}))
        assert Scale(paper_arm().links[link - 1]).set_point(mode, value).value == 0


@pytest.mark.parametrize("words", REFUSED)
def test_what_is_not_understood_whole_is_refused(stream, words):
    kind, message = REFUSED[words]
    with pytest.raises(StreamError, match=words) as error:
        stream.parse(message)
    assert error.value.kind == kind


def test_a_message_lives_from_its_stamp_on(stream):
    assert stream.start_time(0, START_TIME) == START_TIME
    assert stream.start_time(START_TIME - SECOND // 2, START_TIME) == START_TIME - SECOND // 2
    assert stream.start_time(START_TIME + MAX_LEAD, START_TIME) == START_TIME
    with pytest.raises(StreamError, match=r"stamp is 0.501 s old, expected less than 0.5 s"):
        stream.start_time(START_TIME - 501_000_000, START_TIME)
    words = "stamp is 0.101 s in the future, expected at most 0.1 s: synchronize the clocks"
    with pytest.raises(StreamError, match=words):
        stream.start_time(START_TIME + MAX_LEAD + 1_000_000, START_TIME)


def test_refusals_are_counted_and_a_change_is_told(stream):
    told = [stream.count_refusal(StreamError(kind, "")) for kind in ("old", "old", "names", "old")]
    assert told == [True, False, True, True]
    stream.count_accepted()
    assert stream.count_refusal(StreamError("old", ""))
    assert (stream.refused, stream.accepted) == ({"old": 4, "names": 1}, 1)


@pytest.mark.parametrize(
    ("commands", "accelerations"),
    [
        ([(0.0, 0.1), (0.1, 0.2), (0.2, 0.1)], [2.0, 1.0, 1.0]),  # linear between messages
        ([(0.0, 0.0), (1.0, 0.1), (2.0, 0.1)], [2.0, 1.0, 1.0]),  # within RAMP_TIME
        ([(0.0, 0.0), (0.02, 1.0), (0.04, 1.01)], [2.0, 2.0, 2.0]),  # 1.0 is not reached yet
        ([(0.0, 0.0), (0.1, 0.1), (0.15, 0.1)], [2.0, 1.0, 0.5]),  # as if due after 0.1 s
        ([(0.0, 0.0), (0.1, 0.0), (0.14, 0.1)], [2.0, 2.0, 1.0]),  # the same, from rest
    ],
)
def test_a_rate_is_reached_when_the_next_is_due(commands, accelerations):
    ramp = Ramp(0.0, 2.0)
    found = [ramp.acceleration(rate, time) for time, rate in commands]
    assert found == pytest.approx(accelerations, rel=1e-12)


def test_a_joint_that_lags_at_a_constant_rate_catches_up_without_a_pulse():
    ramp = Ramp(0.21, 2.0)
    rates = [0.21, 0.14, 0.07, 0.0, 0.0, 0.0]
    found = [ramp.acceleration(rate, 0.1 * k) for k, rate in enumerate(rates)]
    assert found == pytest.approx([2.0, 0.7, 0.7, 0.7, 0.7, 0.7])
    ramp = Ramp(0.01, 2.0)
    found = [ramp.acceleration(rate, 0.1 * k) for k, rate in enumerate([0.01, 0.0, 0.0])]
    assert found == pytest.approx([2.0, 0.1, 0.5])


def test_an_earlier_stamp_counts_as_the_last_one():
    ramp = Ramp(0.0, 2.0)
    for time, rate in ((1.0, 0.5), (1.1, 0.1), (1.05, 0.25), (1.11, 0.235)):
        last = ramp.acceleration(rate, time)
    assert last == pytest.approx(0.3, rel=1e-9)  # from 0.205 rad/s in 0.1 s


def test_a_ramp_ends_with_the_time_to_live_of_its_last_command():
    ramp = Ramp(0.0, 2.0)
    assert not ramp.is_current(0.0, 0.5)
    ramp.acceleration(0.1, 1.0)
    assert [ramp.is_current(time, 0.5) for time in (1.0, 1.5, 1.51)] == [True, True, False]


# --- whose turn it is ----------------------------------------------------------------------------


def test_the_newest_has_the_turn():
    turn = Arbiter()
    first = turn.start("a trajectory", 0)
    second = turn.start("a stream", 1, expiry=10)
    assert (first.end_reason, second.end_reason) == ("preempted by a stream", "")
    assert turn.is_current(second, 10)
    assert not turn.is_current(first, 10)
    turn.finish(first)
    assert turn.current_name(10) == "a stream"
    assert turn.current_name(11) == ""
    assert not turn.start("a move", 11).end_reason
    assert second.end_reason == ""  # it was over


def test_a_stop_ends_what_there_is():
    turn = Arbiter()
    turn.stop()
    motion = turn.start("a move", 0)
    turn.stop()
    assert (motion.end_reason, turn.current_name(0)) == ("stopped", "")
