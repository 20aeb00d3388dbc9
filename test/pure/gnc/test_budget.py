"""Resources that a mission has used, and limits that abort it."""

import numpy as np
import pytest

from fss_arm_model.description import paper_arm
from fss_gnc.guidance.activity import Craft, Observation
from fss_gnc.guidance.budget import Budget
from fss_gnc.guidance.mission_monitor import MissionMonitor
from fss_gnc.reference import Body

CRAFT = Craft(paper_arm())
BASE = Body(np.zeros(3), np.zeros(3))


def with_torques(t, *torques):
    return Observation(t, BASE, None, np.zeros(4), np.zeros(4), np.array(torques))


def test_missing_torque_of_a_joint_hides_no_other():
    budget = Budget(CRAFT)
    budget.update(with_torques(0.0, 0.5, np.nan, -1.5, 0.0))
    budget.update(with_torques(0.1, np.nan, np.nan, np.nan, np.nan))
    assert budget.largest_torque == pytest.approx(1.5)


def test_lasting_overload_of_a_joint_is_reported():
    monitor = MissionMonitor(CRAFT)
    reasons = [
        monitor.abort_reason(with_torques(t, 0.0, np.nan, -3.2, 0.0), None, "reach", 60.0, 0.0)
        for t in (0.0, 0.2, 0.4)
    ]
    assert reasons == ["", "", "torque of joint 3 is 3.20 N m, expected at most 3 N m"]


def test_phase_timeout_is_reported():
    reason = MissionMonitor(CRAFT).abort_reason(
        with_torques(7.0, *4 * [0.0]), None, "reach", 5.0, 1.0
    )
    assert reason == "phase reach took longer than its timeout of 5 s"
