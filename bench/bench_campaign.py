"""Overhead of campaigns: against a plain loop, and with 32 workers.

    . scripts/env.sh; python bench/bench_campaign.py [--runs 8]

First the same captures in a plain loop, on one worker and on two, interleaved: runs per minute.
Then a simulated cluster: 32 workers in this process whose runs only sleep, as long as the captures
took, scaled to 2 s on average; its efficiency is the time slept divided by that of all workers.
Last, the rate of runs that take no time: the limit of scheduler and results, for any number of
workers. Exits with 1 if one worker takes over 5 % longer than the plain loop.
"""

import argparse
import io
import os
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import dask
import numpy as np
from distributed import Client, LocalCluster
from rich.console import Console

from fss_rehearsal.campaign.execute import DASK, execute, open_client
from fss_rehearsal.campaign.function import perform
from fss_rehearsal.campaign.plan import read_campaign
from fss_rehearsal.campaign.results import Results

CAPTURES = Path(__file__).parents[1] / "config/campaigns/captures.yaml"
MAX_OVERHEAD = 0.05
REPETITIONS = 3
WORKERS, MEAN_SLEEP, RUNS_EACH = 32, 2.0, 10  # of the simulated cluster; [s]
EMPTY_RUNS = 500
STUDY = """
import time

def sleep(seed, duration: float):
    time.sleep(duration)
    return {}
"""


def plain_time(campaign, runs):
    """Return the time of the runs in a loop in this process [s], and of each run."""
    start = time.perf_counter()
    folder = campaign.file.parent
    rows = [perform(campaign.function, folder, r.number, r.seed, r.values) for r in runs]
    return time.perf_counter() - start, [row["wall_time"] for row in rows]


def executed_time(campaign, runs, client, folder):
    """Return the time of the runs on a client's workers [s]."""
    start = time.perf_counter()
    quiet = Console(file=io.StringIO())
    results = Results(folder / "runs.parquet")
    execute(campaign, runs, client, results, quiet)
    results.write()
    assert len(results.rows) == len(runs)
    return time.perf_counter() - start


def compare(count, folder):
    """Print the rates of captures; return the overhead of one worker and the time of each run."""
    campaign = read_campaign(CAPTURES)
    runs, times = campaign.in_random_order()[:count], {"plain loop": []}
    durations = plain_time(campaign, runs[:1])[1]  # kernels are loaded
    for workers in (1, 2):
        times[f"{workers} worker{'s' * (workers > 1)}"] = []
    for _ in range(REPETITIONS):
        elapsed, durations = plain_time(campaign, runs)
        times["plain loop"].append(elapsed)
        for workers, name in zip((1, 2), list(times)[1:], strict=True):
            with open_client("", workers) as client:
                executed_time(campaign, runs[:workers], client, folder)  # workers are warm
                times[name].append(executed_time(campaign, runs, client, folder))
    for name, elapsed in times.items():
        print(f"{name:>12}  {60.0 * count / np.median(elapsed):6.1f} captures/min")
    ratio = np.median(np.array(times["1 worker"]) / np.array(times["plain loop"]))
    return float(ratio) - 1.0, durations


def simulate_cluster(durations, folder):
    """Print the efficiency of many workers, and the rate of empty runs."""
    (folder / "sleep_study.py").write_text(STUDY)
    sleeps = np.resize(durations, WORKERS * RUNS_EACH)
    sleeps *= MEAN_SLEEP / sleeps.mean()
    for name, values in (("sleeping", sleeps), ("empty", np.zeros(EMPTY_RUNS))):
        file = folder / f"{name}.yaml"
        file.write_text(f"run: sleep_study:sleep\ngrid: {{duration: {values.tolist()}}}\n")
        campaign = read_campaign(file)
        with (
            dask.config.set(DASK),
            LocalCluster(
                n_workers=WORKERS,
                threads_per_worker=1,
                processes=False,
                dashboard_address=None,
                silence_logs=50,
            ) as cluster,
            Client(cluster) as client,
        ):
            elapsed = executed_time(campaign, campaign.runs, client, folder)
        if values.any():
            share = values.sum() / (WORKERS * elapsed)
            print(
                f"{WORKERS} workers, {len(values)} runs of {MEAN_SLEEP:g} s: {share:.1%} efficient"
            )
        else:
            print(f"{len(values)} empty runs: {len(values) / elapsed:.0f} runs/s")


def main():
    """Print all figures; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=8, help="captures")
    options = parser.parse_args()
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    with TemporaryDirectory() as folder:
        overhead, durations = compare(options.runs, Path(folder))
        print(f"overhead of one worker: {overhead:.1%} (at most {MAX_OVERHEAD:.0%})")
        simulate_cluster(durations, Path(folder))
    return int(overhead > MAX_OVERHEAD)


if __name__ == "__main__":
    sys.exit(main())
