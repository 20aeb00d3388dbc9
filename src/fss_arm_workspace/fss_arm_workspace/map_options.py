"""Compute workspace and manipulability of an arm (the paper's Figures 6, 7 and 8) without ROS."""

import argparse

from fss_arm_model.settings import default_text
from fss_arm_ros.command_line import Parser
from fss_arm_workspace.analysis import AnalysisSettings
from fss_arm_workspace.straight_path.redundancy import RULES

EPILOG = "Exit codes: 0 done, 1 failed."


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    p = Parser("map", description=__doc__, epilog=EPILOG)
    p.add_argument(
        "source",
        nargs="*",
        metavar="SOURCE",
        help="description YAML, or bags with a calibration (default: the paper's arm)",
    )
    p.add_argument(
        "--output",
        metavar="FOLDER",
        default="workspace",
        help="folder for the results (default %(default)s)",
    )
    default = AnalysisSettings()
    p.add_argument(
        "--cell",
        type=float,
        default=default.cell,
        metavar="M",
        help="size of a map's cell [m] (default %(default)s)",
    )
    p.add_argument(
        "--rule",
        choices=RULES[:3],
        default=default.redundancy,
        help="rule for the redundancy of straight paths (default %(default)s)",
    )
    p.add_argument(
        "--start",
        type=float,
        nargs="+",
        metavar="DEG",
        help="joint readings at the start of straight paths [deg] (default: an arch)",
    )
    p.add_argument(
        "--table",
        type=float,
        nargs=4,
        default=default.table_corners,
        metavar="M",
        help="table for straight paths: low x, low y, high x, high y [m] "
        f"(default {' '.join(map(default_text, default.table_corners))})",
    )
    p.add_argument(
        "--true-angle",
        action="store_true",
        help="joint limits hold for q + theta_0, not for the encoder's reading q",
    )
    p.add_argument(
        "--workers",
        type=int,
        default=1,
        metavar="N",
        help="number of threads (default %(default)s)",
    )
    return p
