"""The gyro by sums: what is lost loses nothing, and a bias is found at rest alone."""

from dataclasses import replace

import numpy as np
import pytest
from base_board import SAMPLE

from fss_arm_model.units import SECOND
from fss_base_driver.gyro import Bias, BiasSearch, GyroSums

MS = 1_000_000


def frames(counts, per_frame=5, begin=(0, 0)):
    """Telemetry at 20 Hz of samples with these counts, sums and numbers going round."""
    total, number = begin
    made = []
    for k in range(0, len(counts) + 1, per_frame):
        gyro_sum = (total + sum(counts[:k])) & 0xFFFFFFFF
        samples = (number + k) & 0xFFFF
        clock = 10_000 * k
        frame = replace(SAMPLE, clock=clock, gyro_sum=gyro_sum, gyro_samples=samples)
        made.append((frame, 1000 * clock))
    return made


def turns(made):
    sums = GyroSums()
    return [turn for frame, stamp in made if (turn := sums.add(frame, stamp))]


@pytest.mark.parametrize("begin", [(0, 0), (0xFFFFFFF0, 0xFFFE), (-70_000, 7)])
def test_the_mean_between_frames_is_that_of_the_samples_in_its_middle(begin):
    counts = np.random.default_rng(1).integers(-60_000, 60_000, 100).tolist()
    got = turns(frames(counts, begin=begin))
    assert [turn.counts for turn in got] == [sum(counts[k : k + 5]) / 5 for k in range(0, 100, 5)]
    assert [turn.stamp for turn in got] == [(25 + 50 * k) * MS for k in range(20)]
    assert {turn.samples for turn in got} == {5}


def test_a_lost_frame_loses_nothing():
    counts = np.random.default_rng(2).integers(-60_000, 60_000, 100).tolist()
    made = frames(counts)
    angle = sum(turn.counts * turn.samples for turn in turns(made[:7] + made[9:]))
    assert angle == pytest.approx(sum(counts))


def test_nothing_is_said_over_a_restart_a_long_gap_or_a_dead_gyro():
    made = frames(list(range(200)))
    assert len(turns(made)) == len(made) - 1
    restarted = [(replace(frame, boot=4), stamp) for frame, stamp in made[5:]]
    assert len(turns(made[:5] + restarted)) == len(made) - 2
    assert len(turns(made[:3] + made[30:])) == len(made) - 27 - 2
    assert turns([(replace(made[0][0], clock=f.clock), stamp) for f, stamp in made]) == []


def search(rates, valves=0):
    """The outcome, and the frame that ended the search."""
    finder = BiasSearch(1.0, 1e-3, 0.01)
    for k, rate in enumerate(rates):
        finder.add(50 * MS * k + 1, rate, 5, valves)
        if finder.outcome:
            return finder.outcome, k
    return None


def test_the_bias_is_the_mean_and_its_deviation_is_honest():
    errors = []
    for seed in range(100):
        rates = 2e-3 + np.random.default_rng(seed).normal(0.0, 1e-4, 40)
        bias, k = search(rates)
        assert k == 20
        errors.append((bias.rate - 2e-3) / bias.deviation)
    assert 0.85 < np.std(errors) < 1.2


@pytest.mark.parametrize(
    ("rates", "valves", "why"),
    [
        (21 * [0.0], 1, "a valve is open"),
        (np.linspace(-0.01, 0.01, 21), 0, "the base moves: rates scatter by 0.0061 rad/s"),
        (21 * [0.05], 0, "the base turns: 0.05 rad/s, a bias is below 0.01"),
    ],
)
def test_no_bias_is_found_in_motion(rates, valves, why):
    assert search(rates, valves)[0] == why


def test_a_search_ends_once():
    finder = BiasSearch(1.0, 1e-3, 0.01)
    finder.add(1, 0.002, 5, 0)
    finder.fail("the gyro is silent")
    finder.fail("the board is lost")
    finder.add(SECOND + 2, 0.002, 5, 0)
    assert finder.outcome == "the gyro is silent"
    finder = BiasSearch(1.0, 1e-3, 0.01)
    for stamp in (1, SECOND + 1):
        finder.add(stamp, 0.002, 5, 0)
    finder.fail("the gyro is silent")
    assert finder.outcome == Bias(0.002, 0.0)
