"""Radio channel that links and base share: delay and loss of datagrams.

The model is a simplified distributed coordination of IEEE 802.11. One station sends at a time; the
others wait, in the order of their requests. An attempt starts when the channel is free, after a
random number of slots. Its airtime covers the bytes and the overhead. It fails through loss or
through a collision, which is more likely if there are fewer slots to choose from. A failed attempt
is repeated with twice as many slots, until the retries are used up.

Loss occurs in bursts (Gilbert 1960, Elliott 1963): each station is out of reach at random times,
for random durations.
"""

from collections import deque
from dataclasses import dataclass
from random import Random

from fss_arm_model.settings import NOT_NEGATIVE, POSITIVE, Settings, above, between, setting
from fss_arm_model.units import SECOND

SLOT_TIME, MIN_SLOTS, MAX_SLOTS = 20_000, 32, 1024  # 802.11b slot [ns]; slots at first and at most
HEADERS = 8 + 20 + 36  # bytes of the UDP, IP and 802.11 headers of a datagram
INTERFERING_SIZE = 1500  # bytes of the datagrams of interfering stations
UTILIZATION_WINDOW = SECOND  # time over which the use of the channel is measured [ns]


@dataclass(frozen=True)
class Radio(Settings):
    """Parameters of an 802.11b channel, whose stations use the second lowest usual rate."""

    rate: float = setting(2e6, "bit rate of the radio channel", unit="bit/s", check=POSITIVE)
    overhead: float = setting(
        0.0008,
        "airtime of a datagram in addition to its bytes: preambles, gaps, acknowledgement",
        unit="s",
        check=NOT_NEGATIVE,
    )
    loss: float = setting(
        0.01, "share of the attempts to send that fail outside bursts", check=between(0.0, 1.0)
    )
    burst_interval: float = setting(
        20.0,
        "mean time between a station's bursts of loss; 0: no bursts",
        unit="s",
        check=NOT_NEGATIVE,
    )
    burst_length: float = setting(
        0.2, "mean length of a burst of loss", unit="s", check=above(0.0, 1e3)
    )
    burst_loss: float = setting(
        0.95, "share of the attempts to send that fail in a burst", check=between(0.0, 1.0)
    )
    retries: int = setting(
        6, "largest number of retries before a datagram is dropped", check=between(0, 15)
    )
    patience: float = setting(
        0.5,
        "time that a datagram waits for the channel before it is dropped",
        unit="s",
        check=POSITIVE,
    )


class RadioChannel:
    """Shared radio channel; times are simulation times [ns].

    Args:
        radio: parameters of the channel.
        seed: seed of its random numbers.
    """

    def __init__(self, radio: Radio, seed: str) -> None:
        self.radio = radio
        self.interference = 0.0  # share of the airtime used by interfering stations
        self._seed, self._random = seed, Random(f"{seed}, air")
        self._free_at = 0  # time from which the channel is free
        self._sent: deque[tuple[int, int]] = deque()  # end and airtime of each attempt

    def station(self, name: str) -> "Station":
        """Return a new station on the channel."""
        return Station(self, Random(f"{self._seed}, air, {name}"))

    def airtime(self, size: int) -> int:
        """Return the airtime of a datagram of `size` bytes [ns]."""
        return round(SECOND * (self.radio.overhead + 8 * (size + HEADERS) / self.radio.rate))

    def utilization(self, now: int) -> float:
        """Return the share of the last second during which the stations were sending."""
        while self._sent and self._sent[0][0] <= now - UTILIZATION_WINDOW:
            self._sent.popleft()
        return sum(airtime for _, airtime in self._sent) / UTILIZATION_WINDOW

    def transmit(self, station: "Station", size: int, now: int) -> int | None:
        """Return the time at which a datagram sent at `now` arrives; None if it is lost."""
        random, airtime = self._random, self.airtime(size)
        contended = now < self._free_at
        for attempt in range(1 + self.radio.retries):
            slots = min(MIN_SLOTS << attempt, MAX_SLOTS)
            start = max(now, self._free_at) + SLOT_TIME * random.randrange(slots)
            while random.random() < self.interference and start - now < UTILIZATION_WINDOW:
                start, contended = start + self.airtime(INTERFERING_SIZE), True
            if start - now > SECOND * self.radio.patience:
                return None
            self._free_at = start + airtime
            self._sent.append((self._free_at, airtime))
            collides = contended and random.random() * slots < 1.0
            if not collides and random.random() >= station.loss(start):
                return self._free_at
        return None


class Station:
    """Station on the channel, with its own bursts of loss in both directions."""

    def __init__(self, channel: RadioChannel, random: Random) -> None:
        self._channel, self._random = channel, random
        self._in_burst, self._until = True, 0  # a burst that ends immediately

    def transmit(self, size: int, now: int) -> int | None:
        """Return the time of arrival, as Air.carry does."""
        return self._channel.transmit(self, size, now)

    def loss(self, now: int) -> float:
        """Return the share of attempts that fail now; `now` may decrease a little."""
        radio = self._channel.radio
        if radio.burst_interval:
            means = radio.burst_interval, radio.burst_length
            while self._until <= now:
                self._in_burst = not self._in_burst
                mean = means[self._in_burst]
                self._until += round(SECOND * self._random.expovariate(1.0 / mean))
            if self._in_burst:
                return radio.burst_loss
        return radio.loss
