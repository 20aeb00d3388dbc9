"""The strip above the view: what it says, and in which tone."""

import json
from math import radians

import pytest

from fss_arm_msgs.msg import BaseTelemetry, GripperState, LinkTelemetry
from fss_arm_view.strip import ALARM, GOOD, PLAIN, WARN, Item, Strip, told


def links(**changes):
    """Two links; the changes are of link 2."""
    plain = LinkTelemetry(link=1, battery=165)
    return {1: (plain, 10.0), 2: (LinkTelemetry(link=2, **{"battery": 160, **changes}), 10.0)}


def test_nothing_heard_is_nothing_said():
    assert Strip().items(10.0) == []


@pytest.mark.parametrize(
    ("changes", "now", "first"),
    [
        ({}, 11.0, Item("arm", "disarmed", PLAIN)),
        ({"armed": True}, 11.0, Item("arm", "1 of 2 armed", WARN)),
        ({"flags": 2, "armed": False}, 11.0, Item("STOPPED", "link 2", ALARM)),
        ({"faults": 4}, 11.0, Item("fault", "link 2", ALARM)),
        ({}, 14.0, Item("silent", "link 1, 2", ALARM)),
    ],
)
def test_what_must_not_be_overlooked_comes_first(changes, now, first):
    items = Strip(links=links(**changes)).items(now)
    assert items[0] == first
    assert Item("lowest battery", "16.0 V, link 2") in items


def test_base_gripper_propellant_and_verdicts_are_said():
    base, gripper = BaseTelemetry(armed=True, battery=121), GripperState(closed=True)
    verdicts = {"kinematic": "pass", "dynamic": "fail", "drift": "not_evaluated"}
    strip = Strip(base=base, gripper=gripper, propellant=0.0421, verdicts=verdicts)
    strip.troubles["/fss2/link_1"] = "link_1 is lost"
    assert strip.items(0.0) == [
        ("base", "armed, 12.1 V", WARN),
        ("propellant", "42 g", PLAIN),
        ("gripper", "closed", PLAIN),
        ("kinematic", "pass", GOOD),
        ("dynamic", "fail", ALARM),
        ("drift", "not_evaluated", WARN),
        ("fss2/link_1", "link_1 is lost", ALARM),
    ]


@pytest.mark.parametrize(("sigma", "tone"), [(0.2, PLAIN), (0.1, ALARM)])
def test_a_heading_that_differs_by_more_than_three_sigma_is_an_alarm(sigma, tone):
    (item,) = Strip(turn=(radians(-0.5), radians(sigma))).items(0.0)
    assert item[1:] == (f"-0.50 ± {sigma:.2f} deg", tone)


def test_stamps_come_to_the_page_whole():
    stamp = 1_795_389_413_875_653_034  # which a number of JavaScript would round
    said = json.loads(told(stamp, 0.24, {"fss1": [Item("arm", "disarmed")]}))
    assert int(said["newest"]) == stamp
    assert said["vehicles"] == [{"name": "fss1", "items": [["arm", "disarmed", ""]]}]
