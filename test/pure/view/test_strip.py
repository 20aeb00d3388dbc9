"""Items of the strip above the view, and their styles."""

from math import nan, radians

import pytest

from fss_arm_msgs.msg import BaseTelemetry, GripperState, LinkTelemetry
from fss_arm_view.strip import (
    ALARM,
    BASE,
    GRIPPER,
    HEADING,
    NEUTRAL,
    POSITIVE,
    PROPELLANT,
    WARNING,
    Item,
    Strip,
)

BEGIN = 10.0  # time at which all messages are received [s]


def links(**changes):
    """Return telemetry of two links, with changes to link 2."""
    link_1 = LinkTelemetry(link=1, battery=165)
    link_2 = LinkTelemetry(link=2, **{"battery": 160, **changes})
    return {1: (link_1, BEGIN), 2: (link_2, BEGIN)}


def strip(**values):
    """Return the strip of a vehicle of two links whose base is seen."""
    return Strip(2, pose_received=BEGIN, **values)


def test_without_messages_it_says_what_is_missing():
    assert Strip(2).items(BEGIN) == [
        ("arm", "unknown", NEUTRAL),
        ("motion capture", "base not seen yet", ALARM),
    ]


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
    assert strip(links=links(**changes)).items(now)[0] == first


def test_without_telemetry_state_and_battery_of_the_arm_are_unknown():
    assert Item("lowest battery", "16.0 V, link 2") in strip(links=links()).items(11.0)
    names = {name: value for name, value, _ in strip(links=links(armed=True)).items(14.0)}
    assert names["arm"] == "unknown"
    assert "lowest battery" not in names


def test_a_link_that_never_sent_telemetry_is_named():
    items = Strip(3, links=links(armed=True), pose_received=BEGIN).items(11.0)
    assert items[:2] == [("no telemetry", "link 3", ALARM), ("arm", "1 of 3 armed", NEUTRAL)]


def values():
    """Return a value of each item, received at BEGIN."""
    return {
        BASE: (BaseTelemetry(armed=True, battery=121), BEGIN),
        PROPELLANT: (0.0421, BEGIN),
        GRIPPER: (GripperState(closed=True), BEGIN),
        HEADING: ((radians(-0.5), radians(0.2)), BEGIN),
    }


def test_base_gripper_propellant_and_verdicts_are_shown():
    verdicts = {"kinematic": "pass", "dynamic": "fail", "drift": "not_evaluated"}
    shown = strip(values=values(), verdicts=verdicts)
    shown.add_report("/fss2/link_1", "link_1 is lost", 0, BEGIN)
    assert shown.items(11.0)[1:] == [
        ("base", "armed, 12.1 V", NEUTRAL),
        ("propellant", "42 g", NEUTRAL),
        ("gripper", "closed", NEUTRAL),
        (HEADING, "-0.50 ± 0.20 deg", NEUTRAL),
        ("kinematic", "pass", POSITIVE),
        ("dynamic", "fail", ALARM),
        ("drift", "not_evaluated", WARNING),
        ("fss2/link_1", "link_1 is lost", ALARM),
    ]


def test_values_without_new_messages_are_no_longer_shown():
    shown = Strip(2, values=values(), pose_received=22.0)
    assert shown.items(22.0)[1:] == [
        (name, "no data for 12 s", WARNING) for name in (BASE, PROPELLANT, GRIPPER, HEADING)
    ]


def test_errors_and_missed_deadlines_are_shown_while_reported():
    shown = strip()
    for error, missed in (("", 7), ("failed", 9)):
        shown.add_report("/controller", error, missed, BEGIN)
    assert shown.items(11.0)[1:] == [
        ("deadlines missed now", "controller 2", WARNING),
        ("controller", "failed", ALARM),
    ]
    shown.pose_received = 17.0
    assert shown.items(17.0)[1:] == []  # its node has ended
    shown.add_report("/controller", "", 9, 17.0)
    assert shown.items(17.0)[1:] == []


@pytest.mark.parametrize(
    ("sigma", "style", "words"), [(0.2, NEUTRAL, ""), (0.1, ALARM, ", beyond 3 sigma")]
)
def test_a_heading_that_differs_by_more_than_three_sigma_is_an_alarm(sigma, style, words):
    difference = radians(-0.5), radians(sigma)
    item = strip(values={HEADING: (difference, BEGIN)}).items(BEGIN)[-1]
    assert item[1:] == (f"-0.50 ± {sigma:.2f} deg{words}", style)


def test_unknown_values_are_not_shown():
    unknown = {PROPELLANT: (nan, BEGIN), HEADING: ((nan, 0.1), BEGIN)}
    assert strip(values=unknown).items(BEGIN) == [("arm", "unknown", NEUTRAL)]


def test_a_base_that_is_not_seen_is_an_alarm():
    assert strip().items(12.0)[1:] == []
    assert strip().items(15.4)[1:] == [Item("motion capture", "base not seen for 5 s", ALARM)]
