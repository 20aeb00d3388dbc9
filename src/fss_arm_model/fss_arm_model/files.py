"""Write files atomically, and read text files within size limits."""

import os
import re
from pathlib import Path
from typing import Any

import yaml

from .units import number_text

MAX_SIZE = 2**20  # largest text [bytes]
MAX_ENTRIES, MAX_DEPTH = 50_000, 20  # limits; entries that aliases repeat count again
MAX_TEXT = 80  # longest value in a message [characters]

_Safe = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # with libyaml it is ten times as fast


class ContentError(ValueError):
    """Invalid content; one line gives the part, its value and what was expected."""

    def __init__(self, field: str, value: Any, expected: str) -> None:
        self.field, self.value, self.expected = field, value, expected
        given = "missing" if value is None else format_value(value)
        super().__init__(f"{field} is {given}, expected {expected}")


def format_value(value: Any) -> str:
    """Return a value as messages show it."""
    if isinstance(value, float):
        return number_text(value)
    try:
        return short(repr(value))
    except ValueError:  # Python prints no integer of more than 4300 digits
        return "a number too long to print"


def short(text: str) -> str:
    """Return a text as messages show it: one line of at most MAX_TEXT characters."""
    line = " ".join(text[: MAX_TEXT + 1].split())
    return line if len(line) <= MAX_TEXT else f"{line[: MAX_TEXT - 3]}..."


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write a file atomically, and create its folder.

    Raises:
        OSError: it cannot be written; it names this file, not the temporary one.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        part.write_text(text, encoding="utf-8")
        part.replace(path)
    except OSError as error:
        error.filename = str(path)
        raise
    finally:
        part.unlink(missing_ok=True)


def read_text(path: str | os.PathLike[str]) -> str:
    """Return the text of an external file.

    Raises:
        OSError: it cannot be read.
        ContentError: it is larger than MAX_SIZE, or not UTF-8.
    """
    with Path(path).open("rb") as file:
        data = file.read(MAX_SIZE + 1)
    try:
        if len(data) <= MAX_SIZE:
            return data.decode()
    except UnicodeDecodeError as error:
        raise ContentError(f"{path}: byte {error.start}", error.reason, "UTF-8") from None
    raise ContentError(f"{path}: size", "too large", f"at most {MAX_SIZE} bytes")


class _Loader(_Safe):  # type: ignore[misc,valid-type]
    """Safe YAML loader that reads 1e-5 as a number and rejects duplicate keys."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        given = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode) and key.tag != "tag:yaml.org,2002:merge":
                if key.value in given:
                    line = key.start_mark.line + 1
                    raise ContentError(short(key.value), "given twice", f"once (line {line})")
                given.add(key.value)
        return super().construct_mapping(node, deep)


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[-+]?[0-9]+[eE][-+]?[0-9]+$"), list("-+0123456789")
)


def read_yaml(source: str | Path) -> Any:
    """Return the content of external YAML or JSON: a text, or a file if `source` is a Path.

    Raises:
        OSError: the file cannot be read.
        ContentError: it is too large, nested too deeply, has too many entries, or is not YAML; the
            message is one line.
    """
    if isinstance(source, Path):
        text = read_text(source)
        try:
            return read_yaml(text)
        except ContentError as error:
            raise ContentError(f"{source}: {error.field}", error.value, error.expected) from None
    if len(source) > MAX_SIZE:
        raise ContentError("text", "too large", f"at most {MAX_SIZE} characters")
    try:
        _check_bounds(source)
        return yaml.load(source, _Loader)
    except ContentError:
        raise
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        where = f"line {mark.line + 1}" if mark else "text"
        if mark and source[mark.index : mark.index + 1] == "\t":
            raise ContentError(where, "indented with a tab", "spaces") from None
        raise ContentError(where, error.problem, "YAML") from None
    except (yaml.YAMLError, ValueError, OverflowError) as error:
        raise ContentError("text", str(error).splitlines()[0], "YAML") from None


def _check_bounds(text: str) -> None:
    """Raise ContentError if a text exceeds the limits, before objects are created from it."""
    known: dict[str | None, tuple[int, int]] = {}  # entries and depth of parts with an anchor
    begun: list[list[Any]] = [["", 0, 0]]  # open parts: anchor, entries before it, depth
    total = 0
    for event in yaml.parse(text, _Loader):
        entries, depth = 0, 0
        if isinstance(event, yaml.CollectionStartEvent):
            begun.append([event.anchor, total, 0])
            entries, known[event.anchor] = 1, (1, MAX_DEPTH)  # a part within itself is too deep
        elif isinstance(event, yaml.CollectionEndEvent):
            anchor, before, depth = begun.pop()
            depth += 1
            known[anchor] = total - before, depth
        elif isinstance(event, yaml.ScalarEvent):
            entries, known[event.anchor] = 1, (1, 0)
        elif isinstance(event, yaml.AliasEvent):
            entries, depth = known.get(event.anchor, (1, 0))
        total += entries
        begun[-1][2] = max(begun[-1][2], depth)
        if len(begun) + begun[-1][2] > MAX_DEPTH + 1:
            line = event.start_mark.line + 1  # type: ignore[union-attr]  # as every event has one
            raise ContentError(f"line {line}", "nested too deeply", f"at most {MAX_DEPTH} levels")
        if total > MAX_ENTRIES:
            raise ContentError("text", "too long", f"at most {MAX_ENTRIES} entries")
