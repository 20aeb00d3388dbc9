"""The firmware of the base's board, in simulated time; or emulated, in real time."""

import socket
import time
from contextlib import suppress
from threading import Event, Thread
from typing import NamedTuple

from firmware import BASE, Core, Electronics

from fss_base_driver import protocol
from fss_base_driver.protocol import BaseTelemetry, Limits, encode


class Valves(NamedTuple):
    """What the firmware knows of them."""

    driven: int
    flags: int
    pulse: int
    left: int  # [us]
    opened: tuple[int, ...]  # [us]


class FirmwareBoard(Electronics):
    """The board's electronics, the model of its hardware behind them."""

    def __init__(
        self, core: Core, boot: int = 7, key: bytes | None = None, limits: Limits | None = None
    ) -> None:
        most = limits or Limits()
        bounds = f"{most.longest} {most.allowance} {most.duty} {most.total}"
        super().__init__(protocol, core, str(boot), key, bounds)

    def run(self, microseconds: int, hangs: bool = False) -> list[BaseTelemetry]:
        """Let time pass; what it sent meanwhile. What hangs is its loop."""
        return self.sent("hang" if hangs else "run", microseconds, BaseTelemetry)

    def valves(self) -> Valves:
        """What its firmware knows of them now."""
        driven, flags, pulse, left, *opened = map(int, self.core.ask("valves").split())
        return Valves(driven, flags, pulse, left, tuple(opened))

    def opened(self) -> list[int]:
        """For how long each really was open [us]."""
        return [int(time) for time in self.core.ask("opened").split()]


def board_core(cortex_m3: bool = False) -> Core:
    """The core of its firmware at a pipe."""
    return Core(cortex_m3, BASE)


class Emulation:
    """The board's firmware on an emulated Cortex-M3, in real time, at a UDP port."""

    def __init__(self, key: bytes) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(0.001)
        self.port = self._socket.getsockname()[1]
        self._board = FirmwareBoard(board_core(cortex_m3=True), key=key)
        self._ended = Event()
        self._thread = Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        begin, peer = time.monotonic_ns(), None
        while not self._ended.is_set():
            clock = (time.monotonic_ns() - begin) // 1000
            for frame in self._board.run(max(clock - self._board.clock, 1)):
                if peer:
                    self._socket.sendto(encode(frame, self._board.key), peer)
            with suppress(TimeoutError):
                data, sender = self._socket.recvfrom(100)
                peer = sender if self._board.send(data) else peer

    def close(self) -> None:
        """End it."""
        self._ended.set()
        self._thread.join()
        self._socket.close()
        self._board.core.close()
