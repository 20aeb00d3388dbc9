"""List the subjects that motion capture sees, with rate, jitter, latency and longest gap."""

import argparse

from fss_arm_ros.command_line import Parser


def parser() -> argparse.ArgumentParser:
    """Return the command-line parser."""
    command = Parser(
        prog="subjects",
        description="List the subjects that motion capture sees: rate, jitter of the stamps, "
        "latency from stamp to arrival here (valid if both computers' clocks agree), longest gap, "
        "mean pose.",
        epilog="Exit codes: 0 poses were received, 1 none.",
    )
    command.add_argument(
        "--seconds", type=float, default=5.0, help="time to listen [s] (default 5)"
    )
    command.add_argument("--prefix", default="vicon", help="prefix of the topics (default vicon)")
    return command
