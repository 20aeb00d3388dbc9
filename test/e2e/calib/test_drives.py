"""A recording replayed to the node `drives`: late, killed and again, it is as from the bag."""

import json

import numpy as np
import pytest
from calib_kinds import CASES
from rclpy.node import Node
from std_srvs.srv import Trigger

from fss_arm_calib.from_bag import main as from_bag
from fss_arm_msgs.msg import DrivesCalibration
from fss_arm_ros.qos import LATCHED

CASE = CASES["drives"]


def given(settings):
    words = [word for k, v in settings.items() for word in ("-p", f"{k}:={v}")]
    return ["--ros-args", *words]


@pytest.mark.slow
def test_drives_by_the_node_are_those_of_the_bag(start, spin, tmp_path):
    samples = CASE.samples()
    middle = samples[len(samples) // 2].t
    settings = {**CASE.settings, "state_file": tmp_path / "state.json"}
    node, got = Node("asks"), []
    node.create_subscription(DrivesCalibration, "calibration/drives", got.append, LATCHED)
    halves = [one for one in samples if one.t < middle], [one for one in samples if one.t >= middle]
    for k, half in enumerate(halves):  # in the second by another process
        bag = CASE.module.record(tmp_path / f"half_{k}", half)
        calibration = start("fss_arm_calib.programs:drives", *given(settings))
        topics = [f"link_{i}/telemetry" for i in range(1, 5)]
        replay = start(
            "fss_arm_bags.replay_node", bag,
            *given({"rate": 0.0, "wait_for": topics, "deadline": 60.0}),
        )  # fmt: skip
        assert replay.wait(240) == 0, replay.output
        client = node.create_client(Trigger, "drives/solve")
        assert client.wait_for_service(20.0)
        answer = client.call_async(Trigger.Request())
        spin(node, answer.done, 120.0)
        calibration.process.kill()
        calibration.process.wait()
    found = spin(node, lambda: got and got[-1].calibration, 20.0)
    assert found.verdict == "pass", found.reason

    bag, result = CASE.module.record(tmp_path / "whole", samples), tmp_path / "drives.json"
    asked = [f"--{k.replace('_', '-')}={v}" for k, v in CASE.settings.items()]
    assert from_bag(["--drives", str(bag), *asked, "--result", str(result)]) == 0
    offline = json.loads(result.read_text())
    assert found.provenance.data_hash == offline["provenance"]["data_hash"]
    np.testing.assert_allclose(found.values, np.array(offline["values"], float), rtol=0, atol=1e-12)
