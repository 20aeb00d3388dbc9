"""Command `campaign`: execute the runs, or repeat one, and write the report."""

import argparse
import os
import sys
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from rich.console import Console

from fss_arm_ros import report
from fss_arm_ros.command_line import in_words
from fss_arm_ros.source_version import source_version
from fss_rehearsal.campaign.execute import execute, open_client
from fss_rehearsal.campaign.function import PICTURE, perform
from fss_rehearsal.campaign.options import parser
from fss_rehearsal.campaign.plan import Campaign, CampaignError, read_campaign
from fss_rehearsal.campaign.results import (
    Results,
    check_rows,
    differences,
    expected_columns,
    picture_file,
    read_rows,
)
from fss_rehearsal.campaign.summary import summarize


def main(arguments: Sequence[str]) -> int:
    """Run the command; return 0 if the campaign passed, 2 if it failed, 1 after an error."""
    options = parser().parse_args(arguments)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    console = report.console()
    try:
        campaign = read_campaign(options.file)
        out = options.out or Path("out") / options.file.stem
        if options.replay is not None:
            return replay(campaign, options.replay, out / "runs.parquet", console)
        return run(campaign, out, options, console)
    except (CampaignError, OSError) as error:
        print(f"campaign: {in_words(error)}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("campaign: interrupted; continue with --resume", file=sys.stderr)
        return 130


def run(campaign: Campaign, out: Path, options: argparse.Namespace, console: Console) -> int:
    """Execute the runs that are not in the results yet; return the exit code."""
    path = out / "runs.parquet"
    if path.exists() and not options.resume:
        raise CampaignError(
            f"{path} exists: continue that campaign with --resume, or start another one with "
            "--out FOLDER"
        )
    rows = read_rows(path) if path.exists() else []
    check_rows(rows, campaign, source_version(), path)
    out.mkdir(parents=True, exist_ok=True)
    results = Results(path, rows)
    planned = campaign.in_random_order()[: options.runs]
    runs = [one for one in planned if one.number not in results.rows]
    console.print(
        f"{campaign.about or options.file.stem}: {len(planned)} runs, "
        f"{len(planned) - len(runs)} done before"
    )
    if runs:
        try:
            with open_client(options.scheduler, options.workers) as client:
                execute(campaign, runs, client, results, console)
        finally:
            if results.rows:
                results.write()
    folder = [] if options.out is None else ["--out", str(options.out)]
    command = " ".join(["ros2 run fss_rehearsal campaign", str(options.file), *folder])
    rows = [results.rows[k] for k in sorted(results.rows)]
    summary = summarize(campaign, rows, command, partial(picture_file, path))
    console.print(report.printable(replace(summary, below=())))
    console.print("\n".join(summary.below), soft_wrap=True)  # commands stay in one line
    page = report.write(out / "report", summary)
    for file in (path, page):
        console.print(f"  {file}", soft_wrap=True)
    return 0 if summary.verdict == "pass" else 2


def replay(campaign: Campaign, number: int, path: Path, console: Console) -> int:
    """Repeat a run; return 0 if its row is the same as before, 2 if not."""
    if not 0 <= number < len(campaign.runs):
        raise CampaignError(
            f"--replay is {number}, expected a run from 0 to {len(campaign.runs) - 1}"
        )
    one = campaign.runs[number]
    before = {row["run"]: row for row in read_rows(path)} if path.exists() else {}
    files = path.with_name(f"run_{number}")
    if files.exists():
        raise CampaignError(f"{files} exists: move it away to repeat run {number} once more")
    row = expected_columns(one) | perform(
        campaign.function, campaign.file.parent.absolute(), number, one.seed, one.values, files
    )
    if png := row.pop(PICTURE, None):
        files.mkdir(parents=True, exist_ok=True)
        (files / "picture.png").write_bytes(png)
    width = max(map(len, row))
    for name, value in row.items():
        shown = f"{value:.4g}" if isinstance(value, float) else value
        console.print(f"{name:>{width}}  {shown}", soft_wrap=True)
    for file in sorted(files.glob("*")):
        console.print(f"  {file}", soft_wrap=True)
    if number not in before:
        console.print(f"not compared: {path} does not contain this run", soft_wrap=True)
        return 0
    changed = differences(row, before[number], () if campaign.is_repeatable else ("outcome",))
    same = "the same as before" if campaign.is_repeatable else "the same outcome as before"
    console.print(same if not changed else f"differs: {'; '.join(changed)}")
    return 2 if changed else 0
