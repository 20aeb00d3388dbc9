"""Rate limit for messages at irregular times. Times are the caller's, in nanoseconds."""

from fss_arm_model.units import SECOND


class Pacer:
    """Rate limiter for the times at which messages may be sent.

    It is the generic cell rate algorithm (ITU-T I.371) with a tolerance of half an interval, so
    that a stream of the same rate may jitter.

    Args:
        rate: highest mean rate [1/s].
    """

    def __init__(self, rate: float) -> None:
        self._interval = round(SECOND / rate)
        self._due = 0  # when the next message would be due at that rate

    def wait(self, now: int) -> int:
        """Return how long the next message must wait [ns]; 0: it may be sent."""
        if self._due > now + 2 * self._interval:  # the clock was set back
            self._due = now
        return max(0, self._due - self._interval // 2 - now)

    def sent(self, now: int) -> None:
        """Note that a message is sent now, whether it had to wait or not."""
        self._due = max(self._due, now) + self._interval
