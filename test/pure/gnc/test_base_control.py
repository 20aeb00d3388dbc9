"""The control of the base: when valves stay closed, its model, and its hold after a stall."""

import numpy as np
import pytest

from fss_arm_model import layout
from fss_arm_model.description import paper_arm
from fss_arm_model.dynamics import inertia_matrix
from fss_arm_model.held import Target, payload_pose, with_payload
from fss_arm_model.units import SECOND
from fss_gnc.control.base_control import BaseControl
from fss_gnc.control.craft_model import CraftModel
from fss_gnc.control.settings import ControlSettings
from fss_gnc.control.stall_hold import StallHold
from fss_gnc.reference import Body, Path

ARM = paper_arm()
START = 100 * SECOND
ZERO = np.zeros(3)
REST_PATH = Path(np.zeros(1), np.array([[[0.01, 0.0, 0.0]]]))
JOINTS = np.array([[1.5, -1.5, -1.5, 1.5], [0.1] * 4, [np.nan] * 4])


def make_controller(*topics, path=REST_PATH, **settings):
    """Return a controller that has received these topics at the start."""
    controller = BaseControl(ARM, ControlSettings(max_age=0.5, timeout=1.0, **settings))
    values = {"base": Body(ZERO, ZERO), "joints": JOINTS, "trajectory": (START, path)}
    for name in topics:
        getattr(controller, name).store(START, values[name])
    return controller


TOPICS = "base", "joints", "trajectory"


@pytest.mark.parametrize(
    ("topics", "path", "status"),
    [
        ((), REST_PATH, "thrusters idle: waiting for base/state"),
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


def test_wrench_counters_error_and_rate_in_the_base_s_axes():
    knots = np.zeros((2, 2, 3))
    knots[:, 0], knots[:, 1, 0] = [[0.01, 0.0, np.pi / 2], [0.11, 0.0, np.pi / 2]], 0.02
    controller = make_controller(*TOPICS, path=Path(np.array([0.0, 5.0]), knots))
    controller.base.store(START, Body(np.array([0.0, 0.0, np.pi / 2]), ZERO))
    controller.joints.store(START, JOINTS * [[1.0], [0.0], [0.0]])
    g, q = controller.settings, np.array([0.0, 0.0, np.pi / 2, *JOINTS[0]])
    acceleration = g.bandwidth**2 * 0.01 + 2.0 * g.damping * g.bandwidth * 0.02
    wrench = controller.step(START)
    mass = inertia_matrix(ARM.vector(), q)[0, 0]
    assert wrench[:2] == pytest.approx([0.0, -mass * acceleration], rel=1e-3, abs=1e-3)


@pytest.mark.parametrize("feed_forward", [True, False])
def test_planned_accelerations_are_compensated_if_wanted(feed_forward):
    controller = make_controller(*TOPICS, feed_forward=feed_forward)
    wrenches = []
    for rates in (np.zeros((2, 4)), np.array([4 * [0.0], 4 * [3.0]])):
        controller.planned.store(START, np.arange(2.0), rates)
        wrenches.append(controller.step(START))
    assert (np.abs(wrenches[1] - wrenches[0]).max() > 0.1) == feed_forward


@pytest.mark.parametrize("silent", ["base", "trajectory"])
def test_a_lost_topic_closes_the_valves_once(silent):
    controller, now = make_controller(*TOPICS), START + 2 * SECOND
    assert controller.step(START) is not None
    for name in {*TOPICS} - {silent}:
        getattr(controller, name).store(now, getattr(controller, name).value)
    np.testing.assert_array_equal(controller.step(now), ZERO)
    assert controller.step(now) is None
    words = {
        "base": "base/state is 2.0 s old",
        "trajectory": "no new base/trajectory for 2.0 s",
    }
    assert controller.status(now) == f"thrusters idle: {words[silent]}"


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


# --- after a stall of the process ---------------------------------------------------------------

FOUND = np.array([0.2, 0.1, 0.3])  # pose at which the base is found after the stall
PAUSED = "control paused for 6.0 s; waiting for the end of base/trajectory"


def test_a_pause_longer_than_allowed_is_a_stall():
    hold, times = StallHold(max_pause=0.5, timeout=1.0), [0.0, 0.1, 0.5, 1.1, 1.2, 86_401.2]
    pauses = [hold.check(time) for time in times]
    np.testing.assert_allclose(pauses, [0.0, 0.0, 0.0, 0.6, 0.0, 86_400.0])


class Control:
    """Controller that follows a moving reference, its clock and the topics that it receives."""

    def __init__(self):
        self.controller, self.now = BaseControl(paper_arm(), ControlSettings()), START
        self.receive(ZERO)
        self.refer()
        assert self.controller.step(self.now) is not None

    def receive(self, pose):
        self.controller.base.store(self.now, Body(pose, ZERO))
        self.controller.joints.store(self.now, JOINTS * [[1.0], [0.0], [1.0]])

    def refer(self, x=0.0, points=True):
        knots = np.array([[[x, 0.0, 0.0], [0.05, 0.0, 0.0]], [[x + 3.0, 0.0, 0.0], ZERO]])
        path = Path(np.array([0.0, 60.0]), knots)
        self.controller.follow(self.now, self.now, path if points else None)

    def stall(self):
        self.now += 6 * SECOND
        self.controller.resume(6.0)

    def step(self):
        self.now += SECOND // 10
        return self.controller.step(self.now)

    @property
    def status(self):
        return self.controller.status(self.now)


def test_the_valves_close_and_then_the_base_is_held_where_it_is_found():
    control = Control()
    control.stall()
    np.testing.assert_array_equal(control.step(), ZERO)
    control.refer(x=0.5)
    assert control.controller.hold.is_asking
    assert control.step() is None  # no state of base and joints since the stall
    control.receive(FOUND)
    np.testing.assert_allclose(control.step(), ZERO, atol=1e-12)
    assert control.status == f"holding the base: {PAUSED}"
    for _ in range(50):
        control.refer(x=0.8)
        control.receive(FOUND + np.array([0.01, 0.0, 0.0]))
        wrench = control.step()
    back = wrench[0] * np.cos(FOUND[2]) - wrench[1] * np.sin(FOUND[2])
    assert back < 0.0  # to the place, away from the reference


def test_without_a_source_the_valves_stay_closed():
    """A goal may have ended during the stall, by a stop."""
    control = Control()
    control.stall()
    for k in range(20):
        control.receive(FOUND)
        wrench = control.step()
        assert wrench is None if k else not wrench.any()
        assert not control.controller.hold.is_asking
    assert control.status == "thrusters idle: waiting for base/trajectory"


def test_a_reference_without_points_ends_the_hold():
    control = Control()
    control.stall()
    control.refer()
    control.receive(FOUND)
    control.step()
    control.refer(points=False)
    assert not control.controller.hold.is_asking
    control.receive(FOUND)
    assert not control.step().any()
    assert control.step() is None
    control.refer(x=0.3)
    control.receive(FOUND)
    assert control.step()[0] > 0.01  # follows
    assert control.status == "following base/trajectory"


def test_a_silent_source_ends_the_hold():
    control = Control()
    control.stall()
    control.refer()
    for _ in range(9):
        control.receive(FOUND)
        control.step()
        assert control.controller.hold.reason
    control.step()
    control.step()
    control.receive(FOUND)
    assert not control.controller.hold.reason
    control.refer()
    assert control.step() is not None
    assert control.status == "following base/trajectory"


def test_a_second_stall_holds_the_base_at_its_new_place():
    control = Control()
    for place in (FOUND, -FOUND):
        control.stall()
        control.refer()
        control.receive(place)
        control.step()
        np.testing.assert_array_equal(control.controller.hold.pose, place)
