"""Execute the runs of a campaign by Dask, on this computer or on a cluster."""

import asyncio
import logging
from collections.abc import Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from fss_arm_ros.source_version import UNKNOWN, source_version
from fss_rehearsal.campaign.function import CRASHED, SUCCESS, Row, perform
from fss_rehearsal.campaign.plan import Campaign, CampaignError, Run
from fss_rehearsal.campaign.results import Results, expected_columns

if TYPE_CHECKING:
    from distributed import Client

CONNECTION_TIMEOUT = 30  # for the scheduler, and for its first worker [s]
# A worker holds one run at a time, so that a run that kills its worker affects no other run.
DASK = {
    "distributed.scheduler.worker-saturation": 1.0,
    "distributed.scheduler.allowed-failures": 2,
    "distributed.worker.daemon": False,  # a run may start processes
    # Monitors share Python's lock with the run, which they interrupt up to 100 times a second.
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "10s",
    "distributed.worker.memory.monitor-interval": "1s",
}


@contextmanager
def open_client(scheduler: str, workers: int) -> "Iterator[Client]":
    """Yield a client of a scheduler, or of a cluster on this computer if its address is empty.

    Raises:
        CampaignError: there is no scheduler or no worker, or a worker has another commit.
    """
    import dask
    from distributed import Client, LocalCluster

    for name in "distributed", "distributed.client":  # what matters is in the rows
        logging.getLogger(name).setLevel(logging.CRITICAL)
    with dask.config.set(DASK):
        if scheduler:
            try:
                client = Client(scheduler, timeout=CONNECTION_TIMEOUT)
            except (OSError, ValueError) as error:
                raise CampaignError(f"no scheduler at {scheduler}: {error}") from None
            with client:
                check_workers(client, scheduler)
                yield client
            return
        cluster = LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            dashboard_address="127.0.0.1:0",  # any port: another campaign may run
            silence_logs=50,
        )
        with cluster, Client(cluster) as client:
            yield client


def check_workers(client: "Client", scheduler: str) -> None:
    """Check the commit of each worker.

    Raises:
        CampaignError: there is no worker, or one has another commit, which the message names.
    """
    try:
        client.wait_for_workers(1, timeout=CONNECTION_TIMEOUT)
    except TimeoutError:
        hint = f"start one: dask worker {scheduler} --nthreads 1"
        raise CampaignError(f"{scheduler} has no worker; {hint}") from None
    if source_version() == UNKNOWN:
        raise CampaignError("the commit here is unknown; start the campaign in a git checkout")
    commits = client.run(source_version, on_error="return")
    for address, commit in commits.items():
        if isinstance(commit, BaseException):
            commit = f"unknown ({type(commit).__name__}: {commit})"
        check_commit(
            client.scheduler_info()["workers"].get(address, {}).get("name"), address, commit
        )


def check_commit(name: Any, address: str, commit: str) -> None:
    """Raise CampaignError if a worker's commit is not that of this computer."""
    if commit != source_version():
        raise CampaignError(
            f"worker {name} at {address} has commit {commit}, expected {source_version()}; "
            "update its workspace and restart it"
        )


def execute(
    campaign: Campaign, runs: Sequence[Run], client: "Client", results: Results, console: Console
) -> None:
    """Execute runs; add each row to the results as its run finishes.

    Raises:
        CampaignError: the scheduler is lost, or a worker with another commit joined.
    """
    from distributed import as_completed

    by_key = {f"run-{run.number}": run for run in runs}
    folder = campaign.file.parent.absolute()
    futures = [
        client.submit(
            perform_on_worker,
            campaign.function,
            folder,
            run.number,
            run.seed,
            dict(run.values),
            key=key,
            pure=False,
        )
        for key, run in by_key.items()
    ]
    failures, crashes = 0, 0
    with _progress(console) as progress:
        task = progress.add_task("", total=len(futures), rate="", failures="")
        for future in as_completed(futures):
            row = finished_row(future, campaign, by_key[future.key])
            future.release()
            results.add(row)
            failures += row["outcome"] != SUCCESS
            crashes += row["outcome"] == CRASHED
            speed = progress.tasks[0].speed
            rate = f"{60.0 * speed:.3g} runs/min" if speed else ""
            text = f"failed {failures}, of these crashed {crashes}" if failures else "failed 0"
            progress.update(task, advance=1, rate=rate, failures=text)


def perform_on_worker(*arguments: Any) -> Row:
    """Perform a run in a worker; add the worker's name and address to the row."""
    from distributed import get_worker

    worker = get_worker()
    return perform(*arguments) | {"worker": f"{worker.name} at {worker.address}"}


def finished_row(future: Any, campaign: Campaign, run: Run) -> Row:
    """Return the row of a finished run.

    Raises:
        CampaignError: the scheduler was lost, or the worker has another commit.
    """
    from distributed import KilledWorker

    columns = expected_columns(run)
    try:
        row = columns | future.result()
    except KilledWorker:
        reason = "the worker's process ended, also when the run was repeated"
        lost = {"function": campaign.function, "outcome": CRASHED, "reason": reason}
        return columns | lost | {"commit": source_version(), "worker": "", "wall_time": 0.0}
    except (CancelledError, asyncio.CancelledError, OSError):
        raise CampaignError("lost the scheduler; continue with --resume") from None
    name, _, address = row["worker"].partition(" at ")
    check_commit(name, address, row["commit"])
    return row


def _progress(console: Console) -> Progress:
    return Progress(
        BarColumn(bar_width=20),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TextColumn("remaining"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[failures]}"),
        console=console,
    )
