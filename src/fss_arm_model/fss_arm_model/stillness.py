"""Detect if a joint is at rest: its readings stay within a threshold of each other."""


class Run:
    """The current run of a joint's readings that stay within a threshold of each other.

    Stamps are in nanoseconds, -1: none.
    """

    def __init__(self) -> None:
        self.start = self.last = -1  # its first and its latest reading
        self.moved = -1  # the last reading before it
        self.low = self.high = 0.0

    def holds(self, q: float, threshold: float) -> bool:
        """Return True if a reading q [rad] is still within the threshold of the run."""
        return self.start >= 0 and max(self.high, q) - min(self.low, q) <= threshold

    def add(self, t: int, q: float, threshold: float) -> None:
        """Add a reading at stamp t to the run, or start a new run with it."""
        if self.holds(q, threshold):
            self.low, self.high = min(self.low, q), max(self.high, q)
        else:
            self.moved, self.start, self.low, self.high = self.last, t, q, q
        self.last = t
