"""Recompute recorded results from the data published with them, and compare."""

import argparse

from fss_arm_ros.command_line import Parser


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    p = Parser("recompute", description=__doc__)
    p.add_argument("bags", nargs="+", metavar="BAG", help="bag, or folder of bags")
    p.add_argument("--namespace", default="", help="namespace of the vehicle, e.g. fss2")
    return p
