"""Observations of the guidance, from the newest messages of each topic."""

import numpy as np
import pytest

from fss_arm_model.held import Target
from fss_arm_model.units import SECOND
from fss_gnc.guidance.measurements import Measurements
from fss_gnc.reference import Body

STAMP = 100 * SECOND
MOVING = Body(np.array([1.0, 2.0, 0.5]), np.array([0.1, -0.2, 0.3]))
JOINTS = np.array([[0.1, 0.2], [1.0, -1.0], [0.3, np.nan]])  # q, qd, effort


def test_nothing_is_known_at_first():
    measured = Measurements(2, 0.5)
    obs = measured.observe(STAMP, STAMP - SECOND)
    assert obs.t == 1.0
    known = obs.base, obs.target, obs.q, obs.qd, obs.effort, obs.holds, obs.last_q, obs.held_body
    assert (*known, obs.armed) == (None,) * 9
    assert np.isnan(obs.propellant)
    assert measured.problem(STAMP) == "waiting for base/state"


def test_bodies_and_joints_are_extrapolated_to_the_present():
    measured = Measurements(2, 0.5)
    for topic in (measured.base, measured.target):
        topic.store(STAMP - SECOND // 5, MOVING)
    assert measured.problem(STAMP) == "waiting for arm/joint_states"
    measured.joints.store(STAMP - SECOND // 10, JOINTS)
    assert not measured.problem(STAMP)
    obs = measured.observe(STAMP, STAMP)
    np.testing.assert_allclose(obs.base.pose, [1.02, 1.96, 0.56])
    np.testing.assert_allclose(obs.target.pose, obs.base.pose)
    np.testing.assert_allclose(obs.q, [0.2, 0.1])
    np.testing.assert_allclose(obs.qd, [1.0, -1.0])
    np.testing.assert_allclose(obs.effort, [0.3, np.nan])
    np.testing.assert_allclose(obs.last_q, [0.1, 0.2])


@pytest.mark.parametrize(("age", "known"), [(0.4, True), (0.6, False), (-0.6, False)])
def test_an_old_state_is_unknown(age, known):
    measured, stamp = Measurements(2, 0.5), STAMP - round(age * SECOND)
    measured.base.store(stamp, MOVING)
    measured.joints.store(stamp, JOINTS)
    obs = measured.observe(STAMP, STAMP)
    assert (obs.base is not None, obs.q is not None, not measured.problem(STAMP)) == (known,) * 3
    assert obs.last_q is not None


def test_a_released_body_is_unknown():
    measured = Measurements(2, 0.5)
    measured.set_gripper(STAMP, True)
    measured.held_body = Target(), np.zeros(3)
    assert measured.observe(STAMP, STAMP).held_body is measured.held_body
    measured.set_gripper(STAMP, True)
    assert measured.held_body is not None
    measured.set_gripper(STAMP, False)
    assert measured.held_body is None
    assert measured.observe(STAMP, STAMP).holds is False
    assert measured.observe(STAMP + 3 * SECOND, STAMP).holds is None
