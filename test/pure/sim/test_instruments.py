"""Encoder and torque converter: errors as stated."""

from dataclasses import replace
from math import pi, radians
from random import Random

import numpy as np
import pytest

from fss_arm_model.description import TorqueSensor
from fss_sim.link.instruments import Encoder, TorqueConverter, make_instruments
from fss_sim.noise import PRESETS

ERROR = radians(150 / 3600)


def test_an_encoder_has_the_stated_error_and_an_exact_inverse():
    encoder, q = Encoder(ERROR, 1.0), np.linspace(-pi / 2, pi / 2, 2001)
    off = np.array([encoder.reading(x) - x for x in q])
    assert np.abs(off).max() == pytest.approx(ERROR, rel=1e-3)
    assert off.std() == pytest.approx(ERROR / 2**0.5, rel=1e-3)
    back = np.array([encoder.angle(encoder.reading(x)) for x in q])
    np.testing.assert_allclose(back, q, rtol=0, atol=0.1 * 2 * pi / 240_000)


def test_an_eccentric_encoder_has_one_more_error_period_per_turn_and_reads_its_rate():
    centred, off = Encoder(ERROR, 1.0), Encoder(ERROR, 1.0, 0.0003, 0.5)
    step = 1e-6
    for q in np.linspace(-pi, pi, 13):
        more = off.reading(q) - centred.reading(q)
        assert more == pytest.approx(0.0003 * np.sin(q + 0.5), abs=1e-12)
        assert off.angle(off.reading(q)) == pytest.approx(q, abs=0.1 * 2 * pi / 240_000)
        change = off.reading(q + step) - off.reading(q - step)
        assert off.rate(q, 0.8) == pytest.approx(0.8 * change / (2 * step), rel=1e-6)


@pytest.mark.parametrize("rate", [10, 80])
def test_a_converter_has_its_own_sample_rate_and_reports_the_age(rate):
    converter = TorqueConverter(TorqueSensor(gain=1e-6, zero=100.0), rate, 0.0, 0.02, Random(1))
    clocks = range(5_000_000, 7_000_000, 10_000)
    seen = []
    for clock in clocks:
        converter.sample(clock, clock * 1e-7)
        seen.append(converter.counts)
        assert 0 <= converter.age(clock) < 1_000_000 // rate
    assert len(set(seen)) == 2 * rate
    # The last sample, at most one step of this test late.
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


def test_a_torque_sensor_feels_forces_across_and_drifts_as_it_warms_up():
    sensor = TorqueSensor(gain=1e-6)
    converter = TorqueConverter(sensor, 80, 0.0, 0.01, Random(1), crosstalk=0.002, drift=0.02)
    for clock, shear, expected in (
        (100_000, 0.0, 0.51),
        (200_000, 3.0, 0.516),
        (1_200_000_000, 0.0, 0.51 + 0.02 * (1.0 - np.exp(-1.0))),
        (10_000_000_000, -3.0, 0.524),
    ):
        converter.sample(clock, 0.5, shear)
        assert converter.counts * 1e-6 == pytest.approx(expected, abs=1e-5)


def test_the_laboratory_errors_do_not_change_the_others():
    sensor, noise = TorqueSensor(gain=1e-6), PRESETS["default"]
    known, more = (make_instruments(sensor, n, Random(5)) for n in (noise, PRESETS["laboratory"]))
    off = [one.encoder.reading(0.3) for one in (known, more)]
    assert 1e-6 < abs(off[1] - off[0]) < radians(60 / 3600)
    bare = replace(PRESETS["laboratory"], encoder_eccentricity=0.0, torque_drift=0.0)
    same = make_instruments(sensor, bare, Random(5))
    for clock in range(0, 10**6, 12_500):
        known.torque.sample(clock, 0.1)
        same.torque.sample(clock, 0.1)
        assert same.torque.counts == known.torque.counts
    assert same.encoder.reading(0.3) == off[0]
