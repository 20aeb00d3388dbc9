"""Transport to a Copley drive on a serial port, with the interface of a link."""

import os
import random
import time
from collections import Counter, deque
from contextlib import suppress
from socket import socketpair
from threading import Event, Thread
from typing import TYPE_CHECKING

from fss_arm_driver.copley.language import FIRST_BAUD
from fss_arm_driver.copley.link import DriveLink
from fss_arm_driver.protocol import Mode
from fss_link.transport.base import BATCH, readable
from fss_link.transport.stream import open_port, set_rate

if TYPE_CHECKING:
    from serial import Serial

TICK = 0.005  # longest time between two polls of the drive [s]
RETRY_INTERVAL = 0.5  # between attempts to open the port [s]
RELEASE_TIMEOUT = 4.0  # to switch the drive off when the process ends [s]
ANSWER_TIMEOUT = 3.0  # a drive that has not answered for this long is reported [s]


class CopleyTransport:
    """Transport whose thread controls the drive and implements the link's watchdog.

    Raises:
        OSError: the port cannot be opened. (Later it may disappear and return.)
    """

    def __init__(self, device: str, baud: int, link: int, key: bytes | None) -> None:
        self.counts: Counter[str] = Counter(connects=1, send_failures=0, drive_refusals=0)
        self.problem = ""
        self._device = device
        self._port: Serial | None = open_port(device, FIRST_BAUD)
        self._link = DriveLink(link, random.randint(1, 0xFFFF), key, baud)
        self._last_answer, self._refusal = time.monotonic(), ""
        self._commands: deque[bytes] = deque(maxlen=BATCH)
        self._frames: deque[bytes] = deque(maxlen=BATCH)
        self._frame_ready, self._closing = Event(), Event()
        self._wakeup, self._waker = socketpair()
        self._waker.setblocking(False)
        self._thread = Thread(target=self._run, daemon=True)
        self._thread.start()

    def send(self, data: bytes) -> None:
        """Pass a command frame to the link."""
        if self._port is None:
            self.counts["send_failures"] += 1
        self._commands.append(data)
        with suppress(OSError):
            self._waker.send(b"\0")

    def receive(self) -> list[bytes]:
        """Return the telemetry frames made from the drive's answers."""
        self._frame_ready.clear()
        return [self._frames.popleft() for _ in range(len(self._frames))]

    def wait(self, timeout: float) -> bool:
        """Wait for a frame."""
        return self._frame_ready.wait(timeout)

    def close(self) -> None:
        """Let the joint come to rest, then close the port."""
        self._closing.set()
        self._thread.join()
        self._wakeup.close()
        self._waker.close()

    def _run(self) -> None:
        while not self._closing.is_set():
            try:
                if self._port is None:
                    self._port = open_port(self._device, FIRST_BAUD)
                    self._link.restart()
                    self.counts["connects"] += 1
                self._step(self._port)
            except Exception as error:  # of any kind: only this thread monitors the drive
                self._close_port()
                why = error.strerror or error if isinstance(error, OSError) else repr(error)
                self.problem = f"cannot use the port: {why}"
                self._closing.wait(RETRY_INTERVAL)
        self._release()
        self._close_port()

    def _release(self) -> None:
        """Bring the joint to rest and switch the drive off, if possible."""
        start = time.monotonic_ns() // 1000  # an older reading may precede the last command
        end = time.monotonic() + RELEASE_TIMEOUT
        with suppress(OSError, ValueError):
            while self._port and time.monotonic() < min(end, self._last_answer + ANSWER_TIMEOUT):
                reading = self._link.drive.reading
                if reading and reading.clock > start and reading.mode == Mode.OFF:
                    break
                self._link.state.disarm()
                self._step(self._port)

    def _step(self, port: "Serial") -> None:
        """Wait up to TICK for bytes or commands, and poll the link."""
        ready = readable([port, self._wakeup], TICK)
        data = b""
        if port in ready and not (data := os.read(port.fileno(), 4096)):
            raise ConnectionResetError("the device is gone")
        if self._wakeup in ready:
            self._wakeup.recv(4096)
        clock = time.monotonic_ns() // 1000
        while self._commands:
            self._link.receive(self._commands.popleft(), clock)
        out, frame = self._link.poll(data, clock)
        drive = self._link.drive
        if drive.baud != port.baudrate:
            set_rate(port, drive.baud)
        if out:
            os.write(port.fileno(), out)
        if frame:
            self._frames.append(frame)
            self._frame_ready.set()
        self._update_problem(bool(drive.reading), drive.refusal)

    def _update_problem(self, answers: bool, refusal: str) -> None:
        """Update the description of the problem."""
        if refusal != self._refusal:
            self.counts["drive_refusals"] += bool(refusal)
        self._refusal = refusal
        now = time.monotonic()
        self._last_answer = now if answers else self._last_answer
        self.problem = f"the drive refuses {refusal}" if refusal else ""
        if now - self._last_answer > ANSWER_TIMEOUT:
            self.problem = "no drive answers, neither at 9600 baud nor at the rate given"

    def _close_port(self) -> None:
        port, self._port = self._port, None
        if port:
            with suppress(OSError):
                port.close()
