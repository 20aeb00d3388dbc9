"""What a link measures with: encoder and torque converter."""

from dataclasses import dataclass
from math import cos, exp, pi, sin
from random import Random

from fss_arm_model.description import TorqueSensor
from fss_sim.noise import Noise

WARM_UP = 1.2e9  # of a link, by which its temperature is 1/e short of what it becomes [us]
RIPPLE = 60  # periods a turn of the encoder's error: two a turn of the wave generator, at 30 : 1

IDEAL = Noise()


class Encoder:
    """The joint's angle as the drive has it, which is off as harmonic drives are.

        reading = q + error sin(60 q + phase) + eccentricity sin(q + way)

    Encoder and gear sit off centre: as the encoder is on the motor, what it does not see of the
    gear is its error too.

    Args:
        error: the largest of the first kind [rad]; 60 times it must be far below 1.
        phase: [rad].
        eccentricity: the largest error of the second kind [rad].
        way: [rad].
    """

    def __init__(
        self, error: float = 0.0, phase: float = 0.0, eccentricity: float = 0.0, way: float = 0.0
    ) -> None:
        self._error, self._phase, self._eccentricity, self._way = error, phase, eccentricity, way

    def reading(self, q: float) -> float:
        """What is read at the angle q [rad]."""
        return q + self._off(q)

    def rate(self, q: float, qd: float) -> float:
        """How fast the reading changes at the angle q [rad] and the rate qd [rad/s]."""
        ripple = RIPPLE * self._error * cos(RIPPLE * q + self._phase)
        return qd * (1.0 + ripple + self._eccentricity * cos(q + self._way))

    def angle(self, reading: float) -> float:
        """The angle at which this is read [rad]."""
        q = reading
        for _ in range(4):  # each leaves 4% of the error
            q = reading - self._off(q)
        return q

    def _off(self, q: float) -> float:
        ripple = self._error * sin(RIPPLE * q + self._phase)
        return ripple + self._eccentricity * sin(q + self._way)


class TorqueConverter:
    """A 24-bit converter that samples by itself; between samples, the last one stands.

        seen = torque + zero + drift (1 - exp(-time / WARM_UP)) + crosstalk shear + noise

    Its strain gauges lie on the spokes between a joint's halves. A force across the link bends them
    as well, which the bridge cancels but for how well its gauges are placed and matched. The zero
    drifts with the temperature, which rises from when the electronics are switched on.

    Args:
        sensor: its gain and zero.
        rate: samples a second.
        noise: white, each sample, 1 sigma [N m].
        zero: what it is off by [N m].
        random: for the noise.
        crosstalk: what it shows of a force across the link [N m/N].
        drift: of its zero when the link is warm [N m].
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
        """Sample if it is time to, by the link's clock [us].

        Args:
            clock: since the electronics were switched on.
            torque: that passes [N m].
            shear: force across the link that passes too [N].
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
    more: Random | None = None,
) -> Instruments:
    """The instruments of a link; its errors come from `random`, those of `laboratory` from `more`.

    So each seed goes on to mean what it always has.
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
