"""Parameters of each joint's drive and torque sensor, by two linear regressions.

The arm's known masses set the scale. The torque s and the force f that a rigid arm would transmit
are those of fss_arm_model.joint_loads. Averages are taken over windows with weights phi, a Hann
window of length W. In these averages, the sensor's torque is s minus the torque of the links that
swing on their gears. phi'' reduces the latter (modulating functions, Shinbrot 1957):

    <phi, seen> = g (<phi, s> + X <phi, f> - c <phi'', M s> + zero + drift t)

Here g = described / true gain, X is the crosstalk of the force f across the link, M is the reduced
inertia, and c is a compliance. c is a nuisance parameter: it also absorbs backlash.

The drive's current then gives its torque constant K and the friction while the joint turns:

    K i = s + J v' + viscous v + (coulomb + more exp(-(v / v_s)^2)) sign v + ripple(q)

with s = seen / g - zero - drift t - X f and a ripple of P periods per turn. The solution satisfies
Z' (i - A x) = 0. If the frames are dense, the swinging of the links determines the rotor's inertia
J, and Z = A. If the frames are far apart, J is assumed. The swinging between the sample of a torque
and that of a current is then unknown, so that least squares would underestimate 1 / K by some
percent. The torque of the rigid arm does not have this error and replaces s in Z (instrumental
variables: Young 1970; Janot, Vandanjon & Gautier 2014).

The swinging of the links is not white noise: residuals are correlated within BLOCK_DURATION.
Standard deviations are therefore computed by a jackknife that leaves out one block after the other
in both regressions (Bell & McCaffrey 2002; MacKinnon, Nielsen & Webb 2023). It covers the errors
that the second regression inherits from the first, and blocks of unequal information. The number of
blocks determines the degrees of freedom of the Student distribution.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from fss_arm_calib.drives.motion import Motion, Samples
from fss_arm_calib.drives.settings import DrivesSettings
from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_model.estimation.least_squares import solve_with_instruments
from fss_arm_model.joint_loads import reduced_inertia, transmitted_loads

INTEGRATION_STEP = 0.02  # step of the integrals [s]
BLOCK_DURATION = 4.0  # time within which residuals may be correlated [s]
MIN_MOVING_TIME = 20.0  # time in motion that each joint needs [s]
STRIBECK_SPEEDS = np.geomspace(0.01, 0.3, 18)  # candidates for the Stribeck speed [rad/s]

SCALE, DRIFT, CROSSTALK, COMPLIANCE = range(1, 5)  # columns of the sensor's regression; 0: zero
EXCESS, SPEED_STEP, INERTIA = range(7, 10)  # columns of the drive's regression

#: Parameters of each joint, in this order, with units.
NAMES = {
    "torque_constant": "N m/A",
    "torque_gain": "N m/count",
    "torque_zero": "N m",
    "torque_crosstalk": "m",
    "viscous": "N m s/rad",
    "coulomb": "N m",
    "static": "N m",
    "stribeck_speed": "rad/s",
    "rotor_inertia": "kg m^2",
    "stiffness": "N m/rad",
    "dead_band": "rad",
}
KT, GAIN, ZERO, CROSS, VISCOUS, COULOMB, STATIC, SPEED, ROTOR, STIFFNESS, BAND = range(len(NAMES))

AVERAGING_TIME = 0.2  # time over which dense samples are averaged [s]
GAUSS_NEWTON_STEPS = 8
MAX_DENSE_PERIOD = 0.015  # largest time between frames that resolves the links' swinging [s]
ROTOR_DEVIATION = 0.1  # relative deviation of a rotor's inertia from its data sheet
SIGNIFICANCE = 3.0  # standard deviations by which a significant value differs from zero
MAX_CROSSTALK_DEVIATION = 0.003  # largest deviation of a reported crosstalk [m]


@dataclass(frozen=True)
class Drive:
    """Estimated drive of one joint."""

    values: Floats  # (11,) in the order of NAMES; NaN: refused
    covariance: Floats  # (11, 11)
    undetermined: dict[str, str]  # reason by name of the parameter
    moving: float  # time for which the joint turned [s]
    residuals: tuple[float, float]  # root mean square of the sensor's [N m] and the drive's [A]


class Windows:
    """Torques and forces of the rigid arm, averaged over windows of known motion."""

    def __init__(self, arm: Arm, samples: Sequence[Samples], s: DrivesSettings) -> None:
        self.arm, self.length = arm, s.window
        self.motion = Motion(samples, s.periods, s.joint_gap)
        parts = [self._average_interval(begin, end) for begin, end in self.motion.runs]
        none = np.empty((0, arm.n))
        columns = zip(*parts, strict=True) if parts else [[none[:, 0]], [none], [none], [none]]
        self.t, self.torque, self.force, self.swing = map(np.concatenate, columns)

    def _average_interval(self, begin: float, end: float) -> tuple[Floats, Floats, Floats, Floats]:
        """Return middles (w,), and torque, force and swing (w, n), between two times."""
        t = np.arange(begin, end, INTEGRATION_STEP)
        moving = self.motion.at(t)
        torque, force = transmitted_loads(self.arm.vector(), *moving)
        half = round(0.5 * self.length / INTEGRATION_STEP)
        u = INTEGRATION_STEP * np.arange(-half, half + 1)
        turn = 2.0 * np.pi / self.length
        phi = 1.0 + np.cos(turn * u)
        bend = -(turn**2) * np.cos(turn * u) / phi.sum()
        bend -= bend.mean()
        phi /= phi.sum()
        middles = np.arange(half, len(t) - half, max(1, half // 2))
        swing = _integrate(torque, bend, middles)
        inertia = reduced_inertia(self.arm.vector(), moving.q[middles])
        swing = np.einsum("kij,kj->ki", inertia, swing)
        return t[middles], _integrate(torque, phi, middles), _integrate(force, phi, middles), swing

    def average_sensor(self, one: Samples) -> tuple[Floats, Floats]:
        """Return mean and number of a sensor's samples in each window, (w,) each."""
        half, means, counts = 0.5 * self.length, [], []
        low = np.searchsorted(one.t, self.t - half)
        high = np.searchsorted(one.t, self.t + half)
        for a, b, middle in zip(low.tolist(), high.tolist(), self.t.tolist(), strict=True):
            weight = 1e-9 + 1.0 + np.cos(np.pi * (one.t[a:b] - one.age[a:b] - middle) / half)
            counts.append(b - a)
            means.append(float(weight @ one.torque[a:b] / weight.sum()) if b > a else 0.0)
        return np.array(means), np.array(counts, dtype=float)


def _integrate(x: Floats, kernel: Floats, middles: np.ndarray) -> Floats:
    """Integrate columns (k, n) with a kernel about each middle, (w, n)."""
    every = [np.convolve(column, kernel[::-1], "same") for column in x.T]
    return np.column_stack(every)[middles]


class Equations(NamedTuple):
    """Equations A x = y, solved as Z' (y - A x) = 0."""

    A: Floats  # (k, p)
    y: Floats  # (k,)
    t: Floats  # (k,) [s]
    Z: Floats  # (k, p)

    def solve(self, without: float = -1.0) -> Floats:
        """Return the solution x (p,) from all blocks except block `without`."""
        keep = self.t // BLOCK_DURATION != without
        return solve_with_instruments(self.A[keep], self.y[keep], self.Z[keep])


def sensor(w: Windows, one: Samples, j: int) -> Equations:
    """Return the equations of a torque sensor, with unknowns zero, scale, drift, X and c."""
    seen, counts = w.average_sensor(one)
    keep = counts >= 0.7 * w.length / one.period
    t = w.t[keep]
    drift, rigid = (t - t.mean()) / 100.0, (w.force[keep, j], -w.swing[keep, j])
    A = np.column_stack([np.ones(len(t)), w.torque[keep, j], drift, *rigid])
    return Equations(A, seen[keep], t, A)


@dataclass(frozen=True)
class Turning:
    """Samples of a drive while its joint turns; groups of neighbours are averaged."""

    t: Floats  # (k,) [s]
    v: Floats  # (k,) [rad/s]
    current: Floats  # (k,) [A]
    torque: Floats  # (k,) sensor torque [N m]
    rigid_torque: Floats  # (k,) torque transmitted by the rigid arm [N m]
    force: Floats  # (k,) [N]
    gain: Floats  # (k,) joint acceleration [rad/s^2]
    others: Floats  # (k, 6) columns of the regression: zero, drift, friction, ripple
    every: Floats  # (k, averaged) all rates [rad/s]
    rotor: float | None  # assumed inertia of the rotor [kg m^2]; None: it is estimated

    @property
    def averaged(self) -> int:
        """Number of samples that are averaged into one."""
        return self.every.shape[1]

    def equations(self, sensor_fit: Floats, speed: float, height: float = 0.0) -> Equations:
        """Return the equations of the current, with a Stribeck curve of a speed [rad/s].

        `sensor_fit` (5,) is the solution of the equations of `sensor`. The curve's height [A] gives
        its derivative by the speed. At height 0, that column is 0.
        """
        torque = self.torque - sensor_fit[CROSSTALK] * self.force
        bell = np.sign(self.every) * np.exp(-((self.every / speed) ** 2))
        slope = height * 2.0 * self.every**2 / speed**3 * bell
        curve = bell.mean(axis=1), slope.mean(axis=1)
        if self.rotor is None:
            A = Z = np.column_stack([torque, self.others, *curve, self.gain])
        else:
            torque += sensor_fit[SCALE] * self.rotor * self.gain
            A = np.column_stack([torque, self.others, *curve])
            Z = np.column_stack([self.rigid_torque, A[:, 1:]])
        return Equations(A, self.current, self.t, Z)


def _collect_turning(w: Windows, one: Samples, j: int, s: DrivesSettings) -> Turning:
    gap = w.motion.width[j]
    v, before, after = (w.motion.rates(one.t + way, j) for way in (0.0, -gap, gap))
    turns = w.motion.is_known(one.t) & (np.abs(v) > s.min_speed)
    turns &= np.minimum(before * v, after * v) > s.min_speed**2
    averaged = max(1, round(AVERAGING_TIME / one.period))
    whole = turns[: len(v) // averaged * averaged].reshape(-1, averaged).all(axis=1)
    which = np.flatnonzero(np.repeat(whole, averaged))
    t, v, dense = one.t[which], v[which], one.period <= MAX_DENSE_PERIOD
    m = w.motion.at(t)
    # The instrument is taken halfway between the torque's sample and that of the current, so that
    # it is equally correlated with both.
    p, between = w.arm.vector(), w.motion.at(t - 0.5 * one.age[which])
    torque = transmitted_loads(p, *between)[0][:, j]
    seen = (_interpolate_torques(one) if dense else one.torque)[which]
    phase = s.periods * m.q[:, j]
    force = transmitted_loads(p, *m)[1][:, j]
    gain = (after - before)[which] / (2.0 * gap)
    drift = (t - one.t.mean()) / 100.0
    others = np.ones(len(v)), drift, v, np.sign(v), np.sin(phase), np.cos(phase)

    def mean(x: Floats) -> Floats:
        return np.asarray(x.reshape(-1, averaged).mean(axis=1))

    names = "t", "v", "current", "torque", "rigid_torque", "force", "gain"
    samples = t, v, one.current[which], seen, torque, force, gain
    means: dict[str, Any] = dict(zip(names, map(mean, samples), strict=True))
    columns, rotor = np.column_stack([*map(mean, others)]), None if dense else s.rotor_inertia
    return Turning(**means, others=columns, every=v.reshape(-1, averaged), rotor=rotor)


def _interpolate_torques(one: Samples) -> Floats:
    """Interpolate torques at the frames' own times; linear interpolation would damp swinging."""
    from scipy.interpolate import CubicSpline  # slow import, not needed by --help

    fresh = np.diff(one.torque, prepend=np.nan) != 0.0  # otherwise a repeated sample
    fresh[-1] = True
    t, which = np.unique((one.t - one.age)[fresh], return_index=True)
    return np.asarray(CubicSpline(t, one.torque[fresh][which])(one.t))


def solve(arm: Arm, samples: Sequence[Samples], s: DrivesSettings) -> list[Drive]:
    """Estimate the drives of all joints; the masses of the described arm set the scale."""
    w = Windows(arm, samples, s)
    return [_drive(w, arm, samples[j], j, s) for j in range(arm.n)]


def _drive(w: Windows, arm: Arm, one: Samples, j: int, s: DrivesSettings) -> Drive:
    """Estimate the drive of joint j, counted from 0."""
    rows = _collect_turning(w, one, j, s)
    moving = one.period * rows.averaged * len(rows.t)
    if moving < MIN_MOVING_TIME:
        reason = f"joint {j + 1} turns for {moving:.1f} s (at least {MIN_MOVING_TIME:g})"
        nothing = np.full((len(NAMES),) * 2, np.nan)
        return Drive(nothing[0], nothing, dict.fromkeys(NAMES, reason), moving, (np.nan, np.nan))
    windows = sensor(w, one, j)
    sensor_fit = windows.solve()
    speed, height = _stribeck_curve(rows, sensor_fit)

    def parameters(without: float = -1.0, rows: Turning = rows) -> Floats:
        first = windows.solve(without)
        second = rows.equations(first, speed, height).solve(without)
        return _parameters(first, second, speed, arm, j)

    values, turning = parameters(), np.unique(rows.t // BLOCK_DURATION)
    blocks = np.unique(np.concatenate([windows.t // BLOCK_DURATION, turning]))
    shifts = np.array([parameters(block) for block in blocks]) - values
    freedom = len(turning) - 1
    student = freedom / max(freedom - 2, 1)  # variance of the Student distribution
    covariance = student * freedom / len(turning) * shifts.T @ shifts
    if rows.rotor is not None:
        other = replace(rows, rotor=(1.0 + ROTOR_DEVIATION) * rows.rotor)
        shift = parameters(rows=other) - values
        covariance += np.outer(shift, shift)
    left = _residuals(windows), _residuals(rows.equations(sensor_fit, speed, height))
    torque, current = (float(np.sqrt(np.mean(each**2))) for each in left)
    refused = _refuse_uncertain(values, covariance, rows, one, s)
    return Drive(values, covariance, refused, moving, (torque, current))


def _stribeck_curve(rows: Turning, sensor_fit: Floats) -> tuple[float, float]:
    """Return the speed [rad/s] and height [A] of the Stribeck curve that fits best."""

    def squares(speed: float) -> float:
        left = _residuals(rows.equations(sensor_fit, speed))
        return float(left @ left)

    speed, height = min(STRIBECK_SPEEDS.tolist(), key=squares), 0.0
    for k in range(GAUSS_NEWTON_STEPS):  # Gauss-Newton iterations from the best candidate
        fit = rows.equations(sensor_fit, speed, height).solve()
        height = fit[EXCESS]
        if k:
            speed += float(np.clip(fit[SPEED_STEP], -0.3 * speed, 0.4 * speed))
            speed = float(np.clip(speed, STRIBECK_SPEEDS[0], STRIBECK_SPEEDS[-1]))
    return speed, height


def _residuals(e: Equations) -> Floats:
    """Return the residuals (k,)."""
    return e.y - e.A @ e.solve()


def _parameters(fit: Floats, x: Floats, speed: float, arm: Arm, j: int) -> Floats:
    """Return the parameters (11,) from the two regressions of a joint and the Stribeck speed."""
    g = fit[SCALE]
    K = 1.0 / (g * x[0])
    found = np.full(len(NAMES), np.nan)
    found[KT], found[GAIN] = K, arm.links[j].torque_sensor.gain / g
    found[ZERO], found[CROSS] = fit[0] / g, fit[CROSSTALK] / g
    found[VISCOUS], found[COULOMB] = K * x[3:5]
    found[STATIC], found[SPEED] = K * (x[4] + x[EXCESS]), speed + x[SPEED_STEP]
    found[ROTOR] = K * x[INERTIA] if len(x) > INERTIA else np.nan
    return found


def _refuse_uncertain(
    values: Floats, covariance: Floats, rows: Turning, one: Samples, s: DrivesSettings
) -> dict[str, str]:
    """Return the reason for each refused parameter, by name, and set its value to NaN."""
    sigma = np.sqrt(np.diag(covariance))
    why: dict[str, str] = {}
    names = tuple(NAMES)
    for k in (KT, GAIN, VISCOUS, COULOMB, STATIC):
        if not sigma[k] <= s.max_relative * abs(values[k]):
            why[names[k]] = f"{values[k]:.3g} ± {sigma[k]:.1g} (at most {s.max_relative:.0%})"
    speed = values[SPEED]
    below = one.period * rows.averaged * np.count_nonzero(np.abs(rows.v) < 0.05)
    excess = values[STATIC] - values[COULOMB]
    spread = covariance[STATIC, STATIC] + covariance[COULOMB, COULOMB]
    spread = np.sqrt(max(spread - 2.0 * covariance[STATIC, COULOMB], 0.0))
    if not excess > SIGNIFICANCE * spread or not STRIBECK_SPEEDS[0] < speed < STRIBECK_SPEEDS[-1]:
        words = f"static friction exceeds Coulomb's by {excess:.2g} ± {spread:.1g} N m"
        words += f"; {below:.0f} s of motion below 0.05 rad/s"
        why["static"] = why["stribeck_speed"] = words
    if one.period > MAX_DENSE_PERIOD:
        why["rotor_inertia"] = (
            f"frames are {1e3 * one.period:.0f} ms apart (at most {1e3 * MAX_DENSE_PERIOD:.0f} to "
            f"resolve the swinging of links); assumed: {rows.rotor:g} kg m^2"
        )
    elif not values[ROTOR] > SIGNIFICANCE * sigma[ROTOR]:
        why["rotor_inertia"] = f"{values[ROTOR]:.2g} ± {sigma[ROTOR]:.1g} kg m^2 is not significant"
    if not sigma[CROSS] <= MAX_CROSSTALK_DEVIATION:
        why["torque_crosstalk"] = f"± {sigma[CROSS]:.1g} m (at most {MAX_CROSSTALK_DEVIATION:g})"
    step = s.min_speed * one.period
    why["dead_band"] = (
        f"the encoder is on the motor and turns {1e3 * step:.2g} mrad between frames at the least "
        "speed, so that a smaller dead band does not show"
    )
    why["stiffness"] = "the encoder is on the motor and does not measure the twist of the gear"
    for name in why:
        k = names.index(name)
        values[k] = np.nan
        covariance[k], covariance[:, k] = np.nan, np.nan
    return why
