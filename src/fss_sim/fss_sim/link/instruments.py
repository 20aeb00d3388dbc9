"""Instruments of a link: encoder and torque converter."""

from dataclasses import dataclass
from math import cos, exp, pi, sin
from random import Random

from fss_arm_model.description import TorqueSensor
from fss_sim.noise import Noise

WARM_UP = 1.2e9  # time constant of a link's temperature [us]
RIPPLE = 60  # periods of the encoder error per turn: two per turn of the wave generator, at 30 : 1

IDEAL = Noise()


class Encoder:
    """Encoder of a joint, with the errors that are typical of harmonic drives.

        reading = q + error sin(60 q + phase) + eccentricity sin(q + way)

    Encoder and gear are eccentric. The encoder is on the motor, so that errors of the gear are
    errors of the reading too.

    Args:
        error: amplitude of the first error [rad]; 60 times it must be far below 1.
        phase: phase of the first error [rad].
        eccentricity: amplitude of the second error [rad].
        way: phase of the second error [rad].
    """

    def __init__(
        self, error: float = 0.0, phase: float = 0.0, eccentricity: float = 0.0, way: float = 0.0
    ) -> None:
        self._error, self._phase, self._eccentricity, self._way = error, phase, eccentricity, way

    def reading(self, q: float) -> float:
        """Return the reading at the angle q [rad]."""
        return q + self._off(q)

    def rate(self, q: float, qd: float) -> float:
        """Return the rate of the reading [rad/s] at the angle q [rad] and the rate qd [rad/s]."""
        ripple = RIPPLE * self._error * cos(RIPPLE * q + self._phase)
        return qd * (1.0 + ripple + self._eccentricity * cos(q + self._way))

    def angle(self, reading: float) -> float:
        """Return the angle that gives this reading [rad]."""
        q = reading
        for _ in range(4):  # each iteration leaves 4% of the error
            q = reading - self._off(q)
        return q

    def _off(self, q: float) -> float:
        ripple = self._error * sin(RIPPLE * q + self._phase)
        return ripple + self._eccentricity * sin(q + self._way)


class TorqueConverter:
    """24-bit torque converter that samples at its own rate and keeps the last sample.

        seen = torque + zero + drift (1 - exp(-time / WARM_UP)) + crosstalk shear + noise

    Its strain gauges are on the spokes between the two halves of a joint. A force across the link
    bends the spokes too. The bridge cancels this except for errors in placing and matching the
    gauges. The zero drifts with the temperature, which rises after the electronics are switched on.

    Args:
        sensor: gain and zero of the sensor.
        rate: samples per second.
        noise: standard deviation of the white noise of each sample [N m].
        zero: offset of the zero [N m].
        random: random numbers for the noise.
        crosstalk: measured torque per force across the link [N m/N].
        drift: drift of the zero when the link is warm [N m].
    """

    def __init__(
        self, sensor: TorqueSensor, rate: int, noise: float, zero: float, random: Random,
        crosstalk: float = 0.0, drift: float = 0.0,
    ) -> None:  # fmt: skip
        self._sensor, self._noise, self._zero, self._random = sensor, noise, zero, random
        self._crosstalk, self._drift = crosstalk, drift
        self._period = 1_000_000 // rate  # [us]
        self._sampled = -1  # [periods]
        self.counts = 0

    def sample(self, clock: int, torque: float, shear: float = 0.0) -> None:
        """Take a sample if one is due.

        Args:
            clock: the link's clock, since the electronics were switched on [us].
            torque: torque that the joint transmits [N m].
            shear: force across the link that the joint transmits [N].
        """
        if (period := clock // self._period) == self._sampled:
            return
        self._sampled = period
        warmth = 1.0 - exp(-clock / WARM_UP)
        seen = torque + self._zero + self._drift * warmth + self._crosstalk * shear
        seen += self._noise * self._random.gauss(0.0, 1.0)
        counts = round(seen / self._sensor.gain + self._sensor.zero)
        self.counts = max(-(1 << 23), min(counts, (1 << 23) - 1))

    def age(self, clock: int) -> int:
        """Return the age of the last sample [us]."""
        return clock - self._sampled * self._period


@dataclass(frozen=True)
class Instruments:
    """Instruments of one link."""

    encoder: Encoder
    torque: TorqueConverter


def make(
    sensor: TorqueSensor,
    noise: Noise = IDEAL,
    random: Random | None = None,
    torque_rate: int = 80,
    more: Random | None = None,
) -> Instruments:
    """Return the instruments of a link, with errors drawn from `random` and `more`.

    `more` supplies the errors that only the preset `laboratory` has. The errors of the other
    presets therefore stay the same for each seed.
    """
    random, more = random or Random(0), more or Random(0)
    way = more.uniform(-pi, pi)
    crosstalk = more.gauss(0.0, noise.torque_crosstalk)
    drift = more.gauss(0.0, noise.torque_drift)
    encoder = Encoder(noise.encoder_error, random.uniform(-pi, pi), noise.encoder_eccentricity, way)
    zero = random.gauss(0.0, noise.torque_zero)
    torque = TorqueConverter(
        sensor, torque_rate, noise.torque_noise, zero, random, crosstalk, drift
    )
    return Instruments(encoder, torque)
