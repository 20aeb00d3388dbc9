"""Executables whose `--help` imports neither ROS nor numerical code.

Each package lists its executables in `programs.py` by the names of modules, which are imported
only to run.
"""

import ast
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import Field, dataclass, field, fields
from importlib import import_module
from importlib.util import find_spec
from inspect import cleandoc
from pathlib import Path
from textwrap import fill
from typing import Any

from fss_arm_model.settings import default_text, meaning
from fss_arm_ros.command_line import report_interrupt
from fss_arm_ros.common_parameter import ABOUT, ALLOW
from fss_arm_ros.libraries import required_libraries


def _wrapped(text: str, margin: str = "", hanging: str = "") -> str:
    """Return a paragraph in lines of 80 columns; long words, such as addresses, stay whole."""
    return fill(
        text,
        80,
        initial_indent=margin,
        subsequent_indent=hanging or margin,
        break_long_words=False,
        break_on_hyphens=False,
    )


def _described(name: str, f: Field[Any]) -> list[str]:
    """Return the lines of a parameter: name and default, meaning."""
    default = default_text(f.default) or "''"
    return [
        _wrapped(f"{name} (default {default})", "  ", "      "),
        _wrapped(meaning(f), "      "),
    ]


def named(place: str) -> Any:
    """Import and return the object MODULE:NAME."""
    module, _, name = place.partition(":")
    return getattr(import_module(module), name)


def docstring(place: str) -> str:
    """Return the docstring of the class or function MODULE:NAME without importing the module."""
    module, _, name = place.partition(":")
    spec = find_spec(module)
    source = Path(spec.origin if spec and spec.origin else "").read_text(encoding="utf-8")
    kinds = (ast.ClassDef, ast.FunctionDef)
    found = [one for one in ast.parse(source).body if isinstance(one, kinds) and one.name == name]
    return cleandoc(ast.get_docstring(found[0]) or "")


@dataclass(frozen=True)
class Command:
    """An executable that is not a node; places are MODULE:NAME."""

    main: str  # place of its main function
    parser: str  # place of the function that returns its argparse.ArgumentParser

    @property
    def about(self) -> str:
        """Description shown by `--help`."""
        return import_module(self.parser.partition(":")[0]).__doc__ or ""

    def __call__(self, args: Sequence[str] | None = None) -> int:
        """Run with a command line (default sys.argv); return the exit code."""
        given = sys.argv[1:] if args is None else list(args)
        if {"-h", "--help"} & set(given):
            named(self.parser)().parse_args(given)
        name = Path(sys.argv[0]).name
        try:
            with required_libraries(name):
                code: int = named(self.main)(given)
        except KeyboardInterrupt:
            return report_interrupt(name)
        return code


@dataclass(frozen=True)
class Program:
    """An executable that runs nodes; places are MODULE:NAME."""

    make: str  # place of the node's class, or of a function that returns nodes
    settings: str  # place of the dataclass of its parameters
    of: str = ""  # place of the first argument of `make`, if any
    takes: str = ""  # plain arguments, such as `BAG...`; empty: none
    short: Mapping[str, str] = field(default_factory=dict)  # flags and the parameters they set
    live: str = ""  # place of a function: dataclasses of parameters settable later, by prefix

    @property
    def about(self) -> str:
        """Description shown by `--help`: ABOUT of the settings, if any, and docstring of `make`.

        Args and later sections of the docstring are left out.
        """
        said = getattr(named(self.settings), "ABOUT", "")
        words = docstring(self.make).partition("\n\nArgs:")[0]
        return "\n\n".join(filter(None, [said, words]))

    def live_fields(self) -> dict[str, Field[Any]]:
        """Return the fields that are settable while the node runs; numbers of prefixes are <i>."""
        kinds = named(self.live)() if self.live else {}
        return {
            f"{re.sub(r'[0-9]+$', '<i>', prefix)}.{f.name}": f
            for prefix, kind in kinds.items()
            for f in fields(kind)
        }

    def usage(self, name: str) -> str:
        """Return the help: purpose, and parameters with their defaults."""
        plain = " ".join([name, self.takes, *(f"[{flag}]" for flag in self.short)])
        lines = [" ".join(plain.split()) + " [--ros-args -p PARAMETER:=VALUE ...]", ""]
        lines += ["\n\n".join(map(_wrapped, self.about.split("\n\n"))), ""]
        for f in fields(named(self.settings)):
            lines += _described(f.name, f)
        lines += [f"  {ALLOW} (default false)", _wrapped(ABOUT, "      ")]
        live = self.live_fields()
        lines += ["", "Also settable while it runs (ros2 param set):", ""] if live else []
        for parameter, f in live.items():
            lines += _described(parameter, f)
        return "\n".join(lines)

    def __call__(self, args: Sequence[str] | None = None) -> int:
        """Run with a command line (default sys.argv); return the exit code."""
        argv = list(sys.argv if args is None else args)
        name = Path(argv[0]).name
        if {"-h", "--help"} & set(_own_arguments(argv)):
            print(self.usage(name))
            return 0
        for flag, parameter in self.short.items():
            if flag in argv:
                argv.remove(flag)
                argv += ["--ros-args", "-p", parameter]
        with required_libraries(name):
            from fss_arm_ros.run import run

            make, of = named(self.make), [named(self.of)] if self.of else []
            return run(lambda *plain: make(*of, *plain), argv, self.takes)


def _own_arguments(argv: Sequence[str]) -> list[str]:
    """Return the arguments outside of `--ros-args ... --`."""
    plain, for_ros = [], False
    for word in argv[1:]:
        if word == "--ros-args" or (for_ros and word == "--"):
            for_ros = not for_ros
        elif not for_ros:
            plain.append(word)
    return plain
