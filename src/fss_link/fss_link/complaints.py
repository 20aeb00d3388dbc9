"""Rate limit of warnings in the log."""

import re
from collections import defaultdict
from collections.abc import Callable
from time import monotonic

FIGURES = re.compile(r"[\d.]+")
BURST, PAUSE = 10, 10.0  # lines of one kind at once, then one line per PAUSE [s]


class Complaints:
    """Filter that passes only new warnings.

    A warning is not new while its words stay the same; numbers in it may change. A client may be
    refused a thousand times a second, each time for a new reason, so the rate is limited for each
    kind of warning.

    Args:
        clock: the time [s].
    """

    def __init__(self, clock: Callable[[], float] = monotonic) -> None:
        self._clock = clock
        self._words: dict[str, str] = {}  # by kind, without figures
        self._due: dict[str, float] = defaultdict(float)  # end of the logged lines, one per PAUSE

    def begins(self, kind: str, text: str) -> bool:
        """Return True if a warning of this kind must be logged; an empty text ends the last one."""
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
