"""Acceptance checks of a drift calibration; each reports its value and its threshold."""

from collections.abc import Sequence

import numpy as np

from fss_arm_calib.acceptance import (
    FIT,
    Check,
    check_chi_square,
    check_convergence,
    check_data_amount,
    check_identifiability,
    check_limit,
    check_outliers,
    check_redundancy,
    hide_pass_reason,
)
from fss_arm_calib.drift.problem import TOLERANCE
from fss_arm_calib.drift.settings import DriftSettings
from fss_arm_calib.drift.solution import Solution
from fss_arm_calib.estimation.least_squares import MAX_CONDITION
from fss_arm_calib.segments.drifts import Drift
from fss_arm_calib.segments.streams import Streams
from fss_arm_model.units import GRAVITY


def check_time(drifts: Sequence[Drift], streams: Streams, s: DriftSettings) -> Check:
    """Check that the base drifted for long enough."""
    total = sum(drift.times[-1] for drift in drifts)
    reason = f"{total:.0f} s of drift, at least {s.min_time:g} s needed"
    brief = f"{total:.0f} s of drift"
    return check_data_amount("time", total, s.min_time, reason, streams, brief)


def evaluate(solution: Solution, s: DriftSettings) -> list[Check]:
    """Evaluate the checks of a solution."""
    r, m = solution.result, solution.result.minimum
    tilt = float(np.sqrt(np.diag(r.covariance)[:2]).max()) / GRAVITY
    torque = r.hose_torque[1]
    return [
        hide_pass_reason(
            check_identifiability(r.undetermined, r.missing, r.condition_number, MAX_CONDITION)
        ),
        check_convergence(m.converged, m.iterations, m.last_update, TOLERANCE),
        check_chi_square(
            FIT,
            m.cost,
            r.problem.degrees_of_freedom,
            s.min_probability,
            "another force moved the base, or its poses have larger errors than assumed",
        ),
        check_outliers(
            solution.errors,
            solution.kept,
            s.outlier,
            s.max_outliers,
            "drift",
            "normalized prediction error",
        ),
        check_redundancy(r.cross_checks.redundancy, solution.kept, s.min_redundancy, "drift"),
        check_limit(
            "tilt",
            tilt,
            s.max_tilt,
            f"tilt known to {np.degrees(tilt):.2g} degrees (at most {np.degrees(s.max_tilt):.2g})",
            "drift for longer",
        ),
        check_limit(
            "torque",
            torque,
            s.max_torque,
            f"hose torque known to {torque:.2g} N m (at most {s.max_torque:g})",
            "drift for longer",
        ),
    ]
