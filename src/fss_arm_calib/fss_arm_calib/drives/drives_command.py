"""What the command `drives` does."""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np
from rich.console import Console

from fss_arm_bags.reader import BagError, Bags, open_bags
from fss_arm_calib import report
from fss_arm_calib.bag_command import EXIT_CODES, told
from fss_arm_calib.bag_data import hint, source
from fss_arm_calib.drives.calibrate import Telemetry, calibrate
from fss_arm_calib.drives.drives_options import parser
from fss_arm_calib.drives.problem import Drive
from fss_arm_calib.drives.report import drives_report
from fss_arm_calib.drives.settings import DrivesSettings
from fss_arm_calib.outcome import Outcome
from fss_arm_model.description import described, load
from fss_arm_ros.command_line import in_one_line
from fss_arm_ros.convert import stamp_ns

TYPE = "fss_arm_msgs/msg/LinkTelemetry"
FIELDS = ("position", "velocity", "current", "torque", "torque_age")


def telemetry(bags: Bags, n: int, namespace: str = "") -> list[Telemetry]:
    """What each of n links reported.

    Raises:
        BagError: the bags have it of no link, or a topic is of another type.
    """
    within = f"/{namespace.strip('/')}" if namespace.strip("/") else ""
    topics = {f"{within}/link_{i}/telemetry": i for i in range(1, n + 1)}
    for topic in topics.keys() & bags.topics.keys():
        if (kind := bags.topics[topic].msgtype) != TYPE:
            raise BagError(f"{topic} is of type {kind}, expected {TYPE}")
    if not topics.keys() & bags.topics.keys():
        there = ", ".join(bags.topics) or "no topics"
        raise BagError(f"no link's telemetry among {there}{hint(bags, 'link_1/telemetry')}")
    rows: dict[int, dict[int, Any]] = {i: {} for i in topics.values()}
    for topic, _, _, data in bags.raw(topics.keys() & bags.topics.keys()):
        message = bags.deserialize(data, TYPE)
        rows[topics[topic]][stamp_ns(message.header.stamp)] = message
    return [_since_homed(rows[i]) for i in sorted(rows)]


def _since_homed(messages: dict[int, Any]) -> Telemetry:
    """By their stamps, those since the encoder last began to count from elsewhere."""
    kept: dict[int, Any] = {}
    boot = homings = None
    for stamp, one in sorted(messages.items()):
        if one.boot != boot or (homings and one.homings not in (0, homings)):
            kept, boot, homings = {}, one.boot, None
        homings = one.homings or homings
        kept[stamp] = one
    columns = (np.array([getattr(one, name) for one in kept.values()], float) for name in FIELDS)
    return Telemetry(np.array([*kept], dtype=np.int64), *columns)


def estimated(options: argparse.Namespace, console: Console) -> Outcome[Telemetry, list[Drive]]:
    """Solve, show and write what was asked for."""
    s = DrivesSettings(**{f.name: getattr(options, f.name) for f in fields(DrivesSettings)})
    truth, arm = load(options.truth) if options.truth else None, described(s.arm)
    with open_bags(options.bags) as bags:
        outcome = calibrate(telemetry(bags, arm.n, options.namespace), arm, s, source(bags))
    told(outcome, drives_report(outcome, truth), "drives", options, console)
    return outcome


@in_one_line("drives")
def main(args: Sequence[str] | None = None) -> int:
    """Run as `ros2 run fss_arm_calib drives`."""
    options = parser().parse_args(args)
    return EXIT_CODES[estimated(options, report.console()).verdict]


if __name__ == "__main__":
    sys.exit(main())
