"""The link's clock on the host's time line: against a simulated link and network."""

import random
from math import inf, isnan, sqrt

import pytest

from fss_arm_model.units import SECOND
from fss_link.host_clock import HostClock
from fss_link.session.clock import LinkClock

START = 1_700_000_000 * SECOND  # host time at which the link's clock is 0


def link_us(host, drift=0.0):
    return round((host - START) * (1.0 + drift)) // 1000


def exchange(clock, sent, there, turnaround, back, drift=0.0, step=1):
    """One round trip over delays [ns]; the host reads a clock that moves in steps."""
    measured = sent + there + turnaround
    received = measured + back
    arrived_us, measured_us = link_us(sent + there, drift), link_us(measured, drift)
    clock.exchange(
        sent // step * step, measured_us - arrived_us, measured_us, received // step * step
    )
    return received


def test_before_a_round_trip_the_least_delayed_frame_stands_in():
    clock = LinkClock(100, START + 100_000 + 7_000_000)
    clock.one_way(200, START + 200_000 + 5_000_000)
    clock.one_way(300, START + 300_000 + 9_000_000)
    assert clock.offset(300) == START + 5_000_000
    assert clock.deviation(START) == inf
    assert isnan(clock.round_trip)


def test_equal_delays_give_the_offset_exactly():
    clock = LinkClock(0, START + SECOND)
    now = exchange(clock, START + SECOND, 3_000_000, 150_000_000, 3_000_000)
    assert clock.offset(0) == START
    assert clock.round_trip == pytest.approx(6e-3)
    assert clock.deviation(now) == pytest.approx(3e-3 / sqrt(3), rel=1e-3)
    assert clock.to_host(clock.to_link(now)) == now


def test_a_short_round_trip_outweighs_long_ones():
    clock = LinkClock(0, START + SECOND)
    exchange(clock, START + SECOND, 1_000_000, 0, 1_000_000)
    for k in range(2, 12):
        now = exchange(clock, START + k * SECOND, 40_000_000, 0, 2_000_000)
    assert abs(clock.to_host(link_us(now)) - now) < 2_000_000


@pytest.mark.parametrize("drift", [-100e-6, 0.0, 30e-6])
def test_drift_is_found_and_carries_over_silence(drift):
    """After two minutes of 2 to 6 ms each way, half a minute of silence costs a millisecond."""
    rng, clock = random.Random(3), LinkClock(0, START + 5_000_000)
    for k in range(1, 600):
        delays = (int(1e6 * rng.uniform(2, 6)) for _ in range(2))
        now = exchange(
            clock, START + k * SECOND // 5, next(delays), 90_000_000, next(delays), drift
        )
    assert clock.drift == pytest.approx(-drift, abs=3e-6)
    later = now + 30 * SECOND
    assert abs(clock.to_host(link_us(later, drift)) - later) < 1_000_000
    assert clock.half_width(later) > clock.half_width(now)


@pytest.mark.parametrize("leap", [-3600 * SECOND, -80_000_000, 80_000_000, 3600 * SECOND])
def test_a_clock_that_was_set_is_followed_at_once(leap):
    clock = LinkClock(0, START + SECOND)
    for k in range(1, 50):
        exchange(clock, START + k * SECOND, 3_000_000, 0, 3_000_000)
    sent = START + 50 * SECOND
    clock.exchange(sent + leap, 0, link_us(sent + 3_000_000), sent + leap + 6_000_000)
    assert clock.offset(link_us(sent)) == START + leap


def test_an_exchange_that_takes_less_than_no_time_is_ignored():
    clock = LinkClock(0, START)
    clock.exchange(START, 2_000_000, 2_000_000, START + SECOND)
    assert clock.deviation(START) == inf


@pytest.mark.parametrize("seed", range(3))
def test_the_interval_holds_the_truth_and_the_middle_is_near(seed):
    """50 +- 40 ms each way, an oscillator 50 ppm fast, a fifth of the frames lost."""
    rng = random.Random(seed)
    drift, errors = 50e-6, []
    clock = LinkClock(0, START + 50_000_000)
    for k in range(1, 1500):
        sent = START + k * SECOND // 5
        if rng.random() < 0.36:
            continue
        there, back = (int(1e6 * rng.uniform(10, 90)) for _ in range(2))
        now = exchange(clock, sent, there, 120_000_000, back, drift)
        error = clock.to_host(link_us(now, drift)) - now
        assert abs(error) <= clock.half_width(now) + 2000  # clocks of whole microseconds
        errors.append(1e-9 * error)
    settled = errors[len(errors) // 5 :]  # after a minute
    assert sqrt(sum(e * e for e in errors) / len(errors)) < 5e-3
    assert sqrt(sum(e * e for e in settled) / len(settled)) < 2e-3
    assert clock.deviation(now) > 5e-3  # it may be all of the least delay, one way


@pytest.mark.parametrize("delay", [0, 400_000, 12_000_000])
def test_a_clock_in_steps_of_10_ms_is_allowed_for(delay):
    step, rng = 10_000_000, random.Random(2)
    clock = LinkClock(0, START, resolution=step)
    for k in range(1, 200):
        sent = START + k * SECOND // 5 + rng.randrange(SECOND // 5)
        now = exchange(clock, sent, delay, 77_000_000, delay, step=step)
        assert abs(clock.to_host(link_us(now)) - now) <= clock.half_width(now) + 2000
    assert clock.half_width(now) < delay + 7_000_000


def test_the_time_of_day_is_followed_at_once_and_does_not_jitter_by_its_reading():
    rng, now, off = random.Random(4), 0, START

    def reading():
        nonlocal now
        now += rng.randrange(1, 50_000)  # each takes its time
        return now

    clock = HostClock(reading, lambda: reading() + off)
    seen = {clock.offset for _ in range(1000)}
    assert max(seen) - min(seen) < 50_000
    assert len({clock.offset for _ in range(1000)}) == 1  # the narrowest bounds are known
    for off in (START - 3600 * SECOND, START + 30 * SECOND, START + 30 * SECOND + 200_000):
        assert abs(clock.offset - off) < 50_000


def test_a_simulated_clock_is_its_own_time_of_day():
    now = 7

    def simulated():
        return now

    clock = HostClock(simulated, simulated)
    assert clock.offset == 0
    now = 3
    assert clock.offset == 0
