"""A bad network between driver and link: which datagrams arrive, how often, and how late."""

from dataclasses import dataclass, field
from random import Random

from fss_arm_model.units import SECOND


@dataclass
class Network:
    """What becomes of each datagram; delays are uniform and in seconds."""

    loss: float = 0.2
    delay: float = 0.05
    jitter: float = 0.04  # to either side
    duplicated: float = 0.05  # share that comes twice
    overtaken: float = 0.05  # share that comes another 0.3 s later
    down: bool = False
    rng: Random = field(default_factory=lambda: Random(1))

    def arrivals(self, now):
        """When a datagram sent now [ns] arrives: never, once or twice."""
        rng = self.rng
        times = [] if self.down or rng.random() < self.loss else [self._arrival(now)]
        return times * 2 if times and rng.random() < self.duplicated else times

    def _arrival(self, now):
        late = 0.3 if self.rng.random() < self.overtaken else 0.0
        way = self.rng.uniform(self.delay - self.jitter, self.delay + self.jitter)
        return now + round((way + late) * SECOND)
