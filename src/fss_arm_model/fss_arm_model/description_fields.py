"""Checks of a description's values: a field's metadata names the function that converts it.

These functions raise TypeError, ValueError or OverflowError for an invalid value.
"""

import math
import operator
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields
from typing import Any

from .files import ContentError

MAX_ANGLE = 2.0 * math.pi  # of limits, offsets and mounts; a larger one is in degrees [rad]


class DescriptionError(ContentError):
    """A value of a description is invalid; the message gives field, value and expected value."""


@contextmanager
def error_context(part: str) -> Iterator[None]:
    """Name the fields of errors raised inside as fields of `part`, if it has a name."""
    try:
        yield
    except ContentError as error:
        field = f"{part}: {error.field}" if part else error.field
        raise DescriptionError(field, error.value, error.expected) from None


def as_number(value: Any) -> float:
    """Return a finite number."""
    if isinstance(value, bool | str) or not math.isfinite(value):
        raise ValueError
    return float(value)


def as_positive(value: Any) -> float:
    """Return a number above 0."""
    if not (number := as_number(value)) > 0.0:
        raise ValueError
    return number


def as_nonzero(value: Any) -> float:
    """Return a number other than 0."""
    if not (number := as_number(value)):
        raise ValueError
    return number


def as_count(value: Any) -> int:
    """Return an integer above 0."""
    if isinstance(value, bool) or not as_number(number := operator.index(value)) > 0.0:
        raise ValueError
    return number


def as_serial(value: Any) -> int:
    """Return a serial number of 31 bits."""
    if isinstance(value, bool) or not 0 <= (number := operator.index(value)) < 1 << 31:
        raise ValueError
    return number


def as_sign(value: Any) -> int:
    """Return 1 or -1."""
    if isinstance(value, bool) or value not in (-1, 1):
        raise ValueError
    return int(value)


def as_name(value: Any) -> str:
    """Return a printable text that is not empty."""
    if not isinstance(value, str) or not value.strip() or not value.isprintable():
        raise ValueError
    return value


def as_numbers(count: int) -> Callable[[Any], tuple[float, ...]]:
    """Return a function that returns `count` finite numbers."""

    def convert(value: Any) -> tuple[float, ...]:
        if isinstance(value, str | dict) or len(value) != count:
            raise ValueError
        return tuple(as_number(v) for v in value)

    return convert


def as_time(value: Any) -> int:
    """Return a time [ns]."""
    if isinstance(value, bool) or not 0 <= (number := operator.index(value)) < 1 << 63:
        raise ValueError
    return number


def as_names(value: Any) -> tuple[str, ...]:
    """Return different names."""
    if isinstance(value, str | dict) or len(set(value)) != len(value):
        raise ValueError
    return tuple(map(as_name, value))


def as_rows(value: Any) -> tuple[tuple[float, ...], ...]:
    """Return rows of numbers, as many as each has."""
    if isinstance(value, str | dict):
        raise ValueError
    return tuple(as_numbers(len(value))(row) for row in value)


def as_instance(kind: type[Any]) -> Callable[[Any], Any]:
    """Return a function that returns an object of a type."""

    def convert(value: Any) -> Any:
        if not isinstance(value, kind):
            raise TypeError
        return value

    return convert


_EXPECTED: dict[Callable[[Any], Any], str] = {
    as_number: "a finite number",
    as_positive: "a positive number",
    as_nonzero: "a number other than zero",
    as_count: "a positive integer",
    as_serial: "an integer from 0 to 2147483647",
    as_sign: "1 or -1",
    as_time: "an integer from 0 to 9223372036854775807",
    as_name: "a printable text that is not empty",
    as_names: "a list of names, each once",
    as_rows: "as many rows of numbers as each has",
}


def rule(
    kind: Callable[[Any], Any], unit: str = "", about: str = "", expected: str = ""
) -> dict[str, Any]:
    """Return a field's metadata: its check, and unit and meaning for the YAML file's comments."""
    expected = expected or _EXPECTED[kind] + (f" [{unit}]" if unit else "")
    return {"kind": kind, "unit": unit, "about": about, "expected": expected}


def check_fields(part: Any) -> None:
    """Convert each field of a description's part to its type; raise DescriptionError if invalid."""
    for f in fields(part):
        value = getattr(part, f.name)
        try:
            converted = f.metadata["kind"](value)
        except (TypeError, ValueError, OverflowError):
            raise DescriptionError(f.name, value, f.metadata["expected"]) from None
        object.__setattr__(part, f.name, converted)
        if f.metadata["unit"].split(", ")[-1] == "rad":
            _check_angle(f.name, converted[-1] if isinstance(converted, tuple) else converted)


def _check_angle(name: str, angle: float) -> None:
    """Raise DescriptionError if an angle [rad] is so large that it must be in degrees."""
    if abs(angle) > MAX_ANGLE:
        expected = f"{-MAX_ANGLE:.4g} to {MAX_ANGLE:.4g} [rad]; in degrees? "
        expected += f"{angle:.4g} deg are {math.radians(angle):.4g} rad"
        raise DescriptionError(name, angle, expected)
