"""Command lines of commands that are not nodes."""

import argparse
import signal
import sys
from argparse import BooleanOptionalAction
from collections.abc import Callable, Sequence
from dataclasses import fields
from functools import wraps
from typing import Any, NoReturn, ParamSpec

from fss_arm_model.settings import default_in, default_text, meaning
from fss_arm_ros.libraries import required_libraries

P = ParamSpec("P")

USER_ERROR = 1  # exit code; a verdict other than pass has another one
INTERRUPTED = 130  # exit code after Ctrl-C


class Parser(argparse.ArgumentParser):
    """Argument parser that reports an error in one line, with exit code USER_ERROR.

    Options cannot be abbreviated: a new option would make an abbreviation ambiguous.
    """

    def __init__(self, prog: str, **options: Any) -> None:
        super().__init__(prog, allow_abbrev=False, **options)

    def error(self, message: str) -> NoReturn:
        """Exit with USER_ERROR."""
        self.exit(USER_ERROR, f"{self.prog}: {message}\n")


def default_settings(kind: type[Any], namespace: str) -> dict[str, Any]:
    """Return the default settings of a vehicle in a namespace."""
    return {f.name: default_in(f, namespace) for f in fields(kind)}


def add_settings(
    p: argparse.ArgumentParser, kind: type[Any], names: Sequence[str] | None = None
) -> None:
    """Add an option for each setting of a dataclass, or only for those in `names`."""
    for f in (f for f in fields(kind) if names is None or f.name in names):
        flag, about = f"--{f.name.replace('_', '-')}", meaning(f)
        if isinstance(f.default, bool):
            p.add_argument(flag, action=BooleanOptionalAction, default=f.default, help=about)
            continue
        several = f.default if isinstance(f.default, tuple) else ()
        p.add_argument(
            flag,
            type=type(several[0] if several else f.default),
            nargs=len(several) or None,
            default=f.default,
            metavar=f.name.split("_")[-1].upper() if isinstance(f.default, str) else "N",
            help=f"{about}{_default(f.default)}".replace("%", "%%"),
        )


def _default(value: Any) -> str:
    """Return a default as help shows it after the meaning, which names the effect of ''."""
    words = " ".join(map(default_text, value)) if isinstance(value, tuple) else default_text(value)
    return words and f" (default {words})"


def interrupt_at_end() -> None:
    """Handle SIGTERM and SIGHUP (a closed terminal) as Ctrl-C, so that the process cleans up."""
    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:  # as under nohup
            signal.signal(number, signal.default_int_handler)


def in_one_line(command: str) -> Callable[[Callable[P, int]], Callable[P, int]]:
    """Decorate a command's main: bad input, a missing library and Ctrl-C end in one line."""

    def decorate(main: Callable[P, int]) -> Callable[P, int]:
        @wraps(main)
        def guarded(*args: P.args, **options: P.kwargs) -> int:
            try:
                with required_libraries(command):
                    return main(*args, **options)
            except (ValueError, OSError) as error:
                print(f"{command}: {in_words(error)}", file=sys.stderr)
                return USER_ERROR
            except KeyboardInterrupt:
                return report_interrupt(command)

        return guarded

    return decorate


def report_interrupt(command: str) -> int:
    """Report in one line that a command was interrupted; return the exit code."""
    print(f"{command}: interrupted", file=sys.stderr)
    return INTERRUPTED


def in_words(error: object) -> str:
    """Return an error as one line; for an OSError, with the file's name if it is known."""
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return " ".join(str(error).split())
