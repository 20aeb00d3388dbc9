"""Success rate of the capture: `python bench/bench_capture.py [--runs 280]`.

Flies missions without ROS (test/support/capturing.py): plant, default sensor errors, navigation,
control and guidance. The grid varies the target's spin and heading, the distance of the base and
the seed, which also draws the target's drift. With --faults, a fault occurs in each phase. With
--ghosts, bodies pass through each other. With --closing, --force and --torque, the fingers need
time to close and can slip. Each run is a line of JSON in --out; the table summarizes all runs;
--draw shows the first failed ones.
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

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "test/support"))

from capturing import Case, Flight

from fss_arm_model.kinematics import joint_positions, tip_pose
from fss_sim.plant.target import Gripper

SPINS = (-0.3, -0.15, -0.05, 0.0, 0.05, 0.15, 0.3)  # [rad/s]
HEADINGS = 8
SEEDS = range(1, 6)
DISTANCES = (1.4, 1.6, 1.8)  # [m]
PHASES = ("approach", "reach", "grip", "detumble")
FAULT_TIMES = 0.1, 0.8  # of a fault after the start of its phase [s]
FAULTS = (
    *((fault, 0.0) for fault in ("link", "gripper", "open", "closed", "gyro")),
    *(("outage", duration) for duration in (10.0, 3.0, 1.0)),
)


def grid() -> Iterator[Case]:
    """Yield the missions in random order, so that any number of them covers the grid."""
    rows = list(product(SPINS, range(HEADINGS), SEEDS))
    for k in np.random.default_rng(0).permutation(len(rows)):
        spin, eighth, seed = rows[k]
        drift = tuple(np.random.default_rng(seed).uniform(-0.008, 0.008, 2).tolist())
        heading = 2.0 * np.pi * eighth / HEADINGS
        yield Case(spin, heading, DISTANCES[(eighth + seed) % len(DISTANCES)], seed, drift)


def failures() -> Iterator[Case]:
    """Yield missions with a fault at the start of a phase, or within it."""
    for seed, (fault, duration), phase, after in product((1, 2, 3), FAULTS, PHASES, FAULT_TIMES):
        case = Case((-0.1, 0.1, 0.2)[seed - 1], float(seed), 1.6, seed)
        valve = (2, 5, 7)[seed - 1] if after == FAULT_TIMES[0] else 2
        yield replace(case, fault=fault, phase=phase, lasts=duration, after=after, valve=valve)


def fly(case: Case) -> dict[str, Any]:
    """Fly one mission; return its result."""
    start = time.process_time()
    flown = Flight(case).fly()
    flown.wall = time.process_time() - start
    return asdict(flown)


def draw(cases: list[Case], path: Path) -> None:
    """Fly missions again, and draw the end of each."""
    figure, panels = plt.subplots(1, len(cases), figsize=(4.2 * len(cases), 4.6), squeeze=False)
    for case, ax in zip(cases, panels[0], strict=True):
        flight = Flight(case)
        flown = flight.fly()
        p, film = flight.arm.vector(), flight.film
        first = next((t for t, *_ in film if t >= flight.last_near - 4.0), 0.0)
        shown = [frame for frame in film if frame[0] >= first][:100]
        for k, (_, q, target) in enumerate(shown[:: max(1, len(shown) // 8)]):
            shade = {"alpha": 0.15 + 0.1 * k, "lw": 1.2}
            joints = np.vstack([joint_positions(p, q), tip_pose(p, q)[:2]])
            ax.plot(*joints.T, "o-", color="tab:blue", ms=2, **shade)
            ax.add_patch(plt.Circle(q[:2], 0.19, fill=False, ec="tab:blue", **shade))
            ax.add_patch(plt.Circle(target[:2], 0.19, fill=False, ec="tab:orange", **shade))
            x, y = target[:2] + 0.19 * np.array([np.cos(target[2]), np.sin(target[2])])
            ax.plot(x, y, "s", color="tab:red", ms=3, alpha=shade["alpha"])
        outcome = flown.contact or flown.message or "lost"
        ax.set_title(
            f"spin {case.spin} rad/s: {outcome}\n{shown[0][0]:.1f} to {shown[-1][0]:.1f} s", size=8
        )
        ax.set_aspect("equal")
        ax.set_xlabel("x [m]")
    panels[0][0].set_ylabel("y [m]")
    figure.tight_layout()
    figure.savefig(path, dpi=90)


HEAD = "spin [rad/s]", "runs", "captured and stopped", "time [s]", "propellant [g]", "torque [N m]"


def report(rows: list[dict[str, Any]]) -> None:
    """Print the table, and each run that failed or had a contact."""
    pace = sum(r["time"] for r in rows) / sum(r["wall"] for r in rows)
    print(f"{len(rows)} runs at {pace:.0f} times real time")
    print("| " + " | ".join((*HEAD, "contacts")) + " |")
    print("|" + 7 * "---:|")
    for spin in sorted({abs(r["case"]["spin"]) for r in rows}):
        group = [r for r in rows if abs(r["case"]["spin"]) == spin]
        good = [r for r in group if r["captured"] and r["well"]]
        cells = [f"{spin:.2f}", str(len(group)), f"{100.0 * len(good) / len(group):.0f} %"]
        for name, scale in (("time", 1.0), ("propellant", 1e3)):
            values = [scale * r[name] for r in good] or [np.nan]
            cells.append(f"{np.median(values):.0f} (to {max(values):.0f})")
        cells.append(f"{max((r['torque'] for r in good), default=np.nan):.2f}")
        cells.append(str(sum(bool(r["contact"]) for r in group)))
        print("| " + " | ".join(cells) + " |")
    for r in rows:
        if not (r["captured"] and r["well"]) or r["contact"]:
            print(r["case"])
            print(f"  {r['phases']} {r['message']}; contact: {r['contact'] or 'none'}")


def main() -> None:
    """Fly the missions and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=280)
    parser.add_argument("--faults", action="store_true")
    parser.add_argument("--ghosts", action="store_true")
    parser.add_argument("--closing", type=float, default=0.0, help="closing time of the grip [s]")
    parser.add_argument("--force", type=float, default=0.0, help="largest grip force [N]")
    parser.add_argument("--torque", type=float, default=0.0, help="largest grip torque [N m]")
    parser.add_argument("--draw", type=Path, help="file for a picture of three failed runs")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("out/capture.jsonl"))
    options = parser.parse_args()
    cases = list(failures() if options.faults else grid())[: options.runs]
    fingers = {"closing_time": options.closing, "force": options.force, "torque": options.torque}
    gripper = Gripper(**fingers)
    cases = [replace(case, solid=not options.ghosts, gripper=gripper) for case in cases]
    options.out.parent.mkdir(parents=True, exist_ok=True)
    rows = []
    with ProcessPoolExecutor(options.processes) as pool, options.out.open("w") as file:
        for row in pool.map(fly, cases):
            rows.append(row)
            print(json.dumps(row), file=file, flush=True)
    report(rows)
    if options.draw:
        failed = [c for c, r in zip(cases, rows, strict=True) if not (r["captured"] and r["well"])]
        draw(failed[:3], options.draw)


if __name__ == "__main__":
    main()
