"""Command lines of commands that are not nodes."""

import argparse
import signal
import sys
from collections.abc import Callable
from functools import wraps
from typing import Any, NoReturn, ParamSpec

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
