"""The command `check`: opens each valve in turn and compares the base's motion with the layout."""

import argparse
import os

from fss_arm_model.thrusters import COUNT
from fss_arm_model.vehicle import Vehicle
from fss_arm_ros.command_line import Parser

BASE_TOPIC = Vehicle.__dataclass_fields__["base_topic"]


def parser() -> argparse.ArgumentParser:
    """Return the command-line parser."""
    p = Parser(
        prog="check",
        description="Open each valve of the base in turn, by the running node `base`, and compare "
        "how the base moves (motion capture, fog/imu) with the valves' layout. The base floats "
        "freely, its joints hold.",
        epilog="Exit codes: 0 pass, 1 cannot be carried out, 2 fail, 3 something was not tried, "
        "130 interrupted.",
    )
    p.add_argument("--arm", default="", help="the arm's description (default: the paper's)")
    p.add_argument(
        "--namespace", default=os.environ.get("FSS_NAMESPACE", ""),
        help="of the vehicle (default: $FSS_NAMESPACE)",
    )  # fmt: skip
    p.add_argument(
        "--base-topic",
        help=f"of the base's poses (default {BASE_TOPIC.default}, of vehicle V /vicon/V/V)",
    )
    p.add_argument("--q", type=float, nargs="+", help="joint angles [rad], if nobody tells them")
    p.add_argument("--thrust", type=float, default=0.16, help="of a thruster [N] (default 0.16)")
    p.add_argument("--lever", type=float, default=0.11, help="of a thruster [m] (default 0.11)")
    p.add_argument("--layout", type=float, nargs=3 * COUNT, help="as the parameter of `base`")
    p.add_argument("--valves", type=int, nargs="+", help="which to try (default: all)")
    p.add_argument("--on-time", type=float, default=1.0, help="of each pulse [s] (default 1)")
    p.add_argument("--before", type=float, default=3.0, help="time before it [s] (default 3)")
    p.add_argument("--after", type=float, default=4.0, help="time after it [s] (default 4)")
    p.add_argument("--tolerance", type=float, default=0.2, help="as a part (default 0.2)")
    p.add_argument("--yes", action="store_true", help="ask nobody whether the base is free")
    p.add_argument("--output", default="base_check.yaml", help="what is written")
    return p
