"""Commands are as old as their stamps; those without, or with a wrong one, are refused."""

import pytest

from fss_arm_model.units import SECOND
from fss_base_driver.command_time import command_time
from fss_link.host_clock import HostClock
from fss_link.session import CommandError

START_TIME, OFFSET = 50 * SECOND, 1_700_000_000 * SECOND
CLOCK = HostClock(lambda: START_TIME, lambda: START_TIME + OFFSET)


def test_it_is_in_the_steady_clock_and_not_in_the_future():
    def time_given(age):
        return command_time(START_TIME + OFFSET - round(age * SECOND), CLOCK, 0.3)

    assert time_given(0.2) == START_TIME - SECOND // 5
    assert time_given(0.3) == START_TIME - 3 * SECOND // 10
    assert time_given(-0.5) == START_TIME


@pytest.mark.parametrize(
    ("stamp", "words"),
    [
        (0, "it has no stamp, so it could be an old recording"),
        (START_TIME + OFFSET - SECOND, "it is 1.000 s old, expected at most 0.3 s"),
        *((SECOND * sec, "s old, expected at most 0.3 s") for sec in (-(2**31), -1, 1, 2**31 - 1)),
        (START_TIME + OFFSET + SECOND, "it is -1.000 s old, expected at most 0.3 s"),
    ],
)
def test_a_wrong_stamp_is_refused(stamp, words):
    with pytest.raises(CommandError, match=words):
        command_time(stamp, CLOCK, 0.3)
