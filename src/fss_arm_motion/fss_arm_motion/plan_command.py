"""Plan a motion of the arm on its floating base."""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import Field, fields
from pathlib import Path
from typing import Any, get_args, get_type_hints

import numpy as np

from fss_arm_model import layout
from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_model.description_file import described
from fss_arm_model.files import write_text
from fss_arm_model.settings import default_text, meaning
from fss_arm_motion.execution import CHANGES
from fss_arm_motion.figures import draw, title
from fss_arm_motion.kinds import KINDS, Kind
from fss_arm_motion.limits import Limits, LimitSettings
from fss_arm_motion.plan import NOTES, Plan, Start
from fss_arm_motion.plan_file import written
from fss_arm_ros.command_line import Parser, in_one_line
from fss_arm_ros.libraries import require

EPILOG = (
    "Angles are in degrees, all other values in SI units. Exit codes: 0 planned, 1 no plan found."
)


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line, with a sub-command for each kind."""
    p = Parser("plan", description=__doc__, epilog=EPILOG)
    kinds = p.add_subparsers(dest="kind", metavar="KIND", required=True, parser_class=Parser)
    for kind in KINDS.values():
        command = kinds.add_parser(
            kind.name,
            help=kind.about,
            usage=f"plan {kind.name} [OPTION ...]",
            description=kind.about,
            epilog=EPILOG,
        )
        for f in fields(kind.settings):
            add_option(command, f, get_type_hints(kind.settings)[f.name])
        add_common(command)
    return p


def add_common(p: argparse.ArgumentParser) -> None:
    """Add the options of all kinds: initial state, uncertainty of the arm, limits and outputs."""
    p.add_argument(
        "--arm",
        default="paper",
        help="paper, cad, truth (simulator) or a file (default %(default)s)",
    )
    p.add_argument(
        "--q", type=float, nargs="+", metavar="DEG", help="initial joint readings (default all 0)"
    )
    p.add_argument(
        "--pose",
        type=float,
        nargs=3,
        metavar=("X", "Y", "DEG"),
        default=(0.0, 0.0, 0.0),
        help="initial pose of the base in the world (default 0 0 0)",
    )
    p.add_argument(
        "--momentum",
        type=float,
        nargs=3,
        metavar=("PX", "PY", "L"),
        default=(0.0, 0.0, 0.0),
        help="momentum of base and arm, L about their center of mass [N s, N s, N m s] "
        "(default 0 0 0)",
    )
    p.add_argument(
        "--deviation",
        type=float,
        default=0.01,
        metavar="SHARE",
        help="relative 1 sigma of each mass, inertia and center of mass; it gives the 1 sigma of "
        "the base's motion (default %(default)s)",
    )
    for f in fields(LimitSettings):
        add_option(p, f, float)
    p.add_argument("--output", metavar="YAML", help="file for the path")
    p.add_argument("--figure", metavar="PNG", help="file for a figure")


def add_option(p: argparse.ArgumentParser, f: "Field[Any]", hint: Any) -> None:
    """Add an option for a setting; angles are in degrees."""
    flag = f"--{f.name.replace('_', '-')}"
    about = meaning(f).replace("[rad]", "[deg]").replace("%", "%%")
    if in_degrees(f):
        about = about.replace("; -pi to pi", "; -180 to 180")
    if hint is bool:
        p.add_argument(flag, action="store_true", help=about)
        return
    several = bool(get_args(hint))
    default: Any = f.default
    if in_degrees(f) and not several:
        default = float(np.degrees(default))
    p.add_argument(
        flag,
        type=float if several else hint,
        nargs="+" if several else None,
        default=f.default,
        metavar=f.name.split("_")[-1].upper() if hint is str else "N",
        help=about if several else f"{about} (default {default_text(default)})",
        action=_Degrees if in_degrees(f) else "store",
    )


def in_degrees(f: "Field[Any]") -> bool:
    """Return True if the user gives a setting in degrees."""
    return bool(f.metadata["unit"] == "rad")


class _Degrees(argparse.Action):
    """Action that converts one or several angles to radians."""

    def __call__(self, _: Any, options: argparse.Namespace, given: Any, __: Any = None) -> None:
        setattr(options, self.dest, np.radians(given).tolist())


def relative_covariance(arm: Arm, share: float) -> Floats:
    """Return a covariance of Arm.vector() from a relative uncertainty of the mass properties."""
    p = arm.vector()
    sigma = np.zeros_like(p)
    index = np.arange(1, arm.n + 1) * layout.LINK_SIZE
    for number in (layout.LINK_MASS, layout.LINK_INERTIA, layout.G):
        sigma[index + number] = share * np.abs(p[index + number])
    sigma[[layout.MASS, layout.INERTIA]] = share * p[[layout.MASS, layout.INERTIA]]
    return np.diag(sigma**2)


def plan_motion(options: argparse.Namespace) -> tuple[Start, Plan]:
    """Plan the motion of a command line.

    Raises:
        ValueError: there is no such plan, or an option is impossible.
        OSError: the description cannot be read.
    """
    arm = described(options.arm)
    limits = Limits.of(
        arm, LimitSettings(**{f.name: getattr(options, f.name) for f in fields(LimitSettings)})
    )
    pose = np.array([*options.pose[:2], np.radians(options.pose[2])])
    start = Start(
        arm,
        np.radians(options.q if options.q else np.zeros(arm.n)),
        pose,
        np.array(options.momentum),
        limits,
        relative_covariance(arm, options.deviation),
    )
    kind, settings = request_of(options)
    return start, kind.plan(start, settings)


def request_of(options: argparse.Namespace) -> tuple[Kind, Any]:
    """Return the kind of plan that a command line requests, and its settings."""
    kind = KINDS[options.kind]
    given = {f.name: getattr(options, f.name) for f in fields(kind.settings)}
    values = {name: tuple(v) if isinstance(v, list) else v for name, v in given.items()}
    return kind, kind.settings(**values)


def report(plan: Plan, share: float) -> str:
    """Return the report of a plan for the user.

    Args:
        plan: the plan.
        share: of the drives' limits that it may use.
    """
    base = plan.prediction
    changes = zip(CHANGES, base.pose[-1] - base.pose[0], base.deviation[-1], strict=True)
    change = ", ".join(
        f"{name} {round(factor * x, digits) + 0.0:.{digits}f} ± {factor * sigma:.{digits}f} {unit}"
        for (name, unit, factor, digits), x, sigma in changes
    )
    friction = ", less friction" if plan.bound.startswith("torque") else ""
    lines = [
        title(plan).replace("°", " deg"),
        f"closest to a limit: {plan.bound} ({100 * share:g} % of the drive's{friction})",
        f"change of the base (± 1 sigma): {change}",
        f"arm at the end: {np.degrees(plan.q[-1]).round(2).tolist()} deg",
    ]
    lines += [note(name, value) for name, value in plan.notes.items()]
    return "\n".join(lines)


def note(name: str, value: float) -> str:
    """Return an additional result of a kind; angles in degrees."""
    about, unit = NOTES[name]
    if unit == "rad":
        value, unit = float(np.degrees(value)), "deg"
    return f"{about}: {value:.3g} {unit}".rstrip()


@in_one_line("plan")
def main(args: Sequence[str] | None = None) -> int:
    """Run as `ros2 run fss_arm_motion plan`."""
    options = parser().parse_args(args)
    if options.figure:
        require("matplotlib")
    start, plan = plan_motion(options)
    lines = [report(plan, options.share)]
    if options.output:
        write_text(options.output, written(start, plan))
        lines.append(f"path written to {options.output}")
    if options.figure:
        Path(options.figure).parent.mkdir(parents=True, exist_ok=True)
        draw(start, plan, options.figure)
        lines.append(f"figure written to {options.figure}")
    print("\n".join(lines))
    return 0


if __name__ == "__main__":
    sys.exit(main())
