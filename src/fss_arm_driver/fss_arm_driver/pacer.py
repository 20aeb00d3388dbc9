"""Keeps what is sent at irregular times to a rate. Times are the caller's, in nanoseconds."""

SECOND = 1_000_000_000  # [ns]


class Pacer:
    """Says when the next may go out; a stream of that very rate, however it jitters, never waits.

    The generic cell rate algorithm (ITU-T I.371), with half an interval of tolerance.

    Args:
        rate: the most in the long run [1/s].
    """

    def __init__(self, rate: float) -> None:
        self._interval = round(SECOND / rate)
        self._due = 0  # when the next would be at that rate

    def wait(self, now: int) -> int:
        """How long the next must wait [ns]; 0: it may go."""
        if self._due > now + 2 * self._interval:  # the clock was set back
            self._due = now
        return max(0, self._due - self._interval // 2 - now)

    def sent(self, now: int) -> None:
        """Learn that one goes out now, whether it had to wait or not."""
        self._due = max(self._due, now) + self._interval
