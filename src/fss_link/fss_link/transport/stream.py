"""Frames on a byte stream, TCP or RS-232, which is reopened when it is lost."""

import errno
import os
import socket
import termios
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from threading import Event, Lock
from typing import TYPE_CHECKING

from fss_link.protocol import StreamDecoder, pack
from fss_link.transport.base import BATCH, Line, readable

if TYPE_CHECKING:
    from serial import Serial

CONNECT_TIMEOUT = 1.0  # timeout to open a stream [s]
ACK_TIMEOUT = 2000  # unacknowledged for this long, a TCP connection is dead [ms]
MAX_NOISE = 1000  # bytes without a frame after which they are reported as noise


class StreamTransport:
    """Frames over a byte stream that `connect` opens, and reopens when it is lost.

    Once threads run, only `wait` opens and closes the stream, and not while another thread sends:
    the number of a closed file descriptor may soon belong to another file.

    Args:
        connect: opens the stream within CONNECT_TIMEOUT, or raises OSError.
        hint: probable cause if the received bytes are not frames.
    """

    def __init__(self, connect: Callable[[], Line], hint: str) -> None:
        self.counts: Counter[str] = Counter(connects=0, send_failures=0, noise_bytes=0)
        self.problem = "not connected yet"
        self._connect, self._hint = connect, hint
        self._line: Line | None = None
        self._decoder = StreamDecoder()
        self._noise_bytes = 0  # bytes since the last frame
        self._broken, self._closed = False, Event()
        self._sending = Lock()

    def open(self) -> None:
        """Open the stream now.

        Raises:
            OSError: it cannot be opened.
        """
        self._line, self._broken = self._connect(), False
        self._decoder, self._noise_bytes = StreamDecoder(), 0
        self.counts["connects"] += 1
        self.problem = ""

    def send(self, data: bytes) -> None:
        """Send a frame. One that does not fit into the system's buffer is truncated and lost."""
        packed = pack(data)
        try:
            with self._sending:
                if self._line is None or self._broken:
                    raise ConnectionError
                sent = os.write(self._line.fileno(), packed)
        except BlockingIOError:
            sent = 0
        except (OSError, ValueError) as error:
            self._break(error)
            sent = 0
        self.counts["send_failures"] += sent < len(packed)

    def receive(self) -> list[bytes]:
        """Return the received frames."""
        frames: list[bytes] = []
        line = self._line
        try:
            while line and not self._broken and len(frames) < BATCH and readable([line], 0.0):
                if not (data := os.read(line.fileno(), 4096)):
                    raise ConnectionResetError("closed by the other end")
                frames += self._decode(data)
        except (OSError, ValueError) as error:
            self._break(error)
        return frames

    def wait(self, timeout: float) -> bool:
        """Wait for bytes; reopen the stream if it is lost."""
        if self._line is None or self._broken:
            self._close_line()
            try:
                self.open()
            except OSError as error:
                self.problem = f"cannot connect: {error.strerror or error}"
                self._closed.wait(timeout)
                return False
        assert self._line
        try:
            return bool(readable([self._line], timeout))
        except (OSError, ValueError):
            return False

    def close(self) -> None:
        """Close the stream."""
        self._closed.set()
        self._close_line()

    def _decode(self, data: bytes) -> list[bytes]:
        found = self._decoder.feed(data)
        if found:
            self._noise_bytes, self.problem = 0, ""
        else:
            self._noise_bytes += len(data)
            self.counts["noise_bytes"] += len(data)
        if self._noise_bytes > MAX_NOISE:
            self.problem = f"the received bytes are no frames: {self._hint}"
        return found

    def _break(self, error: Exception) -> None:
        if self._line and not self._broken:
            self._broken = True
            self.problem = f"connection lost: {getattr(error, 'strerror', None) or error}"

    def _close_line(self) -> None:
        with self._sending:
            line, self._line = self._line, None
            if line:
                with suppress(OSError):
                    line.close()


def tcp(host: str, port: int) -> StreamTransport:
    """Return a transport over TCP to a link that listens; the first `wait` opens it."""

    def connect() -> socket.socket:
        line = socket.create_connection((host, port), CONNECT_TIMEOUT)
        line.setblocking(False)
        line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        line.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, ACK_TIMEOUT)
        return line

    return StreamTransport(connect, f"is it a link that listens on port {port}?")


def serial(device: str, baud: int) -> StreamTransport:
    """Open a transport over a serial port, 8N1.

    Raises:
        OSError: the port cannot be opened. (Once it was, it may come and go.)
    """
    transport = StreamTransport(
        lambda: open_port(device, baud), f"is the other end set to {baud} baud, 8N1?"
    )
    transport.open()
    return transport


def open_port(device: str, baud: int) -> "Serial":
    """Open a serial port, 8N1, non-blocking, exclusively for this process.

    Raises:
        OSError: it cannot be opened, or cannot be set to this rate.
    """
    # Links over UDP and TCP do not need this library.
    from serial import EIGHTBITS, PARITY_NONE, STOPBITS_ONE, Serial, SerialException

    try:
        return Serial(device, baud, EIGHTBITS, PARITY_NONE, STOPBITS_ONE, timeout=0, exclusive=True)
    except termios.error as error:  # not an OSError: the device was removed meanwhile
        raise OSError(*error.args) from None
    except (SerialException, ValueError) as error:
        number = getattr(error, "errno", None)
        if number == errno.EAGAIN:
            raise OSError("another process has it open") from None
        if number == errno.EACCES:
            raise OSError(_permission_problem(device)) from None
        if number:
            raise OSError(number, os.strerror(number)) from None
        raise OSError(f"it is no serial port, or does not support {baud} baud") from None


def _permission_problem(device: str) -> str:
    """Return why a user may not open a device, and how to join the group that may, if any."""
    group = Path(device).group()
    why = os.strerror(errno.EACCES)
    if group == "root":
        return why
    return f"{why}: run sudo usermod -aG {group} $USER, then log in again"


def set_rate(port: "Serial", baud: int) -> None:
    """Change the rate of an open port.

    Raises:
        OSError: it cannot be set.
    """
    try:
        port.baudrate = baud
    except termios.error as error:
        raise OSError(*error.args) from None
