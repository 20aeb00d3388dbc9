"""Distributions of parameters, as campaigns and learning environments state them."""

from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from math import isfinite
from typing import Any

import numpy as np

from .files import ContentError

KINDS: Mapping[str, str] = {
    "uniform": "[low, high]",
    "normal": "[mean, standard deviation]",
    "choice": "a list of values",
    "cycle": "a list of values",
}


@dataclass(frozen=True)
class Distribution:
    """Distribution of a parameter; `cycle` takes its values in turn, by position."""

    kind: str
    numbers: tuple[Any, ...]

    def draw(self, rng: np.random.Generator, position: int) -> Any:
        """Return a value for the run at a position of a series."""
        if self.kind == "uniform":
            return float(rng.uniform(*self.numbers))
        if self.kind == "normal":
            return float(rng.normal(*self.numbers))
        k = position if self.kind == "cycle" else int(rng.integers(len(self.numbers)))
        return self.numbers[k % len(self.numbers)]

    @property
    def examples(self) -> tuple[Any, ...]:
        """Values of which each must be valid."""
        return self.numbers[:1] if self.kind == "normal" else self.numbers


def parse_distribution(key: str, value: Any) -> Distribution:
    """Return a distribution from its form in a file, such as {uniform: [8.0, 12.0]}.

    Raises:
        ContentError: it is malformed; the message gives the key.
    """
    if not isinstance(value, dict) or len(value) != 1:
        forms = ", ".join(f"{{{kind}: {form}}}" for kind, form in KINDS.items())
        raise ContentError(key, value, f"one of {forms}")
    ((kind, numbers),) = value.items()
    if kind not in KINDS:
        near = get_close_matches(str(kind), KINDS, n=1)
        expected = f"{near[0]} as its kind" if near else f"one of {', '.join(KINDS)}"
        raise ContentError(key, kind, expected)
    valid = isinstance(numbers, list) and bool(numbers)
    if valid and kind in ("uniform", "normal"):
        valid = len(numbers) == 2 and all(
            type(one) in (int, float) and isfinite(one) for one in numbers
        )
        valid = valid and (numbers[0] <= numbers[1] if kind == "uniform" else numbers[1] >= 0.0)
    if not valid:
        raise ContentError(f"{key}: {kind}", numbers, KINDS[kind])
    return Distribution(kind, tuple(numbers))
