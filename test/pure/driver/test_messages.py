"""A command's message as the arguments of the session's set."""

from math import inf, nan

import pytest

from fss_arm_driver.messages import command_values
from fss_arm_model.units import SECOND
from fss_arm_msgs.msg import LinkCommand
from fss_link.session import CommandError


def test_a_set_point_or_a_path_expires_after_its_time_to_live():
    message = LinkCommand(mode=LinkCommand.POSITION, set_point=0.5, path=3, time_to_live=2.0)
    message.max_velocity, message.max_acceleration = 0.1, 0.2
    assert command_values(message, SECOND) == (LinkCommand.POSITION, 0.5, 0.1, 0.2, 3 * SECOND)
    message.mode = LinkCommand.PATH
    assert command_values(message, SECOND) == (LinkCommand.PATH, 3, 0.1, 0.2, 3 * SECOND)


@pytest.mark.parametrize("lives", [0.0, -1.0, 3601.0, inf, nan])
def test_a_time_to_live_that_is_not_valid_is_refused(lives):
    with pytest.raises(CommandError, match=f"time_to_live is {lives} s, expected above 0"):
        command_values(LinkCommand(time_to_live=lives), SECOND)
