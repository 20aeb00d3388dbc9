"""List what bags hold and how healthy they are; repair damage on request."""

import argparse
from pathlib import Path

from fss_arm_ros.command_line import Parser


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    p = Parser(
        prog="doctor",
        description=__doc__,
        epilog="Exit codes: 0 healthy, also after a repair, 1 not readable, 2 damaged or with "
        "findings.",
    )
    p.add_argument(
        "bags",
        metavar="BAG",
        nargs="+",
        type=Path,
        help="a bag, or a folder of bags that is read as one",
    )
    p.add_argument(
        "--repair",
        action="store_true",
        help="replace damaged bags by what can be recovered (not while they are recorded); "
        "the damaged files are renamed to *.damaged",
    )
    return p
