"""Findings of the doctor."""

import numpy as np
import pytest
from ros_bags import FIRST, START, make_bag
from rosbags.interfaces import Qos

from fss_arm_bags.definitions import definition
from fss_arm_bags.doctor.command import main as doctor
from fss_arm_bags.doctor.health import Stream, findings, remark, streams
from fss_arm_bags.reader import Topic, open_bags
from fss_arm_bags.recorder import bag_qos
from fss_arm_model.units import SECOND
from fss_arm_ros.qos import LATCHED, SENSOR, sensor

JOINTS = "sensor_msgs/msg/JointState"


def topic(msgtype=JOINTS, qos: Qos | None = None, **change):
    known = definition(msgtype)
    made = Topic(msgtype, 1, [qos or bag_qos(SENSOR)], known.hash, known.text)
    return made._replace(**change)


def found(receipts, delay=0.003, about=None):
    """The findings on messages received at these times [s], stamped `delay` [s] earlier."""
    received = START + np.round(np.asarray(receipts) * SECOND).astype(np.int64)
    stamps = received - np.round(np.broadcast_to(delay, received.shape) * SECOND).astype(np.int64)
    return list(findings(about or topic(), Stream(received, stamps), START))


STEADY = np.arange(1000) * 0.01


def test_a_steady_stream_has_no_findings():
    assert found(STEADY) == []
    jitter = np.random.default_rng(1).normal(0.0, 0.002, len(STEADY))
    assert found(np.sort(STEADY + jitter), delay=0.02) == []


@pytest.mark.parametrize(
    ("receipts", "delay", "expected"),
    [
        (STEADY + 1.5 * (STEADY > 4.0), 0.003, "1 gap; the longest lasts 1.510 s at 4.000 s"),
        (
            STEADY + 0.3 * (STEADY > 4.0) + 0.5 * (STEADY > 6.0),
            0.003,
            "2 gaps; the longest lasts 0.510 s at 6.300 s",
        ),
        (
            STEADY,
            0.003 + 3.2 * (STEADY > 5.0),
            "1 jump of its stamps against the times of receipt, the first by -3.200 s at 5.01",
        ),
        (
            STEADY,
            0.003 - 0.7 * (STEADY > 5.0),
            "1 jump of its stamps against the times of receipt, the first by +0.700 s",
        ),
        (STEADY, 3600.0, "its stamps are 3600.000 s before the times of receipt"),
        (STEADY, -30.0, "its stamps are 30.000 s after the times of receipt"),
        ([], 0.0, "has no messages"),
    ],
)
def test_problems_of_the_times_are_reported_in_numbers(receipts, delay, expected):
    (only,) = found(receipts, delay)
    assert only.startswith(expected)


def test_a_stalled_recorder_has_no_gap():
    delayed = np.where((STEADY > 4.0) & (STEADY < 4.4), 4.4, STEADY)
    assert found(delayed, delay=0.003 + delayed - STEADY) == []


def test_delayed_messages_are_no_clock_jump():
    delayed = STEADY + 0.003
    for stall in (0.0, 2.5, 6.3):  # all received at the end of the stall, once at the start
        delayed = np.where(abs(STEADY - stall - 0.45) <= 0.45, stall + 0.9, delayed)
    assert found(delayed, delay=delayed - STEADY) == []


def test_the_pause_between_two_sessions_is_no_gap(tmp_path, capsys):
    for first in (0, 360_000):  # an hour later
        make_bag(tmp_path, 100, first=first)
    with open_bags(tmp_path) as bags:
        stream = streams(bags)["/joint_states"]
    assert stream.rate == pytest.approx(100.0)
    assert stream.longest_gap == pytest.approx(0.01)
    assert doctor([str(tmp_path)]) == 0
    assert "healthy" in capsys.readouterr().out


def test_a_slow_topic_may_have_longer_silences():
    assert found(np.arange(20) * 1.0) == []
    assert len(found(np.append(np.arange(20), 30.0))) == 1


def test_irregular_topics_have_no_gaps():
    assert found([0.0, 0.1, 0.2, 60.0], about=topic("std_msgs/msg/String")) == []


def test_best_effort_is_reported():
    (only,) = found(STEADY, about=topic(qos=bag_qos(sensor(best_effort=True))))
    assert "best effort" in only
    assert found(STEADY, about=topic(qos=bag_qos(LATCHED))) == []


def test_missing_and_changed_types_are_reported():
    missing = Topic("no_such_msgs/msg/Thing", 1, [], "RIHS01_x", "float64 x\n")
    (only,) = found(STEADY, about=missing)
    assert only == "no_such_msgs/msg/Thing is not installed; replay skips it"
    split = Topic("rosbag2_interfaces/msg/WriteSplitEvent", 1, [], "", "")
    assert found(STEADY, about=split) == []  # /events/write_split, which rosbag2 writes itself
    lost = definition(JOINTS).text.replace("string[] name", "string[] name\nfloat64 more")
    (only,) = found(STEADY, about=topic(hash="RIHS01_other", definition=lost))
    assert only == f"{JOINTS} is installed in another version; replay skips it"


def test_the_bag_of_the_first_version_is_healthy_with_a_remark(capsys):
    with open_bags(FIRST) as bags:
        remarks = {name: remark(about) for name, about in bags.topics.items()}
        by_topic = streams(bags)
    assert "earlier version" in remarks["/calibration/kinematic"]
    assert not remarks["/joint_states"]
    assert by_topic["/vicon/fss/fss"].rate == pytest.approx(10.0, rel=0.02)
    assert doctor([str(FIRST)]) == 0
    output = capsys.readouterr().out
    assert "earlier version of the type; " in output
    assert output.count("  /calibration/kinematic, /calibration/observations, ") == 1
    assert all(len(line) <= 80 for line in output.splitlines() if str(FIRST) not in line)
