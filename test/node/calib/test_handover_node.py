"""A calibration that begins from another: live from its topic, and from its result or its bag."""

import json
from pathlib import Path

import numpy as np
import pytest
from calib_joint import ARM, kinematics, rests
from calib_kinds import CASES, PRECISE, Bed, make_node, maneuvering
from calib_rig import record

from fss_arm_calib.dynamic.kind import DYNAMIC
from fss_arm_calib.from_bag import main as from_bag
from fss_arm_calib.kinds import KINDS
from fss_arm_calib.messages import calibration_part
from fss_arm_calib.result import read_arm
from fss_arm_model.description_file import from_yaml, to_yaml
from fss_arm_ros.qos import LATCHED
from fss_arm_ros.validation import validators

FOUND = kinematics(rests(ARM, 13, np.random.default_rng(0)))


def joint(args):
    return from_bag(["--joint", *args])


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """Ten maneuvers between rests, the end effector in sight."""
    samples = maneuvering(tip=True, noise=(0.0005, 0.002))
    return str(record(tmp_path_factory.mktemp("bag"), samples))


@pytest.mark.parametrize("kind", ["dynamic", "drift", "drives"])
def test_a_node_begins_from_a_kinematic_result_that_passed(spin, kind):
    kind, kinematic = KINDS[kind], KINDS["kinematic"]
    bed, node = Bed(kind), make_node(kind)
    publisher = bed.create_publisher(kinematic.message, kinematic.topic, LATCHED)
    message = kinematic.message()
    message.calibration.verdict, message.calibration.description = "fail", "none"
    publisher.publish(message)
    message.calibration.verdict, message.calibration.description = "pass", to_yaml(FOUND)
    publisher.publish(message)
    spin([bed, node], lambda: node.initial.arm.known.names)
    assert node.initial.arm.known == FOUND.known
    assert {one.topic for one in validators(node)} >= kind.prior_results.keys()
    spin(
        [bed, node], lambda: bed.results and "covariance" in calibration_part(bed.results[-1]).guess
    )
    assert from_yaml(calibration_part(bed.results[-1]).guess) == node.initial.arm


def test_a_result_of_another_arm_is_not_taken(ros):
    node, warned = make_node(DYNAMIC), []
    message, initial = KINDS["kinematic"].message(), node.initial
    node.get_logger().warning = warned.append
    message.calibration.verdict = "pass"
    message.calibration.description = to_yaml(ARM).replace("links:", "links: [", 1)
    node.on_result("calibration/kinematic", message)
    assert "result on calibration/kinematic rejected" in warned[0]
    assert node.initial is initial
    node.destroy_node()


def test_the_command_begins_from_a_result_or_from_a_bag(bag, tmp_path, capsys):
    given = [f"--{k.replace('_', '-')}={v}" for k, v in PRECISE.items()]
    files, found = ("kinematic.json", "arm.yaml", "dynamic.json"), []
    kinematic, arm, result = (str(tmp_path / name) for name in files)
    assert from_bag([bag, "--result", kinematic, "--output", arm]) == 0
    for source in (["--kinematic", kinematic], ["--kinematic", bag], ["--arm", arm]):
        from_bag(["--dynamic", bag, *given, *source, "--result", result])
        found.append(json.loads(Path(result).read_text())["deviations"][:4])
    assert found[1:] == [pytest.approx(found[0], rel=1e-9)] * 2
    assert from_bag(["--dynamic", bag, "--kinematic", result]) == 1
    assert "kind is 'dynamic', expected kinematic" in capsys.readouterr().err
    assert from_bag(["--dynamic", bag, "--kinematic", str(tmp_path / "none.json")]) == 1
    assert "no such file" in capsys.readouterr().err


def test_drives_may_begin_from_a_bag_of_rests(tmp_path):
    """Take settings that both kinds have from the command line."""
    case, rig = CASES["drives"], CASES["kinematic"]
    bag, rests = (str(record(tmp_path / one.kind, one.samples())) for one in (case, rig))
    result = tmp_path / "drives.json"
    asked = ["--max-relative", "0.3", "--kinematic", rests, "--result", str(result)]
    assert from_bag(["--drives", bag, *asked]) == 0
    assert "a_1" in read_arm(result, "drives").known.names


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("dynamic: {position_error: 1}", "dynamic is 'position_error', expected a setting of it"),
        ("[1, 2]", "expected settings of kinematic, dynamic, drift"),
        ("dynamic: 3", "expected settings"),
        ("drift: {bin: -1.0}", "bin is -1.0 s"),
        ("/**/drift: {bin: -1.0}", "bin is -1.0 s"),
    ],
)
def test_settings_that_cannot_be_are_refused(bag, tmp_path, capsys, text, message):
    params = tmp_path / "params.yaml"
    params.write_text(text)
    assert joint([bag, "--params", str(params)]) == 1
    assert message in capsys.readouterr().err
