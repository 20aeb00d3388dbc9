"""Report of a campaign: success rates, figures and the runs to look at first."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from math import sqrt
from pathlib import Path
from typing import Any

import numpy as np

from fss_arm_ros.report import Figure, Report, StoredFigure, Table
from fss_rehearsal.campaign.function import CRASHED, SUCCESS, Row
from fss_rehearsal.campaign.plan import Campaign

MAX_CELLS = 100  # largest number of cells in the table
MAX_WORST_RUNS = 10  # in the table of the worst
Z = 1.959964  # standard normal quantile of a two-sided interval of 95 %
MEASURE_HEAD = ("", "runs", "mean", "standard error", "median", "largest")


def wilson_interval(successes: int, runs: int) -> tuple[float, float]:
    """Return the 95 % interval of a success rate (E. B. Wilson 1927, JASA 22, 209-212)."""
    if not runs:
        return 0.0, 1.0
    rate, spread = successes / runs, Z * Z / runs
    middle = rate + 0.5 * spread
    half = Z * sqrt(rate * (1.0 - rate) / runs + spread / (4.0 * runs))
    low, high = ((middle + sign * half) / (1.0 + spread) for sign in (-1.0, 1.0))
    return max(low, 0.0), min(high, 1.0)


def rate_text(rows: Sequence[Row]) -> tuple[str, str, str, str]:
    """Return runs, successes, rate and interval as texts."""
    good = sum(row["outcome"] == SUCCESS for row in rows)
    low, high = wilson_interval(good, len(rows))
    rate = f"{100.0 * good / len(rows):.1f} %" if rows else ""
    return str(len(rows)), str(good), rate, f"{100.0 * low:.1f} to {100.0 * high:.1f} %"


def figure_names(campaign: Campaign, rows: Sequence[Row]) -> list[str]:
    """Return the names of the figures in the report: the measures of the file, or all numbers."""
    if campaign.measures:
        return list(campaign.measures)
    other = {"run", "seed", "wall_time", *(k for run in campaign.runs for k in run.values)}
    names = dict.fromkeys(name for row in rows for name in row if name not in other)
    return [name for name in names if any(type(row.get(name)) is float for row in rows)]


def numbers(rows: Sequence[Row], name: str) -> np.ndarray:
    """Return the finite values of a figure."""
    values = [row.get(name) for row in rows if row["outcome"] != CRASHED]
    found = np.array([v for v in values if isinstance(v, float | int)], dtype=float)
    return found[np.isfinite(found)]


def unknown_measures(campaign: Campaign, rows: Sequence[Row]) -> list[str]:
    """Return the measures of the file that no run returned, unless all runs crashed."""
    done = [row for row in rows if row["outcome"] != CRASHED]
    return [m for m in campaign.measures if done and not any(m in row for row in done)]


def summarize(
    campaign: Campaign, rows: Sequence[Row], command: str, picture_of: Callable[[int], Path]
) -> Report:
    """Return the report.

    Args:
        campaign: the campaign.
        rows: rows of its runs.
        command: command line of the campaign.
        picture_of: returns the file of a run's picture, which need not exist.
    """
    runs, good, rate, interval = rate_text(rows)
    crashed = sum(row["outcome"] == CRASHED for row in rows)
    passed = bool(rows) and int(good) >= campaign.success_rate * len(rows)
    reason = f"{good} of {runs} runs succeeded, {rate} (95 % interval {interval})"
    if crashed:
        reason += f", {crashed} crashed"
    if len(rows) < len(campaign.runs):
        reason += f"; {len(campaign.runs) - len(rows)} of {len(campaign.runs)} runs remain"
    if unknown := unknown_measures(campaign, rows):
        known = sorted({name for row in rows for name in row if type(row[name]) is float})
        reason += f"; no run returned {', '.join(unknown)}, only {', '.join(known)}"
    names = [name for name in figure_names(campaign, rows) if len(numbers(rows, name))]
    head = ("runs", "succeeded", "rate", "95 % interval")
    tables = [
        Table(
            axis.name,
            ("", *head),
            [
                (level.label, *rate_text(group))
                for level, group in _along(campaign, axis.name, rows)
            ],
        )
        for axis in campaign.axes
    ]
    tables.append(Table("Figures", MEASURE_HEAD, [_spread(name, rows) for name in names]))
    worst = worst_rows(rows, names)
    if worst:
        tables.append(_worst_table(worst, names))
    details = [_cells(campaign, rows, names)] if campaign.axes else []
    versions = sorted({row["commit"] for row in rows})
    return Report(
        campaign.about or campaign.file.stem,
        "pass" if passed and not unknown else "fail",
        reason,
        tables,
        f"commit {', '.join(versions)}, {campaign.file}",
        [
            *(Figure(f"{name.replace(' ', '_')}", name, _histogram(name, rows)) for name in names),
            *pictures(worst, picture_of),
        ],
        details,
        below=[f"repeat a run: {command} --replay {worst[0]['run']}"] if worst else [],
        texts={"The campaign": campaign.file.read_text(encoding="utf-8")},
    )


def _along(campaign: Campaign, axis: str, rows: Sequence[Row]) -> Iterator[tuple[Any, list[Row]]]:
    (levels,) = (one.levels for one in campaign.axes if one.name == axis)
    for level in levels:
        runs = campaign.runs
        group = [row for row in rows if runs[row["run"]].cell[axis] == level.label]
        if group:
            yield level, group


def _cells(campaign: Campaign, rows: Sequence[Row], names: Sequence[str]) -> Table:
    """Return the table of the grid's cells."""
    groups: dict[tuple[str, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault(tuple(campaign.runs[row["run"]].cell.values()), []).append(row)
    axes = [axis.name for axis in campaign.axes]
    head = (*axes, "runs", "succeeded", "rate", "95 % interval", *names)
    body = [
        (*cell, *rate_text(group), *(_mean_text(numbers(group, name)) for name in names))
        for cell, group in list(groups.items())[:MAX_CELLS]
    ]
    note = f"the first {MAX_CELLS} of {len(groups)}; " if len(groups) > MAX_CELLS else ""
    return Table(
        "Cells of the grid", head, body, len(axes), f"{note}figures: mean ± standard error"
    )


def _mean_text(values: np.ndarray) -> str:
    if not len(values):
        return ""
    error = f" ± {np.std(values, ddof=1) / sqrt(len(values)):.2g}" if len(values) > 1 else ""
    return f"{np.mean(values):.4g}{error}"


def _spread(name: str, rows: Sequence[Row]) -> tuple[str, ...]:
    values = numbers(rows, name)
    error = np.std(values, ddof=1) / sqrt(len(values)) if len(values) > 1 else np.nan
    statistics = np.mean(values), error, np.median(values), np.max(values)
    return (name, str(len(values)), *(f"{value:.4g}" for value in statistics))


def worst_rows(rows: Sequence[Row], names: Sequence[str]) -> list[Row]:
    """Return the crashed runs, then the failed ones, then those with the largest first figure."""

    def badness(row: Row) -> tuple[int, float]:
        value = row.get(names[0]) if names else None
        size = float(value) if isinstance(value, float | int) and value == value else 0.0
        return (row["outcome"] != SUCCESS) + (row["outcome"] == CRASHED), size

    return sorted(rows, key=badness, reverse=True)[:MAX_WORST_RUNS]


def pictures(rows: Sequence[Row], picture_of: Callable[[int], Path]) -> Iterator[Figure]:
    """Yield the pictures of runs that have one."""
    for row in rows:
        file = picture_of(row["run"])
        if file.exists():
            yield StoredFigure(file.stem, f"run {row['run']}: {row['reason']}", file.read_bytes)


def _worst_table(rows: Sequence[Mapping[str, Any]], names: Sequence[str]) -> Table:
    first = names[:1]
    head = ("run", "outcome", "reason", *first)
    body = [
        (
            str(row["run"]),
            row["outcome"],
            row["reason"],
            *("" if row.get(n) is None else f"{row[n]:.4g}" for n in first),
        )
        for row in rows
    ]
    return Table("Worst runs", head, body, 3)


def _histogram(name: str, rows: Sequence[Row]) -> Any:
    def draw() -> Any:
        from matplotlib.figure import Figure as Drawing

        figure = Drawing(figsize=(6.0, 2.2), layout="constrained")
        ax = figure.subplots()
        edges = np.histogram_bin_edges(numbers(rows, name), bins=30).tolist()
        for outcome, color in ((SUCCESS, "tab:blue"), ("failure", "tab:red")):
            values = numbers([row for row in rows if row["outcome"] == outcome], name)
            if len(values):
                ax.hist(values, bins=edges, color=color, alpha=0.7, label=outcome)
        ax.set_xlabel(name)
        ax.set_ylabel("runs")
        ax.legend()
        return figure

    return draw
