"""Make the public data set: bags of calibration experiments on simulated arms, with their truth.

DIR receives the data set, DIR_blind_truth what is not published: the true arms of the blind part,
with the seed of their experiments. Takes about half an hour on two cores.
"""

import argparse
import os
import secrets
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from fss_arm_model.description_file import save
from fss_arm_ros.command_line import Parser, in_one_line
from fss_arm_ros.report import console
from fss_arm_ros.source_version import source_version
from fss_rehearsal.dataset.arms import BLIND, LINKS, ArmPair, draw_pair
from fss_rehearsal.dataset.bags import KINDS, USED_PRESETS, plan, record
from fss_rehearsal.dataset.results import Estimates, evaluate, results_table
from fss_rehearsal.dataset.sheet import (
    BLIND_CHECKSUMS,
    write_checksums,
    write_presets,
    write_sheet,
)
from fss_rehearsal.progress import counting_bar


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    found = Parser("dataset.sh", description=__doc__)
    found.add_argument("folder", type=Path, metavar="DIR", help="new folder of the data set")
    found.add_argument(
        "--seed", type=int, default=1, help="seed of the part that is not blind (default 1)"
    )
    return found


def blind_folder(folder: Path) -> Path:
    """Return the folder beside a data set for what is not published."""
    return folder.with_name(f"{folder.name}_blind_truth")


def make_plans(pair: ArmPair, seed: int) -> dict[str, Any]:
    """Return the plan of each kind of experiment with an arm."""
    return {kind: plan(kind, pair.described, seed) for kind in KINDS}


def make_part(
    folder: Path, pair: ArmPair, plans: Mapping[str, Any], name: str, preset: str, seed: int
) -> list[Estimates]:
    """Record the bags of an arm with a preset, and calibrate from them."""
    bags = folder / "bags" / name / preset
    bags.mkdir(parents=True)
    for k, kind in enumerate(KINDS):
        record(bags / kind, kind, preset, pair, plans[kind], seed + k)
    return evaluate(bags, folder / "arms" / f"{name}.yaml", preset, pair)


def make(folder: Path, seed: int) -> list[Estimates]:
    """Make all arms and bags; return the estimates in the order of kinds and presets."""
    blind = blind_folder(folder)
    blind_seed = secrets.randbits(128)  # the hash of an arm from few seeds could be tried out
    for one in (folder / "arms", folder / "truth", blind):
        one.mkdir(parents=True)
    (blind / "seed").write_text(f"{blind_seed}\n")
    seeds = {name: blind_seed if name in BLIND else seed for name in LINKS}
    pairs = {name: draw_pair(name, seeds[name]) for name in LINKS}
    for name, pair in pairs.items():
        save(pair.described, folder / "arms" / f"{name}.yaml")
        save(pair.truth, (blind if name in BLIND else folder / "truth") / f"{name}.yaml")
    write_checksums(folder / BLIND_CHECKSUMS, blind, sorted(blind.glob("*.yaml")))
    write_presets(folder)
    found: dict[tuple[str, str], list[Estimates]] = {}
    workers = ProcessPoolExecutor(os.cpu_count(), get_context("spawn"))
    with counting_bar(console()) as bar, workers:
        planning = bar.add_task("arms planned", total=len(LINKS))
        waiting = {n: workers.submit(make_plans, pairs[n], seeds[n]) for n in reversed(LINKS)}
        plans = {}  # all of them first: an arm without room for its maneuvers ends this at once
        for name, plan_future in waiting.items():
            plans[name] = plan_future.result()
            bar.advance(planning)
        parts = [(name, preset) for preset in USED_PRESETS for name in reversed(LINKS)]
        task = bar.add_task("arms with a preset", total=len(parts))
        futures = {
            workers.submit(
                make_part,
                folder,
                pairs[name],
                plans[name],
                name,
                preset,
                100 * seeds[name] + 10 * k,
            ): (name, preset)
            for k, (name, preset) in enumerate(parts)
        }
        for future in as_completed(futures):
            found[futures[future]] = future.result()
            bar.advance(task)
    ordered = [one for part in parts for one in found[part]]
    return sorted(ordered, key=lambda one: KINDS.index(one.kind))


@in_one_line("dataset.sh")
def main(args: Sequence[str] | None = None) -> int:
    """Run as `scripts/dataset.sh`."""
    options = parser().parse_args(args)
    for folder in (options.folder, blind_folder(options.folder)):
        if folder.exists():
            raise FileExistsError(f"{folder} exists, give a new folder")
    rows = results_table(make(options.folder, options.seed))
    write_sheet(options.folder, source_version(), options.seed, rows)
    console().print(f"data set and its sheet: {options.folder / 'README.md'}", soft_wrap=True)
    return 0
