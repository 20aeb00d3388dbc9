"""Overhead of campaigns: against a plain loop, and with 32 workers.

    . scripts/env.sh; python bench/bench_campaign.py [--runs 8]

First the same captures in a plain loop, on one worker and on two: runs per minute. Loop and one
worker take turns after each run; the overhead is the median of the ratios of their times.
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
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
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


def plain_time(campaign, run, loop):
    """Return the time of a run in another process [s]."""
    start, folder = time.perf_counter(), campaign.file.parent
    place, values = campaign.function, dict(run.values)
    loop.submit(perform, place, folder, run.number, run.seed, values).result()
    return time.perf_counter() - start


def executed_time(campaign, runs, client, folder):
    """Return the time of the runs on a client's workers [s]."""
    start = time.perf_counter()
    results = Results(folder / "runs.parquet")
    execute(campaign, runs, client, results, Console(file=io.StringIO()))
    results.write()
    assert len(results.rows) == len(runs)
    return time.perf_counter() - start


def compare(count, folder):
    """Print the rates of captures; return the overhead of one worker and the time of each run.

    Loop and worker take turns after each run, so that the load of the computer affects both.
    """
    campaign = read_campaign(CAPTURES)
    runs, plain, worked = campaign.in_random_order()[:count], [], []
    with ProcessPoolExecutor(1, get_context("spawn")) as loop, open_client("", 1) as client:
        plain_time(campaign, runs[0], loop)  # kernels are loaded
        executed_time(campaign, runs[:1], client, folder)
        for run in REPETITIONS * runs:
            plain.append(plain_time(campaign, run, loop))
            worked.append(executed_time(campaign, [run], client, folder))
    with open_client("", 2) as client:
        executed_time(campaign, runs[:2], client, folder)
        both = executed_time(campaign, runs, client, folder)
    rates = {
        "plain loop": 60.0 / np.mean(plain),
        "1 worker": 60.0 / np.mean(worked),
        "2 workers": 60.0 * count / both,
    }
    for name, rate in rates.items():
        print(f"{name:>12}  {rate:6.1f} captures/min")
    return float(np.median(np.divide(worked, plain))) - 1.0, plain


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
