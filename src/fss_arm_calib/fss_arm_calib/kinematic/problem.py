"""Kinematic calibration: link lengths and angles from end-effector poses (Eq. 1-5).

An observation is a joint reading q (n,) and the end effector's pose relative to the base, (3,)
x, y [m], heading [rad]. The difference between observed and predicted poses, with wrapped
headings, gives the update

    Delta x_EE = x_observed - k(q, xi)                                        (Eq. 2)
    Delta x_EE = Phi_k Delta xi                                               (Eq. 3)
    Delta xi = (Phi_k' W Phi_k)^-1 Phi_k' W Delta x_EE                        (Eq. 4)

which is iterated until Delta xi is negligible. W is the inverse covariance of the observations, so
that the estimate has the covariance (Phi_k' W Phi_k)^-1. (The paper weighs metres and radians
equally.) `variances.py` defines it, and estimates it from the residuals.

Gears and encoders cause reading errors as well. These are sines of unknown phase: the ripple has
two periods per turn of the wave generator, the eccentricity error one per turn of the joint. Their
standard deviations are sigma_r and sigma_e. The errors of readings q and q' of one joint have the
covariance

    k(q, q') = sigma_r^2 cos 60 (q - q') + sigma_e^2 cos (q - q')

Phi_q is the derivative of the pose with respect to the readings; k(q, q) Phi_q Phi_q' is part of
W^-1. The same errors repeat at other rests, so they do not average out. This adds
P Phi_k' W Phi_q K Phi_q' W Phi_k P to the covariance of the estimate, where P is the covariance
above and K has no diagonal.

A robust loss rho replaces the sum of squares by sum_k rho(d_k^2), where d_k is the length of the
difference of observation k in standard deviations. Each step then weighs observation k by
rho'(d_k^2).
"""

from dataclasses import dataclass, replace
from functools import cached_property
from math import hypot, inf

import numpy as np
import numpy.typing as npt

from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_model.estimation.least_squares import LOSSES, SQUARE
from fss_arm_model.kinematics import reading_jacobian
from fss_arm_model.layout import TIP_ANGLE, kinematic_index, kinematic_names

FULL, EQUAL, OFFSETS = "full", "equal", "offsets"
PARAMETRIZATIONS = (FULL, EQUAL, OFFSETS)
DESCRIBED = "described"  # in settings: FULL or EQUAL, depending on the description

EQUAL_LENGTH_TOLERANCE = 0.01  # described lengths that differ by at most this count as equal [m]

#: Errors of an observation that give residuals like the paper's 0.015 m and 0.683 degrees.
POSITION_DEVIATION = 0.0177  # [m], each axis
HEADING_DEVIATION = float(np.radians(0.715))

RIPPLE_PERIODS = 60  # periods per turn of a joint: two per turn of the wave generator, at 30 : 1


@dataclass(frozen=True)
class KinematicProblem:
    """Problem with s observations of an arm of n links, and prior knowledge.

    Raises:
        ValueError: an array has the wrong shape or is not finite, or a setting is impossible.
    """

    q: Floats  # (s, n) joint readings [rad]
    tip: Floats  # (s, 3) end effector in the base's frame [m, m, rad]
    arm: Arm  # initial guess, and the values of parameters that are not estimated
    parametrization: str = EQUAL  # FULL: all; EQUAL: one length except the last; OFFSETS: angles
    position_deviation: float = POSITION_DEVIATION  # of an observation, each axis, 1 sigma [m]
    heading_deviation: float = HEADING_DEVIATION  # of an observed heading, 1 sigma [rad]
    base_heading_deviation: float = 0.0  # of the base's heading, part of heading_deviation [rad]
    ripple_deviation: float = 0.0  # sigma_r, of readings [rad]
    eccentricity_deviation: float = 0.0  # sigma_e, of readings [rad]
    theta_e: bool = False  # estimate the heading offset of the end effector's subject, too
    loss: str = SQUARE

    def __post_init__(self) -> None:
        q, tip = np.array(self.q, dtype=float), np.array(self.tip, dtype=float)
        object.__setattr__(self, "q", q)
        object.__setattr__(self, "tip", tip)
        if q.ndim != 2 or q.shape[1] != self.arm.n:
            raise ValueError(f"q has shape {q.shape}, expected (s, {self.arm.n})")
        if tip.shape != (len(q), 3):
            raise ValueError(f"tip has shape {tip.shape}, expected ({len(q)}, 3)")
        if not (np.isfinite(q).all() and np.isfinite(tip).all()):
            raise ValueError("an observation is not finite")
        for name, known in (("parametrization", PARAMETRIZATIONS), ("loss", tuple(LOSSES))):
            if getattr(self, name) not in known:
                expected = f"{', '.join(map(repr, known[:-1]))} or {known[-1]!r}"
                raise ValueError(f"{name} is {getattr(self, name)!r}, expected {expected}")
        for name in ("position_deviation", "heading_deviation"):
            if not 0.0 < getattr(self, name) < inf:
                raise ValueError(f"{name} is {getattr(self, name)}, must be positive")
        for name in ("base_heading_deviation", "ripple_deviation", "eccentricity_deviation"):
            if not 0.0 <= getattr(self, name) < inf:
                raise ValueError(f"{name} is {getattr(self, name)}, must not be negative")
        if self.base_heading_deviation > self.heading_deviation:
            raise ValueError("base_heading_deviation is larger than heading_deviation")

    def select(self, chosen: npt.NDArray[np.bool_] | npt.NDArray[np.intp]) -> "KinematicProblem":
        """Return the problem with only the chosen observations."""
        return replace(self, q=self.q[chosen], tip=self.tip[chosen])

    def with_deviations(self, deviations: Floats, base_heading: float = 0.0) -> "KinematicProblem":
        """Return the problem with other deviations of positions and headings, (2,)."""
        position, heading = map(float, deviations)
        return replace(
            self,
            position_deviation=position,
            heading_deviation=heading,
            base_heading_deviation=min(base_heading, heading),
        )

    @property
    def shares_length(self) -> bool:
        """True if several links share one length parameter."""
        return self.parametrization == EQUAL and self.arm.n > 2

    @property
    def all_names(self) -> tuple[str, ...]:
        """Names of all 2n+3 parameters: kinematic_names(n), then theta_E."""
        return (*kinematic_names(self.arm.n), "theta_E")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the p estimated parameters; if lengths are equal, `a` means a_1 .. a_{n-1}."""
        every, n = kinematic_names(self.arm.n), self.arm.n
        chosen = ("a", *every[n - 1 :]) if self.shares_length else every
        if self.parametrization == OFFSETS:
            chosen = tuple(name for name in every if name.startswith("theta"))
        return (*chosen, "theta_E") if self.theta_e else chosen

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each parameter."""
        return tuple("rad" if name.startswith("theta") else "m" for name in self.names)

    @cached_property
    def basis(self) -> Floats:
        """Matrix (2n+3, p) such that all parameters are fixed + basis @ xi."""
        basis = (np.array(self.all_names)[:, None] == np.array(self.names)).astype(float)
        if self.shares_length:
            basis[: self.arm.n - 1, 0] = 1.0
        return basis

    @cached_property
    def index(self) -> npt.NDArray[np.intp]:
        """Indices (2n+3,) of all parameters in Arm.vector()."""
        return np.append(kinematic_index(self.arm.n), TIP_ANGLE)

    @cached_property
    def described(self) -> Floats:
        """Parameters (8 + 6n,) of `arm`, Arm.vector()."""
        return self.arm.vector()

    @cached_property
    def fixed(self) -> Floats:
        """Values from `arm` of the parameters not estimated, (2n+3,); 0 for the estimated ones."""
        return np.where(self.basis.any(axis=1), 0.0, self.described[self.index])

    @property
    def guess(self) -> Floats:
        """Initial values (p,), from `arm`."""
        return np.asarray(np.linalg.lstsq(self.basis, self.described[self.index])[0])

    @property
    def degrees_of_freedom(self) -> int:
        """Number of observed coordinates, less the parameters."""
        return max(self.tip.size - len(self.names), 0)

    @property
    def sigma(self) -> Floats:
        """Standard deviation of an observed pose, (3,)."""
        return np.array([self.position_deviation] * 2 + [self.heading_deviation])

    @property
    def reading_deviation(self) -> float:
        """Standard deviation of a joint reading [rad]."""
        return hypot(self.ripple_deviation, self.eccentricity_deviation)

    @cached_property
    def fixed_covariance(self) -> Floats:
        """Covariance (2n+3, 2n+3) of parameters not estimated, from the description; else 0."""
        C = self.arm.known.covariance_of(self.all_names, np.zeros(len(self.all_names)))
        estimated = self.basis.any(axis=1)
        C[estimated] = C[:, estimated] = 0.0
        return C

    @cached_property
    def by_base_heading(self) -> Floats:
        """Vectors b (s, 3): errors of the poses per error of the base's heading, negated."""
        return np.column_stack([-self.tip[:, 1], self.tip[:, 0], np.ones(len(self.tip))])

    @cached_property
    def reading_covariance(self) -> Floats:
        """Covariances (s, 3, 3) that the readings' errors cause, evaluated at the guess."""
        p = self.described.copy()
        p[self.index] = self.fixed + self.basis @ self.guess
        by_reading = self.reading_deviation * reading_jacobian(p, self.q)
        return np.asarray(by_reading @ np.swapaxes(by_reading, 1, 2))

    def covariance(self, variances: Floats) -> Floats:
        """Return the observations' covariances V (..., s, 3, 3).

        The variances (..., 3) are those of positions, headings and the base's heading.
        """
        position, heading, base = np.moveaxis(variances[..., None, None, None], -4, 0)
        of_base = self.by_base_heading[:, :, None] * self.by_base_heading[:, None, :]
        alike = position * np.diag([1.0, 1.0, 0.0]) + (heading - base) * np.diag([0.0, 0.0, 1.0])
        return np.asarray(alike + base * of_base + self.reading_covariance)

    @property
    def variances(self) -> Floats:
        """Variances (3,) of positions, headings and the base's heading."""
        deviations = self.position_deviation, self.heading_deviation, self.base_heading_deviation
        return np.square(deviations)

    @property
    def typical_deviations(self) -> Floats:
        """Root mean square deviations of the poses (2,): positions, each axis, and headings."""
        squares = np.diagonal(self.covariance(self.variances), axis1=1, axis2=2).mean(axis=0)
        return np.sqrt([squares[:2].mean(), squares[2]])

    @cached_property
    def whitening(self) -> Floats:
        """Inverse roots (s, 3, 3) of the observations' covariances."""
        return np.asarray(np.linalg.inv(np.linalg.cholesky(self.covariance(self.variances))))
