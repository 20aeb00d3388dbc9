"""What commands that are no nodes do with a wrong command line."""

import argparse
from typing import NoReturn

USER_ERROR = 1  # a verdict that is not pass has a code of its own


class Parser(argparse.ArgumentParser):
    """Complains in one line, and not with the exit code of a failed calibration."""

    def error(self, message: str) -> NoReturn:
        """Exit with USER_ERROR."""
        self.exit(USER_ERROR, f"{self.prog}: {message}\n")
