"""Channel for datagrams between a link and its driver, with delays and faults."""

from heapq import heappop, heappush
from random import Random
from typing import Any, NamedTuple

from fss_arm_model.units import SECOND
from fss_sim.faults import NO_FAULTS, LinkFaults
from fss_sim.link.radio import Station


class Datagram(NamedTuple):
    """Bytes, and the peer that sent them or that they are sent to."""

    data: bytes
    peer: Any


class Channel:
    """One direction of a connection; faults can delay, lose or duplicate datagrams.

    Args:
        random: random numbers for the faults.
        station: radio station that each datagram passes before faults delay it; None: a wire.
    """

    def __init__(self, random: Random, station: Station | None = None) -> None:
        self._random, self._station = random, station
        self._in_transit: list[tuple[int, int, Datagram]] = []  # by time of arrival, then order
        self._held: Datagram | None = None  # held back until the next one is sent
        self._count = 0

    def send(self, datagram: Datagram, now: int, faults: LinkFaults = NO_FAULTS) -> None:
        """Send a datagram at a time [ns]."""
        if faults == NO_FAULTS:
            self._schedule(datagram, now, 0)
        elif not self._occurs(faults.loss):
            if self._occurs(faults.corruption):
                datagram = self._corrupted(datagram)
            if not self._held and self._occurs(faults.reordering):
                self._held = datagram
                return
            for _ in range(1 + self._occurs(faults.duplication)):
                jitter = faults.jitter * self._random.uniform(-1.0, 1.0)
                self._schedule(datagram, now, round(SECOND * max(0.0, faults.delay + jitter)))
        if self._held:
            self._schedule(self._held, now, round(SECOND * faults.delay))
            self._held = None

    def arrived(self, now: int) -> list[Datagram]:
        """Return the datagrams that have arrived by a time [ns], in order of arrival."""
        got = []
        while self._in_transit and self._in_transit[0][0] <= now:
            got.append(heappop(self._in_transit)[2])
        return got

    def _schedule(self, datagram: Datagram, now: int, delay: int) -> None:
        self._count += 1
        sent_at = self._station.transmit(len(datagram.data), now) if self._station else now
        if sent_at is not None:
            heappush(self._in_transit, (sent_at + delay, self._count, datagram))

    def _occurs(self, share: float) -> bool:
        return share > 0.0 and self._random.random() < share

    def _corrupted(self, datagram: Datagram) -> Datagram:
        data = bytearray(datagram.data)
        if data:
            data[self._random.randrange(len(data))] ^= 1 << self._random.randrange(8)
        return datagram._replace(data=bytes(data))
