"""The radio channel that links and base share: what it costs a datagram to get through.

In outline the distributed coordination of IEEE 802.11. One station sends at a time, the others
wait, in the order in which they began to. An attempt begins when the channel is free, after a
random number of slots, and takes airtime for the bytes and for what goes with them; it fails
through a collision, the likelier the fewer slots there were to choose from, or through loss. What
has failed is tried again, out of twice as many slots, until its retries are used up.

Loss comes in bursts (Gilbert 1960, Elliott 1963): each station is out of reach at random times,
for random times.
"""

from collections import deque
from dataclasses import dataclass
from random import Random

from fss_arm_model.settings import NOT_NEGATIVE, POSITIVE, Settings, above, between, setting
from fss_arm_model.units import SECOND

SLOT, SLOTS, MOST_SLOTS = 20_000, 32, 1024  # of 802.11b [ns]; at the first attempt, at the most
HEADERS = 8 + 20 + 36  # bytes of UDP, IP and 802.11 around a datagram
FOREIGN = 1500  # bytes of the datagrams of others
WINDOW = SECOND  # over which the use of the channel is counted [ns]


@dataclass(frozen=True)
class Radio(Settings):
    """A channel as 802.11b has it, its stations at the slowest usual rate but one."""

    rate: float = setting(2e6, "bit rate of the radio channel", unit="bit/s", check=POSITIVE)
    overhead: float = setting(
        0.0008, "airtime of a datagram beside its bytes': preambles, gaps, acknowledgement",
        unit="s", check=NOT_NEGATIVE,
    )  # fmt: skip
    loss: float = setting(
        0.01, "share of the attempts to send that fail outside bursts", check=between(0.0, 1.0)
    )
    burst_interval: float = setting(
        20.0, "mean time between a station's bursts of loss; 0: there are none", unit="s",
        check=NOT_NEGATIVE,
    )  # fmt: skip
    burst_length: float = setting(
        0.2, "mean length of a burst of loss", unit="s", check=above(0.0, 1e3)
    )
    burst_loss: float = setting(
        0.95, "share of the attempts to send that fail in a burst", check=between(0.0, 1.0)
    )
    retries: int = setting(
        6, "times that a datagram is sent again before it is given up", check=between(0, 15)
    )
    patience: float = setting(
        0.5, "time that a datagram waits for the channel before it is given up", unit="s",
        check=POSITIVE,
    )  # fmt: skip


class Air:
    """The channel; times are the simulation's [ns].

    Args:
        radio: what it is like.
        seed: of all that chance decides.
    """

    def __init__(self, radio: Radio, seed: str) -> None:
        self.radio, self.taken = radio, 0.0  # share of the airtime that others take
        self._seed, self._random = seed, Random(f"{seed}, air")
        self._free = 0  # from when on
        self._sent: deque[tuple[int, int]] = deque()  # end and airtime of each attempt

    def station(self, name: str) -> "Station":
        """One of those who share it."""
        return Station(self, Random(f"{self._seed}, air, {name}"))

    def airtime(self, size: int) -> int:
        """Of a datagram of so many bytes [ns]."""
        return round(SECOND * (self.radio.overhead + 8 * (size + HEADERS) / self.radio.rate))

    def used(self, now: int) -> float:
        """Share of the last second for which the stations have sent."""
        while self._sent and self._sent[0][0] <= now - WINDOW:
            self._sent.popleft()
        return sum(airtime for _, airtime in self._sent) / WINDOW

    def carry(self, station: "Station", size: int, now: int) -> int | None:
        """When a datagram that waits from `now` on has arrived; None: it is lost."""
        random, airtime = self._random, self.airtime(size)
        contended = now < self._free
        for attempt in range(1 + self.radio.retries):
            slots = min(SLOTS << attempt, MOST_SLOTS)
            begin = max(now, self._free) + SLOT * random.randrange(slots)
            while random.random() < self.taken and begin - now < WINDOW:
                begin, contended = begin + self.airtime(FOREIGN), True
            if begin - now > SECOND * self.radio.patience:
                return None
            self._free = begin + airtime
            self._sent.append((self._free, airtime))
            collides = contended and random.random() * slots < 1.0
            if not collides and random.random() >= station.loss(begin):
                return self._free
        return None


class Station:
    """One that shares the channel, with the bursts of loss that meet it, whoever sends."""

    def __init__(self, air: Air, random: Random) -> None:
        self._air, self._random = air, random
        self._in_burst, self._until = True, 0  # which ends at once

    def carry(self, size: int, now: int) -> int | None:
        """As Air.carry."""
        return self._air.carry(self, size, now)

    def loss(self, now: int) -> float:
        """Share of the attempts that fail now; `now` may run back a little."""
        radio = self._air.radio
        if radio.burst_interval:
            means = radio.burst_interval, radio.burst_length
            while self._until <= now:
                self._in_burst = not self._in_burst
                mean = means[self._in_burst]
                self._until += round(SECOND * self._random.expovariate(1.0 / mean))
            if self._in_burst:
                return radio.burst_loss
        return radio.loss
