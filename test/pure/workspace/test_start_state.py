"""The state from which straight paths start, and when it has changed."""

import numpy as np
import pytest

from fss_arm_model.description import paper_arm
from fss_arm_ros.calibrated import Calibrated
from fss_arm_workspace.start_state import PathStart, posture

KNOWN = Calibrated(paper_arm())


def start(heading=0.0, q_1=0.1, known=KNOWN):
    return PathStart(known, np.array([0.0, 0.0, heading, q_1, 0.2, 0.3, 0.4]), True)


@pytest.mark.parametrize(
    ("readings", "found"),
    [
        ({}, None),
        ({1: 0.1, 3: 0.3}, None),
        ({3: 0.3, 1: 0.1, 2: 0.2}, [0.1, 0.2, 0.3]),
        ({1: 0.1, 2: 0.2, 3: 0.3, 99: 9.9}, [0.1, 0.2, 0.3]),
    ],
)
def test_the_posture_is_known_once_all_joints_are_read(readings, found):
    q = posture(readings, 3)
    assert (q if q is None else q.tolist()) == found


@pytest.mark.parametrize(
    ("one", "other", "near"),
    [
        (start(), None, False),
        (start(), start(), True),
        (start(), start(q_1=0.119), True),
        (start(), start(q_1=0.121), False),
        (start(heading=3.14), start(heading=-3.14), True),
        (start(heading=3.14), start(heading=-3.1), False),
        (start(), start(known=Calibrated(paper_arm())), False),
    ],
)
def test_a_start_is_near_within_the_threshold(one, other, near):
    assert one.is_near(other, 0.02) is near
