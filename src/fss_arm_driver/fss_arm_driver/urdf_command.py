"""Command `urdf`: writes an arm's description as URDF to a file or to standard output."""

import argparse
import sys

from fss_arm_model.description_file import described
from fss_arm_model.files import write_text
from fss_arm_model.urdf import urdf
from fss_arm_ros.command_line import Parser, in_one_line


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    p = Parser(prog="urdf", description="Write an arm's description as URDF.")
    p.add_argument("arm", nargs="?", default="", help="the description (default: the paper's arm)")
    p.add_argument("--output", metavar="FILE", help="file to write (default: standard output)")
    return p


@in_one_line("urdf")
def main() -> int:
    """Run as `ros2 run fss_arm_driver urdf`."""
    given = parser().parse_args()
    text = urdf(described(given.arm))
    if given.output:
        write_text(given.output, text)
    else:
        print(text, end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
