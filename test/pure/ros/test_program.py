"""What executables import: little to tell what they are for, nothing that computes to begin."""

import re
import sys
from importlib.metadata import distribution
from inspect import getdoc
from pathlib import Path

import pytest
from running import run_command

from fss_arm_ros.command_line import in_one_line, in_words
from fss_arm_ros.libraries import LIBRARIES
from fss_arm_ros.program import Command, Program, docstring, named

PACKAGES = sorted(path.parent.name for path in Path(__file__).parents[3].glob("src/*/setup.py"))
EXECUTABLES = [entry for package in PACKAGES for entry in distribution(package).entry_points]
PROGRAMS = [entry for entry in EXECUTABLES if isinstance(entry.load(), Program)]
COMPUTING = {"numba", "scipy", "matplotlib", "rerun"}
NEEDED = {"numpy", "yaml"}  # by nearly every module

HELP = """
import contextlib, io, sys
from importlib.metadata import distribution
avoided = set(sys.argv[1].split())
for package in sys.argv[2:]:
    for entry in distribution(package).entry_points:
        sys.argv = [entry.name, "--help"]
        with contextlib.redirect_stdout(io.StringIO()) as told, contextlib.suppress(SystemExit):
            entry.load()()
        assert entry.name in told.getvalue()
        assert not avoided & sys.modules.keys(), f"{package} {entry.name}"
"""


def run(code, *arguments):
    done = run_command(sys.executable, "-c", code, *arguments)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_help_imports_neither_ros_nor_what_computes_or_may_be_missing():
    run(HELP, " ".join({*COMPUTING, "rclpy", *LIBRARIES} - NEEDED), *PACKAGES)


def test_nodes_import_nothing_that_computes_before_they_are_made():
    """But the view, which draws."""
    made = {one.load().make.partition(":")[0] for one in PROGRAMS if one.name != "view"}
    modules = run(f"import sys, {', '.join(sorted(made))}; print(*sys.modules)")
    assert not set(modules.split()) & COMPUTING


@pytest.mark.parametrize("entry", PROGRAMS, ids=lambda entry: entry.name)
def test_help_has_the_words_of_what_it_runs_for_users(entry):
    program = entry.load()
    assert docstring(program.make) == getdoc(named(program.make))
    assert named(program.settings)
    told, usage = program.about, program.usage(entry.name)
    assert told
    assert " ".join(told.split()) in " ".join(usage.split())
    assert not [line for line in usage.splitlines() if len(line) > 80]
    assert not re.search(r"\.\d{11}", usage)  # an angle converted from degrees
    assert not re.search(r"^(Args|Raises|Returns):", told, re.MULTILINE)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--help"], True),
        (["bag", "-h"], True),
        (["--ros-args", "-p", "a:=1", "--", "--help"], True),
        (["--ros-args", "-r", "--help"], False),
        ([], False),
    ],
)
def test_help_is_for_plain_arguments(monkeypatch, capsys, arguments, told):
    ran = []
    monkeypatch.setattr("fss_arm_ros.run.run", lambda make, argv, takes: ran.append(argv) or 0)
    program = Program(
        "fss_arm_bags.replay_node:ReplayNode",
        "fss_arm_bags.settings:ReplaySettings",
        takes="BAG...",
        short={"--hold": "hold:=true"},
    )
    assert program(["lib/replay", *arguments]) == 0
    assert bool(ran) != told
    assert ("replay BAG... [--hold] [--ros-args" in capsys.readouterr().out) == told


def test_a_flag_is_short_for_its_parameter(monkeypatch):
    ran = []
    monkeypatch.setattr("fss_arm_ros.run.run", lambda make, argv, takes: ran.append(argv) or 3)
    program = Program("collections:Counter", "collections:Counter", short={"--hold": "hold:=true"})
    assert program(["replay", "--hold", "bag"]) == 3
    assert ran == [["replay", "bag", "--ros-args", "-p", "hold:=true"]]


def interrupt(*_):
    raise KeyboardInterrupt


def test_an_interrupted_command_ends_in_one_line(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["/somewhere/from_bag"])
    assert Command(f"{__name__}:interrupt", "argparse:ArgumentParser")([]) == 130
    assert capsys.readouterr().err == "from_bag: interrupted\n"
    assert in_one_line("plan")(interrupt)() == 130
    assert capsys.readouterr().err == "plan: interrupted\n"


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (OSError(28, "No space left on device", "a.yaml"), "a.yaml: No space left on device"),
        (OSError(28, "No space left on device"), "No space left on device"),
        (OSError("no answer"), "no answer"),
        (ValueError("two\nlines"), "two lines"),
    ],
)
def test_an_error_is_one_line_without_its_number(error, words):
    assert in_words(error) == words


def test_a_command_runs_with_its_arguments():
    assert Command("builtins:len", "argparse:ArgumentParser")(["a", "b"]) == 2
