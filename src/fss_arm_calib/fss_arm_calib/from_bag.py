"""Implementation of the command `from_bag`."""

import argparse
import sys
from collections.abc import Iterable, Sequence
from dataclasses import fields
from os import PathLike
from pathlib import Path
from typing import Any, TypeVar

from rich.console import Console

from fss_arm_bags.reader import describe_source, open_bags
from fss_arm_bags.streams import read_streams
from fss_arm_calib import result
from fss_arm_calib.acceptance import FAIL, NOT_EVALUATED, PASS
from fss_arm_calib.bag_data import find_data, topic_name
from fss_arm_calib.calibration import Calibration
from fss_arm_calib.causes import explain_failure
from fss_arm_calib.from_bag_options import DEFAULT_KIND, parser, selected_kind
from fss_arm_calib.joint.from_bags import estimate_from_bags
from fss_arm_calib.joint.kind import JOINT
from fss_arm_calib.kinds import KINDS
from fss_arm_calib.outcome import Outcome
from fss_arm_calib.report_parts import with_description
from fss_arm_calib.segments.streams import Datum, keep_newest
from fss_arm_calib.settings import KindSettings
from fss_arm_model.description import Arm
from fss_arm_model.description_file import described, from_yaml, load
from fss_arm_ros import report
from fss_arm_ros.calibrated import with_kinematics_of
from fss_arm_ros.command_line import default_settings, in_one_line
from fss_arm_ros.libraries import require

EXIT_CODES = {PASS: 0, FAIL: 2, NOT_EVALUATED: 3}

D = TypeVar("D", bound=Datum)
C = TypeVar("C", bound=KindSettings)


@in_one_line("from_bag")
def main(args: Sequence[str] | None = None) -> int:
    """Run as `ros2 run fss_arm_calib from_bag`."""
    given = sys.argv[1:] if args is None else args
    kind = selected_kind(given)
    namespace = parser(kind).parse_args(given).namespace  # changes the defaults
    options = parser(kind, namespace).parse_args(given)
    if options.report:
        require("matplotlib")  # fail before minutes of computation
    truth = load(options.truth) if options.truth else None
    outcome = calibrate_with(kind, options)
    # What is not available of a joint estimate is so of its node only.
    found = (kind.report if kind is JOINT else kind.report_of)(outcome, truth)
    write_outcome(outcome, found, kind, options, report.console())
    return EXIT_CODES[outcome.verdict]


def calibrate_with(kind: Calibration[Any, Any], options: argparse.Namespace) -> Outcome[Any, Any]:
    """Calibrate from the bags and with the settings of a command line."""
    settings = kind.settings(**{f.name: getattr(options, f.name) for f in fields(kind.settings)})
    if kind is JOINT:
        return estimate_from_bags(options.bags, settings, options.params, options.namespace)
    arm = initial_arm(options.kinematic, settings, options) if kind.prior_results else None
    return solve_bag(kind, options.bags, settings, options.namespace, arm)


def solve_bag(
    kind: Calibration[D, C],
    paths: str | PathLike[str] | Iterable[str | PathLike[str]],
    settings: C | None = None,
    namespace: str = "",
    arm: Arm | None = None,
) -> Outcome[D, Any]:
    """Find the data in one or several bags and calibrate, as the node does on live topics.

    By default, the settings are those of the kind, and the arm is that of the settings.

    Raises:
        BagError: a bag cannot be read or lacks a topic.
        ValueError: a setting or the description is invalid.
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
        subjects = {topic_name(bags, one, namespace): one.subject for one in inputs}
        return explain_failure(kind, outcome, read_streams(bags, subjects))


def initial_arm(kinematic: str | None, settings: Any, options: argparse.Namespace) -> Arm | None:
    """Return the described arm with the kinematics of a result (JSON) or of a bag; None: neither.

    A bag is calibrated with the settings that the kinematic calibration shares with this one.

    Raises:
        ValueError: the result is invalid, or the calibration has not passed.
    """
    if not kinematic:
        return None
    arm = described(settings.arm)
    if Path(kinematic).suffix == ".json":
        return with_kinematics_of(result.read_arm(kinematic, DEFAULT_KIND), arm)
    kind, namespace = KINDS[DEFAULT_KIND], options.namespace
    given = default_settings(kind.settings, namespace)
    alike = (name for name in ("arm", "joints_topic", "base_topic") if name in options)
    given |= {name: getattr(options, name) for name in alike}
    found = solve_bag(kind, kinematic, kind.settings(**given), namespace)
    if found.verdict != PASS:
        raise ValueError(f"kinematic calibration from {kinematic}: {found.verdict}: {found.reason}")
    return with_kinematics_of(from_yaml(found.description), arm)


def write_outcome(
    outcome: Outcome[Any, Any],
    found: report.Report,
    kind: Calibration[Any, Any],
    options: argparse.Namespace,
    console: Console,
) -> None:
    """Print a result and write the requested files."""
    if options.output and kind.has_urdf:
        found = with_description(found, options.output)
    console.print(report.printable(found, options.details), highlight=False)
    if options.result:
        result.write(options.result, kind.name, outcome)
    if options.report:
        page = report.write(options.report, found)
        console.print(f"report written to {page}", soft_wrap=True)
    if options.output and outcome.verdict == PASS:
        kind.write(options.output, outcome)
        console.print(f"{kind.output_name} written to {options.output}", soft_wrap=True)
    elif options.output:
        reason = f"as the verdict is {outcome.verdict}"
        console.print(f"{options.output} not written, {reason}", soft_wrap=True)


if __name__ == "__main__":
    sys.exit(main())
