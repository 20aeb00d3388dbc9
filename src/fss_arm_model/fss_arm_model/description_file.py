"""Read and write descriptions as YAML: of an arm, and of physical links by serial number.

`from_yaml(to_yaml(arm)) == arm` to the last bit.
"""

import json
import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import MISSING, Field, fields, is_dataclass, replace
from difflib import get_close_matches
from itertools import dropwhile
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from .description import (
    Arm,
    Base,
    Drive,
    Known,
    Link,
    TorqueSensor,
    check_count,
    paper_arm,
)
from .description_fields import DescriptionError, error_context
from .files import read_text, read_yaml, short, write_text

#: A link's own parameter, by its position in the arm or by the link's serial number.
POSITION_NAME = re.compile(r"(a|theta_0|m|b|I)_([1-9]\d*)")
SERIAL_NAME = re.compile(r"(a|theta_0|m|b|I)_#(\d+)")

#: Standard deviation of an unknown angle after another link was mounted first [rad].
UNKNOWN_ANGLE_SIGMA = math.radians(5.0)

#: Largest values in files by their unit, and the unit that a larger one probably has.
MAX_VALUES = {"m": (10.0, "millimetres"), "kg": (1000.0, "grams")}
MAX_GYRATION_RADIUS = 2.0  # [m]

#: Descriptions in the package, by the name that settings use.
ARMS = {"paper": "arm.yaml", "cad": "cad.yaml", "truth": "truth.yaml"}


def _entries(kind: type[Any]) -> str:
    return f"the entries {', '.join(f.name for f in fields(kind))}"


def _build(kind: type[Any], given: Any) -> Any:
    """Create a `kind` from YAML entries; `kind` itself rejects parts that are not mappings."""
    known = {f.name: f for f in fields(kind)}
    for key, value in given.items():
        if key not in known:
            near = get_close_matches(str(key), known, n=1)
            expected = f"the entry {near[0]}" if near else f"only {_entries(kind)}"
            raise DescriptionError(short(str(key)), value, expected)
    for f in known.values():
        required = f.default is MISSING and f.default_factory is MISSING
        if required and f.name not in given:
            raise DescriptionError(f.name, None, f.metadata["expected"])
    return kind(**{key: _read(key, value) for key, value in given.items()})


_PARTS = {"base": Base, "drive": Drive, "torque_sensor": TorqueSensor, "known": Known}


def _read(key: str, value: Any, kind: type[Any] | None = None) -> Any:
    if key == "links" and isinstance(value, list):
        check_count(value)
        return [_read(f"link {i}", link, Link) for i, link in enumerate(value, 1)]
    kind = kind or _PARTS.get(key)
    if kind is None or not isinstance(value, dict):
        return value
    with error_context(key):
        return _build(kind, value)


def link_file(folder: str | os.PathLike[str], serial: int) -> Path:
    """Return the path of the description of the physical link with this serial number."""
    return Path(folder) / f"link_{serial}.yaml"


def read_link(path: Path) -> tuple[Link, list[dict[str, Any]]]:
    """Read a physical link from its file, with the history of its calibrations.

    Raises:
        DescriptionError: it cannot be read, or its content is invalid.
    """
    try:
        with error_context(str(path)):
            given = read_yaml(read_text(path))
            if not isinstance(given, dict):
                raise DescriptionError("link", given, _entries(Link))
            history = given.pop("history", [])
            if not (isinstance(history, list) and all(isinstance(h, dict) for h in history)):
                raise DescriptionError("history", history, "a list of calibrations")
            link: Link = _build(Link, given)
            if link_file(path.parent, link.serial) != path:
                expected = f"the number in the file name {path.name}"
                raise DescriptionError("serial", link.serial, expected)
    except OSError as error:
        raise DescriptionError("links", path.name, f"a file: {error.strerror or error}") from None
    return link, history


def _with_link_files(given: dict[str, Any], folder: str | os.PathLike[str]) -> dict[str, Any]:
    """Return an arm's entries, with links given by serial number replaced by their files' content.

    The first joint's angle is then the sum of the base's part and the link's, because the link may
    be mounted elsewhere.
    """
    links = given.get("links")
    if not isinstance(links, list) or not any(type(link) is int for link in links):
        return given
    links = [read_link(link_file(folder, k))[0] if type(k) is int else k for k in links]
    base = _read("base", given.get("base"))
    if isinstance(base, Base) and type(given["links"][0]) is int:
        x, y, angle = base.mount
        base = replace(base, mount=(x, y, angle + links[0].theta_0))
        links[0] = replace(links[0], theta_0=0.0)
    known = _read("known", given.get("known", Known()))
    if isinstance(known, Known):
        known = _by_position(known, links)
    return {**given, "base": base, "links": links, "known": known}


def _by_position(known: Known, links: Sequence[Any]) -> Known:
    """Convert covariances of links from serial numbers to their present positions.

    The covariance of a link moves with it; that of a link that is not mounted is dropped. The first
    link's offset is part of theta_BJ1: if another link is first now, both are unknown.
    """
    if by_position := [name for name in known.names if POSITION_NAME.fullmatch(name)]:
        expected = "a name by serial number such as a_#7, because links are given by serial number"
        raise DescriptionError("known: names", by_position[0], expected)
    position = {link.serial: i for i, link in enumerate(links, 1) if isinstance(link, Link)}
    found = [SERIAL_NAME.fullmatch(name) for name in known.names]
    previous_serials = [int(m[2]) for m in found if m and m[1] == "a"]  # in order from the base
    names = [
        f"{m[1]}_{position.get(int(m[2]), m[2] + ' is not mounted')}" if m else name
        for m, name in zip(found, known.names, strict=True)
    ]
    mounted_names = [k for k in names if not k.endswith("mounted") and k != "theta_0_1"]
    renamed = replace(known, names=tuple(names)).only(mounted_names)
    unknown: list[str] = []
    if previous_serials and position.get(previous_serials[0]) != 1:
        unknown = [
            "theta_BJ1",
            *(f"theta_0_{position[k]}" for k in previous_serials[:1] if k in position),
        ]
    return (
        renamed.updated(unknown, UNKNOWN_ANGLE_SIGMA**2 * np.eye(len(unknown)))
        if unknown
        else renamed
    )


def from_yaml(text: str, folder: str | os.PathLike[str] = ".") -> Arm:
    """Return the arm that `text` describes; `folder` has the files of links by serial number.

    Raises:
        DescriptionError: it is not YAML, or an entry is missing, unknown, given twice or wrong.
    """
    with error_context(""):
        given = read_yaml(text)
    if not isinstance(given, dict):
        raise DescriptionError("arm", given, _entries(Arm))
    arm: Arm = _build(Arm, _with_link_files(given, folder))
    return arm


def load(path: str | os.PathLike[str]) -> Arm:
    """Read a description.

    Raises:
        OSError: the file cannot be read.
        DescriptionError: the content is invalid; the message names the file and the field.
    """
    with error_context(""):
        text = read_text(path)
    with error_context(str(path)):
        arm = from_yaml(text, Path(path).parent)
        with error_context("base"):
            _check_units(arm.base)
        for i, link in enumerate(arm.links, 1):
            with error_context(f"link {i}"):
                _check_units(link)
    return arm


def _check_units(part: Base | Link) -> None:
    """Raise DescriptionError if a value is so large that its unit must be wrong."""
    for f in fields(part):
        value, unit = getattr(part, f.name), f.metadata["unit"]
        largest, wrong_unit = MAX_VALUES.get(unit, (math.inf, ""))
        if isinstance(value, float) and abs(value) > largest:
            expected = f"at most {largest:g} [{unit}]; in {wrong_unit}?"
            raise DescriptionError(f.name, value, expected)
    largest = part.mass * MAX_GYRATION_RADIUS**2
    if part.inertia > largest:
        expected = f"at most {largest:g} [kg m^2] with this mass; in kg cm^2?"
        raise DescriptionError("inertia", part.inertia, expected)


def described(arm: str) -> Arm:
    """Return the arm that a setting names: one of ARMS, or a file; empty: the paper's.

    Raises:
        OSError: the file cannot be read.
        DescriptionError: there is no arm of that name, or the file's content is invalid.
    """
    if not arm:
        return paper_arm()
    if arm in ARMS:
        return load(_installed() / ARMS[arm])
    if Path(arm).name == arm and not Path(arm).suffix and not Path(arm).exists():
        raise DescriptionError("arm", arm, f"a file or one of {', '.join(ARMS)}")
    return load(arm)


def _installed() -> Path:
    """Return the folder of the descriptions in ARMS, in the source tree or where installed."""
    here = Path(__file__).resolve()
    if (here.parents[1] / "package.xml").exists():
        return here.parents[1] / "config"
    places = (folder / "share/fss_arm_model/config" for folder in here.parents)
    return next(filter(Path.is_dir, places))


def _scalar(value: Any) -> str:
    """Return the exact YAML of a value: the shortest decimals that give the same float."""
    if isinstance(value, tuple):
        return f"[{', '.join(map(_scalar, value))}]"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    text = repr(value)
    return text.replace("e", ".0e") if "e" in text and "." not in text else text


def _lines(part: Any, indent: str) -> Iterator[str]:
    """Yield the entries of a description's part, each with unit and meaning as a comment."""
    for f in fields(part):
        value = getattr(part, f.name)
        if f.name in ("serial", "begin", "end") and value == f.default:
            continue
        if f.name == "known" and not value.names:  # its times alone say nothing
            continue
        if is_dataclass(value):
            yield f"{indent}{f.name}:"
            yield from _lines(value, indent + "  ")
        elif f.name == "links":
            yield f"{indent}links:"
            for i, link in enumerate(value, 1):
                yield f"{indent}  # link {i}"
                first, *others = _lines(link, indent + "    ")
                yield f"{indent}  - {first.strip()}"
                yield from others
        elif f.name == "covariance":
            yield f"{indent}covariance:{_comment(f, value)}"
            yield from (f"{indent}  - {_scalar(row)}" for row in value)
        else:
            yield f"{indent}{f.name}: {_scalar(value)}{_comment(f, value)}"


def _comment(f: Field[Any], value: Any) -> str:
    unit, about = f.metadata["unit"], f.metadata["about"]
    angle = value[-1] if isinstance(value, tuple) else value
    if unit.split(", ")[-1] == "rad":
        unit += f" = {math.degrees(angle):.6g} deg"
    text = f"{f'[{unit}] ' if unit else ''}{about}".strip()
    return f"  # {text}" if text else ""


def to_yaml(arm: Arm, origin: Sequence[str] = ()) -> str:
    """Return the description as YAML, from which from_yaml creates an equal one.

    The lines of `origin`, which say where it is from, become comments.
    """
    head = "An arm and its base. SI units and radians; degrees in comments are not read."
    comments = [f"# {' '.join(line.split())}" for line in (head, *origin)]
    return "\n".join([*comments, *_lines(arm, "")]) + "\n"


def save(arm: Arm, path: str | os.PathLike[str]) -> None:
    """Write the description, and create its folder; a reader sees the old file or the new one.

    Raises:
        OSError: the file cannot be written.
    """
    write_text(path, to_yaml(arm))


def save_links(
    arm: Arm,
    path: str | os.PathLike[str],
    histories: Mapping[int, Sequence[Mapping[str, Any]]],
) -> None:
    """Write the description as a list of serial numbers, and the links' files next to it.

    The covariances (`known`) of links use serial numbers too, as `histories` does: they move with
    the links. The first link keeps the theta_0 of its file because theta_BJ1 is the sum of this
    angle and the mount's.

    Raises:
        OSError: a file cannot be written.
        DescriptionError: the first link's file is wrong.
    """
    folder, first = Path(path).parent, arm.links[0]
    if (file := link_file(folder, first.serial)).exists():
        first = replace(first, theta_0=read_link(file)[0].theta_0)
    for link in (first, *arm.links[1:]):
        entries = {"history": [*map(dict, histories[link.serial])]}
        history = yaml.safe_dump(entries, sort_keys=False, default_flow_style=None)
        head = "# A physical link. SI units and radians; a calibration's: value, deviation.\n"
        text = head + "\n".join(_lines(link, "")) + "\n" + history
        write_text(link_file(folder, link.serial), text)
    x, y, angle = arm.base.mount
    base = replace(arm.base, mount=(x, y, angle - first.theta_0))
    serials = [link.serial for link in arm.links]
    names = [
        f"{m[1]}_#{serials[int(m[2]) - 1]}" if (m := POSITION_NAME.fullmatch(name)) else name
        for name in arm.known.names
    ]
    known = replace(arm.known, names=tuple(names))
    before, _, after = to_yaml(replace(arm, base=base, known=known)).partition("links:\n")
    rest = dropwhile(lambda line: line.startswith(" "), after.splitlines())
    links = f"links: {serials}  # link_<serial>.yaml beside this file, from the base on"
    write_text(path, "\n".join([before + links, *rest]) + "\n")
