"""A recording replayed, at any rate, to the nodes: `joint`, late and killed, is as from the bag."""

import json

import numpy as np
import pytest
import yaml
from calib_float import TYPES, Float, at, postures, record
from calib_kinds import CLOSELY, STATE, TRUTH
from rclpy.node import Node

from fss_arm_calib.from_bag import main as from_bag
from fss_arm_calib.kinds import KINDS
from fss_arm_msgs.msg import JointCalibration
from fss_arm_ros.qos import LATCHED


def given(settings):
    words = [word for k, v in settings.items() for word in ("-p", f"{k}:={v}")]
    return ["--ros-args", *words]


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """It ends amid the last motion: nobody needs to close what lasts."""
    flight = Float(postures(10, seed=3), TRUTH.vector(), STATE, noise=(0.0005, 0.001))
    end = at(flight.begins[-1] + 1.0)
    samples = [s for s in flight.samples(rate=20, tip=True) if s.t < end]
    return record(tmp_path_factory.mktemp("bags"), samples)


@pytest.mark.slow
@pytest.mark.parametrize("rate", [0.0, 2.0, 20.0])
def test_a_joint_estimate_by_the_nodes_is_that_of_the_bag(bag, start, spin, tmp_path, rate):
    for kind, settings in CLOSELY.items():
        start(f"fss_arm_calib.programs:{kind}", *given(settings))
    inputs = [one.topic for kind in KINDS.values() for one in kind.inputs(kind.settings(), 4)]
    wait_for = [topic for topic in inputs if topic in TYPES]  # of each node
    replay = start(
        "fss_arm_bags.replay_node",
        bag,
        *given({"rate": rate, "wait_for": wait_for, "deadline": 60.0}),
    )
    assert replay.wait(240) == 0, replay.output
    node, got = Node("asks"), []
    node.create_subscription(JointCalibration, "calibration/joint", got.append, LATCHED)

    settings = {"max_relative": 2.0, "state_file": tmp_path / "state.json"}
    first = start("fss_arm_calib.programs:joint", *given(settings))
    all_of_it = "10 observations, 9 maneuvers, 10 drifts of 1 session"
    spin(node, lambda: got and all_of_it in got[-1].calibration.reason, 120.0)
    first.process.kill()
    first.process.wait()
    got.clear()
    start("fss_arm_calib.programs:joint", *given(settings))
    found = spin(node, lambda: got and got[-1].calibration, 60.0)
    assert found.verdict == "pass", found.reason

    params, result = tmp_path / "params.yaml", tmp_path / "joint.json"
    params.write_text(yaml.safe_dump(CLOSELY))
    asked = ["--params", str(params), "--max-relative=2", "--result", str(result)]
    assert from_bag(["--joint", str(bag), *asked]) == 0
    offline = json.loads(result.read_text())
    assert found.provenance.data_hash == offline["provenance"]["data_hash"]
    np.testing.assert_allclose(found.values, offline["values"], rtol=0, atol=1e-9)
    covariance = np.ravel(offline["covariance"])
    np.testing.assert_allclose(found.covariance, covariance, rtol=1e-6, atol=1e-15)
