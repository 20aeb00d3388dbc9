"""Implementation of the command `map`."""

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from fss_arm_bags.reader import BagError, open_bags
from fss_arm_model.description import paper_arm
from fss_arm_model.description_file import load
from fss_arm_ros.calibrated import TOPICS, Calibrated
from fss_arm_ros.command_line import in_one_line
from fss_arm_ros.libraries import require
from fss_arm_workspace.analysis import Analysis, AnalysisSettings, analyze, straight_workspaces
from fss_arm_workspace.figures import draw, save
from fss_arm_workspace.map_options import parser
from fss_arm_workspace.regions.virtual import base_mass_for
from fss_arm_workspace.straight_path.paths import Paths, arch

PAPER_RADIUS = 1.3  # [m]


def load_arm(sources: Sequence[str]) -> Calibrated:
    """Return the arm given by a description, or by the calibrations in bags.

    Raises:
        BagError: a bag cannot be read, or has no calibration that passed.
        DescriptionError: a description is invalid.
        OSError: a file cannot be read.
    """
    if not sources:
        return Calibrated(paper_arm())
    if len(sources) == 1 and Path(sources[0]).suffix in (".yaml", ".yml"):
        return Calibrated(load(sources[0]))
    calibrated = None
    with open_bags(sources) as bags:
        topics = {t for t, kind in bags.topics.items() if kind.msgtype in TOPICS.values()}
        for topic, _, _, message in bags.messages(topics):
            if message.calibration.verdict == "pass":
                calibrated = (calibrated or Calibrated(paper_arm())).with_message(topic, message)
    if calibrated is None:
        raise BagError(f"{', '.join(sources)}: no calibration that passed")
    return calibrated


def report(analysis: Analysis, straight: Mapping[str, Paths], console: Console) -> None:
    """Print the results, and compare R with the paper's."""
    a = analysis
    hole = -sum(area for area in a.region.areas if area < 0.0)
    console.print(
        f"fixed vehicle workspace: {a.region.area:.4f} m^2 within {len(a.region.arcs)} arcs, "
        f"holes of {hole:.4f} m^2"
    )
    radius = _with_deviation(a.radius, a.radius_deviation)
    console.print(
        f"maximum reachable workspace: R = {radius} m (Eq. 13); within the joint "
        f"limits {a.reach[0]:.4f} to {a.reach[1]:.4f} m from the center of mass"
    )
    try:
        mass = base_mass_for(a.arm, PAPER_RADIUS)
        console.print(
            f"the paper's R = {PAPER_RADIUS} m requires a base of {mass:.2f} kg "
            f"instead of {a.arm.base.mass:g} kg"
        )
    except ValueError as error:
        console.print(f"the paper's R = {PAPER_RADIUS} m: {error}")
    for base, paths in straight.items():
        grazing = int(paths.grazes.sum())
        console.print(
            f"straight-path workspace, {base}: {paths.area:.4f} m^2, {len(paths.distance)} "
            f"directions ({grazing} pass close to a singularity), rule: {paths.redundancy}"
        )
    for name, (w, deviation) in a.largest_w.items():
        console.print(f"largest w, {name} base: up to {_with_deviation(w, deviation)} m^2")


def _with_deviation(value: float, deviation: float) -> str:
    """Format a value with its standard deviation, if that is positive."""
    return f"{value:.4f} ± {deviation:.4f}" if deviation > 0.0 else f"{value:.4f}"


def run(options: argparse.Namespace, console: Console) -> None:
    """Compute, write and report the workspace.

    Raises:
        ValueError: an option or a source is invalid.
        OSError: a file cannot be read or written.
    """
    require("matplotlib")  # checked before minutes of computation
    calibrated = load_arm(options.source)
    settings = AnalysisSettings(
        redundancy=options.rule,
        table_corners=tuple(options.table),
        cell=options.cell,
        of_true_angle=options.true_angle,
        workers=options.workers,
    )
    start = arch(calibrated.arm)
    if options.start:
        if len(options.start) != calibrated.arm.n:
            raise ValueError(
                f"--start has {len(options.start)} angles, expected {calibrated.arm.n}"
            )
        start = np.concatenate([np.zeros(3), np.radians(options.start)])
    folder = Path(options.output)
    folder.mkdir(parents=True, exist_ok=True)
    columns = TextColumn("{task.description:34}"), BarColumn(), TimeElapsedColumn()
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("", total=1.0)

        def progress(what: str, share: float) -> None:
            bar.update(task, description=what, completed=share)

        straight = straight_workspaces(calibrated.arm, start, settings, progress)
        analysis = analyze(calibrated, settings, progress)
        progress("figures", 0.0)
        written = draw(analysis, straight, folder)
        save(analysis, straight, folder / "workspace.npz")
    report(analysis, straight, console)
    names = ", ".join(path.name for path in [*written, folder / "workspace.npz"])
    console.print(f"written to {folder}: {names}", soft_wrap=True)


@in_one_line("map")
def main(args: Sequence[str] | None = None) -> int:
    """Run as `ros2 run fss_arm_workspace map`."""
    run(parser().parse_args(args), Console(soft_wrap=True))
    return 0


if __name__ == "__main__":
    sys.exit(main())
