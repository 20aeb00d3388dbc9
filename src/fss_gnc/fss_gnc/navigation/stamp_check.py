"""Plausibility of stamps, and the present in the time of the base's stamps."""

from collections import Counter, defaultdict
from collections.abc import Callable
from enum import Enum

from fss_arm_model.units import SECOND
from fss_arm_ros.stamps import MIN_SAMPLES, Stamps

MAX_LEAD = SECOND  # of a stamp; larger ones are accepted after MIN_SAMPLES in a row [ns]


class Verdict(Enum):
    """Verdict on a stamp; after a jump all earlier stamps are forgotten."""

    ACCEPTED = "accepted"
    FROM_FUTURE = "from the future"
    JUMPED_FORWARD = "jumped forward"
    JUMPED_BACK = "jumped back"


class StampCheck:
    """Stamps of several topics; only a row of stamps of the base proves that the time has jumped.

    Args:
        base_topic: topic of the base's poses.
        clock: returns the time of a clock that measures intervals [ns].
    """

    def __init__(self, base_topic: str, clock: Callable[[], int]) -> None:
        self.base_topic, self._clock = base_topic, clock
        self._reset()

    def _reset(self) -> None:
        self._stamps: dict[str, Stamps] = defaultdict(Stamps)  # by topic
        self._from_future: Counter[str] = Counter()  # consecutive stamps from the future, by topic
        self.newest = self._newest_arrival = -1  # of the base's newest pose [ns]

    def now(self) -> int:
        """Return the present in the time of the base's stamps [ns].

        Before the base's first pose, the first stamp of any topic is used instead.
        """
        return self.newest + max(self._clock() - self._newest_arrival, 0)

    def topics_ahead(self) -> list[str]:
        """Return the topics whose last stamp was from the future."""
        return [topic for topic, count in self._from_future.items() if count]

    def check(self, topic: str, t: int) -> Verdict:
        """Return the verdict on a stamp t [ns] that has just arrived."""
        verdict = Verdict.ACCEPTED
        if self.newest >= 0 and t > self.now() + MAX_LEAD:
            self._from_future[topic] += 1
            if self._from_future[topic] < MIN_SAMPLES or topic != self.base_topic:
                return Verdict.FROM_FUTURE
            self._reset()
            verdict = Verdict.JUMPED_FORWARD
        self._from_future[topic] = 0
        if self._stamps[topic].set_back(t) and topic == self.base_topic:
            self._reset()
            verdict = Verdict.JUMPED_BACK
        if self.newest < 0 or t == self._stamps[self.base_topic].newest:
            self.newest, self._newest_arrival = t, self._clock()
        return verdict
