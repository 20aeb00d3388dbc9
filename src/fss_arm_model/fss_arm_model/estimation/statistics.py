"""Statistics of residuals: probability, and redundancy of the data."""

from math import inf, isinf, nan

import numpy as np

from fss_arm_model.arrays import Floats


def root_mean_square(values: Floats) -> float:
    """Return the root mean square of the finite values; NaN if there are none."""
    finite = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(finite**2))) if finite.size else nan


def probability(chi_square: float, freedom: float, noise_freedom: float = inf) -> float:
    """Return the probability of a sum of squared normal errors at least this large.

    The errors are in deviations, known or estimated with `noise_freedom` degrees of freedom. The
    probability is 1 if there are no degrees of freedom.
    """
    from scipy.special import fdtrc, gammaincc

    if not freedom:
        return 1.0
    if isinf(noise_freedom):
        return float(gammaincc(freedom / 2, chi_square / 2))
    return float(fdtrc(freedom, noise_freedom, chi_square / freedom))


def equivalent_error(error: float, freedom: float, noise_freedom: float) -> float:
    """Return the error in known deviations that has the same probability as this one.

    The square of `error` has `freedom` degrees of freedom; its deviations have `noise_freedom`.
    """
    from scipy.special import chdtri, fdtrc

    if isinf(noise_freedom):
        return error
    chance = max(float(fdtrc(freedom, noise_freedom, error**2 / freedom)), 1e-290)
    return float(np.sqrt(chdtri(freedom, chance)))


def redundancy(hat: Floats) -> Floats:
    """Return the smallest squared share (s,) of a datum's error that its residual shows.

    This is the smallest eigenvalue of 1 - hat, for each datum's diagonal block (s, k, k) of the hat
    matrix. An error e (in deviations) along its eigenvector has a normalized residual of
    e sqrt(redundancy). If the redundancy is 0, the error changes only the parameters.
    """
    return np.maximum(1.0 - np.linalg.norm(hat, 2, axis=(1, 2)), 0.0)  # >= 0 despite rounding
