"""Items of the strip above the view, and their styles."""

from math import radians

import pytest

from fss_arm_msgs.msg import BaseTelemetry, GripperState, LinkTelemetry
from fss_arm_view.strip import ALARM, NEUTRAL, POSITIVE, WARNING, Item, Strip


def links(**changes):
    """Return telemetry of two links, with changes to link 2."""
    link_1 = LinkTelemetry(link=1, battery=165)
    return {1: (link_1, 10.0), 2: (LinkTelemetry(link=2, **{"battery": 160, **changes}), 10.0)}


def test_without_messages_there_are_no_items():
    assert Strip().items(10.0) == []


@pytest.mark.parametrize(
    ("changes", "now", "first"),
    [
        ({}, 11.0, Item("arm", "disarmed", NEUTRAL)),
        ({"armed": True}, 11.0, Item("arm", "1 of 2 armed", NEUTRAL)),
        ({"flags": 2, "armed": False}, 11.0, Item("STOPPED", "link 2", ALARM)),
        ({"faults": 4}, 11.0, Item("fault", "link 2", ALARM)),
        ({}, 14.0, Item("no telemetry", "link 1, 2", ALARM)),
    ],
)
def test_alarms_come_first(changes, now, first):
    items = Strip(links=links(**changes)).items(now)
    assert items[0] == first
    assert Item("lowest battery", "16.0 V, link 2") in items


def test_without_telemetry_it_is_unknown_whether_the_arm_is_armed():
    assert Item("arm", "unknown") in Strip(links=links(armed=True)).items(14.0)


def test_base_gripper_propellant_and_verdicts_are_shown():
    base, gripper = BaseTelemetry(armed=True, battery=121), GripperState(closed=True)
    verdicts = {"kinematic": "pass", "dynamic": "fail", "drift": "not_evaluated"}
    strip = Strip(base=base, gripper=gripper, propellant=0.0421, verdicts=verdicts)
    strip.add_report("/fss2/link_1", "link_1 is lost", 0, 0.0)
    assert strip.items(0.0) == [
        ("base", "armed, 12.1 V", NEUTRAL),
        ("propellant", "42 g", NEUTRAL),
        ("gripper", "closed", NEUTRAL),
        ("kinematic", "pass", POSITIVE),
        ("dynamic", "fail", ALARM),
        ("drift", "not_evaluated", WARNING),
        ("fss2/link_1", "link_1 is lost", ALARM),
    ]


def test_errors_and_missed_deadlines_are_shown_while_reported():
    strip = Strip()
    for error, missed in (("failed", 7), ("", 9)):
        strip.add_report("/controller", error, missed, 1.0)
    assert strip.items(2.0) == [("deadlines missed now", "controller 2", WARNING)]
    assert strip.items(9.0) == []  # its node has ended
    strip.add_report("/controller", "", 9, 2.0)
    assert strip.items(2.0) == []


@pytest.mark.parametrize(
    ("sigma", "style", "words"), [(0.2, NEUTRAL, ""), (0.1, ALARM, ", beyond 3 sigma")]
)
def test_a_heading_that_differs_by_more_than_three_sigma_is_an_alarm(sigma, style, words):
    (item,) = Strip(heading_difference=(radians(-0.5), radians(sigma))).items(0.0)
    assert item[1:] == (f"-0.50 ± {sigma:.2f} deg{words}", style)


def test_a_base_that_is_not_seen_is_an_alarm():
    assert Strip(pose_received=10.0).items(12.0) == []
    assert Strip(pose_received=10.0).items(15.4) == [
        Item("motion capture", "base not seen for 5 s", ALARM)
    ]
