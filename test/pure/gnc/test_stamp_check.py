"""Verdicts on stamps: only a row of stamps of the base proves that the time has jumped."""

import pytest

from fss_arm_model.units import SECOND
from fss_gnc.navigation.stamp_check import MAX_LEAD, StampCheck, Verdict

BASE, GYRO = "vicon/fss/fss", "fog/imu"
START = 500 * SECOND
ACCEPTED, FROM_FUTURE = Verdict.ACCEPTED, Verdict.FROM_FUTURE


class Clock:
    t = 7 * SECOND  # its origin differs from that of the stamps

    def __call__(self):
        return self.t


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def stamps(clock):
    stamps = StampCheck(BASE, clock)
    assert stamps.check(BASE, START) is ACCEPTED
    return stamps


def test_the_present_passes_with_the_clock_and_never_goes_back(stamps, clock):
    assert stamps.now() == START
    clock.t += SECOND
    assert stamps.now() == START + SECOND
    stamps.check(GYRO, START + SECOND + SECOND // 2)  # only the base's stamps set the present
    assert stamps.now() == START + SECOND
    clock.t -= 5 * SECOND
    assert stamps.now() == START


def test_any_topic_sets_the_present_before_the_first_pose(clock):
    stamps = StampCheck(BASE, clock)
    assert stamps.check(GYRO, START) is ACCEPTED
    assert stamps.now() == START


def test_a_stamp_from_the_future_is_rejected(stamps):
    assert stamps.check(GYRO, START + MAX_LEAD) is ACCEPTED
    for _ in range(30):
        assert stamps.check(GYRO, START + MAX_LEAD + 1) is FROM_FUTURE
    assert stamps.now() == START
    assert stamps.topics_ahead() == [GYRO]
    assert stamps.check(GYRO, START + MAX_LEAD) is ACCEPTED
    assert stamps.topics_ahead() == []


def test_ten_stamps_of_the_base_in_a_row_prove_a_jump_forward(stamps):
    later = START + 100 * SECOND
    found = [stamps.check(BASE, later + k) for k in range(9)]
    found += [stamps.check(BASE, START + 1)]  # interrupts the row
    found += [stamps.check(BASE, later + k) for k in range(11)]
    row = [FROM_FUTURE] * 9
    assert found == [*row, ACCEPTED, *row, Verdict.JUMPED_FORWARD, ACCEPTED]
    assert stamps.now() == later + 10


@pytest.mark.parametrize("topic", [BASE, GYRO])
def test_ten_stamps_of_the_base_in_a_row_prove_a_jump_back(stamps, topic):
    stamps.check(topic, START)
    found = [stamps.check(topic, START - 100 * SECOND + k) for k in range(11)]
    jump = Verdict.JUMPED_BACK if topic == BASE else ACCEPTED
    assert found == [*[ACCEPTED] * 9, jump, ACCEPTED]
    assert stamps.now() == (START - 100 * SECOND + 10 if topic == BASE else START)
