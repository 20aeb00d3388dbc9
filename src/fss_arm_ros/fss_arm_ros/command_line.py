"""What commands that are no nodes do with a wrong command line."""

import argparse
import signal
import sys
from collections.abc import Callable
from functools import wraps
from typing import Any, NoReturn, ParamSpec

from fss_arm_ros.libraries import required_libraries

P = ParamSpec("P")

USER_ERROR = 1  # a verdict that is not pass has a code of its own


class Parser(argparse.ArgumentParser):
    """Complains in one line, and not with the exit code of a failed calibration.

    An option has one name: its abbreviation might become another's with the next option.
    """

    def __init__(self, prog: str, **options: Any) -> None:
        super().__init__(prog, allow_abbrev=False, **options)

    def error(self, message: str) -> NoReturn:
        """Exit with USER_ERROR."""
        self.exit(USER_ERROR, f"{self.prog}: {message}\n")


def interrupt_at_end() -> None:
    """Have SIGTERM, and a terminal that closes, end this process as Ctrl-C does: it cleans up."""
    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:  # as under nohup
            signal.signal(number, signal.default_int_handler)


def in_one_line(command: str) -> Callable[[Callable[P, int]], Callable[P, int]]:
    """Decorate a command's main: bad input or a missing library ends in one line (USER_ERROR)."""

    def decorate(main: Callable[P, int]) -> Callable[P, int]:
        @wraps(main)
        def told(*args: P.args, **options: P.kwargs) -> int:
            try:
                with required_libraries(command):
                    return main(*args, **options)
            except (ValueError, OSError) as error:
                print(f"{command}: {in_words(error)}", file=sys.stderr)
                return USER_ERROR

        return told

    return decorate


def in_words(error: object) -> str:
    """What is wrong, on one line, and of which file."""
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    return " ".join(str(error).split())
