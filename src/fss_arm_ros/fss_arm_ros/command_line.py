"""What commands that are no nodes do with a wrong command line."""

import argparse
from typing import Any, NoReturn

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
