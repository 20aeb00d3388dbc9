"""The policy for changing messages: what was recorded with the first version stays readable."""

from collections import Counter

import numpy as np
import pytest
from ros_bags import FIRST, make_before_and_after
from rosbags.rosbag2 import Reader

from fss_arm_bags.definitions import definition, extends, message_class, upgrade
from fss_arm_bags.doctor.command import main as doctor
from fss_arm_bags.reader import BagError, open_bags
from fss_arm_calib.from_bag import solve_bag
from fss_arm_calib.kinematic.kind import KINEMATIC


def test_all_of_the_first_bag_is_read_and_is_of_types_that_only_grew():
    with open_bags(FIRST) as bags, Reader(FIRST) as strict:
        assert not bags.recovered
        got = Counter(topic for topic, *_ in bags.messages())
        assert got.total() == strict.message_count > 2000
        for topic, about in bags.topics.items():
            assert got[topic] == about.messages > 0
            assert extends(about.msgtype, about.definition), topic
        for _, msgtype, _, message in bags.messages():
            upgrade(message, message_class(msgtype))  # field checks are on


def test_bags_from_before_and_after_a_type_grew_are_not_misread(tmp_path, capsys):
    said = "contain two versions of fss_arm_msgs/msg/KinematicCalibration: open them one by one"
    before_and_after = make_before_and_after(tmp_path)
    with open_bags(before_and_after) as bags:
        assert bags.topics["/joint_states"].messages > 0
        assert sum(1 for _ in bags.messages({"/joint_states", "/link_1/telemetry"})) > 0
        with pytest.raises(BagError, match=said):
            list(bags.messages({"/calibration/kinematic"}))
    assert doctor([str(before_and_after)]) == 2
    assert f"/calibration/kinematic: the bags {said}" in capsys.readouterr().out


def test_the_first_bag_gives_the_result_that_was_found_then():
    with open_bags(FIRST) as bags:
        ((_, _, _, then),) = bags.messages({"/calibration/kinematic"})
    then = then.calibration
    now = solve_bag(KINEMATIC, FIRST, KINEMATIC.settings(arm="config/cad.yaml"))
    assert (now.verdict, list(now.names)) == (then.verdict, list(then.names))
    deviations = np.sqrt(np.diag(np.reshape(then.covariance, (len(then.names), -1))))
    # The poses were thinned to a tenth when the bag was put away.
    assert (np.abs(now.values - then.values) < deviations).all()


@pytest.mark.parametrize(
    ("change", "grew"),
    [
        (("float64 time_to_live", "float64 time_to_live\nfloat64 another"), False),
        (("float64 time_to_live", "float32 time_to_live"), False),
        (("uint8 mode ", "uint8 kind "), False),
        (("float64 time_to_live", "# float64 time_to_live"), True),
        (("builtin_interfaces/Time stamp", "int64 stamp"), False),
    ],
)
def test_a_type_that_lost_or_changed_a_field_is_told_from_one_that_grew(change, grew):
    text = definition("fss_arm_msgs/msg/LinkCommand").text
    assert text.replace(*change) != text
    assert extends("fss_arm_msgs/msg/LinkCommand", text.replace(*change)) is grew
