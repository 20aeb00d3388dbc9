"""Statistics of periods and latencies."""

from types import SimpleNamespace

import pytest

from fss_arm_model.units import SECOND
from fss_arm_ros.timing import MAX_SAMPLES, Timing


@pytest.fixture
def clock():
    """The simulated time of a node [ns], as its attribute t."""
    return SimpleNamespace(t=0)


@pytest.fixture
def timing(clock):
    simulated = SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=clock.t))
    parameter = SimpleNamespace(value=True)  # use_sim_time
    node = SimpleNamespace(get_clock=lambda: simulated, get_parameter=lambda _: parameter)
    return Timing(100.0, node)


@pytest.fixture
def step(timing, clock):
    def step(t, latency=SECOND // 500):
        clock.t = t
        timing.add_step()
        timing.add_command(t - latency)

    return step


def test_percentiles_and_missed_deadlines(timing, step):
    assert timing.values() == {}
    for k in range(1001):
        step(k * SECOND // 100 + (SECOND // 10 if k == 1000 else 0))
    values = timing.values()
    assert values["period p50 [ms]"] == pytest.approx(10.0)
    assert values["period p99 [ms]"] == pytest.approx(10.0)
    assert values["period p99.9 [ms]"] == pytest.approx(10.1, abs=0.1)
    assert values["latency p99.9 [ms]"] == pytest.approx(2.0)
    assert values["missed deadlines"] == 10


def test_a_late_step_is_none_missed(timing, clock):
    for late in (0, 10, 27, 30, 40, 57, 60, 70):  # [ms]; a timer keeps its phase
        clock.t = late * SECOND // 1000
        timing.add_step()
    assert timing.missed == 0
    clock.t = 99 * SECOND // 1000  # that of 80 ms; there is none for 90 ms
    timing.add_step()
    assert timing.missed == 1


def test_a_pause_is_no_period(timing, step):
    step(0)
    step(SECOND // 100)
    timing.interrupt()
    step(1000 * SECOND)
    assert timing.values()["period p99.9 [ms]"] == pytest.approx(10.0)
    assert timing.values()["missed deadlines"] == 0


def test_time_that_is_set_back_is_no_period(timing, step):
    for t in (0, SECOND // 100, -SECOND, SECOND // 100 - SECOND, 2 * SECOND // 100 - SECOND):
        step(100 * SECOND + t)
    values = timing.values()
    assert values["period p50 [ms]"] == values["period p99.9 [ms]"] == pytest.approx(10.0)
    assert values["missed deadlines"] == 0


def test_old_samples_are_dropped(timing, step):
    step(0, latency=SECOND)
    for k in range(1, MAX_SAMPLES + 1):
        step(k * SECOND // 100)
    assert timing.values()["latency p99.9 [ms]"] == pytest.approx(2.0)


def test_a_command_without_a_measurement_has_no_latency(timing, clock):
    timing.add_step()
    timing.add_command(None)
    clock.t = SECOND // 100
    timing.add_step()
    assert not any("latency" in name for name in timing.values())
