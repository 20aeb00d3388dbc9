"""Generate docs/reference: messages (interfaces.md), settings (parameters.md), description.md."""

import argparse
import sys
from collections.abc import Iterator
from dataclasses import MISSING, fields
from importlib.metadata import distribution
from inspect import getdoc
from pathlib import Path
from typing import Any, get_type_hints

from fss_arm_model.description import Arm, Base, Drive, Link, TorqueSensor
from fss_arm_model.settings import default_text, meaning
from fss_arm_ros.common_parameter import ABOUT, ALLOW
from fss_arm_ros.program import Command, Program, named

ROOT = Path(__file__).resolve().parents[1]
MESSAGES = ROOT / "src/fss_arm_msgs"
REFERENCE = ROOT / "docs/reference"
NOTE = "Made by `scripts/make_docs.py`; do not edit it by hand."


def interfaces() -> str:
    """Return a table for each message, service and action."""
    parts = ["# Messages, services, actions", NOTE]
    parts += ["See [`messages.md`](messages.md) for the rules of changes."]
    for kind in ("msg", "srv", "action"):
        for path in sorted((MESSAGES / kind).glob(f"*.{kind}")):
            parts += interface(path)
    return "\n\n".join(parts) + "\n"


def interface(path: Path) -> Iterator[str]:
    """Yield the heading, the leading comment and the tables of one file."""
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
    """Return the comment at the top in one line, then the lines after it."""
    count = next(k for k, line in enumerate(lines) if not line.startswith("#"))
    return [" ".join(line.lstrip("# ") for line in lines[:count]), *lines[count:]]


def _rows(lines: list[str]) -> Iterator[str]:
    """Yield a row for each field or constant, with its comment and the comment lines below it.

    After an empty line, a comment line describes the fields that follow: it gets its own row.
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
    """Return a table of parameters for each node."""
    parts = ["# Parameters", NOTE]
    parts += ["Set them with `--ros-args -p NAME:=VALUE`; the node's `--help` lists them, too."]
    parts += [
        "Built-in arms: `paper`, as published ([comparison](../explanation/paper.md)); `cad`, that "
        "arm as designed, before its calibration; `truth`, the arm that the test bed simulates."
    ]
    parts += [
        "A file (`--params-file`) may set a parameter of all nodes (`/**:`), as `base_radius`, "
        "or of a node in any namespace (`/**/dynamic:`). "
        "But many names, such as `arm`, `rate`, `tolerance`, `acceleration` or `output`, mean "
        "something else in other nodes: compare the tables first. A node refuses parameters that "
        "it does not have, except from `/**:`. The test bed also has its "
        "[faults](../explanation/simulator.md#faults) as parameters."
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
                if live := found.live_fields():
                    parts += ["Also settable while it runs, by `ros2 param set`:"]
                    parts += [_table({n: (f, "float") for n, f in live.items()})]
            else:
                command = found if isinstance(found, Command) else sys.modules[found.__module__]
                words = (getattr(command, "about", command.__doc__) or "").split("\n\n")[0]
                words = " ".join(words.split())
                commands.append(f"- `ros2 run {package} {entry.name} --help`: {words}")
    parts += ["## Commands", "`--help` lists their arguments:", "\n".join(commands)]
    return "\n\n".join(parts) + "\n"


def _parameters(settings: type) -> str:
    """Return the table of one settings dataclass."""
    hints, found = get_type_hints(settings), {}
    for f in fields(settings):  # type: ignore[arg-type]
        kind = getattr(hints[f.name], "__name__", str(hints[f.name]))
        if kind == "tuple":
            kind = f"list of {hints[f.name].__args__[0].__name__}"
        found[f.name] = f, kind
    return _table(found)


def _table(parameters: dict[str, tuple[Any, str]]) -> str:
    """Return a table of parameters: field and type, by name."""
    rows = ["| parameter | type | default | |", "|---|---|---|---|"]
    for name, (f, kind) in parameters.items():
        default = default_text(f.default)
        rows.append(_row(f"`{name}`", kind, default and f"`{default}`", meaning(f)))
    return "\n".join(rows)


def description() -> str:
    """Return a table of fields for each part of a description."""
    parts = ["# The description of an arm and its base", NOTE]
    parts += [
        "A YAML file such as `config/cad.yaml`; nodes read it with `arm:=FILE`, commands with "
        "`--arm FILE`. Required entries have no default. Errors name the missing, unknown or wrong "
        "entry, and the expected value."
    ]
    for title, kind in (
        ("The file", Arm),
        ("`base`", Base),
        ("each of `links`, from the base on", Link),
        ("`drive` of a link", Drive),
        ("`torque_sensor` of a link", TorqueSensor),
    ):
        rows = ["| entry | default | |", "|---|---|---|"]
        for f in fields(kind):
            given = f.default is MISSING and f.default_factory is MISSING
            default = (
                "**required**" if given else "" if f.default is MISSING else default_text(f.default)
            )
            unit = f" [{f.metadata['unit']}]" if f.metadata["unit"] else ""
            words = f"{f.metadata['about']}{unit}".strip() or f.metadata["expected"]
            rows.append(_row(f"`{f.name}`", default, words))
        parts += [f"## {title}", (getdoc(kind) or "").split("\n\n")[0], "\n".join(rows)]
    return "\n\n".join(parts) + "\n"


def _row(*cells: str) -> str:
    safe = (cell.replace("|", "\\|") for cell in cells)
    return "| " + " | ".join(safe) + " |"


def main() -> int:
    """Run; with --check, exit with 1 if a file is out of date."""
    parser = argparse.ArgumentParser("make_docs.py", description=__doc__)
    parser.add_argument("--check", action="store_true", help="list outdated files, write nothing")
    check = parser.parse_args().check
    old = []
    made = {"interfaces.md": interfaces, "parameters.md": parameters, "description.md": description}
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
