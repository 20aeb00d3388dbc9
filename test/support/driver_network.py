"""A bad network between driver and link: which datagrams arrive, how often, and how late."""

import heapq
import socket
import time
from dataclasses import dataclass, field
from random import Random
from select import select
from threading import Thread

SECOND = 1_000_000_000


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


class Relay(Thread):
    """A UDP relay with a `Network` inside. The driver talks to `port`, the link sits at `link`."""

    def __init__(self, link, network, host="127.0.0.1"):
        super().__init__(daemon=True)
        self.link, self.network = link, network
        self.near, self.far = (self._socket(host) for _ in range(2))
        self.port = self.near.getsockname()[1]
        self.driver, self.closing, self.queue = None, False, []
        self.start()

    @staticmethod
    def _socket(host):
        made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        made.bind((host, 0))
        return made

    def run(self):
        while not self.closing:
            now = time.time_ns()
            while self.queue and self.queue[0][0] <= now:
                _, _, data, towards_link = heapq.heappop(self.queue)
                if towards_link:
                    self.far.sendto(data, self.link)
                elif self.driver:
                    self.near.sendto(data, self.driver)
            wait = (self.queue[0][0] - now) / SECOND if self.queue else 0.05
            for ready in select([self.near, self.far], [], [], min(max(wait, 0.0), 0.05))[0]:
                self._take(ready)
        self.near.close()
        self.far.close()

    def _take(self, ready):
        data, source = ready.recvfrom(2000)
        if ready is self.near:
            self.driver = source
        for arrival in self.network.arrivals(time.time_ns()):
            # Equal times never compare the data: the counter decides.
            entry = arrival, self.network.rng.random(), data, ready is self.near
            heapq.heappush(self.queue, entry)

    def close(self):
        self.closing = True
        self.join()
