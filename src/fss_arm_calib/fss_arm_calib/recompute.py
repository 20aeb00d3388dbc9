"""Implementation of the command `recompute`."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fss_arm_bags.reader import BagError, Bags, converter, open_bags
from fss_arm_calib.acceptance import format_count
from fss_arm_calib.calibration import Calibration
from fss_arm_calib.joint.kind import JOINT
from fss_arm_calib.kinds import KINDS
from fss_arm_calib.messages import COMPUTED_FIELDS, calibration_part
from fss_arm_calib.outcome import LIVE, Outcome, parse_settings
from fss_arm_calib.recompute_options import parser
from fss_arm_calib.segments.streams import Streams
from fss_arm_model.description_file import from_yaml
from fss_arm_ros.command_line import in_one_line
from fss_arm_ros.convert import stamp_ns

MAX_ROUNDING = 1e-9  # largest difference explained by rounding, in the unit of the number

EXIT_SAME, EXIT_DIFFERENT = 0, 2


@dataclass(frozen=True)
class Comparison:
    """Comparison of a recorded result with the same result recomputed."""

    what: str  # number and name of the data
    verdict: str
    difference: float  # largest of all numbers, each in its unit; inf: the shapes differ

    @property
    def same(self) -> bool:
        """True if rounding explains the difference."""
        return self.difference <= MAX_ROUNDING

    def __str__(self) -> str:
        same = "the same" if self.same else "NOT the same"
        return f"{self.what}, {self.verdict}: {same}, to {self.difference:.1e}"


def recalibrate(kind: Calibration[Any, Any], result: Any, data: Any) -> Outcome[Any, Any]:
    """Calibrate again from the data, the settings and the initial guess of a published result.

    Raises:
        ValueError: the result does not contain its settings or its initial guess.
    """
    found = calibration_part(result)
    settings = parse_settings(found.provenance.parameters, kind.settings, kind.name)
    data, arm = kind.data.from_message(data), from_yaml(found.guess)
    return kind.calibrate(data, arm, settings, Streams(), LIVE)


def recompute(kind: Calibration[Any, Any], result: Any, data: Any) -> Comparison | None:
    """Recompute a published result and compare; None if it was computed from other data."""
    outcome, found = recalibrate(kind, result, data), calibration_part(result)
    if outcome.provenance.data_hash != found.provenance.data_hash:
        return None
    message = kind.to_message(outcome, "")
    common = [(found, calibration_part(message), name) for name in COMPUTED_FIELDS]
    every = [*common, *((result, message, name) for name in kind.recomputed_fields)]
    known = [one for one in every if hasattr(one[0], one[2])]  # earlier versions have fewer fields
    difference = max(_difference(getattr(a, name), getattr(b, name)) for a, b, name in known)
    return Comparison(format_count(len(outcome.used), kind.data.noun), found.verdict, difference)


def _difference(a: Any, b: Any) -> float:
    a, b = np.atleast_1d(a).astype(float), np.atleast_1d(b).astype(float)
    if a.shape != b.shape:
        return np.inf
    other = (a != b) & ~(np.isnan(a) & np.isnan(b))
    return float(np.max(np.nan_to_num(np.abs(a[other] - b[other]), nan=np.inf), initial=0.0))


def comparisons(bags: Bags, namespace: str = "") -> list[Comparison]:
    """Recompute all recorded results of the vehicle in a namespace, and compare.

    Raises:
        BagError: there is no result, or one without its data or of an incompatible version.
    """
    found = []
    space = f"/{namespace.strip('/')}/".replace("//", "/")
    kinds = [*KINDS.values(), JOINT]
    for kind in kinds:
        results, source = f"{space}{kind.topic}", f"{space}{kind.data.topic}"
        of = {topic: converter(bags, topic) for topic in {results, source} & bags.topics.keys()}
        read = [(topic, m) for topic, _, _, m in bags.messages(of)]
        data = [of[topic](m) for topic, m in read if topic == source]
        ends = [{0, *(one.end for one in kind.data.from_message(m))} for m in data]
        for result in (m for topic, m in read if topic == results):
            # Solving is slow: try only messages with the last datum, and stop at the first match.
            end = stamp_ns(calibration_part(result).provenance.end)
            alike = (m for those, m in zip(ends, data, strict=True) if end in those)
            try:
                same = next((c for m in alike if (c := recompute(kind, result, m))), None)
            except ValueError as error:
                raise ValueError(f"a result on {results}: {error}") from None
            if same is None:
                what = f"{kind.data.noun}s of a result on {results}"
                begin = calibration_part(result).provenance.data_hash[:8]
                raise BagError(f"the bag lacks the {what} (hash {begin}...)")
            found.append(same)
    if not found:
        topics = " or ".join(f"{space}{kind.topic}" for kind in kinds)
        raise BagError(f"no result on {topics} in {', '.join(map(str, bags.paths))}")
    return found


@in_one_line("recompute")
def main(args: Sequence[str] | None = None) -> int:
    """Run as `ros2 run fss_arm_calib recompute`."""
    options = parser().parse_args(args)
    with open_bags(options.bags) as bags:
        found = comparisons(bags, options.namespace)
    print(*found, sep="\n")
    return EXIT_SAME if all(one.same for one in found) else EXIT_DIFFERENT


if __name__ == "__main__":
    sys.exit(main())
