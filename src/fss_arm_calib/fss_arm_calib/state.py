"""What a node must not forget when it is killed: JSON files, replaced whole."""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict
from math import isfinite
from pathlib import Path
from typing import Any

from fss_arm_calib.segments.rests import Observation


class StateError(ValueError):
    """A state file cannot be understood; the message names it."""


def write_text(path: str | Path, text: str) -> None:
    """Replace the file: a reader, or the next start, finds the old text or the new one.

    Raises:
        OSError: it cannot be written.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.part")
    part.write_text(text, encoding="utf-8")
    part.replace(path)


def write(path: str | Path, state: Any) -> None:
    """Replace the file by a state, likewise.

    Raises:
        OSError: it cannot be written.
    """
    write_text(path, json.dumps(state, indent=1))


class Writes:
    """Attempts to write; `trouble` is what could not be written since it was last cleared."""

    def __init__(self, log: Any) -> None:
        self.log, self.trouble = log, ""

    def __call__(self, write: Callable[[], object]) -> None:
        """Write, or log why it cannot be done: a full disk ends no calibration."""
        try:
            write()
        except OSError as error:
            where = f" {error.filename}" if error.filename else ""  # not of a write to an open file
            self.trouble = f"cannot write{where}: {error.strerror}"
            self.log.error(self.trouble)


def read(path: str | Path, default: Any) -> Any:
    """The state in the file, `default` if there is none.

    Raises:
        StateError: it is not JSON.
        OSError: it cannot be read.
    """
    try:
        return json.loads(Path(path).read_text(encoding="utf-8"))
    except FileNotFoundError:
        return default
    except ValueError as error:
        raise StateError(f"{path} is not a state file: {error}") from None


def write_observations(path: str | Path, observations: Sequence[Observation]) -> None:
    """Save observations; numbers come back to the last bit, NaN as null in between.

    Raises:
        OSError: the file cannot be written.
    """
    write(path, [{k: _null(v) for k, v in asdict(o).items()} for o in observations])


def read_observations(path: str | Path, n: int) -> list[Observation]:
    """Observations of an arm of n links, none if there is no such file.

    Raises:
        StateError: the file holds something else.
        OSError: it cannot be read.
    """
    saved = read(path, [])
    try:
        observations = [Observation(**{k: _nan(k, v) for k, v in o.items()}) for o in saved]
    except (AttributeError, TypeError, ValueError) as error:
        raise StateError(f"{path} holds no observations: {error}") from None
    for observation in observations:
        if len(observation.q) != n:
            raise StateError(f"{path} is of {len(observation.q)} joints, expected {n}")
    return observations


def _null(value: Any) -> Any:
    if isinstance(value, tuple):
        return [v if isfinite(v) else None for v in value]
    return value


def _nan(name: str, value: Any) -> Any:
    if name in ("boots", "homings"):
        return tuple(map(int, value))
    if isinstance(value, list):
        return tuple(float("nan") if v is None else float(v) for v in value)
    return value
