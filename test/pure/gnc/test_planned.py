import numpy as np
import pytest

from fss_gnc.control.planned import PlannedRates
from fss_gnc.latest import Latest

SECOND = 1_000_000_000
AHEAD = np.arange(0.0, 0.6, 0.1)


def rates(t):
    """Of two joints: a bell, and one that jumps."""
    return np.array([np.sin(t) ** 2, 0.3 * (t > 1.0)])


def test_whatever_is_told_late_the_sum_over_periods_is_the_change_of_the_rates():
    rng, plan, total = np.random.default_rng(1), PlannedRates(), np.zeros(2)
    assert plan.accelerations(0, 0.1) is None
    for k in range(40):
        now = 0.1 * k
        late = rng.uniform(0.0, 0.2)
        told = np.array([rates(now - late + ahead) for ahead in AHEAD])
        plan.take(round((now - late) * SECOND), AHEAD, told)
        total += 0.1 * plan.accelerations(round(now * SECOND), 0.1)
    np.testing.assert_allclose(total, rates(4.0) - rates(0.1), atol=0.01)


def test_what_joints_do_without_a_plan_is_not_balanced_but_a_plan_from_there_is():
    plan = PlannedRates()
    for k, rate in enumerate([0.001, -0.001, 0.001]):
        plan.take(k * SECOND // 10, np.zeros(1), np.array([[rate]]))
        assert plan.accelerations(k * SECOND // 10, 0.1) == [0.0]
    plan.take(3 * SECOND // 10, AHEAD, np.full((6, 1), 0.101))
    assert plan.accelerations(3 * SECOND // 10, 0.1) == pytest.approx([1.0])


def test_after_a_pause_nothing_is_made_up_for():
    plan = PlannedRates()
    plan.take(0, AHEAD, np.zeros((6, 1)))
    plan.accelerations(0, 0.1)
    plan.reset()
    plan.take(SECOND, AHEAD, np.ones((6, 1)))
    assert plan.accelerations(SECOND, 0.1) == [0.0]


@pytest.mark.parametrize("later", [5, -5])  # who tells them died, or the clock was set back
def test_a_plan_of_another_time_is_not_made_up_for(later):
    plan = PlannedRates()
    plan.take(10 * SECOND, AHEAD, np.full((6, 1), 0.3))
    assert plan.accelerations(10 * SECOND, 0.1) == [0.0]
    now = (10 + later) * SECOND
    assert plan.accelerations(now, 0.1) is None
    plan.take(now, AHEAD, np.zeros((6, 1)))
    assert plan.accelerations(now, 0.1) == [0.0]


@pytest.mark.parametrize(
    ("now", "words"),
    [
        (100 * SECOND, ""),
        (100 * SECOND + SECOND // 2, ""),
        (101 * SECOND, "base/state is 1.0 s old"),
        (90 * SECOND, "base/state is 10.0 s ahead of the clock"),
    ],
)
def test_a_value_holds_as_long_as_it_is_neither_old_nor_of_the_future(now, words):
    latest = Latest("base/state", 0.5)
    assert latest.trouble(now) == "base/state was not heard yet"
    assert latest.at(now) is None
    latest.take(100 * SECOND, "there")
    assert latest.trouble(now) == words
    assert latest.at(now) == (None if words else "there")
