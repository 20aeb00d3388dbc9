"""Wrenches by valves: as near as can be, in pulses that valves can make, and right on average."""

import numpy as np
import pytest
from scipy.optimize import minimize

from fss_arm_model.thrusters import thruster_wrenches
from fss_base_driver.allocation import Allocation

VALVES = thruster_wrenches(0.16, 0.11)
PERIOD, MIN_ON_TIME = 0.1, 0.01
SCALE = np.array([1.0, 1.0, 0.16 / 0.0176])


def mean(allocation, wrench, periods=80, leak=()):
    """The wrench that is given over many periods, and the time for which valves are open."""
    times = np.array([allocation.on_times(wrench) for _ in range(periods)])
    times[:, list(leak)] = PERIOD
    return (times @ VALVES).mean(axis=0) / PERIOD, times


@pytest.mark.parametrize("size", [0.003, 0.05, 1.0])
def test_feasible_wrenches_come_true_on_average(size):
    rng = np.random.default_rng(1)
    for _ in range(8):
        wanted = size * rng.uniform(-1.0, 1.0, 3) * (0.1, 0.1, 0.02)
        given, times = mean(Allocation(VALVES, PERIOD, MIN_ON_TIME), wanted)
        # What may be owed, two shortest pulses, over 8 s.
        np.testing.assert_allclose(given, wanted, atol=2.0 * 0.16 * MIN_ON_TIME / 8.0)
        assert ((times == 0.0) | ((times >= MIN_ON_TIME) & (times <= PERIOD))).all()


def test_shares_are_optimal():
    rng = np.random.default_rng(2)
    for _ in range(30):
        wanted = rng.uniform(-1.0, 1.0, 3) * (0.6, 0.6, 0.15)  # also beyond what is possible
        times = Allocation(VALVES, PERIOD, 0.0).on_times(wanted)

        def cost(u, wanted=wanted):
            off = SCALE * (u @ VALVES - wanted)
            return off @ off + (1e-3 * 0.16 * u.sum()) ** 2

        best = minimize(cost, np.full(8, 0.5), bounds=[(0.0, 1.0)] * 8, tol=1e-14)
        assert cost(times / PERIOD) <= best.fun + 1e-9


@pytest.mark.parametrize("stuck", [0, 5])
@pytest.mark.parametrize("how", ["stuck_open", "stuck_closed"])
def test_a_stuck_valve_is_done_without(stuck, how):
    leak = (stuck,) if how == "stuck_open" else ()
    for wanted in (*np.eye(3), *-np.eye(3)):
        wrench = wanted * (0.05, 0.05, 0.01)
        given, times = mean(
            Allocation(VALVES, PERIOD, MIN_ON_TIME, **{how: (stuck,)}), wrench, leak=leak
        )
        np.testing.assert_allclose(given, wrench, atol=2.0 * 0.16 * MIN_ON_TIME / 8.0)
        assert leak or not times[:, stuck].any()


def test_what_cannot_be_given_is_not_owed_for_ever():
    allocation = Allocation(VALVES, PERIOD, MIN_ON_TIME)
    for _ in range(100):
        allocation.on_times([5.0, 0.0, 0.0])
    assert allocation.on_times([0.0, 0.0, 0.0]).sum() <= 6.0 * MIN_ON_TIME
    assert not allocation.on_times([0.0, 0.0, 0.0])[VALVES[:, 0] > 0.0].any()


@pytest.mark.parametrize(
    ("wrench", "stuck_closed", "clipped"),
    [
        ((0.31, 0.0, 0.0), (), False),
        ((0.0, 0.0, -0.07), (), False),
        ((0.33, 0.0, 0.0), (), True),
        ((0.0, 0.0, 0.075), (), True),
        ((0.31, 0.31, 0.07), (), True),
        ((-0.31, 0.0, 0.0), (0,), True),
        ((1e3, 0.0, 0.0), (), True),
    ],
)
def test_a_wrench_beyond_the_working_valves_is_clipped(wrench, stuck_closed, clipped):
    allocation = Allocation(VALVES, PERIOD, MIN_ON_TIME, stuck_closed=stuck_closed)
    for _ in range(20):  # whatever is owed meanwhile
        allocation.on_times(wrench)
        assert allocation.clipped == clipped
    allocation.on_times((0.0, 0.0, 0.0))
    assert not allocation.clipped


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"stuck_open": [8]}, r"stuck valves are \[8\], expected numbers from 0 to 7"),
        ({"minimum_on_time": 0.2}, r"minimum_on_time is 0.2 s, expected from 0 to below 0.1 s"),
    ],
)
def test_wrong_settings_are_named(options, expected):
    with pytest.raises(ValueError, match=expected):
        Allocation(VALVES, PERIOD, **{"minimum_on_time": MIN_ON_TIME} | options)


def test_a_denormal_wrench_opens_no_valve():
    allocation = Allocation(VALVES, PERIOD, MIN_ON_TIME)
    for _ in range(100):
        assert not allocation.on_times(3 * [5e-324]).any()
