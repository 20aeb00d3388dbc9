"""Commands sent at once, and delayed ones."""

import numpy as np
import pytest

from fss_arm_model.units import SECOND
from fss_link.pacer import Pacer

INTERVAL = SECOND // 50


def gone(times, rate=50.0):
    """Times at which they are sent, one after the other."""
    pacer, sent = Pacer(rate), []
    for at in times:
        now = max([at, *sent[-1:]])
        now += pacer.wait(now)
        pacer.sent(now)
        sent.append(now)
    return np.array(sent)


def test_a_stream_of_that_rate_never_waits_though_it_jitters():
    rng = np.random.default_rng(1)
    times = SECOND + INTERVAL * np.arange(2000) + rng.integers(0, INTERVAL // 4, 2000)
    np.testing.assert_array_equal(gone(times), times)


@pytest.mark.parametrize("rate", [100.0, 1000.0])
def test_a_faster_one_goes_out_at_that_rate(rate):
    times = SECOND + np.arange(2000) * SECOND // int(rate)
    sent = gone(times)
    assert np.diff(sent).min() >= INTERVAL // 2
    assert abs((sent[-1] - sent[0]) / 1999 - INTERVAL) < 0.01 * INTERVAL


def test_after_a_pause_nothing_is_made_up_for():
    sent = gone([SECOND, 5 * SECOND, 5 * SECOND, 5 * SECOND])
    assert sent[1] == 5 * SECOND
    assert np.diff(sent[1:]).min() >= INTERVAL // 2


def test_a_clock_that_is_set_back_stops_nothing():
    pacer = Pacer(50.0)
    pacer.sent(100 * SECOND)
    assert pacer.wait(SECOND) <= INTERVAL
