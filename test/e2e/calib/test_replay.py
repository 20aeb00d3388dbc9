"""A recorded experiment replayed into the node `dynamic`, at any rate: the result is the same."""

import numpy as np
import pytest
from calib_float import ARM, TYPES, Float, postures, record
from rclpy.node import Node
from std_srvs.srv import Trigger

from fss_arm_calib.from_bag import solve_bag
from fss_arm_calib.kinds import KINDS
from fss_arm_calib.recompute import recompute
from fss_arm_msgs.msg import DynamicCalibration, Maneuvers
from fss_arm_ros.qos import LATCHED

PRECISE = {
    "position_deviation": 0.0005,
    "heading_deviation": 0.001,
    "max_relative": 3.0,
    "max_place": 0.1,
}
STATE = np.array([0.1, 0.2, 3.0, 0.1, -0.1, 0.02, 0.0002, -0.0001])


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """Eight maneuvers, VICON at 20 Hz with fresh errors ten times a second: about a minute."""
    rig = Float(postures(8, seed=3), ARM.vector(), STATE, rest=2.6, noise=(0.0005, 0.001))
    return record(tmp_path_factory.mktemp("bags"), rig.samples(rate=20))


@pytest.mark.slow
@pytest.mark.parametrize("rate", [0.0, 0.5, 1.0, 5.0, 20.0])
def test_the_result_is_that_of_the_bag(bag, start, spin, rate):
    kind = KINDS["dynamic"]
    offline = solve_bag(kind, bag, kind.settings(**PRECISE))
    assert offline.verdict == "pass", offline.reason
    assert len(offline.data) == 8

    given = [word for k, v in PRECISE.items() for word in ("-p", f"{k}:={v}")]
    start("fss_arm_calib.programs:dynamic", "--ros-args", *given)
    node, got, told = Node("asks"), [], []
    node.create_subscription(DynamicCalibration, "calibration/dynamic", got.append, LATCHED)
    node.create_subscription(Maneuvers, "calibration/maneuvers", told.append, LATCHED)
    client = node.create_client(Trigger, "dynamic/solve")
    replay = start(
        "fss_arm_bags.replay_node", bag, "--ros-args", "-p", f"rate:={rate}",
        "-p", f"wait_for:={list(TYPES)}", "-p", "deadline:=60.0",
    )  # fmt: skip
    assert replay.wait(240) == 0, replay.output
    assert client.wait_for_service(20.0)
    answer = client.call_async(Trigger.Request())
    spin(node, answer.done, 60.0)
    live = spin(node, lambda: got and got[-1].calibration.used == 8 and got[-1], 20.0)
    assert live.calibration.provenance.data_hash == offline.provenance.data_hash
    for name in ("values", "covariance", "residuals"):
        np.testing.assert_allclose(
            getattr(live.calibration, name),
            getattr(offline.estimate, name).ravel(),
            rtol=0,
            atol=1e-9,
        )
    # What was published is enough to compute it again.
    assert spin(node, lambda: told and recompute(kind, live, told[-1]), 20.0).same
