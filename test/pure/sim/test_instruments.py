"""Encoder and torque converter: errors as stated."""

from math import pi, radians
from random import Random

import numpy as np
import pytest

from fss_arm_model.description import TorqueSensor
from fss_sim.link.instruments import Encoder, TorqueConverter

ERROR = radians(150 / 3600)


def test_an_encoder_is_off_by_as_much_as_stated_and_its_inverse_is_exact():
    encoder, q = Encoder(ERROR, 1.0), np.linspace(-pi / 2, pi / 2, 5001)
    off = np.array([encoder.reading(x) - x for x in q])
    assert np.abs(off).max() == pytest.approx(ERROR, rel=1e-3)
    assert off.std() == pytest.approx(ERROR / 2**0.5, rel=1e-3)
    back = np.array([encoder.angle(encoder.reading(x)) for x in q])
    np.testing.assert_allclose(back, q, rtol=0, atol=0.1 * 2 * pi / 240_000)


def test_the_rate_read_is_the_derivative_of_the_reading():
    encoder, step = Encoder(ERROR, 0.3), 1e-6
    for q in np.linspace(-1.0, 1.0, 7):
        change = encoder.reading(q + step) - encoder.reading(q - step)
        assert encoder.rate(q, 0.8) == pytest.approx(0.8 * change / (2 * step), rel=1e-6)


@pytest.mark.parametrize("rate", [10, 80])
def test_a_converter_samples_by_itself_and_tells_the_age(rate):
    converter = TorqueConverter(TorqueSensor(gain=1e-6, zero=100.0), rate, 0.0, 0.02, Random(1))
    clocks = range(5_000_000, 7_000_000, 10_000)
    seen = []
    for clock in clocks:
        converter.sample(clock, clock * 1e-7)
        seen.append(converter.counts)
        assert 0 <= converter.age(clock) < 1_000_000 // rate
    assert len(set(seen)) == 2 * rate
    # What was sampled last, at most a step of this test after its time.
    last = (clocks[-1] - converter.age(clocks[-1])) * 1e-7
    assert seen[-1] == pytest.approx((last + 0.02) / 1e-6 + 100, abs=1001)


def test_a_converter_is_noisy_and_saturates_at_24_bits():
    converter = TorqueConverter(TorqueSensor(gain=1e-6), 80, 0.002, 0.0, Random(1))
    seen = []
    for clock in range(0, 2000 * 12_500, 12_500):
        converter.sample(clock, 0.5)
        seen.append(converter.counts * 1e-6)
    assert np.mean(seen) == pytest.approx(0.5, abs=4 * 0.002 / 2000**0.5)
    assert np.std(seen) == pytest.approx(0.002, rel=0.07)
    converter.sample(10**9, 50.0)
    assert converter.counts == (1 << 23) - 1
