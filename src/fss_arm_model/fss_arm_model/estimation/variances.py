"""Variances of the observations, separated by how their errors move the observed poses.

An observation is the end effector's pose seen from the base, so an error of the base's heading
turns all of it. With b = (-y, x, 1), an observation at (x, y) has the covariance

    V = sigma_p^2 diag(1, 1, 0) + (sigma_h^2 - sigma_b^2) diag(0, 0, 1) + sigma_b^2 b b'

where sigma_p is the deviation of positions, sigma_h of headings and sigma_b of the base's heading.
sigma_p and sigma_h include both subjects. Errors of positions are alike in all directions, so no
rests can separate the two subjects' own.

The restricted likelihood of the variances is that of the part of the residuals r that no parameter
absorbs (Patterson and Thompson 1971). With r and Phi_k whitened by V = L L' of all observations,

    log l = -sum log diag L - 1/2 log |Phi_k' Phi_k| - 1/2 min_xi |r - Phi_k xi|^2

The estimate is not its maximum but the mean of the variances over log sigma_p, log sigma_h and the
share phi = sigma_b^2 / sigma_h^2. Then (Phi_k' W Phi_k)^-1 is on average as large as the squared
errors of the parameters: for a single variance this mean is S / (nu - 2), as in noise.py.
What the data cannot separate keeps its prior value: the headings of base and end effector
are equally accurate (phi is uniform in arcsin sqrt(phi), with mean 1/2), and sigma_p / sigma_h is
that of the largest accepted deviations, within a factor of e^2 (1 sigma). The integrals are
computed by Gauss-Hermite quadrature, with nodes placed by the mean and covariance that the last
pass found (Naylor and Smith 1982).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from typing import NamedTuple

import numpy as np

from fss_arm_model.arrays import Floats
from fss_arm_model.estimation.noise import Noise, S

MAX_SHARE_UNCERTAINTY = 0.2  # of phi, if the data separate the headings; without data 0.35

RATIO_SPREAD = 4.0  # standard deviation of log (sigma_p / sigma_h)^2 beforehand

NODES = 5  # of the quadrature, in each dimension
MAX_PASSES = 50
MAX_LOGIT = 25.0  # of phi; beyond, rounding makes it 0 or 1
MAX_SHIFT = 0.1  # of the nodes in a pass, in deviations, if they have converged


class Variances(NamedTuple):
    """Mean variances of positions, headings and the base's heading, and how well they are known."""

    mean: Floats  # (3,) [m^2, rad^2, rad^2]
    uncertainty: Floats  # (3,) standard deviations of their roots [m, rad, rad]
    share_uncertainty: float  # standard deviation of phi


class Nodes(NamedTuple):
    """Mean (3,) and covariance (3, 3) of log sigma_p^2, log sigma_h^2 and the logit of phi."""

    mean: Floats
    covariance: Floats


@dataclass(frozen=True)
class PoseNoise(Noise):
    """Standard deviations of relative poses; that of headings includes the base's heading."""

    base_heading: float = 0.0  # standard deviation of the base's heading [rad]
    base_uncertainty: float = 0.0  # standard deviation of `base_heading`; 0: not estimated
    share_uncertainty: float = 0.0  # standard deviation of phi; 0: not estimated

    @property
    def is_separated(self) -> bool:
        """True if the data, not the prior, determine the base's share of the headings' errors."""
        return 0.0 < self.share_uncertainty < MAX_SHARE_UNCERTAINTY

    def with_variances(self, found: Variances) -> "PoseNoise":
        """Return the noise with estimated variances."""
        deviations, uncertainty = np.sqrt(found.mean), found.uncertainty
        return replace(
            self,
            deviations=deviations[:2],
            uncertainty=uncertainty[:2],
            base_heading=float(deviations[2]),
            base_uncertainty=float(uncertainty[2]),
            share_uncertainty=found.share_uncertainty,
        )

    def apply_to(self, settings: S) -> S:
        """Return the settings with these deviations in place of theirs."""
        return replace(super().apply_to(settings), base_heading_deviation=self.base_heading)

    def __str__(self) -> str:
        if not self.base_uncertainty:
            return super().__str__()
        value, uncertainty = np.degrees([self.base_heading, self.base_uncertainty])
        base = f"of it the base {value:.2g} ± {uncertainty:.1g} degrees"
        return f"{super().__str__()}, {base}{'' if self.is_separated else ' (not separated)'}"


def first_nodes(deviations: Floats) -> Nodes:
    """Return widely spread nodes around deviations of positions and headings, (2,)."""
    return Nodes(np.append(np.log(deviations**2), 0.0), np.diag([1.0, 1.0, np.pi**2 / 3.0]))


def restricted_log_likelihood(
    residuals: Floats, regressor: Floats, weights: Floats, covariance: Floats
) -> Floats:
    """Return the restricted log likelihood (...) of covariances (..., s, 3, 3) of s observations.

    The residuals (s, 3) and their regressor (s, 3, p) are those at any parameters. An observation
    of weight w, one of weights (s,), counts w times.
    """
    L = np.linalg.cholesky(covariance)
    rows = np.concatenate([regressor, residuals[..., None]], axis=-1)
    rows = np.linalg.inv(L) @ (np.sqrt(weights)[:, None, None] * rows)
    R = np.linalg.qr(rows.reshape(*L.shape[:-3], -1, rows.shape[-1]), mode="r")
    diagonal = np.abs(np.diagonal(R, axis1=-2, axis2=-1))
    volume = np.log(np.diagonal(L, axis1=-2, axis2=-1)).sum(axis=-1) @ weights
    volume += np.log(diagonal[..., :-1]).sum(axis=-1)
    return np.asarray(-volume - 0.5 * diagonal[..., -1] ** 2)


def log_prior(variances: Floats, ratio: float) -> Floats:
    """Return the log prior density (k,) of variances (k, 3), as in `mean_variances`.

    `ratio` is the expected ratio of the variances of positions and headings [m^2].
    """
    position, heading, base = variances.T
    share = 0.5 * np.log(base / heading * (1.0 - base / heading))
    found: Floats = share - 0.5 * (np.log(position / heading / ratio) / RATIO_SPREAD) ** 2
    return found


def mean_variances(
    log_density: Callable[[Floats], Floats], nodes: Nodes
) -> tuple[Variances, Nodes]:
    """Return the mean variances, and the nodes for the next call.

    `log_density` (k,) of the variances (k, 3) is that per log sigma_p, log sigma_h and logit phi.
    """
    grid, log_weight = _quadrature()
    center = len(grid) // 2
    for _ in range(MAX_PASSES):
        root = np.linalg.cholesky(nodes.covariance)
        x = nodes.mean + grid @ root.T
        share = 1.0 / (1.0 + np.exp(-np.clip(x[:, 2], -MAX_LOGIT, MAX_LOGIT)))
        variances = np.exp(x[:, [0, 1, 1]])
        variances[:, 2] *= share
        log = log_density(variances) + log_weight
        best, w = int(np.argmax(log)), np.exp(log - np.max(log))
        w /= np.sum(w)
        if w[best] > 0.5:  # too few nodes for moments: search for the mode
            shift, spread = grid[best], np.eye(3) / (4.0 if best == center else 1.0)
        else:
            shift = w @ grid
            spread = (w[:, None] * (grid - shift)).T @ (grid - shift) + 0.01 * np.eye(3)
        nodes = Nodes(nodes.mean + root @ shift, root @ spread @ root.T)
        if max(np.max(np.abs(shift)), np.max(np.abs(spread - np.eye(3)))) < MAX_SHIFT:
            break

    def deviation(values: Floats) -> Floats:
        return np.sqrt(np.maximum(w @ values**2 - (w @ values) ** 2, 0.0))

    of_share = float(deviation(share))
    return Variances(w @ variances, deviation(np.sqrt(variances)), of_share), nodes


@cache
def _quadrature() -> tuple[Floats, Floats]:
    """Return nodes (k, 3), and log weights (k,) relative to the normal density there."""
    z, weight = np.polynomial.hermite_e.hermegauss(NODES)
    grid = np.array([*product(z, repeat=3)])
    weights = np.array([*product(weight, repeat=3)])
    return grid, np.log(weights).sum(axis=1) + 0.5 * np.sum(grid**2, axis=1)
