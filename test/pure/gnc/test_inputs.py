"""Known acceleration of the base, over the history that the filter may recompute."""

import numpy as np
import pytest

from fss_arm_model.description import paper_arm
from fss_arm_model.dynamics import inertia_matrix
from fss_arm_model.units import SECOND
from fss_gnc.navigation import EstimatorSettings, KnownInputs, Navigation
from fss_gnc.navigation.body_filter import HISTORY_LENGTH

P = paper_arm().vector()
Q = (0.1, 0.2, 0.3, 0.4)
MS = 1_000_000


def test_joints_and_valves_are_stored_over_the_history_of_the_filter():
    """Links report up to 50 times a second, and a program may open valves as often."""
    inputs = KnownInputs(P, EstimatorSettings(valve_delay=0.0))
    on_times = [0.02, *7 * [0.0]]
    for at in range(0, 2 * SECOND, 20 * MS):
        for i, q in enumerate(Q):
            inputs.add_joint_reading(i, at, q, 0.01e-9 * at * (i == 0), 0.0)
        inputs.add_pulses(at, on_times)
    early, late = inputs.mean_accelerations(
        [at - HISTORY_LENGTH, at - HISTORY_LENGTH + 40 * MS, at - 40 * MS, at]
    )[0][[0, 2]]
    np.testing.assert_allclose(early, late, rtol=1e-6)
    assert inputs.open_times(at - HISTORY_LENGTH, at)[0] == pytest.approx(1.0)
    H = inertia_matrix(P, [0.0, 0.0, 0.0, *Q])[:3]
    expected = np.linalg.solve(H[:, :3], inputs.valves[0] - 0.01 * H[:, 3])
    np.testing.assert_allclose(early, expected, atol=5e-4)  # turning at 0.02 rad/s


def test_implausible_joint_rate_is_ignored():
    navigation = Navigation(paper_arm())
    for k in range(200):
        at = 10 * k * MS
        navigation.base.update_rate(at, 0.0)
        navigation.base.update_pose(at, 0.0, 0.0, 0.0)
        if k % 20 == 0:
            for i, q in enumerate(Q):
                navigation.add_joint_reading(i, at, q, 1e9 if k == 100 and i == 0 else 0.0)
    state = navigation.base.state()
    assert np.abs([*state.pose, *state.twist]).max() < 1e-3
    assert navigation.base.lost_reason(at) == ""
