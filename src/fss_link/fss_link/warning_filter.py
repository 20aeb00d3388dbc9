"""Rate limit of warnings in the log."""

import re
from collections import defaultdict
from collections.abc import Callable
from time import monotonic

NUMBERS = re.compile(r"[\d.]+")
BURST_LINES, LINE_INTERVAL = (
    10,
    10.0,
)  # lines of one kind at once, then one line per LINE_INTERVAL [s]


class WarningFilter:
    """Filter that passes only new warnings.

    A warning is not new while its words stay the same; numbers in it may change. A client may be
    refused a thousand times a second, each time for a new reason, so the rate is limited for each
    kind of warning.

    Args:
        clock: the time [s].
    """

    def __init__(self, clock: Callable[[], float] = monotonic) -> None:
        self._clock = clock
        self._words: dict[str, str] = {}  # by kind, without numbers
        self._due: dict[str, float] = defaultdict(
            float
        )  # end of the logged lines, one per LINE_INTERVAL

    def is_new(self, kind: str, text: str) -> bool:
        """Return True if a warning of this kind must be logged; an empty text ends the last one."""
        words = NUMBERS.sub("", text)
        before, self._words[kind] = self._words.get(kind, ""), words
        if words in ("", before):
            return False
        now = self._clock()
        due = max(self._due[kind], now)
        if due > now + LINE_INTERVAL * (BURST_LINES - 1):
            return False
        self._due[kind] = due + LINE_INTERVAL
        return True
