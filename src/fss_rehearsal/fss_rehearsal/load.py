"""Load of the computer during a rehearsal: an overloaded one makes the result invalid."""

from collections.abc import Mapping, Sequence
from math import inf

LOSSES = "times lost"  # counter of a link's driver
MAX_LAG = 1.0  # time by which the test bed may be late [s]; links then count as lost


class Load:
    """Signs of an overloaded computer, from the diagnostics of drivers and test bed."""

    def __init__(self) -> None:
        self.max_lag = 0.0  # largest time by which the test bed was late [s]
        self._least = inf  # smallest difference of real and simulated time [s]
        self._losses: dict[str, int] = {}  # by driver

    def add(self, node: str, stamp: float, values: Mapping[str, str]) -> None:
        """Add what a node reports at a time [s]."""
        if node.startswith("/link_") and LOSSES in values:
            self._losses[node] = int(values[LOSSES])
        elif node == "/testbed" and "simulated time [s]" in values:
            difference = stamp - float(values["simulated time [s]"])
            self._least = min(self._least, difference)
            self.max_lag = max(self.max_lag, difference - self._least)

    @property
    def losses(self) -> int:
        """Number of times that a link was lost."""
        return sum(self._losses.values())


def overload(loads: Sequence[Load]) -> str:
    """Return a sentence if the computer was too slow in a session, else an empty string."""
    losses, lag = sum(load.losses for load in loads), max(load.max_lag for load in loads)
    if not losses and lag < MAX_LAG:
        return ""
    return (
        f"the result is not valid, because the computer was overloaded (links lost {losses} times, "
        f"test bed late by up to {lag:.1f} s)"
    )
