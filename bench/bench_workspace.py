"""Time of the workspace maps, compared with sampling in numpy: `python bench/bench_workspace.py`.

One core unless stated otherwise, after the kernels are compiled. Wall and processor times are
medians of three runs. A numpy warning is an error.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from statistics import median
from typing import Any

import numpy as np

from fss_arm_model.description import Arm, paper_arm
from fss_arm_workspace.manipulability.map import Map, manipulability_map
from fss_arm_workspace.manipulability.measure import FIXED, FLOATING
from fss_arm_workspace.regions.fixed import fixed_workspace, joint_limits
from fss_arm_workspace.regions.grid import Grid
from fss_arm_workspace.straight_path.paths import Rules, arch, straight_paths

CELL = 0.01  # [m]
RUNS = 3


def measure(work: Callable[[], Any]) -> tuple[float, float, Any]:
    """Return wall time [s], processor time [s], and the result of `work`."""
    times, processor, result = [], [], None
    for _ in range(RUNS):
        start = time.perf_counter(), time.process_time()
        result = work()
        times.append(time.perf_counter() - start[0])
        processor.append(time.process_time() - start[1])
    return median(times), median(processor), result


def sampled_map(arm: Arm, grid: Grid, count: int, seed: int = 0) -> np.ndarray:
    """Return the largest w of random postures in each cell, in plain numpy, for a fixed base."""
    rng, best = np.random.default_rng(seed), np.full(grid.width * grid.height, np.nan)
    a = np.array([link.a for link in arm.links])
    offset = np.array([arm.base.mount[2], *(link.theta_0 for link in arm.links[1:])])
    low, high = joint_limits(arm).T
    for _ in range(max(1, count // 500_000)):
        q = rng.uniform(low, high, (min(count, 500_000), arm.n))
        heading = np.cumsum(q + offset, axis=1)
        reach = np.cumsum((a * np.exp(1j * heading))[:, ::-1], axis=1)[:, ::-1]
        tip = complex(*arm.base.mount[:2]) + reach[:, 0]
        J = np.stack([-reach.imag, reach.real], axis=1)
        w = np.sqrt(np.linalg.det(J @ J.transpose(0, 2, 1)).clip(0.0))
        column = ((tip.real - grid.x) / grid.cell).astype(int)
        row = ((tip.imag - grid.y) / grid.cell).astype(int)
        np.fmax.at(best, row * grid.width + column, w)
    return best.reshape(grid.height, grid.width)


def main() -> None:
    warnings.simplefilter("error")
    arm = paper_arm()
    manipulability_map(arm, FIXED, cell=0.1)
    boundary, _, region = measure(lambda: fixed_workspace(arm))
    print(f"boundary in {len(region.arcs)} exact arcs: {1e3 * boundary:.1f} ms")
    maps: dict[str, Map] = {}
    for name, kind in (("fixed", FIXED), ("floating", FLOATING)):
        for workers in (1, 2, 4):
            elapsed, processor, maps[name] = measure(
                partial(manipulability_map, arm, kind, cell=CELL, workers=workers)
            )
            cells = int(np.isfinite(maps[name].w).sum())
            print(
                f"{name} base, best of all postures, {cells} cells of 1 cm, {workers} threads: "
                f"{elapsed:.2f} s, processor time {processor:.2f} s, "
                f"{1e6 * processor / cells:.1f} us per cell"
            )
    for n in (6, 8):
        longer = replace(arm, links=(arm.links * 2)[:n])
        for name, kind in (("fixed", FIXED), ("floating", FLOATING)):
            start = time.process_time()
            cells = int(np.isfinite(manipulability_map(longer, kind, cell=CELL).w).sum())
            processor = time.process_time() - start
            print(
                f"{n} links, {name} base, {cells} cells of 1 cm: processor time "
                f"{processor:.1f} s, {1e6 * processor / cells:.1f} us per cell"
            )
    fixed = maps["fixed"]
    for count in (500_000, 4_000_000, 16_000_000):
        start = time.perf_counter()
        error = np.abs(sampled_map(arm, fixed.grid, count) - fixed.w)
        elapsed = time.perf_counter() - start
        empty = np.isnan(error[np.isfinite(fixed.w)]).mean()
        print(
            f"numpy, fixed base, {count} random postures: {elapsed:.1f} s, "
            f"error of w: median {np.nanmedian(error):.4f}, "
            f"95 % {np.nanquantile(error, 0.95):.4f}, largest {np.nanmax(error):.3f} m^2; "
            f"{100 * empty:.1f} % of the cells empty"
        )
    print(
        "(our maps: within 1e-4 m^2 of exhaustive search, test/pure/workspace/test_manipulability)"
    )
    directions = np.linspace(0.0, 2.0 * np.pi, 361)[:-1]
    for base in ("fixed", "floating"):
        elapsed, processor, paths = measure(
            partial(straight_paths, arm, arch(arm), directions, Rules(base=base))
        )
        print(
            f"straight paths, {base} base, 360 directions, rule {Rules.redundancy}: "
            f"{elapsed:.2f} s, "
            f"processor time {processor:.2f} s; area {paths.area:.3f} m^2"
        )


if __name__ == "__main__":
    main()
