"""Calibrate from bags, without any ROS process."""

import argparse
import sys
from collections.abc import Sequence
from typing import Any

from fss_arm_calib.bag_options import EPILOG, add_settings, defaults, outputs
from fss_arm_calib.calibration import Calibration
from fss_arm_calib.joint.kind import JOINT
from fss_arm_calib.joint.settings import JointSettings
from fss_arm_calib.kinds import KINDS
from fss_arm_ros.command_line import Parser

DEFAULT = "kinematic"  # kind of calibration if no option selects one

ABOUT_JOINT = """One arm from all rests, maneuvers and drifts of one bag or many. Each bag is a
session of its own: tilt, hose and the joints' zeros may be others in each, and so they may after a
homing within it."""


def asked(args: Sequence[str]) -> Calibration[Any, Any]:
    """Return the kind of calibration that a command line selects."""
    found = [k for k in (*KINDS.values(), JOINT) if k.name != DEFAULT and f"--{k.name}" in args]
    return found[0] if found else KINDS[DEFAULT]


def parser(
    kind: Calibration[Any, Any] | None = None, namespace: str = ""
) -> argparse.ArgumentParser:
    """Return the parser of the command line: the bags, the output files and the node's settings.

    Args:
        kind: kind of calibration; None: the one that sys.argv selects.
        namespace: namespace of the vehicle, which changes the defaults.
    """
    kind = kind or asked(sys.argv)
    if kind is JOINT:
        return _joint()
    lacks = "".join(f" No {what}: {why}." for what, why in kind.lacks.items())
    p = Parser("from_bag", description=f"{__doc__} {kind.about}{lacks}", epilog=EPILOG)
    p.add_argument("bags", nargs="+", metavar="BAG", help="bag, or folder of bags")
    one = p.add_mutually_exclusive_group()
    for other in (*KINDS.values(), JOINT):
        if other.name != DEFAULT:
            about = f"{other.about} See --{other.name} --help"
            one.add_argument(f"--{other.name}", action="store_true", help=about)
    outputs(p, kind.written)
    if kind.after:
        p.add_argument(
            "--kinematic", metavar="FROM", help="begin from a kinematic calibration, with its "
            "covariance: its result as JSON, or a bag to make it from",
        )  # fmt: skip
    add_settings(p, kind.settings)
    p.set_defaults(**defaults(kind.settings, namespace))
    return p


def _joint() -> argparse.ArgumentParser:
    p = Parser("from_bag", description=ABOUT_JOINT, epilog=EPILOG)
    p.add_argument("--joint", action="store_true", help="this estimate")
    p.add_argument("bags", nargs="+", metavar="BAG", help="bag, or folder of bags: a session")
    outputs(p, "calibrated description")
    p.add_argument(
        "--params", metavar="YAML", help="settings of kinematic, dynamic and drift, as their nodes "
        "are given them",
    )  # fmt: skip
    add_settings(p, JointSettings)
    return p
