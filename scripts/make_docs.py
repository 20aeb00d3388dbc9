"""Make docs/reference/: messages in interfaces.md, settings in parameters.md, description.md."""

import argparse
import sys
from collections.abc import Iterator
from dataclasses import MISSING, fields
from importlib.metadata import distribution
from inspect import getdoc
from pathlib import Path
from typing import Any, get_type_hints

from fss_arm_model.description import Arm, Base, Drive, Link, TorqueSensor
from fss_arm_model.settings import meaning
from fss_arm_ros.program import ABOUT, ALLOW, Command, Program, named

ROOT = Path(__file__).resolve().parents[1]
MESSAGES = ROOT / "src/fss_arm_msgs"
REFERENCE = ROOT / "docs/reference"
NOTE = "Made by `scripts/make_docs.py`; do not edit it by hand."


def interfaces() -> str:
    """All messages, services and actions, a table each."""
    parts = ["# Messages, services, actions", NOTE]
    parts += ["How they may change is said in [`messages.md`](messages.md)."]
    for kind in ("msg", "srv", "action"):
        for path in sorted((MESSAGES / kind).glob(f"*.{kind}")):
            parts += interface(path)
    return "\n\n".join(parts) + "\n"


def interface(path: Path) -> Iterator[str]:
    """The heading, the words and the tables of one file."""
    yield f"## `fss_arm_msgs/{path.suffix[1:]}/{path.stem}`"
    names = {
        ".msg": [""],
        ".srv": ["Request", "Response"],
        ".action": ["Goal", "Result", "Feedback"],
    }
    words, *lines = _leading_comment(path.read_text(encoding="utf-8").splitlines())
    yield words
    sections: list[list[str]] = [[]]
    for line in lines:
        if line.strip() == "---":
            sections.append([])
        else:
            sections[-1].append(line)
    for name, section in zip(names[path.suffix], sections, strict=True):
        rows = list(_rows(section))
        if name:
            yield f"{name}:" if rows else f"{name}: empty."
        if rows:
            yield "\n".join(["| type | field | |", "|---|---|---|", *rows])


def _leading_comment(lines: list[str]) -> list[str]:
    """The comment at the top in one line, then the lines after it."""
    count = next(k for k, line in enumerate(lines) if not line.startswith("#"))
    return [" ".join(line.lstrip("# ") for line in lines[:count]), *lines[count:]]


def _rows(lines: list[str]) -> Iterator[str]:
    """A row for each field or constant, with its comment and those on lines of their own below.

    After an empty line, such a comment is about what follows: a row of its own.
    """
    rows: list[list[str]] = []
    apart = False
    for line in lines:
        code, _, comment = (part.strip() for part in line.partition("#"))
        if code:
            kind, name = code.split(maxsplit=1)
            rows.append([f"`{kind}`", f"`{name}`", comment])
        elif comment and rows and not apart:
            rows[-1][2] += f" {comment}"
        elif comment:
            rows.append(["", "", comment])
        apart = not code and not comment
    for row in rows:
        yield _row(*row)


def parameters() -> str:
    """All nodes' parameters, a table each."""
    parts = ["# Parameters", NOTE]
    parts += ["Each is given as `--ros-args -p NAME:=VALUE`; the node's `--help` shows them, too."]
    parts += [
        "A file (`--params-file`) may give some to all nodes (`/**:`): each takes those it has. "
        "Whatever else a node does not have, it refuses."
    ]
    parts += [f"All nodes have `{ALLOW}` (false): {ABOUT}."]
    commands = []
    for package in sorted(path.parent.name for path in ROOT.glob("src/*/setup.py")):
        for entry in sorted(distribution(package).entry_points):
            found = entry.load()
            if isinstance(found, Program):
                words = found.about.split("\n\n")[0].replace("\n", " ")
                table = _parameters(named(found.settings))
                parts += [f"## `{package} {entry.name}`", words, table]
            else:
                command = found if isinstance(found, Command) else sys.modules[found.__module__]
                words = (getattr(command, "about", command.__doc__) or "").split("\n\n")[0]
                words = " ".join(words.split())
                commands.append(f"- `ros2 run {package} {entry.name} --help`: {words}")
    parts += ["## Commands", "These take arguments, and say which:", "\n".join(commands)]
    return "\n\n".join(parts) + "\n"


def _parameters(settings: type) -> str:
    """The table of one settings dataclass."""
    hints = get_type_hints(settings)
    rows = ["| parameter | type | default | |", "|---|---|---|---|"]
    for f in fields(settings):  # type: ignore[arg-type]
        kind = getattr(hints[f.name], "__name__", str(hints[f.name]))
        if kind == "tuple":
            kind = f"list of {hints[f.name].__args__[0].__name__}"
        default = _shown(f.default)
        rows.append(_row(f"`{f.name}`", kind, default and f"`{default}`", meaning(f)))
    return "\n".join(rows)


def description() -> str:
    """The fields of a description, a table for each of its parts."""
    parts = ["# The description of an arm and its base", NOTE]
    parts += [
        "A YAML file, as `config/cad.yaml`; `arm:=FILE` gives it to nodes, `--arm FILE` to "
        "commands. What is required has no default. An entry that is missing, unknown or wrong is "
        "named with its place and what was expected."
    ]
    for title, kind in (
        ("The file", Arm), ("`base`", Base), ("each of `links`, from the base on", Link),
        ("`drive` of a link", Drive), ("`torque_sensor` of a link", TorqueSensor),
    ):  # fmt: skip
        rows = ["| entry | default | |", "|---|---|---|"]
        for f in fields(kind):
            given = f.default is MISSING and f.default_factory is MISSING
            default = "**required**" if given else "" if f.default is MISSING else _shown(f.default)
            unit = f" [{f.metadata['unit']}]" if f.metadata["unit"] else ""
            words = f"{f.metadata['about']}{unit}".strip() or f.metadata["expected"]
            rows.append(_row(f"`{f.name}`", default, words))
        parts += [f"## {title}", (getdoc(kind) or "").split("\n\n")[0], "\n".join(rows)]
    return "\n\n".join(parts) + "\n"


def _shown(default: Any) -> str:
    """As a parameters file has it; empty for an empty string."""
    if isinstance(default, tuple):
        return f"[{', '.join(map(_shown, default))}]"
    if isinstance(default, float):
        return min(repr(default), f"{default:.6g}", key=len) if default % 1 else repr(default)
    return str(default).lower() if isinstance(default, bool) else str(default)


def _row(*cells: str) -> str:
    safe = (cell.replace("|", "\\|").replace("<", "&lt;") for cell in cells)
    return "| " + " | ".join(safe) + " |"


def main() -> int:
    """Run; with --check, exit with 1 if a file is not as it would be made."""
    parser = argparse.ArgumentParser("make_docs.py", description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing, list what is old")
    check = parser.parse_args().check
    old = []
    made = {
        "interfaces.md": interfaces, "parameters.md": parameters, "description.md": description,
    }  # fmt: skip
    for name, make in made.items():
        path, text = REFERENCE / name, make()
        if path.exists() and path.read_text(encoding="utf-8") == text:
            continue
        old.append(name)
        if not check:
            path.write_text(text, encoding="utf-8")
    if check and old:
        print(f"docs/reference: {' and '.join(old)} not up to date; run scripts/make_docs.py")
    return 1 if check and old else 0


if __name__ == "__main__":
    sys.exit(main())
