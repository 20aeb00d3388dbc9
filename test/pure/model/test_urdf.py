"""The arm's URDF: read by another library, it is the same arm."""

from dataclasses import replace
from math import cos, sin
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
from model_oracles import pinocchio_inertia

from fss_arm_model.description import paper_arm
from fss_arm_model.description_file import load
from fss_arm_model.dynamics import inertia_matrix
from fss_arm_model.kinematics import tip_pose
from fss_arm_model.urdf import urdf

TRUTH = load(Path(__file__).parents[3] / "config/truth.yaml")
BENT = replace(
    TRUTH,
    theta_E=0.1,
    base=replace(TRUTH.base, com=(0.01, -0.02)),
    links=tuple(replace(link, lateral=0.01 * i) for i, link in enumerate(TRUTH.links)),
)


@pytest.mark.parametrize("arm", [paper_arm(), BENT, replace(BENT, links=BENT.links[:1])])
def test_another_library_reads_the_same_arm(arm):
    model = pin.buildModelFromXML(urdf(arm), pin.JointModelPlanar())
    data = model.createData()
    rng = np.random.default_rng(4)
    for _ in range(5):
        x, y, theta, *q = rng.uniform(-1.0, 1.0, 3 + arm.n)
        state = np.array([x, y, cos(theta), sin(theta), *q])
        pin.forwardKinematics(model, data, state)
        pin.updateFramePlacements(model, data)
        tip = data.oMf[model.getFrameId("end_effector")]
        heading = np.arctan2(tip.rotation[1, 0], tip.rotation[0, 0])
        expected = tip_pose(arm.vector(), [x, y, theta, *q])
        turned = (heading - expected[2] + np.pi) % (2 * np.pi) - np.pi
        np.testing.assert_allclose([*tip.translation[:2], turned], [*expected[:2], 0.0], atol=1e-12)
        inertia = pinocchio_inertia(model, data, np.array([x, y, 1.0, 0.0, *q]))
        expected = inertia_matrix(arm.vector(), [x, y, 0.0, *q])
        np.testing.assert_allclose(inertia, expected, atol=1e-12)


def test_joints_have_the_names_of_joint_states_and_the_drives_limits():
    robot = ElementTree.fromstring(urdf(paper_arm()))
    joints = [joint for joint in robot.iter("joint") if joint.get("type") == "revolute"]
    assert [joint.get("name") for joint in joints] == [f"joint_{i}" for i in range(1, 5)]
    limit = joints[0].find("limit").attrib
    assert [float(limit[name]) for name in ("effort", "velocity")] == [1.8, 1.0]
    assert float(limit["upper"]) == pytest.approx(np.pi / 2)


def test_a_reader_of_text_gets_any_name_no_encoding_and_a_root_without_mass():
    arm = replace(paper_arm(), name='a "quick" <arm> & more')
    text = urdf(arm)
    assert not text.startswith("<?xml")
    assert ElementTree.fromstring(text).get("name") == arm.name
    links = {link.get("name"): link for link in ElementTree.fromstring(text).iter("link")}
    assert links["fss"].find("inertial") is None
    assert float(links["fss_body"].find("inertial/mass").get("value")) == paper_arm().base.mass


def test_what_is_drawn_is_what_collides():
    for link in ElementTree.fromstring(urdf(paper_arm())).iter("link"):
        drawn, collides = (
            [part.attrib for name in ("geometry/box", "origin") for part in shape.findall(name)]
            for kind in ("visual", "collision")
            for shape in [link.find(kind) if link.find(kind) is not None else link]
        )
        assert drawn == collides
        assert bool(drawn) == (link.get("name") not in ("fss", "end_effector"))
