"""The control of the base: when the valves stay closed, and with which model it computes."""

import numpy as np
import pytest

from fss_arm_model import layout
from fss_arm_model.description import paper_arm
from fss_arm_model.held import Target, payload_pose, with_payload
from fss_arm_model.units import SECOND
from fss_gnc.control.base_control import BaseControl
from fss_gnc.control.craft_model import CraftModel
from fss_gnc.control.settings import ControlSettings
from fss_gnc.reference import Body, Path

ARM = paper_arm()
START = 100 * SECOND
ZERO = np.zeros(3)
REST_PATH = Path(np.zeros(1), np.array([[[0.01, 0.0, 0.0]]]))
JOINTS = np.array([[1.5, -1.5, -1.5, 1.5], [0.1] * 4, [np.nan] * 4])


def make_controller(*topics, path=REST_PATH):
    """Return a controller that has received these topics at the start."""
    controller = BaseControl(ARM, ControlSettings(max_age=0.5, timeout=1.0))
    values = {"base": Body(ZERO, ZERO), "joints": JOINTS, "trajectory": (START, path)}
    for name in topics:
        getattr(controller, name).store(START, values[name])
    return controller


TOPICS = "base", "joints", "trajectory"


@pytest.mark.parametrize(
    ("topics", "path", "status"),
    [
        ((), REST_PATH, "thrusters idle: waiting for base/state"),
        (("joints", "trajectory"), REST_PATH, "thrusters idle: waiting for base/state"),
        (("base", "trajectory"), REST_PATH, "thrusters idle: waiting for arm/joint_states"),
        (("base", "joints"), REST_PATH, "thrusters idle: waiting for base/trajectory"),
        (TOPICS, None, "thrusters idle: base/trajectory has no points"),
        (TOPICS, REST_PATH, "following base/trajectory"),
    ],
)
def test_valves_stay_closed_until_all_is_known(topics, path, status):
    controller = make_controller(*topics, path=path)
    wrench = controller.step(START)
    assert (wrench is not None) == controller.active == status.startswith("following")
    assert controller.status(START) == status


@pytest.mark.parametrize("silent", ["base", "trajectory"])
def test_a_lost_topic_closes_the_valves_once(silent):
    controller, now = make_controller(*TOPICS), START + 2 * SECOND
    assert controller.step(START) is not None
    for name in {*TOPICS} - {silent}:
        getattr(controller, name).store(now, getattr(controller, name).value)
    np.testing.assert_array_equal(controller.step(now), ZERO)
    assert controller.step(now) is None
    assert controller.status(now) == (
        "thrusters idle: base/state is 2.0 s old"
        if silent == "base"
        else "thrusters idle: base/trajectory is 2.0 s old"
    )


def test_silent_joints_are_assumed_at_rest():
    controller, now = make_controller(*TOPICS), START + 2 * SECOND
    for name in ("base", "trajectory"):
        getattr(controller, name).store(now, getattr(controller, name).value)
    assert np.isfinite(controller.step(now)).all()
    assert controller.status(now) == "joints assumed at rest: arm/joint_states is 2.0 s old"


def test_the_model_includes_the_held_body_and_excludes_used_gas():
    model, p, q = CraftModel(ARM, Target()), ARM.vector(), np.array([*ZERO, *JOINTS[0]])
    at = np.array([0.5, 0.6, 0.7])
    model.propellant_used = 0.06
    expected = p.copy()
    expected[layout.MASS] -= 0.06
    np.testing.assert_array_equal(model.parameters(q, at), expected)  # not held yet
    model.set_gripper(True)
    np.testing.assert_array_equal(model.parameters(q, None), expected)  # not seen yet
    held = with_payload(expected, Target(), payload_pose(p, q, at))
    np.testing.assert_array_equal(model.parameters(q, at), held)
    np.testing.assert_array_equal(model.parameters(q, 2.0 * at), held)  # its place is kept
    model.measured = Target(20.0, 0.6), np.array([0.4, 0.05, 0.0])
    np.testing.assert_array_equal(model.parameters(q, at), with_payload(expected, *model.measured))
    assert model.is_loaded
    model.set_gripper(False)
    np.testing.assert_array_equal(model.parameters(q, at), expected)
    assert not model.is_loaded
