"""What links' telemetry says of their drives."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fss_arm_calib.acceptance import FAIL, NOT_EVALUATED, PASS, Check
from fss_arm_calib.drives.motion import Samples
from fss_arm_calib.drives.problem import COULOMB, GAIN, KT, NAMES, VISCOUS, ZERO, Drive, solve
from fss_arm_calib.drives.settings import DrivesSettings
from fss_arm_calib.estimation.least_squares import Floats
from fss_arm_calib.outcome import LIVE, Estimate, Outcome, concluded
from fss_arm_calib.segments.samples import Stamps
from fss_arm_calib.segments.streams import Streams
from fss_arm_model.description import Arm, Link

NEEDED = ("torque_constant", "torque_gain", "viscous", "coulomb")
FEWEST = 50  # samples of a link


@dataclass(frozen=True)
class Telemetry:
    """What a link reported, raw as LinkTelemetry has it: (k,) each, in order of time."""

    stamp: Stamps  # of the measurement [ns]
    position: Floats  # [counts]
    velocity: Floats  # [0.1 counts/s]
    current: Floats  # [0.01 A]
    torque: Floats  # [counts]
    torque_age: Floats  # [ms]

    @property
    def start(self) -> int:
        """Of it [ns]."""
        return int(self.stamp[0]) if self.stamp.size else 0

    @property
    def end(self) -> int:
        """Of it [ns]."""
        return int(self.stamp[-1]) if self.stamp.size else 0

    @property
    def reason(self) -> str:
        """Why it is not used; empty: it is."""
        few = self.stamp.size < FEWEST
        return f"{self.stamp.size} samples (at least {FEWEST})" if few else ""

    @property
    def used(self) -> bool:
        """Whether it is solved from."""
        return not self.reason

    def samples(self, link: Link, origin: int) -> Samples:
        """The same in SI units, times from `origin` [ns] on."""
        drive, sensor = link.drive, link.torque_sensor
        count = drive.direction * 2.0 * np.pi / drive.counts_per_turn
        return Samples(
            1e-9 * (self.stamp - origin).astype(np.float64),
            count * self.position,
            0.1 * count * self.velocity,
            0.01 * drive.direction * self.current,
            sensor.gain * (self.torque - sensor.zero),
            1e-3 * self.torque_age,
        )


def calibrate(
    data: Sequence[Telemetry], arm: Arm, s: DrivesSettings, source: str = LIVE
) -> Outcome[Telemetry, list[Drive]]:
    """Estimate each joint's drive, and check the result.

    Args:
        data: of links 1 to n.
        arm: its masses set the scale; its torque constants and sensors are the guess.
        s: the settings.
        source: of the data.
    """
    names = tuple(f"{name}_{i}" for i in range(1, arm.n + 1) for name in NAMES)
    units = tuple(NAMES.values()) * arm.n
    guess = np.full((arm.n, len(NAMES)), np.nan)
    for row, link in zip(guess, arm.links, strict=True):
        row[[KT, GAIN, ZERO]] = link.drive.torque_constant, link.torque_sensor.gain, 0.0
    estimate, drives = Estimate(names, units, guess.ravel()), None
    silent = [f"link {i}: {one.reason}" for i, one in enumerate(data, 1) if not one.used]
    checks = [
        Check(
            "telemetry", NOT_EVALUATED if silent else PASS, arm.n - len(silent), arm.n,
            "; ".join(silent) or f"{sum(one.stamp.size for one in data)} samples of {arm.n} links",
        )
    ]  # fmt: skip
    if not silent:
        origin = min(one.start for one in data)
        drives = solve(
            arm, [one.samples(k, origin) for one, k in zip(data, arm.links, strict=True)], s
        )
        estimate = estimate_of(drives, names, units, guess.ravel())
        checks += evaluate(drives)
    columns = [getattr(one, name) for one in data for name in one.__dataclass_fields__]
    return concluded(
        data, [one for one in data if one.used], columns, arm, s, DrivesSettings, Streams(),
        source, checks, estimate, drives, (lambda: calibrated(arm, drives)) if drives else None,
    )  # fmt: skip


def estimate_of(
    drives: Sequence[Drive], names: tuple[str, ...], units: tuple[str, ...], guess: Floats
) -> Estimate:
    """What is estimated, as every kind of calibration has it; joints are independent."""
    size = len(NAMES)
    covariance = np.zeros((len(names),) * 2)
    for k, one in enumerate(drives):
        covariance[k * size :, k * size :][:size, :size] = one.covariance
    values = np.concatenate([one.values for one in drives])
    lost = tuple(name for name, value in zip(names, values, strict=True) if np.isnan(value))
    return Estimate(names, units, guess, values, covariance, undetermined=lost)


def evaluate(drives: Sequence[Drive]) -> list[Check]:
    """The checks of a result; what is refused has one each, which says why."""
    checks = []
    for i, one in enumerate(drives, 1):
        for name, reason in one.refused.items():
            needed = name in NEEDED
            words = f"{name}_{i} refused: {reason}"
            checks.append(Check(f"{name}_{i}", NOT_EVALUATED, np.nan, np.nan, words, needed))
        least = np.nanmin([*one.values[[KT, GAIN, VISCOUS, COULOMB]], np.inf])
        words = "" if least > 0.0 else f"joint {i}: {least:.2g}, where only a positive one can be"
        checks.append(Check(f"positive_{i}", FAIL if words else PASS, float(least), 0.0, words))
    return checks


def calibrated(arm: Arm, drives: Sequence[Drive]) -> Arm:
    """The arm with the torque constants and torque sensors that were found."""
    links = []
    for link, one in zip(arm.links, drives, strict=True):
        K, gain, zero = one.values[[KT, GAIN, ZERO]].tolist()
        shift = link.torque_sensor.zero + zero / gain
        links.append(
            replace(
                link,
                drive=replace(link.drive, torque_constant=K),
                torque_sensor=replace(link.torque_sensor, gain=gain, zero=shift),
            )
        )
    return replace(arm, links=tuple(links))
