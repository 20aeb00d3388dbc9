"""Calibrate from bags, without any ROS process: the command `from_bag`."""

import argparse
import sys
from argparse import BooleanOptionalAction
from collections.abc import Callable, Iterable, Sequence
from dataclasses import fields
from itertools import zip_longest
from math import nan
from os import PathLike
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from geometry_msgs.msg import PoseStamped
from rich.console import Console
from sensor_msgs.msg import Imu, JointState

from fss_arm_bags.bulk import frame_id, pieces, turn_rates, whole_poses
from fss_arm_bags.reader import BagError, Bags, digest, open_bags
from fss_arm_calib import report, result
from fss_arm_calib.acceptance import FAIL, NOT_EVALUATED, PASS
from fss_arm_calib.calibration import Calibration, Finder, Input, write_described
from fss_arm_calib.causes import explained
from fss_arm_calib.kinds import KINDS
from fss_arm_calib.outcome import Datum, Outcome
from fss_arm_calib.segments.streams import newest
from fss_arm_calib.segments.tape import Tape, Track
from fss_arm_calib.settings import CalibrationSettings
from fss_arm_model.description import Arm, described, from_yaml, load
from fss_arm_model.settings import default_in, meaning
from fss_arm_ros.calibrated import with_kinematics_of
from fss_arm_ros.command_line import Parser, in_one_line
from fss_arm_ros.convert import SECOND, stamp_ns

D = TypeVar("D", bound=Datum)
C = TypeVar("C", bound=CalibrationSettings)

EXIT_CODES = {PASS: 0, FAIL: 2, NOT_EVALUATED: 3}

PIECE = 0.2  # of the horizon that streams may lag each other by: what is read at once

DEFAULT = "kinematic"  # kind of calibration

EPILOG = "Exit codes: 0 pass, 1 the command cannot be carried out, 2 fail, 3 not evaluated."


def solve_bag(
    kind: Calibration[D, C],
    paths: str | PathLike[str] | Iterable[str | PathLike[str]],
    settings: C | None = None,
    namespace: str = "",
    arm: Arm | None = None,
) -> Outcome[D, Any]:
    """Find the data in one or several bags, and calibrate, as the node does on live topics.

    Args:
        kind: of calibration.
        paths: the bags'.
        settings: those of the kind by default.
        namespace: of the vehicle whose data they are, as `fss2`.
        arm: to begin from; that of the settings by default.

    Raises:
        BagError: a bag cannot be read or lacks a topic.
        ValueError: a setting is impossible, or the description is.
        OSError: a file cannot be read.
    """
    s = settings or kind.settings(**defaults(kind.settings, namespace))
    arm = arm or described(s.arm)
    finder = kind.finder(arm.n, s, [])
    with open_bags(paths) as bags:
        for topic in bags.left_out:
            print(f"from_bag: {topic}", file=sys.stderr)
        inputs = kind.inputs(s, arm.n)
        found = newest(fed(bags, finder, inputs, s.horizon, namespace), kind.most(s))
        outcome = kind.calibrate(found, arm, s, finder.streams(), source(bags))
        if outcome.verdict == PASS:
            return outcome
        return explained(kind, outcome, taped(bags, inputs, namespace))


def begun_from(kinematic: str, arm: str, options: argparse.Namespace, namespace: str = "") -> Arm:
    """The arm that a kinematic calibration leaves: of its result, or made here from a bag.

    Args:
        kinematic: a result as JSON, or a bag.
        arm: description of what such a calibration does not estimate.
        options: settings that it has in common with what follows.
        namespace: of the vehicle.

    Raises:
        ValueError: there is no such result, or it has not passed.
        OSError: a file cannot be read.
    """
    own = described(arm)
    if Path(kinematic).suffix == ".json":
        return with_kinematics_of(result.arm_of(kinematic, DEFAULT), own)
    kind = KINDS[DEFAULT]
    given = defaults(kind.settings, namespace)
    given |= {name: getattr(options, name) for name in ("arm", "joints_topic", "base_topic")}
    found = solve_bag(kind, kinematic, kind.settings(**given), namespace)
    if found.verdict != PASS:
        raise ValueError(f"kinematics by {kinematic}: {found.verdict}: {found.reason}")
    return with_kinematics_of(from_yaml(found.description), own)


def source(bags: Bags) -> str:
    """The bags' names with the SHA-256 of each one's data, and what was lost of damaged ones."""
    lost = {
        r.path: f" ({r.messages} messages recovered, {r.lost} bytes lost)" for r in bags.recovered
    }
    return ", ".join(f"{path.name} {digest(path)}{lost.get(path, '')}" for path in bags.paths)


def defaults(kind: type[Any], namespace: str) -> dict[str, Any]:
    """The defaults of settings for a vehicle, which is in a namespace."""
    return {f.name: default_in(f, namespace) for f in fields(kind)}


def fed(
    bags: Bags, finder: Finder[D], inputs: Sequence[Input], horizon: float, namespace: str = ""
) -> list[D]:
    """What a finder makes of the bags' messages.

    Raises:
        BagError: a topic is missing or of another type.
    """
    topics = {name(bags, one, namespace): one for one in inputs}
    found: list[D] = []
    for piece in pieces(bags.raw(set(topics)), round(PIECE * horizon * SECOND)):
        for topic, one in topics.items():
            data = piece.get(topic, [])
            if one.bulk:
                found += one.bulk(finder, data)
                continue
            for message in data:
                found += one.feed(finder, bags.deserialize(message, one.type))
    return found + finder.close()


def taped(bags: Bags, inputs: Sequence[Input], namespace: str = "") -> Tape:
    """What the bags hold of joints, subjects and gyro, to be heard again.

    Raises:
        BagError: a topic is missing or of another type.
    """
    topics = {name(bags, one, namespace): one for one in inputs}
    wanted = {
        topic for topic, one in topics.items() if one.message in (JointState, PoseStamped, Imu)
    }
    data: dict[str, list[bytes]] = {topic: [] for topic in wanted}
    receipts: dict[str, list[int]] = {topic: [] for topic in wanted}
    for topic, _, receipt, message in bags.raw(wanted):
        data[topic].append(message)
        receipts[topic].append(receipt)
    joints: dict[str, list[tuple[int, int, float, float]]] = {}
    poses, frames, rates = {}, {}, None
    for topic, messages in data.items():
        one, heard = topics[topic], np.array(receipts[topic], dtype=np.int64)
        if one.message is JointState:
            for received, message in zip(receipts[topic], messages, strict=True):
                state = bags.deserialize(message, one.type)
                readings = zip_longest(state.name, state.position, state.velocity, fillvalue=nan)
                for joint, q, qd in readings:
                    row = stamp_ns(state.header.stamp), received, float(q), float(qd)
                    joints.setdefault(str(joint), []).append(row)
        elif one.message is PoseStamped and messages:
            stamps, numbers = whole_poses(messages)
            poses[one.subject] = Track(stamps, heard, numbers)
            frames[one.subject] = frame_id(messages[0])
        elif messages:
            stamps, turns = turn_rates(messages)
            rates = Track(stamps, heard, turns[:, None])
    return Tape({joint: _track(rows) for joint, rows in joints.items()}, poses, rates, frames)


def _track(rows: Sequence[tuple[int, int, float, float]]) -> Track:
    stamps, receipts, q, qd = zip(*rows, strict=True)
    t, heard = (np.array(part, dtype=np.int64) for part in (stamps, receipts))
    return Track(t, heard, np.column_stack([q, qd]))


def name(bags: Bags, one: Input, namespace: str = "", needed: bool = True) -> str:
    """The name of an input's topic, as in the bags: in the namespace, unless it begins with `/`.

    Raises:
        BagError: it is of another type, or missing and needed.
    """
    within = namespace.strip("/")
    topic = (
        f"/{within}/{one.topic}" if within and one.topic[0] != "/" else f"/{one.topic.lstrip('/')}"
    )
    if topic in bags.topics and bags.topics[topic].msgtype != one.type:
        raise BagError(f"{topic} is of type {bags.topics[topic].msgtype}, expected {one.type}")
    if topic not in bags.topics and one.needed and needed:
        there = ", ".join(bags.topics) or "no topics"
        where = ", ".join(map(str, bags.paths))
        raise BagError(f"no {topic} in {where}, which has {there}{hint(bags, one.topic)}")
    return topic


def hint(bags: Bags, topic: str) -> str:
    """In which namespaces there is a topic that was looked for, in words; empty: in none."""
    last = f"/{topic.lstrip('/')}"
    spaces = [found.removesuffix(last)[1:] for found in bags.topics if found.endswith(last)]
    named = " or ".join(f"--namespace {space}" for space in spaces if space)
    return named and f"; see {named}"


def parser(kind: Calibration[Any, Any], namespace: str = "") -> argparse.ArgumentParser:
    """The command line: the bags, what to write, and each setting that the node has, too."""
    lacks = "".join(f" No {what}: {why}." for what, why in kind.lacks.items())
    p = Parser("from_bag", description=f"{__doc__} {kind.about}{lacks}", epilog=EPILOG)
    p.add_argument("bags", nargs="+", metavar="BAG", help="bag, or folder of bags")
    for other in KINDS.values():
        if other.name != DEFAULT:
            about = f"{other.about} See --{other.name} --help"
            p.add_argument(f"--{other.name}", action="store_true", help=about)
    outputs(p, kind.written)
    if kind.after:
        p.add_argument(
            "--kinematic", metavar="FROM", help="begin from a kinematic calibration, with its "
            "covariance: its result as JSON, or a bag to make it from",
        )  # fmt: skip
    add_settings(p, kind.settings)
    p.set_defaults(**defaults(kind.settings, namespace))
    return p


def outputs(p: argparse.ArgumentParser, written: str) -> None:
    """Options that every estimate from bags has: what to write, and of whom."""
    p.add_argument("--output", metavar="FILE", help=f"write the {written}, if it passes")
    p.add_argument(
        "--result", metavar="JSON", help="write the result, whatever its verdict; a CSV beside it"
    )
    p.add_argument("--report", metavar="DIR", help="write a page to read, and its drawings as PNG")
    p.add_argument(
        "--truth", metavar="YAML", help="description to compare with, in the report only"
    )
    p.add_argument("--namespace", default="", help="of the vehicle, if the bag has several: fss2")


def add_settings(
    p: argparse.ArgumentParser, kind: type[Any], names: Sequence[str] | None = None
) -> None:
    """An option for each setting of a dataclass, or for some by their names."""
    for f in (f for f in fields(kind) if names is None or f.name in names):
        flag, about = f"--{f.name.replace('_', '-')}", meaning(f)
        if isinstance(f.default, bool):
            p.add_argument(flag, action=BooleanOptionalAction, default=f.default, help=about)
            continue
        several = f.default if isinstance(f.default, tuple) else ()
        p.add_argument(
            flag,
            type=type(several[0] if several else f.default),
            nargs=len(several) or None,
            default=f.default,
            metavar=f.name.split("_")[-1].upper(),
            help=f"{about} (default: {'none' if f.default == '' else f.default})".replace(
                "%", "%%"
            ),
        )


def asked(args: Sequence[str]) -> Calibration[Any, Any]:
    """The kind of calibration that a command line asks for."""
    found = [k for k in KINDS.values() if k.name != DEFAULT and f"--{k.name}" in args]
    return found[0] if found else KINDS[DEFAULT]


def calibrated(
    kind: Calibration[Any, Any], options: argparse.Namespace, console: Console
) -> Outcome[Any, Any]:
    """Solve, show and write what was asked for."""
    truth = load(options.truth) if options.truth else None
    settings = kind.settings(**{f.name: getattr(options, f.name) for f in fields(kind.settings)})
    arm = None
    if kind.after and options.kinematic:
        arm = begun_from(options.kinematic, settings.arm, options, options.namespace)
    outcome = solve_bag(kind, options.bags, settings, options.namespace, arm)
    told(
        outcome,
        kind.report_of(outcome, truth),
        kind.name,
        options,
        console,
        kind.write,
        kind.written,
    )
    return outcome


def told(
    outcome: Outcome[Any, Any],
    found: report.Report,
    kind: str,
    options: argparse.Namespace,
    console: Console,
    write: Callable[[str, Outcome[Any, Any]], None] = write_described,
    written: str = "calibrated description",
) -> None:
    """Show a result, and write what was asked for.

    Raises:
        OSError: it cannot be written.
    """
    console.print(report.printed(found))
    if options.result:
        result.write(options.result, kind, outcome)
    if options.report:
        page = report.write(options.report, found)
        console.print(f"report written to {page}", soft_wrap=True)
    if options.output and outcome.verdict == PASS:
        write(options.output, outcome)
        console.print(f"{written} written to {options.output}", soft_wrap=True)
    elif options.output:
        reason = f"as the verdict is {outcome.verdict}"
        console.print(f"{options.output} not written, {reason}", soft_wrap=True)


@in_one_line("from_bag")
def main(args: Sequence[str] | None = None) -> int:
    """Run as `ros2 run fss_arm_calib from_bag`."""
    given = sys.argv[1:] if args is None else args
    kind = asked(given)
    namespace = parser(kind).parse_args(given).namespace  # which changes the defaults
    options = parser(kind, namespace).parse_args(given)
    return EXIT_CODES[calibrated(kind, options, report.console()).verdict]


if __name__ == "__main__":
    sys.exit(main())
