"""How probable residuals are, and how far data check each other."""

from math import nan

import numpy as np

from fss_arm_calib.estimation.least_squares import Floats


def root_mean_square(values: Floats) -> float:
    """About zero, of those that are finite; NaN of none."""
    seen = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(seen**2))) if seen.size else nan


def probability(chi_square: float, freedom: int) -> float:
    """Of a sum of squares of normal errors as large as found, or larger; 1 without any freedom."""
    from scipy.special import gammaincc

    return float(gammaincc(freedom / 2, chi_square / 2)) if freedom else 1.0


def redundancy(hat: Floats) -> Floats:
    """(s,) what share of an error of a datum shows in its residual at least, squared.

    The least eigenvalue of 1 - hat, of each datum's diagonal block of the hat matrix. An error e
    (in deviations) along it has a normalized residual of e sqrt(redundancy); 0: it moves the
    parameters alone.

    Args:
        hat: (s, k, k).
    """
    return np.maximum(1.0 - np.linalg.norm(hat, 2, axis=(1, 2)), 0.0)  # but for rounding
