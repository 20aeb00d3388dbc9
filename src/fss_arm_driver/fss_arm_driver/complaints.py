"""Which warnings are worth a line of the log, however often something is found wrong."""

import re
from collections import defaultdict
from collections.abc import Callable
from time import monotonic

FIGURES = re.compile(r"[\d.]+")
BURST, PAUSE = 10, 10.0  # of each kind so many lines at once, then one in so long [s]


class Complaints:
    """Tells warnings that begin from those that go on.

    One goes on while its words stay the same; figures in them may change all the time. Who is
    refused may ask a thousand times a second and for ever new reasons: that is bounded for each
    kind of warning.

    Args:
        clock: the time [s].
    """

    def __init__(self, clock: Callable[[], float] = monotonic) -> None:
        self._clock = clock
        self._words: dict[str, str] = {}  # by kind, without figures
        self._due: dict[str, float] = defaultdict(float)  # by then a line each PAUSE was paid for

    def begins(self, kind: str, text: str) -> bool:
        """Whether to log a warning of this kind; an empty one ends the one before."""
        words = FIGURES.sub("", text)
        before, self._words[kind] = self._words.get(kind, ""), words
        if words in ("", before):
            return False
        now = self._clock()
        due = max(self._due[kind], now)
        if due > now + PAUSE * (BURST - 1):
            return False
        self._due[kind] = due + PAUSE
        return True
