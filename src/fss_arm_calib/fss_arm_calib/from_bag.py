"""Calibrate from bags, without any ROS process: the command `from_bag`."""

import argparse
import sys
from argparse import BooleanOptionalAction
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from os import PathLike
from typing import Any

from rich.console import Console

from fss_arm_bags.bulk import pieces, poses, turn_rates
from fss_arm_bags.reader import BagError, Bags, digest, open_bags
from fss_arm_calib import dynamic_messages, report
from fss_arm_calib.drift import checks as drift_verdict
from fss_arm_calib.drift.checks import FloatCalibration, float_report, parameters
from fss_arm_calib.drift.settings import DriftSettings
from fss_arm_calib.dynamic import checks as dynamic_verdict
from fss_arm_calib.dynamic.checks import DynamicCalibration
from fss_arm_calib.dynamic.report import dynamic_report
from fss_arm_calib.dynamic.settings import DynamicCalibrationSettings
from fss_arm_calib.kinematic.checks import FAIL, NOT_EVALUATED, PASS, Calibration, calibrate
from fss_arm_calib.kinematic.report import kinematic_report
from fss_arm_calib.kinematic.settings import CalibrationSettings
from fss_arm_calib.messages import feed_joints, feed_telemetry
from fss_arm_calib.segments.drifts import DriftFinder
from fss_arm_calib.segments.maneuvers import Maneuver, ManeuverFinder
from fss_arm_calib.segments.rests import BASE, TIP, Observation, RestFinder
from fss_arm_calib.segments.streams import newest
from fss_arm_calib.state import write_text
from fss_arm_model.description import Arm, described, from_yaml, load, save
from fss_arm_model.settings import meaning
from fss_arm_ros.command_line import USER_ERROR, Parser
from fss_arm_ros.convert import SECOND

EXIT_CODES = {PASS: 0, FAIL: 2, NOT_EVALUATED: 3}

JOINTS, POSES = "sensor_msgs/msg/JointState", "geometry_msgs/msg/PoseStamped"

TELEMETRY = "fss_arm_msgs/msg/LinkTelemetry"

PIECE = 0.2  # of the horizon that streams may lag each other by: what is read at once

EPILOG = "Exit codes: 0 pass, 1 the command cannot be carried out, 2 fail, 3 not evaluated."


def solve_bag(
    paths: str | PathLike[str] | Iterable[str | PathLike[str]],
    settings: CalibrationSettings | None = None,
) -> Calibration:
    """Find the rests in one or several bags, and calibrate, as the node does on live topics.

    Raises:
        BagError: a bag cannot be read or lacks a topic.
        ValueError: a setting is impossible, or the description is.
        OSError: a file cannot be read.
    """
    settings = settings or CalibrationSettings()
    arm = described(settings.arm)
    finder = RestFinder(arm.n, settings)
    with open_bags(paths) as bags:
        found = newest(observations(bags, finder, settings), settings.kept)
        return calibrate(found, arm, settings, finder.streams(), source(bags))


def source(bags: Bags) -> str:
    """The bags' names with the SHA-256 of each one's data, and what was lost of damaged ones."""
    lost = {
        r.path: f" ({r.messages} messages recovered, {r.lost} bytes lost)" for r in bags.recovered
    }
    return ", ".join(f"{path.name} {digest(path)}{lost.get(path, '')}" for path in bags.paths)


def solve_dynamic_bag(
    paths: str | PathLike[str] | Iterable[str | PathLike[str]],
    settings: DynamicCalibrationSettings | None = None,
) -> tuple[DynamicCalibration, list[Maneuver]]:
    """Find the maneuvers in one or several bags, and calibrate, as the node `dynamic` does.

    Raises:
        BagError: a bag cannot be read or lacks a topic.
        ValueError: a setting is impossible, or the description is.
        OSError: a file cannot be read.
    """
    settings = settings or DynamicCalibrationSettings()
    arm = described(settings.arm)
    finder = ManeuverFinder(arm.n, settings)
    with open_bags(paths) as bags:
        found = newest(maneuvers(bags, finder, settings), settings.kept)
        told = dynamic_verdict.calibrate(found, arm, settings, finder.streams(), source(bags))
        return told, found


def solve_float_bag(
    paths: str | PathLike[str] | Iterable[str | PathLike[str]],
    settings: DriftSettings | None = None,
) -> FloatCalibration:
    """Find the drifts in one or several bags, and what they tell, as the node `float` does.

    Raises:
        BagError: a bag cannot be read or lacks a topic.
        ValueError: a setting is impossible, or the description is.
        OSError: a file cannot be read.
    """
    s = settings or DriftSettings()
    arm = described(s.arm)
    finder, found = DriftFinder(arm.n, s), []
    with open_bags(paths) as bags:
        joints, base = topics(bags, {s.joints_topic: JOINTS, s.base_topic: POSES}, 2)
        for piece in pieces(bags.raw({joints, base}), round(PIECE * s.horizon * SECOND)):
            for data in piece.get(joints, ()):
                found += feed_joints(finder, bags.deserialize(data, JOINTS))
            found += finder.poses(BASE, *poses(piece.get(base, ())))
        found = (found + finder.close())[-s.kept :]
        return drift_verdict.calibrate(found, arm, s, finder.streams(), source(bags))


def topics(bags: Bags, wanted: Mapping[str, str], needed: int) -> list[str]:
    """The names, as in the bags, of topics wanted with their types; the first ones must be there.

    Raises:
        BagError: a topic is missing or of another type.
    """
    names = [f"/{topic.lstrip('/')}" for topic in wanted]
    for k, (name, kind) in enumerate(zip(names, wanted.values(), strict=True)):
        if name in bags.topics and bags.topics[name].msgtype != kind:
            raise BagError(f"{name} is of type {bags.topics[name].msgtype}, expected {kind}")
        if name not in bags.topics and k < needed:
            there = ", ".join(bags.topics) or "no topics"
            raise BagError(f"no {name} in {', '.join(map(str, bags.paths))}, which has {there}")
    return names


def observations(
    bags: Bags, finder: RestFinder, settings: CalibrationSettings
) -> list[Observation]:
    """What the finder makes of the bags' messages.

    Raises:
        BagError: a topic is missing or of another type.
    """
    s = settings
    wanted = {s.joints_topic: JOINTS, s.base_topic: POSES, s.tip_topic: POSES}
    wanted |= {f"link_{i}/telemetry": TELEMETRY for i in range(1, len(finder.joints) + 1)}
    joints, base, tip, *links = topics(bags, wanted, 3)
    found: list[Observation] = []
    span = round(PIECE * s.horizon * SECOND)
    for piece in pieces(bags.raw({joints, base, tip, *links}), span):
        for data in (data for link in links for data in piece.get(link, ())):
            found += feed_telemetry(finder, bags.deserialize(data, TELEMETRY))
        for data in piece.get(joints, ()):
            found += feed_joints(finder, bags.deserialize(data, JOINTS))
        for subject, topic in ((BASE, base), (TIP, tip)):
            found += finder.poses(subject, *poses(piece.get(topic, ())))
    return found + finder.close()


def maneuvers(
    bags: Bags, finder: ManeuverFinder, settings: DynamicCalibrationSettings
) -> list[Maneuver]:
    """What the finder makes of the bags' messages; all but joints and base may be missing.

    Raises:
        BagError: a topic is missing or of another type.
    """
    s = settings
    wanted = {s.joints_topic: JOINTS, s.base_topic: POSES}
    wanted |= {s.gyro_topic: "sensor_msgs/msg/Imu", s.tip_topic: POSES}
    wanted |= {f"link_{i}/telemetry": TELEMETRY for i in range(1, len(finder.joints) + 1)}
    joints, base, gyro, tip, *links = topics(bags, wanted, 2)
    found: list[Maneuver] = []
    span = round(PIECE * s.horizon * SECOND)
    for piece in pieces(bags.raw({joints, base, gyro, tip, *links}), span):
        for data in (data for link in links for data in piece.get(link, ())):
            found += feed_telemetry(finder, bags.deserialize(data, TELEMETRY))
        for data in piece.get(joints, ()):
            found += dynamic_messages.feed_joints(finder, bags.deserialize(data, JOINTS))
        found += finder.rates(*turn_rates(piece.get(gyro, ())))
        found += finder.poses(TIP, *poses(piece.get(tip, ())))
        found += finder.poses(BASE, *poses(piece.get(base, ())))
    return found + finder.close()


def parser(
    kind: type[CalibrationSettings | DynamicCalibrationSettings | DriftSettings] = (
        CalibrationSettings
    ),
) -> argparse.ArgumentParser:
    """The command line: the bags, what to write, and each setting that the node has, too."""
    p = Parser("from_bag", description=__doc__, epilog=EPILOG)
    p.add_argument("bags", nargs="+", metavar="BAG", help="bag, or folder of bags")
    p.add_argument(
        "--dynamic", action="store_true", help="calibrate the dynamics; see --dynamic --help"
    )
    p.add_argument(
        "--float", action="store_true", help="tell tilt, hose and momentum; see --float --help"
    )
    p.add_argument(
        "--output",
        metavar="YAML",
        help="write the calibrated description if it passes; of a float, other nodes' parameters",
    )
    p.add_argument("--report", metavar="DIR", help="write a page to read, and its drawings as PNG")
    p.add_argument(
        "--truth", metavar="YAML", help="description to compare with, in the report only"
    )
    add_settings(p, kind)
    return p


def add_settings(p: argparse.ArgumentParser, kind: type[Any]) -> None:
    """An option for each setting of a dataclass."""
    for f in fields(kind):
        flag, about = f"--{f.name.replace('_', '-')}", meaning(f)
        if isinstance(f.default, bool):
            p.add_argument(flag, action=BooleanOptionalAction, default=f.default, help=about)
            continue
        p.add_argument(
            flag,
            type=type(f.default),
            default=f.default,
            metavar=f.name.split("_")[-1].upper(),
            help=f"{about} (default: {'none' if f.default == '' else f.default})".replace(
                "%", "%%"
            ),
        )


def kind_of(
    *, dynamic: bool, afloat: bool
) -> type[CalibrationSettings | DynamicCalibrationSettings | DriftSettings]:
    """The settings of what is asked for."""
    if afloat:
        return DriftSettings
    return DynamicCalibrationSettings if dynamic else CalibrationSettings


def calibrated(
    options: argparse.Namespace, console: Console
) -> Calibration | DynamicCalibration | FloatCalibration:
    """Solve, show and write what was asked for."""
    kind = kind_of(dynamic=options.dynamic, afloat=options.float)
    truth: Arm | None = load(options.truth) if options.truth else None
    settings = kind(**{f.name: getattr(options, f.name) for f in fields(kind)})
    calibration: Calibration | DynamicCalibration | FloatCalibration
    if isinstance(settings, DriftSettings):
        calibration = solve_float_bag(options.bags, settings)
        told = float_report(calibration)
    elif isinstance(settings, DynamicCalibrationSettings):
        calibration, found = solve_dynamic_bag(options.bags, settings)
        told = dynamic_report(calibration, truth, found)
    else:
        calibration = solve_bag(options.bags, settings)
        told = kinematic_report(calibration, truth)
    console.print(report.printed(told))
    if options.report:
        page = report.write(options.report, told)
        console.print(f"report written to {page}", soft_wrap=True)
    if options.output and calibration.verdict == PASS:
        if isinstance(calibration, FloatCalibration):
            what = "parameters of dynamic and base_reaction"
            write_text(options.output, parameters(calibration))
        else:
            what = "calibrated description"
            save(from_yaml(calibration.description), options.output)
        console.print(f"{what} written to {options.output}", soft_wrap=True)
    elif options.output:
        reason = f"as the verdict is {calibration.verdict}"
        console.print(f"{options.output} not written, {reason}", soft_wrap=True)
    return calibration


def main(args: Sequence[str] | None = None) -> int:
    """Run as `ros2 run fss_arm_calib from_bag`."""
    given = sys.argv[1:] if args is None else args
    kind = kind_of(dynamic="--dynamic" in given, afloat="--float" in given)
    options = parser(kind).parse_args(given)
    try:
        return EXIT_CODES[calibrated(options, report.console()).verdict]
    except (ValueError, OSError) as error:
        print(f"from_bag: {' '.join(str(error).split())}", file=sys.stderr)
        return USER_ERROR


if __name__ == "__main__":
    sys.exit(main())
