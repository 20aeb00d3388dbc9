"""Flight of a rehearsed capture: read from its bag, and evaluated."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fss_arm_bags.reader import open_bags
from fss_arm_model.held import Target, combined_momentum, payload_pose
from fss_arm_msgs.msg import MassProperties
from fss_arm_ros.convert import SECOND, stamp_ns
from fss_rehearsal.processes import RehearsalError
from fss_rehearsal.rehearsed import Check

TARGET = Target(mass=10.0, inertia=0.25)
UNITS = "kg", "m", "m", "kg m^2"  # of mass, centre of mass and inertia
MOMENTUM_TOLERANCE = 1e-9  # tolerance for momentum before and after the capture [N s, N m s]


class Flight(NamedTuple):
    """Recorded mission, mainly from sim/truth; arrays (k, ...) unless noted."""

    time: np.ndarray  # since the start of the mission [s]
    q: np.ndarray
    qd: np.ndarray
    target: np.ndarray
    target_twist: np.ndarray
    holds: np.ndarray
    momentum: np.ndarray  # of all bodies
    impulse: np.ndarray  # part of the momentum that came from outside
    error: np.ndarray  # audit errors of momentum and energy
    propellant: np.ndarray
    valves: np.ndarray  # True for open valves
    planned: np.ndarray  # (m, 3) reference poses of the base
    phases: list[tuple[float, str]]  # start time [s] and name of each phase
    estimate: MassProperties | None  # last estimate of the target's mass properties


def read(bag: Path) -> Flight:
    """Read the mission from its bag.

    Raises:
        RehearsalError: the bag has no sim/truth.
    """
    with open_bags(bag) as bags:
        truths = [message for _, _, _, message in bags.messages({"/sim/truth"})]
        states = [message for _, _, _, message in bags.messages({"/mission/state"})]
        estimate = [message for *_, message in bags.messages({"/target/mass_properties"})]
    if not truths:
        raise RehearsalError(f"the bag {bag} contains no sim/truth")

    def column(name: str) -> np.ndarray:
        return np.array([getattr(message, name) for message in truths])

    stamps = np.array([stamp_ns(message.header.stamp) for message in truths]) / SECOND
    error = np.column_stack([column("momentum_error"), column("energy_error")])
    phases: list[tuple[float, str]] = []
    for state in states:
        if state.mission and (not phases or phases[-1][1] != state.phase):
            phases.append((stamp_ns(state.header.stamp) / SECOND, state.phase))
    start = phases[0][0] if phases else 0.0
    phases = [(since - start, phase) for since, phase in phases]
    planned = np.array([state.reference for state in states]).reshape(-1, 3)
    return Flight(
        stamps - start,
        column("q"),
        column("qd"),
        column("target"),
        column("target_twist"),
        column("holds"),
        column("momentum"),
        column("impulse"),
        error,
        column("propellant"),
        column("valves"),
        planned,
        phases,
        estimate[-1] if estimate else None,
    )


def true_momentum(flight: Flight, p: np.ndarray, k: int) -> np.ndarray:
    """Return the momentum (3,) of all bodies at row k, angular about their centre of mass."""
    state = np.array([flight.target[k], flight.target_twist[k]])
    return combined_momentum(p, flight.q[k], flight.qd[k], TARGET, state)


def mass_errors(flight: Flight, p: np.ndarray, k: int) -> tuple[float, list[str]]:
    """Return the largest error of the target's estimate, in standard deviations, and its lines.

    The true values are those of the capture, at row k.
    """
    if flight.estimate is None:
        return np.inf, ["mass of the target: not estimated"]
    m = flight.estimate
    values = np.array([m.mass, *m.com, m.inertia])
    deviations = np.sqrt(m.covariance.reshape(4, 4).diagonal())
    pose = payload_pose(p, flight.q[k], flight.target[k])
    truth = np.array([TARGET.mass, *pose[:2], TARGET.inertia])
    rows = zip(("mass", "x", "y", "inertia"), values, deviations, truth, UNITS, strict=True)
    lines = [
        f"  {name:>16}  {value:+.3f} ± {deviation:.3f} {unit}, true {true:+.3f}"
        for name, value, deviation, true, unit in rows
    ]
    title = "estimate of the target, ± 1 sigma; centre of mass x, y from the last joint:"
    return float((np.abs(values - truth) / deviations).max()), [title, *lines]


def evaluate(flight: Flight, p: np.ndarray, log_line: Callable[[str], None]) -> list[Check]:
    """Print a summary of the mission, and return its checks."""
    capture_check = Check("the target is captured", "not captured", False)
    if not flight.holds.any():
        log_line("the target was not captured")
        return [capture_check]
    k = int(np.argmax(flight.holds))
    change = flight.momentum[k] - flight.momentum[k - 1]
    impulse = flight.impulse[k] - flight.impulse[k - 1]
    when = f"captured between {flight.time[k - 1]:.2f} and {flight.time[k]:.2f} s of the mission"
    log_line(when)
    log_line("true momentum of all bodies just before and after the grip:")
    momenta = zip(*(true_momentum(flight, p, row) for row in (k - 1, k)), strict=True)
    names = ("x", "N s"), ("y", "N s"), ("about the common centre of mass", "N m s")
    for (name, unit), (before, after) in zip(names, momenta, strict=True):
        log_line(f"  {name:>31}  before {before:+#.4g}  after {after:+#.4g} {unit}")
    worst, (*audit, energy) = float(np.abs(change - impulse).max()), np.abs(flight.error).max(0)
    difference = f"changes by {worst:.0e} N s or N m s beyond the impulse of the thrusters"
    spin = np.degrees(flight.target_twist[[0, -1], 2])
    rest = np.round(spin[1], 3) + 0.0  # never -0.000
    spin_text = f"{spin[0]:.2f} deg/s at the start, {rest:.3f} deg/s at the end"
    own = TARGET.inertia * flight.target_twist[k - 1, 2]
    log_line(f"  for comparison, the spinning target alone: {own:+#.4g} N m s")
    log_line(f"  the momentum {difference}")
    log_line(
        f"numerical error of the simulation: momentum minus impulse {max(audit):.0e} N s\n"
        f"  or N m s, energy minus work {energy:.0e} J"
    )
    log_line(f"spin of the target: {spin_text}")
    log_line(f"propellant used: {1e3 * flight.propellant[-1]:.1f} g")
    sigmas, lines = mass_errors(flight, p, k)
    for line in lines:
        log_line(line)
    return [
        Check(
            "mass, centre of mass and inertia of the target are within 3 sigma",
            f"largest error {sigmas:.1f} sigma",
            sigmas < 3.0,
        ),
        capture_check._replace(happened=when, passed=True),
        Check(
            f"the grip changes the momentum by less than {MOMENTUM_TOLERANCE:g} N s, N m s",
            difference,
            worst < MOMENTUM_TOLERANCE,
        ),
        Check(
            "the target's spin falls below a tenth of its initial value",
            spin_text,
            abs(spin[1]) < 0.1 * abs(spin[0]),
        ),
    ]
