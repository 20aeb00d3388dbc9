"""Propose maneuvers or postures and predict their results: the command `design`."""

import argparse

from fss_arm_calib.bag_options import add_settings
from fss_arm_calib.dynamic.settings import DynamicSettings
from fss_arm_calib.experiment.settings import JOINT, KINDS, Conditions
from fss_arm_ros.command_line import Parser

GUARD = ("table", "base_radius", "link_radius", "margin", "edge_margin")
CONDITIONS = ("duration", "rest", "repeats", *GUARD)  # available as options


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    p = Parser("design", description=__doc__)
    p.add_argument("--kinematic", action="store_true", help="propose postures to rest in instead")
    p.add_argument("--count", type=int, default=16, help="how many (default: 16)")
    p.add_argument("--chosen", default="", help="names that matter most, as 'b_1 b_2'; empty: all")
    p.add_argument(
        "--goal", default="", help="deviations at which to stop sooner, as 'b_i 0.002 I_4 0.001'"
    )
    before = p.add_mutually_exclusive_group()
    before.add_argument(
        "--bag", default="", help="maneuvers made before, to add to: what they tell of the arm and "
        "of the cameras counts"
    )  # fmt: skip
    before.add_argument(
        "--result", metavar="JSON", default="", help="of a calibration, to add to: its values count"
        " as known to its deviations, with all correlations"
    )  # fmt: skip
    p.add_argument("--output", metavar="YAML", help="write the plan, for `experiment` to run")
    p.add_argument("--seed", type=int, default=0, help="of the candidates (default: 0)")
    p.add_argument(
        "--compare", action="store_true", help="compare the kinds at equal floating time, too"
    )
    p.add_argument(
        "--kinds", default=" ".join(KINDS), help=f"of {', '.join(KINDS)}; or {JOINT}: each joint "
        "alone, to and fro in two postures, for `drives`; --repeats of all",
    )  # fmt: skip
    add_settings(p, Conditions, CONDITIONS)
    add_settings(p, DynamicSettings)
    return p
