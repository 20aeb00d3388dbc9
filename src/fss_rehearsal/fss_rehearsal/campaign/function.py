"""Run one function of a campaign, on any computer, and return its row."""

import sys
import time
import traceback
from collections.abc import Callable, Mapping
from dataclasses import asdict, is_dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from fss_arm_model.files import ContentError, short
from fss_arm_ros.report import Figure
from fss_arm_ros.source_version import source_version

SUCCESS, FAILURE, CRASHED = "success", "failure", "crashed"
PICTURE = "picture"  # in what a function returns, and in a row before it is stored
Row = dict[str, Any]


def find_function(place: str, folder: Path | None = None) -> Callable[..., Any]:
    """Return the function MODULE:NAME; the module may be in `folder`.

    Raises:
        ContentError: there is no such function.
    """
    if folder and str(folder.absolute()) not in sys.path:
        sys.path.insert(0, str(folder.absolute()))
    module, _, name = place.partition(":")
    try:
        function: Callable[..., Any] = getattr(import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise ContentError("run", place, f"a function module:function ({error})") from None
    return function


def perform(
    place: str,
    folder: Path,
    number: int,
    seed: int,
    values: Mapping[str, Any],
    files: Path | None = None,
) -> Row:
    """Run the function; return the row, in which an exception is a crash with its reason.

    A function may return `success`, `reason` and `picture`, a function that returns a matplotlib
    figure. The row of a run that failed, or that is repeated, has it as `picture`, a PNG file. A
    function with an argument `bag` records its topics there in a folder `files`, if one is given.
    """
    from fss_rehearsal.campaign.arguments import BAG, SEED, Arguments

    start = time.perf_counter()
    row: Row = {"run": number, "seed": seed, "function": place, "outcome": SUCCESS, "reason": ""}
    row |= values
    try:
        function = find_function(place, folder)
        arguments = Arguments(function)
        given = arguments.build(values)
        if arguments.takes_seed:
            given[SEED] = seed
        if arguments.takes_bag:
            given[BAG] = files and files / "bag"
        result = function(**given)
        draw = result.get(PICTURE) if isinstance(result, Mapping) else None
        figures = figures_of(result)
        reason, success = str(figures.pop("reason", "")), figures.pop("success", True)
        if clashes := sorted(figures.keys() & row.keys()):
            raise ValueError(f"the figure {clashes[0]} has the name of another column")
        row |= {"outcome": SUCCESS if success else FAILURE, "reason": reason, **figures}
        if draw and (files or not success):
            row[PICTURE] = Figure("", "", draw).png()
    except Exception as error:
        frame = traceback.extract_tb(error.__traceback__)[-1]
        at = f"{Path(frame.filename).name}:{frame.lineno}"
        row |= {"outcome": CRASHED, "reason": f"{type(error).__name__}: {short(str(error))} ({at})"}
    return row | {"commit": source_version(), "wall_time": time.perf_counter() - start}


def figures_of(result: Any) -> Row:
    """Return what a function returned, a dataclass or a mapping, as plain values.

    Raises:
        TypeError: it returned something else.
    """
    if is_dataclass(result) and not isinstance(result, type):
        result = asdict(result)
    if not isinstance(result, Mapping):
        kind = type(result).__name__
        raise TypeError(f"the function returned {kind}, expected a mapping or a dataclass")
    return {str(name): _scalar(value) for name, value in result.items() if name != PICTURE}


def _scalar(value: Any) -> Any:
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, int | float | np.number):
        return float(value)
    return str(value)
