"""The far ends of the driver's transports, in a few lines: a link's socket or serial port."""

import errno
import os
import pty
import socket
import termios
import tty
from contextlib import suppress

from fss_link.protocol import StreamDecoder, pack
from fss_link.transport import readable

TIMEOUT = 10.0


class UdpEnd:
    """A UDP port. Datagrams may have any length."""

    def __init__(self, _):
        self.port, self.home = 0, None
        self.replug()
        self.url = f"udp://127.0.0.1:{self.port}?bind=0"

    def replug(self):
        self.line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.line.bind(("127.0.0.1", self.port))
        self.port = self.line.getsockname()[1]

    def unplug(self):
        self.line.close()

    def accept(self):
        """A UDP port meets its driver by what comes."""

    def receive(self, timeout=TIMEOUT):
        if not readable([self.line], timeout):
            return b""
        data, self.home = self.line.recvfrom(2000)
        return data

    def send(self, frame):
        self.line.sendto(frame, self.home)

    close = unplug


class StreamEnd:
    """Frames over a byte stream, which `accept` makes of whoever has connected."""

    def __init__(self):
        self.frames, self.decoder = [], StreamDecoder()

    def receive(self, timeout=TIMEOUT):
        self.accept(timeout)
        with suppress(OSError):  # a pseudo-terminal that nobody has open
            while self.line and not self.frames and readable([self.line], timeout):
                if not (data := os.read(self.line.fileno(), 4096)):
                    break
                self.frames = self.decoder.feed(data)
        return self.frames.pop(0) if self.frames else b""

    def send(self, frame):
        self.raw(pack(frame))

    def raw(self, data):
        os.write(self.line.fileno(), data)


class TcpEnd(StreamEnd):
    """A TCP port that listens; one connection at a time."""

    def __init__(self, _):
        super().__init__()
        self.port, self.line = 0, None
        self.replug()
        self.url = f"tcp://127.0.0.1:{self.port}"

    def replug(self):
        self.listener = socket.create_server(("127.0.0.1", self.port))
        self.port = self.listener.getsockname()[1]

    def unplug(self):
        self.listener.close()
        if self.line:
            self.line.close()
        self.line = None

    def accept(self, timeout=TIMEOUT):
        if readable([self.listener], 0.0 if self.line else timeout):
            self.line = self.listener.accept()[0]

    close = unplug


class PtyEnd(StreamEnd):
    """A pseudo-terminal that keeps its name when it is plugged in again."""

    def __init__(self, folder):
        super().__init__()
        self.device = folder / "ttyLINK"
        self.replug()
        self.url = f"serial://{self.device}?baud=115200"

    def replug(self):
        master, slave = pty.openpty()
        tty.setraw(master)
        self.device.symlink_to(os.ttyname(slave))
        os.close(slave)
        self.line = open(master, "r+b", buffering=0)  # noqa: SIM115 (closed by unplug)

    def unplug(self):
        self.device.unlink()
        self.line.close()

    def accept(self, timeout=TIMEOUT):
        """A terminal is there as soon as it is plugged in."""

    def close(self):
        if not self.line.closed:
            self.unplug()


def go_in_mid_open(*_):
    """What `termios.tcsetattr` does for a serial adapter that is pulled just then."""
    raise termios.error(errno.EIO, "Input/output error")


ENDS = {"udp": UdpEnd, "tcp": TcpEnd, "pty": PtyEnd}
