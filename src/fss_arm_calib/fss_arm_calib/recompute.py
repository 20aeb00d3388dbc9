"""Computes recorded results again from what was published with them: the command `recompute`."""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fss_arm_model.description import from_yaml
from fss_arm_ros.bags import BagError, Bags, open_bags

from .judgement import settings_of
from .messages import observations_of, to_message
from .settings import CalibrationSettings
from .verdict import calibrate

LARGEST = 1e-9  # difference of any number, in its unit

SAME, OTHER, USER_ERROR = 0, 2, 1

RESULTS, OBSERVATIONS = "/calibration/kinematic", "/calibration/observations"

NUMBERS = (
    "values", "covariance", "residuals", "leverage", "normalized_residuals", "held_out_residuals",
    "chi_square", "position_residual", "heading_residual",
)  # fmt: skip


@dataclass(frozen=True)
class Comparison:
    """A recorded result beside the same computed again."""

    observations: int
    verdict: str
    difference: float  # largest of all numbers, each in its unit; inf: they are not of one shape

    @property
    def same(self) -> bool:
        """Whether rounding explains the difference."""
        return self.difference <= LARGEST


def recompute(result: Any, observations: Any) -> Comparison | None:
    """Compute a KinematicCalibration again from its KinematicObservations; None: it has others.

    Raises:
        ValueError: the result does not tell its settings or its guess.
    """
    settings = settings_of(result.provenance, CalibrationSettings)
    again = calibrate(observations_of(observations), from_yaml(result.guess), settings)
    if again.provenance.data_hash != result.provenance.data_hash:
        return None
    there = to_message(again, result.header.frame_id)
    difference = max(_difference(getattr(result, n), getattr(there, n)) for n in NUMBERS)
    return Comparison(len(again.q), result.verdict, difference)


def _difference(a: Any, b: Any) -> float:
    a, b = np.atleast_1d(a), np.atleast_1d(b)
    if a.shape != b.shape or np.any(np.isnan(a) != np.isnan(b)):
        return np.inf
    return float(np.max(np.nan_to_num(np.abs(a - b)), initial=0.0))


def comparisons(bags: Bags) -> list[Comparison]:
    """All recorded results whose observations were recorded, too, computed again.

    Raises:
        BagError: no result was recorded, or one without its observations.
        ValueError: a result does not tell its settings.
    """
    messages = [(topic, m) for topic, _, _, m in bags.messages({RESULTS, OBSERVATIONS})]
    every = [m for topic, m in messages if topic == OBSERVATIONS]
    results = [m for topic, m in messages if topic == RESULTS]
    if not results:
        raise BagError(f"no result on {RESULTS} in {', '.join(map(str, bags.paths))}")
    found = []
    for result in results:
        count = len(result.tip) // 3
        fitting = [m for m in every if sum(o.used for o in m.observations) == count]
        again = next((c for m in fitting[::-1] if (c := recompute(result, m))), None)
        if again is None:
            raise BagError(f"a result from {count} observations was recorded without them")
        found.append(again)
    return found


def parser() -> argparse.ArgumentParser:
    """The command line."""
    p = argparse.ArgumentParser("recompute", description=__doc__)
    p.add_argument("bags", nargs="+", metavar="BAG", help="bag, or folder of bags")
    return p


def main(args: Sequence[str] | None = None) -> int:
    """Run as `ros2 run fss_arm_calib recompute`."""
    options = parser().parse_args(args)
    try:
        with open_bags(options.bags) as bags:
            found = comparisons(bags)
    except (ValueError, OSError) as error:
        print(f"recompute: {' '.join(str(error).split())}", file=sys.stderr)
        return USER_ERROR
    for one in found:
        print(
            f"{one.observations} observations, {one.verdict}: "
            f"{'the same' if one.same else 'NOT the same'}, to {one.difference:.1e}"
        )
    return SAME if all(one.same for one in found) else OTHER


if __name__ == "__main__":
    sys.exit(main())
