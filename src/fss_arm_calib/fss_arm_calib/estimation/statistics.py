"""How probable residuals are, and how far data check each other."""

from math import inf, isinf, nan

import numpy as np

from fss_arm_calib.estimation.least_squares import Floats


def root_mean_square(values: Floats) -> float:
    """About zero, of those that are finite; NaN of none."""
    seen = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(seen**2))) if seen.size else nan


def probability(chi_square: float, freedom: float, known_by: float = inf) -> float:
    """Of a sum of squares of normal errors as large as found, or larger; 1 without any freedom.

    Args:
        chi_square: the sum, in deviations.
        freedom: its degrees of freedom.
        known_by: those by which the deviations were estimated; inf: they are known.
    """
    from scipy.special import fdtrc, gammaincc

    if not freedom:
        return 1.0
    if isinf(known_by):
        return float(gammaincc(freedom / 2, chi_square / 2))
    return float(fdtrc(freedom, known_by, chi_square / freedom))


def as_if_known(error: float, freedom: float, known_by: float) -> float:
    """An error as improbable in known deviations as this one is in estimated ones.

    Args:
        error: length of it, in the deviations.
        freedom: degrees of freedom of its square.
        known_by: those by which the deviations were estimated; inf: they are known.
    """
    from scipy.special import chdtri, fdtrc

    if isinf(known_by):
        return error
    chance = max(float(fdtrc(freedom, known_by, error**2 / freedom)), 1e-290)
    return float(np.sqrt(chdtri(freedom, chance)))


def redundancy(hat: Floats) -> Floats:
    """(s,) what share of an error of a datum shows in its residual at least, squared.

    The least eigenvalue of 1 - hat, of each datum's diagonal block of the hat matrix. An error e
    (in deviations) along it has a normalized residual of e sqrt(redundancy); 0: it moves the
    parameters alone.

    Args:
        hat: (s, k, k).
    """
    return np.maximum(1.0 - np.linalg.norm(hat, 2, axis=(1, 2)), 0.0)  # but for rounding
