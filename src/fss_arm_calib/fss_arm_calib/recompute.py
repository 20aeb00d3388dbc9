"""Computes recorded results again from what was published with them: the command `recompute`."""

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from fss_arm_bags.reader import BagError, Bags, open_bags
from fss_arm_calib import dynamic_messages, messages
from fss_arm_calib.acceptance import settings_of
from fss_arm_calib.dynamic import checks as dynamic_verdict
from fss_arm_calib.dynamic.settings import DynamicCalibrationSettings
from fss_arm_calib.kinematic import checks as verdict
from fss_arm_calib.kinematic.settings import CalibrationSettings
from fss_arm_calib.segments.maneuvers import Maneuver
from fss_arm_calib.segments.rests import Observation, since_homed
from fss_arm_model.description import Arm, from_yaml
from fss_arm_ros.command_line import USER_ERROR, Parser
from fss_arm_ros.convert import stamp_ns

LARGEST = 1e-9  # difference of any number, in its unit

SAME, OTHER = 0, 2


class Kind(NamedTuple):
    """A kind of calibration: where its results and their data are published."""

    results: str
    data: str
    parts: str  # what the data are, in words
    used: Callable[[Any], Sequence[Any]]  # of the data, what a result is from
    settings: type[Any]
    again: Callable[[Any, Any, Any], Any]  # the message, of data, arm and settings
    numbers: tuple[str, ...]  # to compare


def _observations(data: Any) -> list[Observation]:
    return [o for o in since_homed(messages.observations_of(data)) if o.used]


def _maneuvers(data: Any) -> list[Maneuver]:
    return [m for m in dynamic_messages.maneuvers_of(data) if m.used]


def _kinematic(data: Any, arm: Arm, settings: CalibrationSettings) -> Any:
    found = verdict.calibrate(messages.observations_of(data), arm, settings)
    return messages.to_message(found, "")


def _dynamic(data: Any, arm: Arm, settings: DynamicCalibrationSettings) -> Any:
    found = dynamic_verdict.calibrate(dynamic_messages.maneuvers_of(data), arm, settings)
    return dynamic_messages.to_message(found, "")


KINDS = (
    Kind(
        "/calibration/kinematic", "/calibration/observations", "observations", _observations,
        CalibrationSettings, _kinematic,
        ("values", "covariance", "residuals", "leverage", "normalized_residuals",
         "held_out_residuals", "chi_square", "position_residual", "heading_residual"),
    ),
    Kind(
        "/calibration/dynamic", "/calibration/maneuvers", "maneuvers", _maneuvers,
        DynamicCalibrationSettings, _dynamic,
        ("values", "covariance", "residuals", "leverage", "prediction_errors", "momenta",
         "combination_values", "chi_square", "position_residual", "heading_residual"),
    ),
)  # fmt: skip


@dataclass(frozen=True)
class Comparison:
    """A recorded result beside the same computed again."""

    what: str  # it was computed from
    verdict: str
    difference: float  # largest of all numbers, each in its unit; inf: they are not of one shape

    @property
    def same(self) -> bool:
        """Whether rounding explains the difference."""
        return self.difference <= LARGEST

    def __str__(self) -> str:
        same = "the same" if self.same else "NOT the same"
        return f"{self.what}, {self.verdict}: {same}, to {self.difference:.1e}"


def recompute(kind: Kind, result: Any, data: Any) -> Comparison | None:
    """Compute a published result again from its data; None: it has others.

    Raises:
        ValueError: the result does not tell its settings or its guess.
    """
    settings = settings_of(result.provenance, kind.settings)
    again = kind.again(data, from_yaml(result.guess), settings)
    if again.provenance.data_hash != result.provenance.data_hash:
        return None
    difference = max(_difference(getattr(result, n), getattr(again, n)) for n in kind.numbers)
    return Comparison(f"{len(kind.used(data))} {kind.parts}", result.verdict, difference)


def _difference(a: Any, b: Any) -> float:
    a, b = np.atleast_1d(a), np.atleast_1d(b)
    if a.shape != b.shape or np.any(np.isnan(a) != np.isnan(b)):
        return np.inf
    return float(np.max(np.nan_to_num(np.abs(a - b)), initial=0.0))


def comparisons(bags: Bags) -> list[Comparison]:
    """All recorded results computed again.

    Raises:
        BagError: no result was recorded, or one without its data.
        ValueError: a result does not tell its settings.
    """
    found = []
    for kind in KINDS:
        read = [(topic, m) for topic, _, _, m in bags.messages({kind.results, kind.data})]
        data = [m for topic, m in reversed(read) if topic == kind.data]
        every = [(used[-1].end if (used := kind.used(m)) else 0, m) for m in data]
        for result in (m for topic, m in read if topic == kind.results):
            # Solving takes longer than to tell that others end at another time.
            alike = (m for end, m in every if end == stamp_ns(result.provenance.end))
            again = next((c for m in alike if (c := recompute(kind, result, m))), None)
            if again is None:
                begin = result.provenance.data_hash[:8]
                raise BagError(f"a result on {kind.results} lacks its {kind.parts} ({begin}..)")
            found.append(again)
    if not found:
        topics = " or ".join(kind.results for kind in KINDS)
        raise BagError(f"no result on {topics} in {', '.join(map(str, bags.paths))}")
    return found


def parser() -> argparse.ArgumentParser:
    """The command line."""
    p = Parser("recompute", description=__doc__)
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
    print(*found, sep="\n")
    return SAME if all(one.same for one in found) else OTHER


if __name__ == "__main__":
    sys.exit(main())
