"""Persistent state of a node: JSON files, replaced atomically."""

import json
from collections.abc import Callable
from dataclasses import MISSING, fields, is_dataclass
from math import isfinite, nan
from pathlib import Path
from typing import Any, get_args, get_origin, get_type_hints

from fss_arm_model.files import ContentError, short, write_text

MAX_FILE_SIZE = 2**26  # largest state file [bytes]: for drives whose links report at 100 Hz


class StateError(ValueError):
    """Error: a state file is invalid; the message names the file, in one line."""


def write(path: str | Path, state: Any, indent: int | None = 1) -> None:
    """Replace the file by a state; numbers that are not finite become null."""
    write_text(path, json.dumps(_without_nan(state), indent=indent))


def read(path: str | Path, default: Any) -> Any:
    """Read the state in a file, `default` if there is none; StateError: it is no valid JSON."""
    path = Path(path)
    try:
        with path.open("rb") as file:
            data = file.read(MAX_FILE_SIZE + 1)
    except FileNotFoundError:
        return default
    if len(data) > MAX_FILE_SIZE:
        raise StateError(f"{path} cannot be read: more than {MAX_FILE_SIZE} bytes")
    try:
        return json.loads(data.decode(), parse_constant=_no_constant)
    except RecursionError:
        raise StateError(f"{path} cannot be read: nested too deeply") from None
    except ValueError as error:
        raise StateError(f"{path} cannot be read: {short(str(error))}") from None


def from_json(hint: Any, value: Any, where: str) -> Any:
    """Convert a JSON value to a type: a dataclass, tuple, mapping, float, int, bool or str.

    Raises:
        ContentError: it is something else; the message names the part, within `where`.
    """
    kind, args = get_origin(hint), get_args(hint)
    if is_dataclass(hint) and isinstance(hint, type):
        hints = get_type_hints(hint)
        given = (f.default is not MISSING or f.default_factory is not MISSING for f in fields(hint))
        needed = {name for name, optional in zip(hints, given, strict=True) if not optional}
        if not isinstance(value, dict) or not needed <= value.keys() <= hints.keys():
            raise ContentError(where, value, f"an object of {', '.join(hints)}")
        return hint(
            **{name: from_json(hints[name], one, f"{where}.{name}") for name, one in value.items()}
        )
    if kind is tuple:
        if not isinstance(value, list):
            raise ContentError(where, value, "a list")
        return tuple(from_json(args[0], one, f"{where}[{k}]") for k, one in enumerate(value))
    if kind is not None:  # a mapping
        if not isinstance(value, dict):
            raise ContentError(where, value, "an object")
        return {key: from_json(args[1], one, f"{where}.{short(key)}") for key, one in value.items()}
    if hint is float:
        if value is None:
            return nan
        if type(value) not in (int, float) or not -1e300 < value < 1e300:
            raise ContentError(where, value, "a number")
        return float(value)
    if type(value) is not hint or (hint is int and not 0 <= value < 2**63):
        expected = {int: "an integer from 0 on", bool: "true or false", str: "a string"}[hint]
        raise ContentError(where, value, expected)
    return value


class FileWriter:
    """Writer that logs errors; `trouble` is the last error since it was cleared."""

    def __init__(self, log: Any) -> None:
        self.log, self.trouble = log, ""

    def __call__(self, write: Callable[[], object]) -> None:
        """Write, or log the error: a full disk must not stop a calibration."""
        try:
            write()
        except OSError as error:
            where = f" {error.filename}" if error.filename else ""  # none for an open file
            self.trouble = f"cannot write{where}: {error.strerror}"
            self.log.error(self.trouble)


def _no_constant(name: str) -> Any:
    raise ValueError(f"{name} is no number")


def _without_nan(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_nan(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(one) for one in value]
    return None if isinstance(value, float) and not isfinite(value) else value
