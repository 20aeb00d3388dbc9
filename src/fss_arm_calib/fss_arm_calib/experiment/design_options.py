"""Propose maneuvers or postures and predict their results."""

import argparse

from fss_arm_calib.dynamic.settings import DynamicSettings
from fss_arm_calib.experiment.settings import ABOUT_KINDS, JOINT, KINDS, Conditions
from fss_arm_ros.command_line import Parser, add_settings

GUARD = ("table", "base_radius", "link_radius", "margin", "edge_margin")
CONDITIONS = ("duration", "rest", "repeats", *GUARD)  # available as options


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    p = Parser("design", usage="design [OPTION ...]", description=__doc__)
    p.add_argument(
        "--kinematic",
        action="store_true",
        help="propose postures for a kinematic calibration instead",
    )
    p.add_argument(
        "--count", type=int, default=16, help="number of maneuvers or postures (default 16)"
    )
    p.add_argument(
        "--chosen", default="", help="parameters to determine best, e.g. 'b_1 b_2'; empty: all"
    )
    p.add_argument(
        "--goal", default="", help="standard deviations to reach, e.g. 'b_i 0.002 I_4 0.001'"
    )
    before = p.add_mutually_exclusive_group()
    before.add_argument(
        "--bag",
        default="",
        help="bag with earlier maneuvers to add to; their information about "
        "the arm and the cameras is used",
    )
    before.add_argument(
        "--result",
        metavar="JSON",
        default="",
        help="result of a calibration to add to; its values and covariance are prior knowledge",
    )
    p.add_argument("--output", metavar="YAML", help="write the plan for `experiment`")
    p.add_argument("--seed", type=int, default=0, help="seed of the candidates (default 0)")
    p.add_argument(
        "--kinds",
        default=" ".join(KINDS),
        help=f"{ABOUT_KINDS}; or {JOINT}: each joint alone, back and forth in two postures, "
        "--repeats times, for `drives`",
    )
    add_settings(p, Conditions, CONDITIONS)
    add_settings(p, DynamicSettings)
    return p
