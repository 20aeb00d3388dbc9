"""The hold of the base after the control process did not run for a while."""

import numpy as np
import pytest

from fss_arm_model.description import paper_arm
from fss_arm_model.units import SECOND
from fss_gnc.control.base_control import BaseControl
from fss_gnc.control.settings import ControlSettings
from fss_gnc.control.stall_hold import StallHold
from fss_gnc.reference import Body, Path

ZERO = np.zeros(3)
START = 100 * SECOND
JOINTS = np.array([[1.5, -1.5, -1.5, 1.5], [0.0] * 4, [np.nan] * 4])
FOUND = np.array([0.2, 0.1, 0.3])  # pose at which the base is found after the stall
PAUSED = "control paused for 6.0 s; waiting for the end of base/trajectory"


@pytest.mark.parametrize(
    ("times", "pauses"),
    [
        ([0.0, 0.1, 0.5, 0.9], [0.0] * 4),
        ([0.0, 0.1, 0.7, 0.8], [0.0, 0.0, 0.6, 0.0]),
        ([1e6, 1e6 + 86_400.0, 1e6 + 86_400.1], [0.0, 86_400.0, 0.0]),
    ],
)
def test_a_pause_longer_than_allowed_is_a_stall(times, pauses):
    hold = StallHold(max_pause=0.5, timeout=1.0)
    np.testing.assert_allclose([hold.check(time) for time in times], pauses)


class Control:
    """Controller that follows a moving reference, its clock and the topics that it receives."""

    def __init__(self):
        self.controller, self.now = BaseControl(paper_arm(), ControlSettings()), START
        self.receive(ZERO)
        self.refer()
        assert self.controller.step(self.now) is not None

    def receive(self, pose):
        self.controller.base.store(self.now, Body(pose, ZERO))
        self.controller.joints.store(self.now, JOINTS)

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
