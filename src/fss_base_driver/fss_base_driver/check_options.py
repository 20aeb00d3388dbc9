"""Open each valve in turn and compare the base's motion with the layout."""

import argparse
import os
from collections.abc import Sequence
from math import isfinite

from fss_arm_model.thrusters import THRUSTER_COUNT
from fss_arm_model.vehicle import Vehicle
from fss_arm_ros.command_line import Parser

BASE_TOPIC = Vehicle.__dataclass_fields__["base_topic"]
MAX_VALUE = 60.0  # of --thrust, --lever, --tolerance, and of times [s]


def parser() -> argparse.ArgumentParser:
    """Return the command-line parser."""
    p = Parser(
        prog="check",
        description="Open each valve of the base in turn through the running node `base`, and "
        "compare the base's motion (motion capture, fog/imu) with the valves' layout. The base "
        "must float freely, and its joints must hold.",
        epilog="Exit codes: 0 pass, 1 cannot be carried out, 2 fail, 3 a valve was not tested, "
        "130 interrupted.",
    )
    p.add_argument("--arm", default="", help="the arm's description (default: the paper's)")
    p.add_argument(
        "--namespace",
        default=os.environ.get("FSS_NAMESPACE", ""),
        help="namespace of the vehicle (default $FSS_NAMESPACE)",
    )
    p.add_argument(
        "--base-topic",
        help=f"topic of the base's poses (default {BASE_TOPIC.default}, for vehicle V /vicon/V/V)",
    )
    p.add_argument(
        "--q",
        type=float,
        nargs="+",
        metavar="RAD",
        help="joint angles [rad], if no node publishes them",
    )
    p.add_argument(
        "--thrust", type=float, default=0.16, help="thrust of a thruster [N] (default %(default)s)"
    )
    p.add_argument(
        "--lever", type=float, default=0.11, help="lever of a thruster [m] (default %(default)s)"
    )
    p.add_argument(
        "--layout",
        type=float,
        nargs="+",
        metavar="N",
        help=f"layout as the parameter of `base`, {3 * THRUSTER_COUNT} numbers",
    )
    p.add_argument(
        "--valves", type=int, nargs="+", metavar="I", help="valves to test (default: all)"
    )
    p.add_argument(
        "--on-time", type=float, default=1.0, help="length of each pulse [s] (default %(default)s)"
    )
    p.add_argument(
        "--before",
        type=float,
        default=3.0,
        help="time recorded before a pulse [s] (default %(default)s)",
    )
    p.add_argument(
        "--after",
        type=float,
        default=4.0,
        help="time recorded after a pulse [s] (default %(default)s)",
    )
    p.add_argument(
        "--tolerance",
        type=float,
        default=0.2,
        help="accepted relative error of thrust and lever (default %(default)s)",
    )
    p.add_argument(
        "--yes", action="store_true", help="start without asking whether the base is free"
    )
    p.add_argument(
        "--output", default="base_check.yaml", help="file to write (default %(default)s)"
    )
    return p


def parse(args: Sequence[str] | None) -> argparse.Namespace:
    """Return the options of a command line (default sys.argv); exit if one is out of range."""
    command = parser()
    given = command.parse_args(args)
    for name in ("thrust", "lever", "on_time", "before", "after", "tolerance"):
        if not 0.0 < (value := getattr(given, name)) < MAX_VALUE:
            option, limits = f"--{name.replace('_', '-')}", f"above 0 and below {MAX_VALUE:g}"
            command.error(f"{option} is {value}, expected {limits}")
    for name in ("q", "layout"):
        if not all(map(isfinite, values := getattr(given, name) or ())):
            command.error(f"--{name} is {values}, expected finite numbers")
    if len(given.layout or ()) not in (0, 3 * THRUSTER_COUNT):
        command.error(f"--layout has {len(given.layout)} numbers, expected {3 * THRUSTER_COUNT}")
    if not set(given.valves or [1]) <= set(range(1, THRUSTER_COUNT + 1)):
        command.error(f"--valves is {given.valves}, expected 1 to {THRUSTER_COUNT}")
    return given
