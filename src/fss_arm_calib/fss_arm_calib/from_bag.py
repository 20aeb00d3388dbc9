"""Implementation of the command `from_bag`."""

import argparse
import sys
from collections.abc import Iterable, Sequence
from dataclasses import fields
from os import PathLike
from pathlib import Path
from typing import Any, TypeVar

from rich.console import Console

from fss_arm_bags.reader import open_bags
from fss_arm_calib import report, result
from fss_arm_calib.acceptance import PASS
from fss_arm_calib.bag_command import EXIT_CODES, report_outcome
from fss_arm_calib.bag_data import describe_source, find_data, recorded_streams
from fss_arm_calib.bag_options import default_settings
from fss_arm_calib.calibration import Calibration
from fss_arm_calib.causes import explain_failure
from fss_arm_calib.from_bag_options import DEFAULT_KIND, parser, selected_kind
from fss_arm_calib.joint import from_bags
from fss_arm_calib.joint.kind import JOINT
from fss_arm_calib.kinds import KINDS
from fss_arm_calib.outcome import Datum, Outcome
from fss_arm_calib.segments.streams import keep_newest
from fss_arm_calib.settings import KindSettings
from fss_arm_model.description import Arm
from fss_arm_model.description_file import described, from_yaml, load
from fss_arm_ros.calibrated import with_kinematics_of
from fss_arm_ros.command_line import in_one_line
from fss_arm_ros.libraries import require

D = TypeVar("D", bound=Datum)
C = TypeVar("C", bound=KindSettings)


def solve_bag(
    kind: Calibration[D, C],
    paths: str | PathLike[str] | Iterable[str | PathLike[str]],
    settings: C | None = None,
    namespace: str = "",
    arm: Arm | None = None,
) -> Outcome[D, Any]:
    """Find the data in one or several bags and calibrate, as the node does on live topics.

    Args:
        kind: kind of calibration.
        paths: paths of the bags.
        settings: settings; None: the defaults of the kind.
        namespace: namespace of the vehicle, e.g. `fss2`.
        arm: arm to start from; None: the one in the settings.

    Raises:
        BagError: a bag cannot be read or lacks a topic.
        ValueError: a setting or the description is invalid.
        OSError: a file cannot be read.
    """
    s = settings or kind.settings(**default_settings(kind.settings, namespace))
    arm = arm or described(s.arm)
    finder = kind.finder(arm, s, [])
    with open_bags(paths) as bags:
        for topic in bags.left_out:
            print(f"from_bag: {topic}", file=sys.stderr)
        inputs = kind.inputs(s, arm.n)
        found = keep_newest(find_data(bags, finder, inputs, s.horizon, namespace), kind.max_data(s))
        outcome = kind.calibrate(found, arm, s, finder.streams(), describe_source(bags))
        if outcome.verdict == PASS:
            return outcome
        return explain_failure(kind, outcome, recorded_streams(bags, inputs, namespace))


def initial_arm(kinematic: str, arm: str, options: argparse.Namespace, namespace: str = "") -> Arm:
    """Return the arm after a kinematic calibration, from its result or computed here from a bag.

    Args:
        kinematic: a result as JSON, or a bag.
        arm: description with the parameters that a kinematic calibration does not estimate.
        options: command-line options; the settings shared with the kinematic calibration are used.
        namespace: namespace of the vehicle.

    Raises:
        ValueError: the result is invalid, or the calibration has not passed.
        OSError: a file cannot be read.
    """
    own = described(arm)
    if Path(kinematic).suffix == ".json":
        return with_kinematics_of(result.read_arm(kinematic, DEFAULT_KIND), own)
    kind = KINDS[DEFAULT_KIND]
    given = default_settings(kind.settings, namespace)
    alike = (name for name in ("arm", "joints_topic", "base_topic") if name in options)
    given |= {name: getattr(options, name) for name in alike}
    found = solve_bag(kind, kinematic, kind.settings(**given), namespace)
    if found.verdict != PASS:
        raise ValueError(f"kinematic calibration from {kinematic}: {found.verdict}: {found.reason}")
    return with_kinematics_of(from_yaml(found.description), own)


def run_calibration(
    kind: Calibration[Any, Any], options: argparse.Namespace, console: Console
) -> Outcome[Any, Any]:
    """Solve, print the result and write the requested files."""
    if options.report:
        require("matplotlib")  # fail before minutes of computation
    if kind is JOINT:
        return from_bags.estimate_from_bags(options, console)
    truth = load(options.truth) if options.truth else None
    settings = kind.settings(**{f.name: getattr(options, f.name) for f in fields(kind.settings)})
    arm = None
    if kind.prior_results and options.kinematic:
        arm = initial_arm(options.kinematic, settings.arm, options, options.namespace)
    outcome = solve_bag(kind, options.bags, settings, options.namespace, arm)
    report_outcome(outcome, kind.report_of(outcome, truth), kind, options, console)
    return outcome


@in_one_line("from_bag")
def main(args: Sequence[str] | None = None) -> int:
    """Run as `ros2 run fss_arm_calib from_bag`."""
    given = sys.argv[1:] if args is None else args
    kind = selected_kind(given)
    namespace = parser(kind).parse_args(given).namespace  # changes the defaults
    options = parser(kind, namespace).parse_args(given)
    return EXIT_CODES[run_calibration(kind, options, report.console()).verdict]


if __name__ == "__main__":
    sys.exit(main())
