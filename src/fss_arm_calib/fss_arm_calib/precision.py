"""Precision of masses, inertias and places: which of them the data determine, and its check."""

from itertools import compress
from math import ceil, floor, inf, log10
from typing import Any

import numpy as np

from fss_arm_calib.acceptance import FAIL, PASS, Check
from fss_arm_model.arrays import Floats

MASS_UNITS = ("kg", "kg m^2")
MAX_USABLE_DEVIATION = 0.25  # of a mass or inertia, relative; more is too uncertain to use


def unmeasured(problem: Any, deviations: Floats) -> tuple[str, ...]:
    """Return the masses and inertias of a problem that come mostly from a prior too vague to use.

    `deviations` (p,) are those of the result.
    """
    prior = problem.prior_deviations
    vague = np.isin(problem.units, MASS_UNITS) & np.isfinite(prior)
    vague &= prior > MAX_USABLE_DEVIATION * np.abs(problem.guess)
    return tuple(compress(problem.names, vague & (2.0 * deviations**2 > prior**2)))


def check_precision(r: Any, s: Any) -> Check:
    """Check masses and inertias against `max_relative`, if it is not 0, places against `max_place`.

    The limit for masses and inertias is a share of the described value: that of an estimate would
    depend on chance. Parameters of the Fit that are at a bound or inseparable have other checks.
    """
    names, units = np.array(r.problem.names), np.array(r.problem.units)
    sigma = np.where(np.isfinite(r.deviations) & ~np.isin(names, r.at_bound), r.deviations, 0.0)
    masses, places = np.isin(units, MASS_UNITS), units == "m"
    vague = unmeasured(r.problem, r.deviations)
    sigma[np.isin(names, vague)] = inf if s.max_relative else 0.0
    sizes = sigma / np.where(masses, np.abs(r.problem.guess), 1.0)
    limits = np.select([masses, places], [s.max_relative or inf, s.max_place], inf)
    shares = np.where(np.isinf(limits), 0.0, sizes / limits)

    def text(k: int) -> str:
        words = f"{1e3 * sizes[k]:.3g} mm" if places[k] else f"{100 * sizes[k]:.0f} %"
        return f"{names[k]} not determined" if np.isinf(sizes[k]) else f"{names[k]} ± {words}"

    required = f"at most {1e3 * s.max_place:g} mm"
    if s.max_relative:
        required += f" and {100 * s.max_relative:g} % of a described mass or inertia"
    order = np.argsort(-shares)
    worst, failing = int(order[0]), order[shares[order] > 1.0]
    if not len(failing):
        facts = [f"{text(worst)} ({required})"] if shares[worst] else []
        if vague:
            require = f"to require them: --max-relative {MAX_USABLE_DEVIATION}"
            facts.append(f"not determined, which is accepted: {', '.join(vague)} ({require})")
        return Check("precision", PASS, float(shares[worst]), 1.0, "; ".join(facts))
    brief = f"too uncertain: {', '.join(map(text, failing))}"
    limits_met = [
        f"--{option} {_round_up(float(sizes[failing][which[failing]].max()))}"
        for option, which in (("max-place", places), ("max-relative", masses))
        if which[failing].any()
    ]
    reason = f"{brief} ({required}): record more, or accept it with {' '.join(limits_met)}"
    return Check("precision", FAIL, float(shares[worst]), 1.0, reason, brief=brief)


def _round_up(size: float) -> str:
    """Return a limit of two digits that a size meets; 0, which is no limit, for infinity."""
    if np.isinf(size):
        return "0"
    step = 10.0 ** (floor(log10(size)) - 1)
    return f"{ceil(size / step) * step:.2g}"
