"""Run a campaign: simulations over a grid, distributions and seeds, on all cores or a cluster.

docs/how-to/campaign.md describes the file. Results are OUT/runs.parquet, one row per run, and
OUT/report/index.html.
"""

import argparse
import os
from pathlib import Path

from fss_arm_ros.command_line import Parser


def positive(text: str) -> int:
    """Return a number of runs or workers.

    Raises:
        argparse.ArgumentTypeError: it is not a positive integer.
    """
    if not (text.isascii() and text.isdecimal() and int(text) > 0):
        raise argparse.ArgumentTypeError(f"{text!r} is given, expected 1 or more")
    return int(text)


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    found = Parser(
        "campaign",
        description=__doc__,
        epilog="Exit codes: 0 pass, 1 the command cannot be carried out, 2 fail, 130 interrupted.",
    )
    found.add_argument("file", type=Path, metavar="FILE.yaml", help="file of the campaign")
    found.add_argument(
        "--out", type=Path, help="folder of the results (default out/NAME of the file)"
    )
    found.add_argument(
        "--runs", type=positive, help="number of runs, spread over the grid (default: all)"
    )
    found.add_argument("--resume", action="store_true", help="continue a campaign that ended early")
    found.add_argument("--replay", type=int, metavar="RUN", help="repeat one run and compare it")
    found.add_argument(
        "--workers",
        type=positive,
        default=os.cpu_count(),
        help="processes on this computer (default %(default)s)",
    )
    found.add_argument(
        "--scheduler", default="", metavar="tcp://HOST:8786", help="Dask scheduler of a cluster"
    )
    return found
