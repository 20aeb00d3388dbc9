"""Settings: frozen dataclasses whose fields have a meaning, a unit and bounds.

Meaning and bounds of a value are defined once, at its field: nodes declare their parameters from
it, commands their options, and the documentation lists it.
"""

from collections.abc import Callable
from dataclasses import MISSING, Field, dataclass, field, fields
from math import degrees, inf
from typing import Any, ClassVar, get_args, get_origin

from .units import number_text


class SettingError(ValueError):
    """A setting has an invalid value; the message names it and what was expected."""


@dataclass(frozen=True)
class Check:
    """A check of a value: in words, as a predicate, and as limits of its range."""

    expected: str
    holds: Callable[[Any], bool]
    low: float = -inf
    high: float = inf


POSITIVE = Check("a positive number", lambda value: 0.0 < value < inf, low=0.0)
NOT_NEGATIVE = Check("0 or more", lambda value: 0.0 <= value < inf, low=0.0)
FINITE = Check("a finite number", lambda value: -inf < value < inf)

NAMES = {bool: "true or false", int: "an integer", float: "a number", str: "a string"}


def between(low: float, high: float) -> Check:
    """Return a check for values from `low` to `high`, both included."""
    expected = f"{low:.10g} to {high:.10g}"
    return Check(expected, lambda value: low <= value <= high, low, high)


def above(low: float, high: float) -> Check:
    """Return a check for values above `low`, and up to `high`."""
    return Check(f"above {low:g}, at most {high:g}", lambda value: low < value <= high, low, high)


def at_least(low: float) -> Check:
    """Return a check for values of at least `low`."""
    return Check(f"{low:g} or more", lambda value: low <= value < inf, low)


def one_of(*choices: str) -> Check:
    """Return a check for one of several words."""
    text = ", ".join(choice or "''" for choice in choices)
    return Check(f"one of {text}", lambda value: value in choices)


def setting(
    default: Any,
    about: str,
    *,
    unit: str = "",
    check: Check | None = None,
    size: int | None = None,
    within: str = "",
) -> Any:
    """Create a field of Settings.

    Args:
        default: a bool, int, float, str or a tuple of one of them.
        about: a description of the setting that is complete in itself.
        unit: unit of the value.
        check: valid values; for a tuple, of each of its elements.
        size: number of elements of a tuple; None: any number.
        within: the default in a ROS namespace, if it must differ between vehicles: {namespace} in
            it is `lab/fss2` in /lab/fss2, {vehicle} is `fss2`.
    """
    what = {"about": about, "unit": unit, "check": check, "size": size, "within": within}
    return field(default=default, metadata=what)


def default_in(f: "Field[Any]", namespace: str) -> Any:
    """Return the default of a field in a ROS namespace, as `/fss2`."""
    name, within = namespace.strip("/"), f.metadata["within"]
    if not name or not within:
        return f.default
    return within.format(namespace=name, vehicle=name.rpartition("/")[2])


def like(kind: type, name: str, default: Any = MISSING) -> Any:
    """Create a field with the meaning and bounds of the field `name` of other Settings.

    Args:
        kind: the other Settings.
        name: name of its field.
        default: the default; if omitted, that of the other field.
    """
    other = kind.__dataclass_fields__[name]  # type: ignore[attr-defined]
    return field(default=other.default if default is MISSING else default, metadata=other.metadata)


class Settings:
    """Base of dataclasses of `setting` fields: values are checked when an object is created.

    Raises:
        SettingError: a value is not what its field's check expects.
    """

    ABOUT: ClassVar[str] = ""  # what a program with these settings does, for its help

    def __post_init__(self) -> None:
        for f in fields(self):  # type: ignore[arg-type]  # a dataclass each
            refuse(f, getattr(self, f.name))


def refuse(f: "Field[Any]", value: Any, name: str = "") -> None:
    """Raise SettingError, under the field's name or another, if `value` is invalid."""
    name = name or f.name
    size, check, unit = f.metadata["size"], f.metadata["check"], f.metadata["unit"]
    if size is not None and len(value) != size:
        raise SettingError(f"{name} has {len(value)} numbers, expected {size}")
    for one in value if isinstance(value, tuple) else (value,):
        if check is not None and not check.holds(one):
            raise SettingError(f"{name} is {_format_given(one, unit)}, expected {check.expected}")


def _format_given(value: Any, unit: str) -> str:
    """Return an invalid value as messages show it; an angle also as commands take it."""
    if isinstance(value, str):
        return repr(value)
    if unit == "rad":
        return f"{value:.4g} rad ({degrees(value):.4g} deg)"
    return f"{value}{unit and ' ' + unit}"


def converted(name: str, value: Any, hint: Any) -> Any:
    """Convert an external value to the type of a field; lists become tuples.

    Raises:
        SettingError: it is of another type; the message names the setting.
    """
    if get_origin(hint) is tuple:
        kind = get_args(hint)[0]
        value = () if value is None else value  # rcl reads `name:=[]` as None
        if isinstance(value, str | bytes) or not hasattr(value, "__iter__"):
            raise SettingError(f"{name} is {value!r}, expected a list, each {NAMES[kind]}")
        return tuple(converted(name, item, kind) for item in value)
    if hint is float and type(value) is int:
        return float(value)
    if type(value) is not hint:
        raise SettingError(f"{name} is {value!r}, expected {NAMES[hint]}")
    return value


def default_text(value: Any) -> str:
    """Return a default as help and pages show it: numbers with six digits, lists in brackets."""
    if isinstance(value, tuple):
        return f"[{', '.join(map(default_text, value))}]"
    if isinstance(value, float):
        return number_text(value)
    return str(value).lower() if isinstance(value, bool) else str(value)


def meaning(f: "Field[Any]") -> str:
    """Return a field's meaning, unit and bounds in one line, for help and `ros2 param describe`.

    All numbers must be finite, so FINITE is not mentioned.
    """
    about, unit, check = (f.metadata[key] for key in ("about", "unit", "check"))
    text = f"{about} [{unit}]" if unit else about
    each = "each " if isinstance(f.default, tuple) else ""
    text = text if check in (None, FINITE) else f"{text}; {each}{check.expected}"
    within = default_in(f, "NAME") if f.metadata["within"] else ""
    return f"{text}; default in a namespace /NAME: {within}" if within else text
