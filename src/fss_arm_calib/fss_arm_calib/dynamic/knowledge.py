"""Prior knowledge of the parameters of a dynamic calibration."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import compress
from math import radians
from typing import Any

import numpy as np
import numpy.typing as npt

from fss_arm_calib.segments.settings import sigma
from fss_arm_calib.segments.streams import Datum
from fss_arm_model.arrays import Floats
from fss_arm_model.choice import Choice
from fss_arm_model.description import Arm
from fss_arm_model.estimation.least_squares import Fit
from fss_arm_model.parameters import parameter_names
from fss_arm_model.settings import NOT_NEGATIVE, Settings, setting


@dataclass(frozen=True)
class Knowledge(Settings):
    """Prior standard deviation of each kind of value of a description.

    An uncertainty in the description itself replaces these values.
    """

    mass_deviation: float = sigma(0.005, "kg", "a link's mass, as measured with a scale")
    b_deviation: float = sigma(0.02, "m", "a link's center of mass, as known from its geometry")
    relative_inertia_deviation: float = setting(
        0.5,
        "1 sigma of a link's inertia, relative to the described one (from CAD)",
        check=NOT_NEGATIVE,
    )
    base_mass_deviation: float = sigma(0.05, "kg", "the base's mass, including propellant")
    base_inertia_deviation: float = sigma(0.025, "kg m^2", "the base's inertia")
    base_com_deviation: float = sigma(0.01, "m", "the base's center of mass, each axis")
    length_deviation: float = sigma(
        0.0005, "m", "a link's length, unless the description gives one"
    )
    offset_deviation: float = sigma(
        radians(0.1), "rad", "an encoder's offset, unless the description gives one"
    )
    mount_deviation: float = sigma(
        0.0005, "m", "the first joint's position, each axis, unless the description gives one"
    )
    mount_angle_deviation: float = sigma(
        radians(0.1), "rad", "the first joint's heading, unless the description gives one"
    )

    def deviations(self, arm: Arm) -> Floats:
        """Return the standard deviations (5 n + 6,) of all parameters of an arm."""
        n, com = arm.n, self.base_com_deviation
        base = [self.base_mass_deviation, self.base_inertia_deviation, com, com]
        angles = [self.offset_deviation] * (n - 1)
        mount = [self.mount_deviation] * 2 + [self.mount_angle_deviation]
        links = [self.mass_deviation] * n + [self.b_deviation] * n
        links += [self.relative_inertia_deviation * link.inertia for link in arm.links]
        return np.array([*base, *[self.length_deviation] * n, *angles, *mount, *links])

    def covariance(self, arm: Arm) -> Floats:
        """Return the covariance (5 n + 6, 5 n + 6) of all parameters of an arm."""
        return arm.known.covariance_of(parameter_names(arm.n), self.deviations(arm))

    def prior_indices(self, arm: Arm, words: str) -> npt.NDArray[np.intp]:
        """Return indices (k,) of parameters with a prior: named by words, or known."""
        none = np.empty(0, dtype=np.intp)
        chosen = Choice.of(words, arm.n, "priors").indices if words.strip() else none
        known = np.isin(parameter_names(arm.n), arm.known.names)
        return np.union1d(chosen, np.flatnonzero(known))


def independent_knowledge(arm: Arm, data: Sequence[Datum], kept: Sequence[str]) -> Arm:
    """Return the arm without knowledge that is from data of the same time, but for `kept` names.

    Such data may be the same, and must not count twice.
    """
    known = arm.known
    begin = min((one.start for one in data), default=known.end + 1)
    end = max((one.end for one in data), default=begin)
    if not known.end or begin > known.end or end < known.begin:
        return arm
    return replace(arm, known=known.only(kept))


def advise_priors(r: Fit, s: Any) -> str:
    """Return the option that takes the described values of undetermined parameters as observations.

    These are the parameters of a result that have no prior, and are inseparable or at a bound.
    """
    without = np.isinf(r.problem.prior_deviations)
    lost = np.isin(r.problem.names, [*r.undetermined, *r.at_bound])
    names = compress(r.problem.names, without & lost)
    more = " ".join([*s.priors.split(), *names])
    return f"; --priors '{more}' takes described values as observations" if more != s.priors else ""
