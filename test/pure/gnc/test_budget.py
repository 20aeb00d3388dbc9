"""What a mission has taken, and when it has to be aborted."""

import numpy as np
import pytest

from fss_arm_model.description import paper_arm
from fss_gnc.guidance.activity import Craft, Seen
from fss_gnc.guidance.budget import Budget
from fss_gnc.guidance.watch import Watch
from fss_gnc.reference import Body

CRAFT = Craft(paper_arm())
BASE = Body(np.zeros(3), np.zeros(3))


def straining(t, *torques):
    return Seen(t, BASE, None, np.zeros(4), np.zeros(4), np.array(torques))


def test_a_joint_without_torque_hides_no_other():
    budget = Budget(CRAFT)
    budget.update(straining(0.0, 0.5, np.nan, -1.5, 0.0))
    budget.update(straining(0.1, np.nan, np.nan, np.nan, np.nan))
    assert budget.largest_torque == pytest.approx(1.5)


def test_a_joint_that_bears_too_much_for_long_is_named():
    watch = Watch(CRAFT)
    why = [
        watch.reason(straining(t, 0.0, np.nan, -3.2, 0.0), None, "reach", 60.0, 0.0)
        for t in (0.0, 0.2, 0.4)
    ]
    assert why == ["", "", "3.20 N m at joint 3, at most 3 N m expected"]


def test_a_phase_that_takes_too_long_is_named():
    why = Watch(CRAFT).reason(straining(7.0, *4 * [0.0]), None, "reach", 5.0, 1.0)
    assert why == "the phase reach took more than 5 s"
