"""Recorded results computed again from what was recorded with them."""

import struct

import pytest
from calib_rig import ARM
from rclpy.serialization import serialize_message

from fss_arm_calib.messages import observations_message, to_message
from fss_arm_calib.postures import DEFAULT
from fss_arm_calib.recompute import RESULTS, main
from fss_arm_calib.rests import TIP, Observation
from fss_arm_calib.settings import CalibrationSettings
from fss_arm_calib.verdict import calibrate
from fss_arm_model.kinematics import tip_in_base
from fss_arm_msgs.msg import KinematicCalibration
from fss_arm_ros.qos import LATCHED
from fss_arm_ros.recording import Recording

SETTINGS = CalibrationSettings(max_outliers=2, loss="huber")


@pytest.fixture
def published():
    """Observations and result after each rest."""
    tips = tip_in_base(ARM.vector(), DEFAULT) + 0.01
    tips[4] += 0.5
    rests = [
        Observation(k, k + 1, tuple(q), tuple(tip))
        for k, (q, tip) in enumerate(zip(DEFAULT.tolist(), tips.tolist(), strict=True))
    ]
    rests.insert(7, Observation(7, 8, rests[7].q, used=False, reason="a gap"))
    found = []
    for count in range(1, len(rests) + 1):
        result = calibrate(rests[:count], ARM, SETTINGS)
        observations = observations_message(rests[:count], "fss", TIP)
        found.append((observations, to_message(result, "fss")))
    return found


def serialized(message):
    """As a publisher does it: serialize_message leaves some bytes more at the end."""
    data = serialize_message(message)
    if isinstance(message, KinematicCalibration):
        last = struct.pack("<d", message.time_offset_deviation)
        data = data[: data.rindex(last) + len(last)]
    return data


def record(folder, published, topics=("/calibration/observations", RESULTS)):
    bag = Recording(folder)
    for topic, message in zip(topics, published[0], strict=False):
        bag.add(topic, f"fss_arm_msgs/msg/{type(message).__name__}", [LATCHED])
    for k, pair in enumerate(published):
        for topic, message in zip(topics, pair, strict=False):
            bag.write(topic, 10 * k + 1, serialized(message))
    bag.close()
    return str(bag.path)


def test_every_result_follows_from_its_observations(published, tmp_path, capsys):
    assert main([record(tmp_path, published)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 14
    assert lines[0] == "1 observations, not_evaluated: the same, to 0.0e+00"
    assert all("the same, to " in line for line in lines)
    assert lines[-1].startswith("13 observations, ")


def test_a_result_that_does_not_is_told(published, tmp_path, capsys):
    published[-1][1].values[2] += 1e-8
    assert main([record(tmp_path, published)]) == 2
    assert capsys.readouterr().out.splitlines()[-1].endswith("NOT the same, to 1.0e-08")


def test_what_is_missing_is_named(published, tmp_path, capsys):
    assert main([record(tmp_path / "a", published, ["/calibration/observations"])]) == 1
    assert f"no result on {RESULTS} in " in capsys.readouterr().err
    others = [(published[0][0], result) for _, result in published]
    assert main([record(tmp_path / "b", others)]) == 1
    error = capsys.readouterr().err
    assert error == "recompute: a result from 2 observations was recorded without them\n"
    assert main(["/nowhere"]) == 1
    assert "no such file" in capsys.readouterr().err
