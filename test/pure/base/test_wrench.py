"""Wrenches that the base accepts, and messages that name an invalid number."""

from math import inf, nan
from operator import attrgetter

import pytest
from geometry_msgs.msg import WrenchStamped

from fss_base_driver.wrench import IN_PLANE, OUT_OF_PLANE, planar_wrench
from fss_link.session import CommandError

LIMIT = 1280.0


def wrench(frame="fss", **components):
    message = WrenchStamped()
    message.header.frame_id = frame
    message.wrench.force.x, message.wrench.force.y, message.wrench.torque.z = 1.0, -2.0, 0.5
    for name, value in components.items():
        part, _, axis = name.partition("_")
        setattr(attrgetter(part)(message.wrench), axis, value)
    return message


def test_components_in_the_plane_are_returned():
    assert planar_wrench(wrench(), "fss", LIMIT) == (1.0, -2.0, 0.5)
    nearly = wrench(force_z=1e-4, torque_x=-1e-4, torque_y=5e-324)
    assert planar_wrench(nearly, "fss", LIMIT) == (1.0, -2.0, 0.5)


@pytest.mark.parametrize("value", [nan, -inf, 1e9, -1e300])
@pytest.mark.parametrize("name", [*IN_PLANE, *OUT_OF_PLANE])
def test_a_component_that_makes_no_sense_is_named(name, value):
    largest = "1280" if name in IN_PLANE else "0.001"
    unit = "N" if name.startswith("force") else "N m"
    words = f"{name} is {value:g} {unit}, expected -{largest} to {largest} {unit}"
    with pytest.raises(CommandError) as error:
        planar_wrench(wrench(**{name.replace(".", "_"): value}), "fss", LIMIT)
    assert str(error.value) == words


@pytest.mark.parametrize("frame", ["", "world", 9000 * "x"])
def test_a_wrench_in_no_frame_or_another_is_refused(frame):
    with pytest.raises(CommandError) as error:
        planar_wrench(wrench(frame), "fss", LIMIT)
    assert str(error.value) == f"frame_id is {frame[:40]!r}, expected 'fss'"
