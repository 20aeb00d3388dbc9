"""Planned motions on the whole graph: the base does what was predicted, within its errors."""

from time import monotonic

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from motion_person import Person
from running import OWN

from fss_arm_msgs.action import ExecuteMotion
from fss_arm_ros.convert import stamp_ns
from fss_rehearsal.processes import Nodes


@pytest.fixture(scope="module")
def nodes(tmp_path_factory):
    """The nodes, in lockstep with the simulated time: a busy computer ends no motion."""
    with Nodes(tmp_path_factory.mktemp("nodes"), print, OWN) as nodes:
        clock, time = {"use_sim_time": True}, {"keep_clock": True, "lockstep": True}
        nodes.start("testbed", "fss_sim", "testbed", ports=OWN.ports(4), **time)
        slack = {"timeout": 4.0, "watchdog": 6.0}
        nodes.start("link_1", "fss_arm_driver", "link", urls=OWN.urls(4), **slack, **clock)
        nodes.start("arm", "fss_arm_driver", "arm", time_to_live=4.0, **clock)
        nodes.start("base_reaction", "fss_arm_view", "base_reaction", **clock)
        nodes.start("motion", "fss_arm_motion", "motion", **clock)
        yield nodes


@pytest.fixture
def person(spin, nodes):
    person = Person(spin)
    person.begin()
    yield person
    person.mover.destroy()


def test_the_base_turns_as_predicted_or_not_at_all(person):
    ended = person.execute(kind="reorientation", arguments=["--angle", "15"])
    assert ended.result.reached, ended.result.message
    report = ended.result.report
    assert report.predicted[2] == pytest.approx(np.radians(15.0), abs=1e-3)  # and a little drift
    # Motion capture, the links' tracking, and joints that are stiff but not rigid.
    assert abs(report.measured[2] - report.predicted[2]) < np.radians(0.5)
    np.testing.assert_allclose(report.measured[:2], report.predicted[:2], atol=0.01)
    assert report.measured_excursion == pytest.approx(report.predicted_excursion, abs=0.01)
    print(report)
    person.spin(person, lambda: person.reports and person.reports[-1].header == report.header)
    assert person.feedback

    ended = person.execute(kind="zero_reaction", arguments=["--direction", "1", "0", "0", "0"])
    assert ended.result.reached, ended.result.message
    report = ended.result.report
    print(report)
    assert report.predicted_excursion < np.radians(0.2)  # by what drift there is
    assert report.measured_excursion < np.radians(1.0)  # half of it on an idle machine
    back = person.execute(kind="point_to_point", arguments=["--goal", "0", "0", "0", "0"])
    assert back.result.reached, back.result.message


def test_a_canceled_motion_comes_to_rest(person):
    handle = person.send(
        kind="point_to_point", arguments=["--goal", "60", "0", "0", "0", "--duration", "20"]
    )
    person.feedback.clear()
    person.spin(person, lambda: person.feedback, 20.0)
    person.after(handle.cancel_goal_async())
    ended = person.after(handle.get_result_async())
    assert ended.status == GoalStatus.STATUS_CANCELED
    assert ended.result.message == "canceled"


def test_the_arm_comes_to_rest_when_the_planner_is_killed_and_goes_on_with_the_next(person, nodes):
    goal = {
        "kind": "point_to_point",
        "arguments": ["--goal", "60", "0", "0", "0", "--duration", "20"],
    }
    person.truths.clear()

    def fastest():
        return np.abs(person.truths[-1].qd[3:]).max()

    deadline, reasons = monotonic() + 240.0, []
    while not person.truths or fastest() <= 0.05:  # a busy link may end the motion
        assert monotonic() < deadline, reasons
        ended = person.send(**goal).get_result_async()
        person.spin(person, lambda e=ended: e.done() or (person.truths and fastest() > 0.05), 120.0)
        if ended.done():
            reasons.append(ended.result().result.message)
            person.begin()
    nodes.processes["motion"].kill()
    killed = len(person.truths)
    person.spin(person, lambda: fastest() < 0.002, 20.0)
    rates = np.array([truth.qd[3:] for truth in person.truths[killed:]])
    took = 1e-9 * (
        stamp_ns(person.truths[-1].header.stamp) - stamp_ns(person.truths[killed - 1].header.stamp)
    )
    print(f"at rest {took:.2f} s after the planner was killed")
    assert took < 3.0  # who asked is missed within a second; then a gentle stop
    assert np.abs(rates).max() < 0.12  # no jump: the path's own rate is 0.1 rad/s at most
    there = person.truths[-1].q[3]
    person.reports.clear()
    nodes.restart_killed()
    home = ExecuteMotion.Goal(kind="point_to_point", arguments=["--goal", "0", "0", "0", "0"])
    deadline, reasons = monotonic() + 240.0, []
    while not person.reports:  # the dead server counts as ready for 20 s; a busy link ends a motion
        assert monotonic() < deadline, reasons
        sent, again = person.mover.send_goal_async(home), monotonic() + 10.0
        person.spin(person, lambda f=sent, t=again: f.done() or monotonic() > t, 20.0)
        if not reasons:  # no jump as it comes back
            assert person.truths[-1].q[3] == pytest.approx(there, abs=0.005)
        if sent.done() and sent.result().accepted:
            reasons.append(person.after(sent.result().get_result_async()).result.message)
    assert person.truths[-1].q[3] == pytest.approx(0.0, abs=0.01)
