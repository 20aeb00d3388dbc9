"""Calibrate from bags, without any ROS process."""

import argparse
import sys
from collections.abc import Sequence
from typing import Any

from fss_arm_calib.calibration import Calibration
from fss_arm_calib.joint.kind import JOINT
from fss_arm_calib.kinds import KINDS
from fss_arm_ros.command_line import Parser, add_settings, default_settings

DEFAULT_KIND = "kinematic"  # kind of calibration if no option selects one

EPILOG = "Exit codes: 0 pass, 1 the command cannot be carried out, 2 fail, 3 not evaluated."
USAGE = "from_bag [OPTION ...] BAG [BAG ...]"
JOINT_DESCRIPTION = """Estimate one arm from all rests, maneuvers and drifts of one or more bags.
Each bag is a session: tilt, hose and joint zeros may differ between bags, and after a homing within
a bag."""


def selected_kind(args: Sequence[str]) -> Calibration[Any, Any]:
    """Return the kind of calibration that a command line selects."""
    found = [
        k for k in (*KINDS.values(), JOINT) if k.name != DEFAULT_KIND and f"--{k.name}" in args
    ]
    return found[0] if found else KINDS[DEFAULT_KIND]


def parser(
    kind: Calibration[Any, Any] | None = None, namespace: str = ""
) -> argparse.ArgumentParser:
    """Return the parser of the command line: the bags, the output files and the node's settings.

    Without `kind`, it is the one that sys.argv selects. The namespace changes the defaults.
    """
    kind = kind or selected_kind(sys.argv)
    p = Parser("from_bag", usage=USAGE, description=_description(kind), epilog=EPILOG)
    p.add_argument("bags", nargs="+", metavar="BAG", help="bag, or folder of bags")
    one = p.add_mutually_exclusive_group()
    for other in (*KINDS.values(), JOINT):
        if other.name != DEFAULT_KIND:
            about = f"{other.about} See --{other.name} --help"
            one.add_argument(f"--{other.name}", action="store_true", help=about)
    p.add_argument(
        "--output", metavar="FILE", help=f"write the {kind.output_name} if the calibration passes"
    )
    p.add_argument(
        "--result", metavar="JSON", help="write the result as JSON and CSV, whatever the verdict"
    )
    p.add_argument("--report", metavar="DIR", help="write an HTML page, and its figures as PNG")
    p.add_argument("--details", action="store_true", help="print all tables and checks")
    p.add_argument("--truth", metavar="YAML", help="true description to compare with in the report")
    p.add_argument("--namespace", default="", help="namespace of the vehicle, e.g. fss2")
    if kind is JOINT:
        p.add_argument(
            "--params",
            metavar="YAML",
            help="parameter file with settings of kinematic, dynamic and drift, as for their nodes",
        )
    elif kind.prior_results:
        p.add_argument(
            "--kinematic",
            metavar="FROM",
            help="start from a kinematic calibration with its "
            "covariance: its result as JSON, or a bag to calibrate from",
        )
    add_settings(p, kind.settings)
    p.set_defaults(**default_settings(kind.settings, namespace))
    return p


def _description(kind: Calibration[Any, Any]) -> str:
    if kind is JOINT:
        return JOINT_DESCRIPTION
    return f"{__doc__} {kind.about}"
