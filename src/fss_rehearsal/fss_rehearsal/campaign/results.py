"""Results of a campaign: one Parquet file with a row per run."""

import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pyarrow
import pyarrow.parquet

from fss_rehearsal.campaign.function import PICTURE, Row
from fss_rehearsal.campaign.plan import Campaign, CampaignError, Run

MAX_WRITING_SHARE = 0.05  # share of the time that writing may take
NOT_COMPARED = "commit", "worker", "wall_time"  # columns that may differ when a run is repeated


class Results:
    """The rows of the runs that have finished, and their file.

    The file is replaced atomically with each row, or less often if it is large. If the campaign is
    killed, the few runs since the last replacement run again, with the same result. Pictures of
    runs go to files of their own.
    """

    def __init__(self, path: Path, rows: Sequence[Row] = ()) -> None:
        self.path = path
        self.rows = {row["run"]: row for row in rows}
        self._next_writing = 0.0  # by time.monotonic() [s]

    def add(self, row: Row) -> None:
        """Add the row of a run, and write the file if it is time."""
        if png := row.pop(PICTURE, None):
            file = picture_file(self.path, row["run"])
            file.parent.mkdir(exist_ok=True)
            file.write_bytes(png)
        self.rows[row["run"]] = row
        if time.monotonic() >= self._next_writing:
            self.write()

    def write(self) -> None:
        """Write all rows, in the order of the runs' numbers."""
        start = time.monotonic()
        rows = [self.rows[number] for number in sorted(self.rows)]
        names = dict.fromkeys(name for row in rows for name in row)
        table = pyarrow.table({name: _column([row.get(name) for row in rows]) for name in names})
        part = self.path.with_name(f".{self.path.name}.{os.getpid()}")
        pyarrow.parquet.write_table(table, part)
        part.replace(self.path)
        now = time.monotonic()
        self._next_writing = now + (now - start) / MAX_WRITING_SHARE


def picture_file(results: Path, run: int) -> Path:
    """Return the file of a run's picture, beside the file of the results."""
    return results.with_name("pictures") / f"run_{run}.png"


def _column(values: list[Any]) -> Any:
    try:
        return pyarrow.array(values)
    except (pyarrow.ArrowInvalid, pyarrow.ArrowTypeError):  # of several types
        return pyarrow.array([None if value is None else str(value) for value in values])


def read_rows(path: Path) -> list[Row]:
    """Return the rows of a results file.

    Raises:
        CampaignError: it does not contain results.
    """
    try:
        rows: list[Row] = pyarrow.parquet.read_table(path).to_pylist()
    except (OSError, pyarrow.ArrowInvalid) as error:
        raise CampaignError(f"{path} cannot be read: {error}") from None
    return rows


def check_rows(rows: Sequence[Row], campaign: Campaign, commit: str, path: Path) -> None:
    """Check that rows are those of a campaign, so that it can continue.

    Raises:
        CampaignError: a run has other parameters now, or was made with another commit.
    """
    for row in rows:
        known = row["run"] < len(campaign.runs)
        expected = expected_columns(campaign.runs[row["run"]]) if known else {}
        for name, value in ({"run": "none"} if not known else expected).items():
            if _comparable(row.get(name)) != _comparable(value):
                raise CampaignError(
                    f"{path}: run {row['run']} has {name} {row.get(name)}, expected {value} as in "
                    f"{campaign.file}; start another campaign with --out FOLDER"
                )
        if row["commit"] != commit:
            raise CampaignError(
                f"{path}: run {row['run']} was made with commit {row['commit']}, expected {commit};"
                " check out that commit (after + is a digest of uncommitted changes), or start "
                "another campaign with --out FOLDER"
            )
        if row["function"] != campaign.function:
            raise CampaignError(
                f"{path}: run {row['run']} is one of {row['function']}, expected "
                f"{campaign.function} as in {campaign.file}; start another campaign with --out "
                "FOLDER"
            )


def expected_columns(run: Run) -> Row:
    """Return the columns of a run that are known before it runs."""
    labels = {name: label for name, label in run.cell.items() if name not in run.values}
    return {"run": run.number, "seed": run.seed, **labels, **run.values}


def differences(row: Row, other: Row, only: Sequence[str] = ()) -> list[str]:
    """Return the columns in which two rows of the same run differ, with both values.

    If names are given, only these columns are compared.
    """
    names = only or dict.fromkeys([*row, *other])
    return [
        f"{name}: {row.get(name)}, before {other.get(name)}"
        for name in names
        if name not in NOT_COMPARED and _comparable(row.get(name)) != _comparable(other.get(name))
    ]


def _comparable(value: Any) -> Any:
    """Return a value such that equal ones are equal: NaN as a text, tuples as lists."""
    if isinstance(value, list | tuple):
        return [_comparable(one) for one in value]
    return "nan" if value != value else value
