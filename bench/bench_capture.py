"""How often a capture succeeds: `python bench/bench_capture.py [--reach predictive] [--runs 280]`.

Flies missions in the pure loop of test/support/capturing.py: the plant with the default errors of
the sensors, navigation, control and guidance, over a grid of the target's spin and heading, of the
base's distance and of seeds, which also draw the target's drift. With --faults, missions in which
something fails in each phase; with --ghosts, bodies pass through each other. Each run is a line of
JSON in --out; the table is of all of them.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import json
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "test/support"))

from capturing import SETTINGS, Case, Flight

SPINS = (-0.3, -0.15, -0.05, 0.0, 0.05, 0.15, 0.3)  # [rad/s]
HEADINGS = 8
SEEDS = range(1, 6)
DISTANCES = (1.4, 1.6, 1.8)  # [m]
PHASES = ("approach", "reach", "grip", "detumble")
FAULTS = (
    *((fault, 0.0) for fault in ("link", "open", "closed", "gyro")),
    *(("outage", lasts) for lasts in (10.0, 3.0, 1.0)),
)


def grid() -> Iterator[Case]:
    """The missions, in an order of chance, so that any number of them shows the whole."""
    rows = list(product(SPINS, range(HEADINGS), SEEDS))
    for k in np.random.default_rng(0).permutation(len(rows)):
        spin, eighth, seed = rows[k]
        drift = tuple(np.random.default_rng(seed).uniform(-0.008, 0.008, 2).tolist())
        heading = 2.0 * np.pi * eighth / HEADINGS
        yield Case(spin, heading, DISTANCES[(eighth + seed) % len(DISTANCES)], seed, drift)


def failures() -> Iterator[Case]:
    """Missions in which something fails."""
    for seed, (fault, lasts), phase in product((1, 2, 3), FAULTS, PHASES):
        spin = (-0.1, 0.1, 0.2)[seed - 1]
        yield Case(spin, float(seed), 1.6, seed, fault=fault, phase=phase, lasts=lasts)


def fly(case: Case, reach: str) -> dict[str, Any]:
    """One of them."""
    begin = time.process_time()
    flown = Flight(case, settings=replace(SETTINGS, reach=reach)).fly()
    flown.wall = time.process_time() - begin
    return {**asdict(flown), "reach": reach}


HEAD = "spin [rad/s]", "runs", "captured and stopped", "time [s]", "propellant [g]", "torque [N m]"


def report(rows: list[dict[str, Any]]) -> None:
    """The table, and what else happened."""
    pace = sum(r["time"] for r in rows) / sum(r["wall"] for r in rows)
    print(f"{len(rows)} runs, {pace:.0f} times real time")
    print("| " + " | ".join((*HEAD, "contacts")) + " |")
    print("|" + 7 * "---:|")
    for spin in sorted({abs(r["case"]["spin"]) for r in rows}):
        some = [r for r in rows if abs(r["case"]["spin"]) == spin]
        good = [r for r in some if r["captured"] and r["well"]]
        cells = [f"{spin:.2f}", str(len(some)), f"{100.0 * len(good) / len(some):.0f} %"]
        for name, scale in (("time", 1.0), ("propellant", 1e3)):
            values = [scale * r[name] for r in good] or [np.nan]
            cells.append(f"{np.median(values):.0f} (to {max(values):.0f})")
        cells.append(f"{max((r['torque'] for r in good), default=np.nan):.2f}")
        cells.append(str(sum(bool(r["contact"]) for r in some)))
        print("| " + " | ".join(cells) + " |")
    for r in rows:
        if not (r["captured"] and r["well"]) or r["contact"]:
            print(r["case"])
            print(f"  {r['phases']} {r['message']}; contact: {r['contact'] or 'none'}")


def main() -> None:
    """Fly, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--reach", default="jacobian")
    parser.add_argument("--runs", type=int, default=280)
    parser.add_argument("--faults", action="store_true")
    parser.add_argument("--ghosts", action="store_true")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("out/capture.jsonl"))
    options = parser.parse_args()
    cases = list(failures() if options.faults else grid())[: options.runs]
    cases = [replace(case, solid=not options.ghosts) for case in cases]
    options.out.parent.mkdir(parents=True, exist_ok=True)
    rows = []
    with ProcessPoolExecutor(options.processes) as pool, options.out.open("w") as file:
        for row in pool.map(fly, cases, [options.reach] * len(cases)):
            rows.append(row)
            print(json.dumps(row), file=file, flush=True)
    report(rows)


if __name__ == "__main__":
    main()
