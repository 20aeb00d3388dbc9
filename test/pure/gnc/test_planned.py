import numpy as np
import pytest

from fss_arm_model.units import SECOND
from fss_gnc.control.planned import PlannedRates
from fss_gnc.latest import Latest

PLAN_TIMES = np.arange(0.0, 0.6, 0.1)


def rates(t):
    """Rates of two joints: one smooth, one with a step."""
    return np.array([np.sin(t) ** 2, 0.3 * (t > 1.0)])


def test_accelerations_of_delayed_plans_add_up_to_the_change_of_the_rates():
    rng, plan, total = np.random.default_rng(1), PlannedRates(), np.zeros(2)
    assert plan.accelerations(0, 0.1) is None
    for k in range(40):
        now = 0.1 * k
        delay = rng.uniform(0.0, 0.2)
        planned = np.array([rates(now - delay + t) for t in PLAN_TIMES])
        plan.store(round((now - delay) * SECOND), PLAN_TIMES, planned)
        total += 0.1 * plan.accelerations(round(now * SECOND), 0.1)
    np.testing.assert_allclose(total, rates(4.0) - rates(0.1), atol=0.01)


def test_measured_rates_are_not_balanced_but_a_later_plan_is():
    plan = PlannedRates()
    for k, rate in enumerate([0.001, -0.001, 0.001]):
        plan.store(k * SECOND // 10, np.zeros(1), np.array([[rate]]))
        assert plan.accelerations(k * SECOND // 10, 0.1) == [0.0]
    plan.store(3 * SECOND // 10, PLAN_TIMES, np.full((6, 1), 0.101))
    assert plan.accelerations(3 * SECOND // 10, 0.1) == pytest.approx([1.0])


def test_reset_discards_past_changes():
    plan = PlannedRates()
    plan.store(0, PLAN_TIMES, np.zeros((6, 1)))
    plan.accelerations(0, 0.1)
    plan.reset()
    plan.store(SECOND, PLAN_TIMES, np.ones((6, 1)))
    assert plan.accelerations(SECOND, 0.1) == [0.0]


@pytest.mark.parametrize("later", [5, -5])  # the planner died, or the clock jumped back
def test_expired_plan_is_not_balanced(later):
    plan = PlannedRates()
    plan.store(10 * SECOND, PLAN_TIMES, np.full((6, 1), 0.3))
    assert plan.accelerations(10 * SECOND, 0.1) == [0.0]
    now = (10 + later) * SECOND
    assert plan.accelerations(now, 0.1) is None
    plan.store(now, PLAN_TIMES, np.zeros((6, 1)))
    assert plan.accelerations(now, 0.1) == [0.0]


@pytest.mark.parametrize(
    ("now", "problem"),
    [
        (100 * SECOND, ""),
        (100 * SECOND + SECOND // 2, ""),
        (101 * SECOND, "base/state is 1.0 s old"),
        (90 * SECOND, "base/state is stamped 10.0 s in the future"),
    ],
)
def test_value_is_valid_if_neither_stale_nor_from_the_future(now, problem):
    latest = Latest("base/state", 0.5)
    assert latest.problem(now) == "waiting for base/state"
    assert latest.valid_value(now) is None
    latest.store(100 * SECOND, "there")
    assert latest.problem(now) == problem
    assert latest.valid_value(now) == (None if problem else "there")
