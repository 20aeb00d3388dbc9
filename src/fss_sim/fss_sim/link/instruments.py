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

        reading = q + error sin(60 q + phase) + eccentricity sin(q + eccentricity_phase)

    Encoder and gear are eccentric. The encoder is on the motor, so that errors of the gear are
    errors of the reading too.

    Args:
        error: amplitude of the first error [rad]; 60 times it must be far below 1.
        phase: phase of the first error [rad].
        eccentricity: amplitude of the second error [rad].
        eccentricity_phase: phase of the second error [rad].
    """

    def __init__(
        self,
        error: float = 0.0,
        phase: float = 0.0,
        eccentricity: float = 0.0,
        eccentricity_phase: float = 0.0,
    ) -> None:
        self._error, self._phase = error, phase
        self._eccentricity, self._eccentricity_phase = eccentricity, eccentricity_phase

    def reading(self, q: float) -> float:
        """Return the reading at the angle q [rad]."""
        return q + self._error_at(q)

    def rate(self, q: float, qd: float) -> float:
        """Return the rate of the reading [rad/s] at the angle q [rad] and the rate qd [rad/s]."""
        ripple = RIPPLE * self._error * cos(RIPPLE * q + self._phase)
        return qd * (1.0 + ripple + self._eccentricity * cos(q + self._eccentricity_phase))

    def angle(self, reading: float) -> float:
        """Return the angle that gives this reading [rad]."""
        q = reading
        for _ in range(4):  # each iteration leaves 4% of the error
            q = reading - self._error_at(q)
        return q

    def _error_at(self, q: float) -> float:
        ripple = self._error * sin(RIPPLE * q + self._phase)
        return ripple + self._eccentricity * sin(q + self._eccentricity_phase)


class TorqueConverter:
    """24-bit torque converter that samples at its own rate and keeps the last sample.

        measured = torque + zero + drift (1 - exp(-time / WARM_UP)) + crosstalk shear + noise

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
        self,
        sensor: TorqueSensor,
        rate: int,
        noise: float,
        zero: float,
        random: Random,
        crosstalk: float = 0.0,
        drift: float = 0.0,
    ) -> None:
        self._sensor, self._noise, self._zero, self._random = sensor, noise, zero, random
        self._crosstalk, self._drift = crosstalk, drift
        self._period = 1_000_000 // rate  # [us]
        self._last_period = -1  # [periods]
        self.counts = 0

    def sample(self, clock: int, torque: float, shear: float = 0.0) -> None:
        """Take a sample if one is due.

        Args:
            clock: the link's clock, since the electronics were switched on [us].
            torque: torque that the joint transmits [N m].
            shear: force across the link that the joint transmits [N].
        """
        if (period := clock // self._period) == self._last_period:
            return
        self._last_period = period
        warmth = 1.0 - exp(-clock / WARM_UP)
        measured = torque + self._zero + self._drift * warmth + self._crosstalk * shear
        measured += self._noise * self._random.gauss(0.0, 1.0)
        counts = round(measured / self._sensor.gain + self._sensor.zero)
        self.counts = max(-(1 << 23), min(counts, (1 << 23) - 1))

    def age(self, clock: int) -> int:
        """Return the age of the last sample [us]."""
        return clock - self._last_period * self._period


@dataclass(frozen=True)
class Instruments:
    """Instruments of one link."""

    encoder: Encoder
    torque: TorqueConverter


def make_instruments(
    sensor: TorqueSensor,
    noise: Noise = IDEAL,
    random: Random | None = None,
    torque_rate: int = 80,
    laboratory_random: Random | None = None,
) -> Instruments:
    """Return the instruments of a link, with random errors.

    `laboratory_random` supplies the errors that only the preset `laboratory` has. The errors of the
    other presets therefore stay the same for each seed.
    """
    random, laboratory_random = random or Random(0), laboratory_random or Random(0)
    eccentricity_phase = laboratory_random.uniform(-pi, pi)
    crosstalk = laboratory_random.gauss(0.0, noise.torque_crosstalk)
    drift = laboratory_random.gauss(0.0, noise.torque_drift)
    encoder = Encoder(
        noise.encoder_error, random.uniform(-pi, pi), noise.encoder_eccentricity, eccentricity_phase
    )
    zero = random.gauss(0.0, noise.torque_zero)
    torque = TorqueConverter(
        sensor, torque_rate, noise.torque_noise, zero, random, crosstalk, drift
    )
    return Instruments(encoder, torque)
