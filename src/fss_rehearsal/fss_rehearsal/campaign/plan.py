"""A campaign as its file states it, and the runs that follow from it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cached_property, partial
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fss_arm_model.distributions import Distribution, parse_distribution
from fss_arm_model.files import ContentError, format_value, read_text, read_yaml
from fss_arm_model.settings import SettingError
from fss_rehearsal.campaign.arguments import Arguments
from fss_rehearsal.campaign.function import find_function

#: Functions that a campaign runs, by the name for the file.
RUNS = {
    "capture": "fss_rehearsal.loops.capture:capture",
    "hold": "fss_rehearsal.loops.holding:hold",
    "crossing": "fss_rehearsal.loops.crossing:crossing",
    "calibration": "fss_rehearsal.loops.calibration:calibration",
}
#: The same with all nodes on the simulated test bed, for `loop: graph`.
GRAPH_RUNS = {
    "capture": "fss_rehearsal.loops.graph:capture",
    "hold": "fss_rehearsal.loops.graph:hold",
}
KEYS = "about", "run", "loop", "seeds", "settings", "grid", "draw", "measure", "success_rate"


class CampaignError(ValueError):
    """The campaign cannot run or continue; the message gives the reason and the next step."""


class Level(NamedTuple):
    """A level of an axis of the grid."""

    label: str
    settings: Mapping[str, Any]


class Axis(NamedTuple):
    """An axis of the grid: a parameter with its values, or named sets of settings."""

    name: str
    levels: tuple[Level, ...]


class Run(NamedTuple):
    """One run of a campaign."""

    number: int
    seed: int
    cell: Mapping[str, str]  # label of the level of each axis
    values: Mapping[str, Any]  # parameters that are not defaults


@dataclass(frozen=True)
class Campaign:
    """A campaign as its file states it."""

    file: Path
    about: str
    function: str  # place of the function, MODULE:NAME
    seeds: tuple[int, ...]
    settings: Mapping[str, Any]
    axes: tuple[Axis, ...]
    distributions: Mapping[str, Distribution]
    measures: tuple[str, ...]  # figures in the report; empty: all
    success_rate: float  # smallest rate with which the campaign passes

    @property
    def is_repeatable(self) -> bool:
        """True if a repeated run gives the same figures; with nodes, only its outcome is alike."""
        return self.function not in GRAPH_RUNS.values()

    @cached_property
    def runs(self) -> tuple[Run, ...]:
        """Runs of the campaign: the cells of the grid for the first seed, then the next.

        A seed draws the same values in each cell, so that cells can be compared run by run; a
        `cycle` is a Latin square over the grid's last axis and the seeds.
        """
        runs = []
        cells = list(product(*(enumerate(axis.levels) for axis in self.axes)))
        for number, (seed, cell) in enumerate(product(self.seeds, cells)):
            values = dict(self.settings)
            for _, level in cell:
                values |= level.settings
            rng, position = np.random.default_rng(seed), seed + (cell[-1][0] if cell else 0)
            for name, distribution in self.distributions.items():
                values[name] = distribution.draw(rng, position)
            labels = {a.name: level.label for a, (_, level) in zip(self.axes, cell, strict=True)}
            runs.append(Run(number, seed, labels, values))
        return tuple(runs)

    def in_random_order(self) -> list[Run]:
        """Return the runs in an order of which any beginning covers the grid."""
        order = np.random.default_rng(0).permutation(len(self.runs))
        return [self.runs[k] for k in order]


def read_campaign(file: Path) -> Campaign:
    """Read and check a campaign's file.

    Raises:
        OSError: the file cannot be read.
        CampaignError: its content is invalid; the message gives the key, the value and what was
            expected.
    """
    try:
        return _campaign(file, read_yaml(read_text(file)))
    except (ContentError, SettingError) as error:
        raise CampaignError(f"{file}: {error}") from None


def _campaign(file: Path, given: Any) -> Campaign:
    if not isinstance(given, dict):
        raise ContentError("content", given, f"the keys {', '.join(KEYS)}")
    for key, value in given.items():
        if key not in KEYS:
            near = get_close_matches(str(key), KEYS, n=1, cutoff=0.5)
            raise ContentError(
                str(key), value, f"{near[0]}: ..." if near else f"one of the keys {', '.join(KEYS)}"
            )
    place = _function_place(given.get("run"), given.get("loop"))
    arguments = Arguments(find_function(place, file.parent))
    settings = _mapping("settings", given.get("settings"))
    axes = tuple(_axis(name, v) for name, v in _mapping("grid", given.get("grid")).items())
    draws = _mapping("draw", given.get("draw"))
    distributions = {
        name: parse_distribution(f"draw: {name}", value) for name, value in draws.items()
    }
    _check_values(arguments, settings, axes, distributions)
    rate = given.get("success_rate", 1.0)
    if type(rate) not in (int, float) or not 0.0 <= rate <= 1.0:
        raise ContentError("success_rate", rate, "a number from 0 to 1")
    measures = given.get("measure") or []
    if not isinstance(measures, list) or not all(isinstance(m, str) for m in measures):
        raise ContentError("measure", measures, "a list of the names of figures")
    return Campaign(
        file,
        str(given.get("about", "")),
        place,
        _seeds(given.get("seeds", 1)),
        settings,
        axes,
        distributions,
        tuple(measures),
        float(rate),
    )


def _function_place(name: Any, loop: Any) -> str:
    """Return the place of the function that the keys `run` and `loop` name, MODULE:NAME."""
    if loop not in (None, "graph"):
        raise ContentError("loop", loop, "graph (all nodes), or no such key (without ROS)")
    if loop:
        if name not in GRAPH_RUNS:
            choices = " or ".join(f"run: {known}" for known in GRAPH_RUNS)
            raise ContentError("loop", loop, f"{choices} with it, not run: {name}")
        return GRAPH_RUNS[name]
    place = RUNS.get(name, name) if isinstance(name, str) else ""
    if ":" not in place:
        raise ContentError("run", name, f"one of {', '.join(RUNS)}, or module:function")
    return place


def _mapping(key: str, value: Any) -> dict[str, Any]:
    if value is not None and not (
        isinstance(value, dict) and all(isinstance(name, str) for name in value)
    ):
        raise ContentError(key, value, "names of parameters, each with its value")
    return value or {}


def _seeds(value: Any) -> tuple[int, ...]:
    seeds = range(1, 1 + value) if type(value) is int else value
    valid = isinstance(seeds, range | list) and all(type(s) is int and s >= 0 for s in seeds)
    if not valid or not seeds or len(set(seeds)) < len(seeds):
        raise ContentError("seeds", value, "their number, or a list of different integers from 0")
    return tuple(seeds)


def _axis(name: str, value: Any) -> Axis:
    if isinstance(value, list) and value:
        return Axis(name, tuple(Level(label(one), {name: one}) for one in value))
    if isinstance(value, dict) and value:
        sets = {str(key): _mapping(f"grid: {name}: {key}", one) for key, one in value.items()}
        return Axis(name, tuple(Level(*one) for one in sets.items()))
    raise ContentError(f"grid: {name}", value, "a list of values, or names of settings each")


def label(value: Any) -> str:
    """Return a value as tables show it."""
    return f"{value:.4g}" if isinstance(value, float) else format_value(value).strip("'")


def _check_values(
    arguments: Arguments,
    settings: Mapping[str, Any],
    axes: Sequence[Axis],
    distributions: Mapping[str, Distribution],
) -> None:
    """Check each value together with the fixed settings."""
    for key, value in settings.items():
        _in_part("settings", partial(arguments.build, {key: value}))
    _in_part("settings", partial(arguments.build, settings))
    for axis in axes:
        for level in axis.levels:
            _in_part("grid", partial(arguments.build, {**settings, **level.settings}))
    for name, distribution in distributions.items():
        for value in distribution.examples:
            _in_part("draw", partial(arguments.build, {**settings, name: value}))
    parameters = [*settings, *distributions, *(k for a in axes for k in a.levels[0].settings)]
    if missing := arguments.missing(dict.fromkeys(parameters)):
        raise ContentError(f"settings: {missing[0]}", None, "a value: it has no default")


def _in_part(part: str, check: Callable[[], Any]) -> None:
    """Run a check; its error names the part of the file."""
    try:
        check()
    except ContentError as error:
        raise ContentError(f"{part}: {error.field}", error.value, error.expected) from None
    except SettingError as error:
        raise SettingError(f"{part}: {error}") from None
