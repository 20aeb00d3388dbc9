"""Calibration of drives from excitations: the solution and its checks."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial

import numpy as np

from fss_arm_calib import checks
from fss_arm_calib.acceptance import FAIL, NOT_EVALUATED, PASS, Check
from fss_arm_calib.drives.motion import Samples
from fss_arm_calib.drives.problem import COULOMB, GAIN, KT, NAMES, VISCOUS, ZERO, Drive, solve
from fss_arm_calib.drives.settings import DrivesSettings
from fss_arm_calib.outcome import LIVE, Estimate, Outcome, make_outcome
from fss_arm_calib.segments.excitations import Excitation
from fss_arm_calib.segments.streams import Streams
from fss_arm_calib.segments.telemetry import keep_since_homing
from fss_arm_model.arrays import Floats, Stamps
from fss_arm_model.description import Arm, Link

REQUIRED = ("torque_constant", "torque_gain", "viscous", "coulomb")
MIN_FRAMES = 50  # smallest number of samples of a link


def calibrate(
    excitations: Sequence[Excitation],
    arm: Arm,
    settings: DrivesSettings | None = None,
    streams: Streams | None = None,
    source: str = LIVE,
) -> Outcome[Excitation, list[Drive]]:
    """Estimate each joint's drive, and check the result.

    Excitations before the last homing of a joint are left out. The arm's masses set the scale; its
    torque constants and sensors are the guess.
    """
    s, streams = settings or DrivesSettings(), streams or Streams()
    used = keep_since_homing([one for one in excitations if one.used])
    telemetry = [Telemetry.of(used, i) for i in range(arm.n)]
    fewest = min(one.stamps.size for one in telemetry)
    number = f"{fewest} frames of each link"
    words = f"{number} while a joint turned (at least {MIN_FRAMES})"
    frames = checks.data_amount("telemetry", fewest, MIN_FRAMES, words, streams, number)
    criteria = [checks.clocks(streams, s.joint_gap), frames]
    drives: list[Drive] | None = None
    calibrated: Callable[[], Arm] | None = None
    if frames.verdict == PASS:
        origin = min(int(one.stamps[0]) for one in telemetry)
        pairs = zip(telemetry, arm.links, strict=True)
        drives = solve(arm, [one.samples(link, origin) for one, link in pairs], s)
        criteria += evaluate(drives)
        calibrated = partial(with_drives, arm, drives)
    columns = [getattr(one, f.name) for one in telemetry for f in fields(one)]
    context = arm, s, DrivesSettings, streams, source
    estimate = estimate_of(arm, drives)
    return make_outcome(
        excitations, used, columns, *context, criteria, estimate, drives, calibrated
    )


@dataclass(frozen=True)
class Telemetry:
    """Telemetry of a link in all excitations, in the units of LinkTelemetry: (k,) each."""

    stamps: Stamps  # of the measurement, increasing [ns]
    position: Floats  # [counts]
    velocity: Floats  # [0.1 counts/s]
    current: Floats  # [0.01 A]
    torque: Floats  # [counts]
    torque_age: Floats  # [ms]

    @classmethod
    def of(cls, excitations: Sequence[Excitation], i: int) -> "Telemetry":
        """Collect the telemetry of link i, counted from 0."""
        columns = {
            f.name: [x for one in excitations for x in getattr(one.links[i], f.name)]
            for f in fields(cls)
        }
        stamps = np.array(columns.pop("stamps"), dtype=np.int64)
        stamps, once = np.unique(stamps, return_index=True)
        numbers = {name: np.array(column, float)[once] for name, column in columns.items()}
        return cls(stamps, **numbers)

    def samples(self, link: Link, origin: int) -> Samples:
        """Convert to SI units, with times relative to `origin` [ns]."""
        sign, sensor = link.drive.direction, link.torque_sensor
        count = sign * 2.0 * np.pi / link.drive.counts_per_turn
        t = 1e-9 * (self.stamps - origin).astype(np.float64)
        torque = sensor.gain * (self.torque - sensor.zero)
        motion = count * self.position, 0.1 * count * self.velocity
        return Samples(t, *motion, 0.01 * sign * self.current, torque, 1e-3 * self.torque_age)


def estimate_of(arm: Arm, drives: Sequence[Drive] | None) -> Estimate:
    """Convert to the estimate that all kinds of calibration share; joints are independent."""
    size = len(NAMES)
    names = tuple(f"{name}_{i}" for i in range(1, arm.n + 1) for name in NAMES)
    units = tuple(NAMES.values()) * arm.n
    guess = np.full((arm.n, size), np.nan)
    for row, link in zip(guess, arm.links, strict=True):
        row[[KT, GAIN, ZERO]] = link.drive.torque_constant, link.torque_sensor.gain, 0.0
    if drives is None:
        return Estimate(names, units, guess.ravel())
    covariance = np.zeros((len(names),) * 2)
    for k, one in enumerate(drives):
        covariance[k * size :, k * size :][:size, :size] = one.covariance
    values = np.concatenate([one.values for one in drives])
    lost = tuple(name for name, value in zip(names, values, strict=True) if np.isnan(value))
    return Estimate(names, units, guess.ravel(), values, covariance, undetermined=lost)


def evaluate(drives: Sequence[Drive]) -> Iterator[Check]:
    """Yield the checks of a result, with one check and reason for each refused parameter."""
    for i, one in enumerate(drives, 1):
        for name, reason in one.undetermined.items():
            words = f"{name}_{i} not determined: {reason}"
            needed = name in REQUIRED
            yield Check(f"{name}_{i}", NOT_EVALUATED, np.nan, np.nan, words, needed)
        least = float(np.nanmin([*one.values[[KT, GAIN, VISCOUS, COULOMB]], np.inf]))
        words = "" if least > 0.0 else f"joint {i}: a parameter is {least:.2g}, must be positive"
        yield Check(f"positive_{i}", FAIL if words else PASS, least, 0.0, words)


def with_drives(arm: Arm, drives: Sequence[Drive]) -> Arm:
    """Return the arm with the estimated torque constants and torque sensors."""
    links = []
    for link, one in zip(arm.links, drives, strict=True):
        K, gain, zero = one.values[[KT, GAIN, ZERO]].tolist()
        sensor = replace(link.torque_sensor, gain=gain, zero=link.torque_sensor.zero + zero / gain)
        drive = replace(link.drive, torque_constant=K)
        links.append(replace(link, drive=drive, torque_sensor=sensor))
    return replace(arm, links=tuple(links))
