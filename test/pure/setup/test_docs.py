"""The documentation: tables as the code has them, links that lead somewhere, real commands."""

import os
import re
import shlex
import sys
from dataclasses import fields
from importlib import import_module
from importlib.metadata import distribution
from itertools import pairwise
from pathlib import Path
from typing import get_type_hints

import pytest
import yaml
from running import run_command

from fss_arm_bags.replay import is_command
from fss_arm_ros.program import Command, Program, named

ROOT = Path(__file__).resolve().parents[3]
PAGES = [
    *sorted(ROOT.glob("*.md")),
    *sorted((ROOT / "docs").rglob("*.md")),
    ROOT / "test/TRIALS.md",
]
#: Commands of the system and of ROS that the documentation may use.
SYSTEM = {
    *(".", "cd", "cmake", "colcon", "cp", "export", "make", "python", "ssh", "sudo", "systemctl"),
    *("cc", "dask", "git", "mkdir", "pip", "python3", "rosdep"),
    *("awk", "sed", "arduino-cli", "fast-discovery-server", "build/firmware/fss_link"),
    "build/base_firmware/fss_base",
}


ADDED = ("action", "daemon", "interface", "node", "param", "pkg", "service", "topic")


def commands():
    """Each command line in the pages' blocks of shell and in their text, with the page's name."""
    for page in PAGES:
        text = page.read_text()
        blocks = re.findall(r"^ *```sh\n(.*?)^ *```", text, re.M | re.S)
        lines = [line for block in blocks for line in block.replace("\\\n", " ").splitlines()]
        lines += re.findall(r"(?<!`)`((?:ros2 run|scripts/[\w.]+) [^`]+)`", text)
        for line in lines:
            words = shlex.split(line, comments=True)
            while words and re.match(r"\w+=", words[0]):  # a variable for the command
                del words[0]
            if words:
                yield pytest.param(words, id=f"{page.stem}: {' '.join(words)[:60]}")


def test_the_tables_are_those_of_the_code():
    run = run_command(sys.executable, ROOT / "scripts/make_docs.py", "--check")
    assert run.returncode == 0, run.stdout + run.stderr


def anchor(heading):
    """What a link to it is made of, as GitHub does."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_within_the_repository_and_names_of_files_lead_somewhere(page):
    place = r"\b(?:test|bench|src|config)/[\w/.]+\.(?:py|yaml|sh|msg|txt)\b"
    assert not [name for name in re.findall(place, page.read_text()) if not (ROOT / name).exists()]
    for target, _, part in re.findall(r"\]\(([^)#]*)(#([^)]+))?\)", page.read_text()):
        if not target.startswith("http"):
            place = page.parent / target if target else page
            assert place.exists(), target
            headings = re.findall(r"^#+ (.*)", place.read_text(), re.M) if part else []
            assert not part or part in map(anchor, headings), f"{target}#{part}"


def test_the_example_of_the_method_prints_each_parameter_with_its_deviation(capsys):
    page = (ROOT / "docs/explanation/method.md").read_text()
    (code,) = re.findall(r"^```python\n(.*?)^```", page, re.M | re.S)
    exec(compile(code, "method.md", "exec"), {})
    *rows, last = capsys.readouterr().out.splitlines()
    table = {name: (float(value), float(sigma)) for name, value, _, sigma in map(str.split, rows)}
    assert len(table) == 8  # one length for all links but the last, four in all: n + 4
    for name, truth in {"a": 0.3825, "a_4": 0.3351, "x_BJ1": 0.2058}.items():
        value, sigma = table[name]
        assert abs(value - truth) < 4 * sigma, name
    assert last.startswith("residuals 0.00")


@pytest.mark.parametrize(
    ("page", "row"),
    [("test/TRIALS.md", r"\| (?!\*\*|trial )"), ("docs/explanation/safety.md", r"\| \d+ \|")],
)
def test_each_trial_and_each_barrier_has_its_tests(page, row):
    text, _, _ = (ROOT / page).read_text().partition("\n## A hundred stops")
    cells = [line.split("|")[4] for line in text.splitlines() if re.match(row, line)]
    assert len(cells) > 20
    for cell in cells:
        check_tests(cell)


def check_tests(cell):
    """Check that a cell names tests that exist: a file, then its functions."""
    file = None
    for word in re.findall(r"`([\w/.]+)`", cell):
        if word.endswith(".py"):
            file = (ROOT / "test" / word).read_text()
        else:
            assert f"def {word}(" in file, word
    assert file, cell


def test_each_statement_removed_from_the_firmware_is_there_with_its_test():
    text = (ROOT / "test/TRIALS.md").read_text().partition("\n## Barriers of the firmware\n")[2]
    lines = text.partition("\n## ")[0].splitlines()
    rows = [line.split("|")[2:4] for line in lines if line.startswith("|")][2:]
    assert len(rows) > 20
    for removed, tests in rows:
        check_tests(tests)
        file = None
        for words in re.findall(r"`([^`]+)`", removed):
            if words.endswith((".cpp", ".hpp")):
                (place,) = ROOT.glob(f"src/*/firmware/core/{words}")
                file = " ".join(place.read_text().split())
            else:
                assert words in file, words


def test_the_code_of_each_barrier_is_there():
    text = (ROOT / "docs/explanation/safety.md").read_text()
    cells = [line.split("|")[3] for line in text.splitlines() if re.match(r"\| \d+ \|", line)]
    assert len(cells) == 33
    for cell in cells:
        file, names = "", []
        for word in re.findall(r"`([\w/.]+)`", cell):
            if word.endswith(".py"):
                (place,) = [*ROOT.glob(f"src/*/{word}"), *ROOT.glob(word)]
                file = place.read_text()
            else:
                assert re.search(rf"(def|class) {word}\(", file), word
                names.append(word)
        assert names, cell


def check_goal(name, kind, fields):
    """Of an action: its name is in the table, its type has these fields."""
    assert f"`{name.lstrip('/')}`" in (ROOT / "docs/reference/topics.md").read_text()
    package, _, action = kind.split("/")
    getattr(import_module(f"{package}.action"), action).Goal(**yaml.safe_load(fields))


@pytest.mark.parametrize("words", list(commands()))
def test_each_command_can_be_given(words):
    program, *arguments = [word for word in words if word != "..."]
    if program.startswith("scripts/"):
        assert os.access(ROOT / program, os.X_OK), program
        named = [word for word in arguments if word.startswith("config/")]
        assert all((ROOT / name).exists() for name in named), named
    elif [program, *arguments[:1]] == ["ros2", "run"]:
        check_node(*arguments[1:])
    elif arguments[:2] == ["action", "send_goal"]:
        check_goal(*(word for word in arguments[2:] if word != "--feedback"))
    elif program == "ros2":
        # Of the distribution, or added to the wheels: test_ros2cli.py runs those that can be there.
        assert arguments[0] in {"security", "bag", *ADDED}
    else:
        assert program in SYSTEM or program.startswith("("), program


def check_node(package, executable, *arguments):
    """That the program exists and takes these arguments, parameters with their types and limits."""
    entry = distribution(package).entry_points[executable]
    found = entry.load()
    if "--help" in arguments:
        return
    plain = arguments
    if "--ros-args" in arguments:
        plain = arguments[: arguments.index("--ros-args")]
    if not isinstance(found, Program):
        place = found.parser.partition(":")[0] if isinstance(found, Command) else found.__module__
        module = import_module(place)
        kind = [module.selected_kind(plain)] if hasattr(module, "selected_kind") else []
        module.parser(*kind).parse_args(plain)
        return
    settings = named(found.settings)
    hints, given = get_type_hints(settings), {}
    for flag, word in pairwise(arguments):
        if flag == "-p":
            name, _, text = word.partition(":=")
            value = yaml.safe_load(text)
            assert name in {f.name for f in fields(settings)} | {"use_sim_time"}, name
            if name in hints:
                given[name] = tuple(value) if isinstance(value, list) else hints[name](value)
    settings(**given)


def test_no_command_is_played_by_rosbag2_as_the_page_has_it():
    page = (ROOT / "docs/how-to/ros2cli.md").read_text()
    excluded = re.compile(re.search(r'--exclude-regex "([^"]+)"', page)[1])
    table = (ROOT / "docs/reference/topics.md").read_text().partition("`/clock`")[0]
    cells = re.findall(r"^\| (`[^|]*`) \|", table, re.M)
    topics = [f"/{t.strip('/')}" for cell in cells for t in re.findall(r"`([^`]+)`", cell)]
    topics = [topic.replace("<i>", "1") for topic in topics]
    assert len(topics) > 40
    for topic in topics:
        commands = is_command(topic) or topic.endswith("/path") or "arm_controller" in topic
        for name in (topic, f"/fss2{topic}"):
            assert bool(excluded.search(name)) == commands, name


SOURCES = "".join(
    path.read_text()
    for folder in (*ROOT.glob("src/*/fss_*"), ROOT / "scripts")
    for path in sorted(folder.rglob("*"))
    if path.suffix in (".py", ".js", ".sh") or path.name == "ros2"
)


@pytest.mark.parametrize(
    "message",
    re.findall(r"^\|[^`|]*`([^`]+)`", (ROOT / "docs/start/troubles.md").read_text(), re.M),
)
def test_each_trouble_is_one_that_a_program_tells(message):
    """Its words stand in a source, but for numbers and names, which are put in."""
    plain = re.sub(r'"\s*\n\s*f?"', "", SOURCES)  # texts of several lines
    parts = re.split(r" in ROS domain 0|\d+ ?s? ?|not (?:armed|referenced): ", message)
    for part in filter(str.strip, parts):
        assert part.strip() in plain, part
