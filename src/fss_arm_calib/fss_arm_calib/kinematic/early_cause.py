"""Likely cause of observations that contradict the description, from three observations on.

Typical errors of a laboratory are tested one by one. Each hypothesis changes readings or poses; all
kinematic parameters are then fitted, with the description and its usual errors as prior knowledge.
The description contradicts the observations if the fit without a change is far too bad. A cause is
named only if its fit is good. It is never applied.

Errors that need the poses of the base and the end effector by themselves, such as clockwise
headings, are found in recordings only (causes.py).
"""

from collections.abc import Iterator
from itertools import combinations
from typing import NamedTuple

import numpy as np

from fss_arm_calib.kinematic import model
from fss_arm_calib.kinematic.problem import FULL, KinematicProblem
from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_model.estimation.least_squares import Linear, minimize
from fss_arm_model.estimation.statistics import root_mean_square
from fss_arm_model.planar import inverse

MIN_OBSERVATIONS = 3
#: Usual errors of a description, 1 sigma: lengths and mount [m], angles [rad].
LENGTH_DEVIATION, ANGLE_DEVIATION = 0.02, float(np.radians(8.0))
#: Usual errors of an observation, 1 sigma: position [m], heading [rad].
POSITION_DEVIATION, HEADING_DEVIATION = 0.005, float(np.radians(0.5))
MAX_GOOD_COST = 1.5  # per observed coordinate
MIN_EXCESS = 30.0  # above it, of a description that the observations contradict
FREE = float(np.radians(180.0))  # deviation of an unknown angle [rad]
MAX_READING = 3.3  # readings above this are probably not in radians [rad]
MAX_POSITION = 20.0  # positions above this are not in metres: no test bed is that large [m]
TOLERANCE, MAX_ITERATIONS = 1e-3, 8  # of the fits; the update is in standard deviations


class Hypothesis(NamedTuple):
    """Possible error with its correction, in words, and the corrected data."""

    words: str
    q: Floats  # (s, n)
    tip: Floats  # (s, 3)
    theta_e_deviation: float = ANGLE_DEVIATION  # of the subject's heading on the last link [rad]


def early_cause(problem: KinematicProblem) -> str:
    """Describe the likely cause of observations that contradict the description; else empty."""
    count, arm = problem.tip.size, problem.arm
    if len(problem.q) < MIN_OBSERVATIONS:
        return ""
    as_they_are = Hypothesis("", problem.q, problem.tip)
    if _fit(as_they_are, arm)[0] < MAX_GOOD_COST * count + MIN_EXCESS:
        return ""
    fits = [(*_fit(one, arm), one.words) for one in _hypotheses(problem.q, problem.tip, arm)]
    cost, residual, words = min(fits)
    if cost > MAX_GOOD_COST * count:
        return ""
    return f"{words}, the residuals of {len(problem.q)} observations are {1e3 * residual:.2g} mm"


def _fit(one: Hypothesis, arm: Arm) -> tuple[float, float]:
    """Return the cost of a hypothesis, with that of the prior, and the position residual [m]."""
    problem = KinematicProblem(
        one.q,
        one.tip,
        arm,
        FULL,
        position_deviation=POSITION_DEVIATION,
        heading_deviation=HEADING_DEVIATION,
        theta_e=True,
    )
    is_angle = np.array(problem.units) == "rad"
    prior = np.where(is_angle, ANGLE_DEVIATION, LENGTH_DEVIATION)
    prior[-1] = one.theta_e_deviation
    guess = problem.guess

    def linearize(xi: Floats) -> Linear:
        seen = model.linearize(problem, xi)
        residuals = np.concatenate([seen.residuals, (guess - xi) / prior])
        regressor = np.concatenate([seen.regressor, np.diag(1.0 / prior)])
        return Linear(residuals, regressor, residuals @ residuals)

    found = minimize(linearize, guess, tolerance=TOLERANCE, max_iterations=MAX_ITERATIONS)
    positions = model.residuals(problem, found.x)[:, :2]
    return float(found.linear.cost), root_mean_square(positions)


def _hypotheses(q: Floats, tip: Floats, arm: Arm) -> Iterator[Hypothesis]:
    n = arm.n
    if np.abs(q).max() > MAX_READING:
        yield Hypothesis("joints in degrees? converted to radians", np.radians(q), tip)
        drives = [link.drive for link in arm.links]
        counts = np.array([2.0 * np.pi * k.direction / k.counts_per_turn for k in drives])
        yield Hypothesis("joints in counts? converted to radians", counts * q, tip)
    if np.abs(tip[:, :2]).max() > MAX_POSITION:
        yield Hypothesis(
            "positions in millimeters? with a factor of 0.001", q, tip * [1e-3, 1e-3, 1]
        )
    words = "end effector's subject rotated against the last link? with theta_e:=true"
    yield Hypothesis(words, q, tip, FREE)
    yield Hypothesis("base and end effector are swapped? swapped back", q, inverse(tip))
    words = "poses mirrored? with y and headings reversed"
    yield Hypothesis(words, q, tip * [1.0, -1.0, -1.0])
    if n > 1:
        yield Hypothesis("all joints with the wrong sign? reversed", -q, tip)
    if n > 3:  # otherwise the same as two joints swapped
        yield Hypothesis("joints counted from the tip? in reverse order", q[:, ::-1], tip)
    for i in range(n):
        signs = np.where(np.arange(n) == i, -1.0, 1.0)
        yield Hypothesis(f"joint_{i + 1} with the wrong sign? reversed", signs * q, tip)
    for i, j in combinations(range(n), 2):
        order = np.arange(n)
        order[[i, j]] = j, i
        yield Hypothesis(f"joint_{i + 1} and joint_{j + 1} swapped? swapped back", q[:, order], tip)
