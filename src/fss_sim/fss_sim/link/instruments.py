"""What a link measures with: encoder and torque converter."""

from dataclasses import dataclass
from math import cos, pi, sin
from random import Random

from fss_arm_model.description import TorqueSensor
from fss_sim.noise import Noise

RIPPLE = 60  # periods a turn of the encoder's error: two a turn of the wave generator, at 30 : 1

IDEAL = Noise()


class Encoder:
    """The joint's angle as the drive has it, which is off as harmonic drives are.

        reading = q + error sin(60 q + phase)

    Args:
        error: the largest [rad]; 60 times it must be far below 1.
        phase: [rad].
    """

    def __init__(self, error: float = 0.0, phase: float = 0.0) -> None:
        self._error, self._phase = error, phase

    def reading(self, q: float) -> float:
        """What is read at the angle q [rad]."""
        return q + self._error * sin(RIPPLE * q + self._phase)

    def rate(self, q: float, qd: float) -> float:
        """How fast the reading changes at the angle q [rad] and the rate qd [rad/s]."""
        return qd * (1.0 + RIPPLE * self._error * cos(RIPPLE * q + self._phase))

    def angle(self, reading: float) -> float:
        """The angle at which this is read [rad]."""
        q = reading
        for _ in range(4):  # each leaves 4% of the error
            q = reading - self._error * sin(RIPPLE * q + self._phase)
        return q


class TorqueConverter:
    """A 24-bit converter that samples by itself; between samples, the last one stands.

    Args:
        sensor: its gain and zero.
        rate: samples a second.
        noise: white, each sample, 1 sigma [N m].
        zero: what it is off by [N m].
        random: for the noise.
    """

    def __init__(
        self, sensor: TorqueSensor, rate: int, noise: float, zero: float, random: Random
    ) -> None:
        self._sensor, self._noise, self._zero, self._random = sensor, noise, zero, random
        self._period = 1_000_000 // rate  # [us]
        self._sampled = -1  # [periods]
        self.counts = 0

    def sample(self, clock: int, torque: float) -> None:
        """Sample the torque [N m] if it is time to, by the link's clock [us]."""
        if (period := clock // self._period) == self._sampled:
            return
        self._sampled = period
        seen = torque + self._zero + self._noise * self._random.gauss(0.0, 1.0)
        counts = round(seen / self._sensor.gain + self._sensor.zero)
        self.counts = max(-(1 << 23), min(counts, (1 << 23) - 1))

    def age(self, clock: int) -> int:
        """Of the last sample [us]."""
        return clock - self._sampled * self._period


@dataclass(frozen=True)
class Instruments:
    """Those of one link."""

    encoder: Encoder
    torque: TorqueConverter


def make(
    sensor: TorqueSensor,
    noise: Noise = IDEAL,
    random: Random | None = None,
    torque_rate: int = 80,
) -> Instruments:
    """The instruments of a link, their errors drawn from `random`."""
    random = random or Random(0)
    encoder = Encoder(noise.encoder_error, random.uniform(-pi, pi))
    zero = random.gauss(0.0, noise.torque_zero)
    torque = TorqueConverter(sensor, torque_rate, noise.torque_noise, zero, random)
    return Instruments(encoder, torque)
