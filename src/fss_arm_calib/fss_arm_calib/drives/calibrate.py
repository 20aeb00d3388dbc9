"""Calibration of drives from excitations: the solution and its checks."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from fss_arm_calib.acceptance import (
    FAIL,
    NOT_EVALUATED,
    PASS,
    Check,
    check_clocks,
    check_data_amount,
)
from fss_arm_calib.drives.motion import Samples
from fss_arm_calib.drives.problem import COULOMB, GAIN, KT, NAMES, VISCOUS, ZERO, Drive, solve
from fss_arm_calib.drives.settings import DrivesSettings
from fss_arm_calib.outcome import LIVE, Estimate, Outcome, make_outcome
from fss_arm_calib.segments.excitations import Excitation
from fss_arm_calib.segments.samples import Stamps
from fss_arm_calib.segments.streams import Streams
from fss_arm_calib.segments.telemetry import keep_since_homing
from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm, Link

REQUIRED = ("torque_constant", "torque_gain", "viscous", "coulomb")
MIN_FRAMES = 50  # smallest number of samples of a link


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
        drive, sensor = link.drive, link.torque_sensor
        count = drive.direction * 2.0 * np.pi / drive.counts_per_turn
        return Samples(
            1e-9 * (self.stamps - origin).astype(np.float64),
            count * self.position,
            0.1 * count * self.velocity,
            0.01 * drive.direction * self.current,
            sensor.gain * (self.torque - sensor.zero),
            1e-3 * self.torque_age,
        )


def calibrate(
    excitations: Sequence[Excitation],
    arm: Arm,
    settings: DrivesSettings | None = None,
    streams: Streams | None = None,
    source: str = LIVE,
) -> Outcome[Excitation, list[Drive]]:
    """Estimate each joint's drive, and check the result.

    Args:
        excitations: in order of time; those before the last homing of a joint are left out.
        arm: its masses set the scale; its torque constants and sensors are the guess.
        settings: prior knowledge and criteria.
        streams: events in the streams that the excitations come from.
        source: name of the source of the excitations.
    """
    s, streams = settings or DrivesSettings(), streams or Streams()
    used = keep_since_homing([one for one in excitations if one.used])
    links = [Telemetry.of(used, i) for i in range(arm.n)]
    names = tuple(f"{name}_{i}" for i in range(1, arm.n + 1) for name in NAMES)
    units = tuple(NAMES.values()) * arm.n
    guess = np.full((arm.n, len(NAMES)), np.nan)
    for row, link in zip(guess, arm.links, strict=True):
        row[[KT, GAIN, ZERO]] = link.drive.torque_constant, link.torque_sensor.gain, 0.0
    estimate, drives = Estimate(names, units, guess.ravel()), None
    fewest = min(one.stamps.size for one in links)
    words = f"{fewest} frames of each link while a joint turned (at least {MIN_FRAMES})"
    checks = [
        check_clocks(streams, s.joint_gap),
        check_data_amount(
            "telemetry", fewest, MIN_FRAMES, words, streams, f"{fewest} frames of each link"
        ),
    ]
    if fewest >= MIN_FRAMES:
        origin = min(int(one.stamps[0]) for one in links)
        drives = solve(
            arm, [one.samples(k, origin) for one, k in zip(links, arm.links, strict=True)], s
        )
        estimate = estimate_of(drives, names, units, guess.ravel())
        checks += evaluate(drives)
    columns = [getattr(one, f.name) for one in links for f in fields(one)]
    return make_outcome(
        excitations,
        used,
        columns,
        arm,
        s,
        DrivesSettings,
        streams,
        source,
        checks,
        estimate,
        drives,
        (lambda: calibrated(arm, drives)) if drives else None,
    )


def estimate_of(
    drives: Sequence[Drive], names: tuple[str, ...], units: tuple[str, ...], guess: Floats
) -> Estimate:
    """Convert to the estimate that all kinds of calibration share; joints are independent."""
    size = len(NAMES)
    covariance = np.zeros((len(names),) * 2)
    for k, one in enumerate(drives):
        covariance[k * size :, k * size :][:size, :size] = one.covariance
    values = np.concatenate([one.values for one in drives])
    lost = tuple(name for name, value in zip(names, values, strict=True) if np.isnan(value))
    return Estimate(names, units, guess, values, covariance, undetermined=lost)


def evaluate(drives: Sequence[Drive]) -> list[Check]:
    """Evaluate the checks of a result, with one check and reason for each refused parameter."""
    checks = []
    for i, one in enumerate(drives, 1):
        for name, reason in one.undetermined.items():
            needed = name in REQUIRED
            words = f"{name}_{i} not determined: {reason}"
            checks.append(Check(f"{name}_{i}", NOT_EVALUATED, np.nan, np.nan, words, needed))
        least = np.nanmin([*one.values[[KT, GAIN, VISCOUS, COULOMB]], np.inf])
        words = "" if least > 0.0 else f"joint {i}: a parameter is {least:.2g}, must be positive"
        checks.append(Check(f"positive_{i}", FAIL if words else PASS, float(least), 0.0, words))
    return checks


def calibrated(arm: Arm, drives: Sequence[Drive]) -> Arm:
    """Return the arm with the estimated torque constants and torque sensors."""
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
