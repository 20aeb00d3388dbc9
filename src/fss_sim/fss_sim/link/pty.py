"""Pseudo-terminals for the connections to links, in place of RS-232."""

import os
import termios
import tty
from contextlib import suppress
from pathlib import Path
from typing import Any

from fss_link.protocol import StreamDecoder, pack

MAX_READ_SIZE = 8192  # maximum number of bytes per read


class LinkTerminal:
    """Pseudo-terminal of one link; no method blocks, or raises after it is opened.

    Args:
        path: symbolic link to the terminal, for drivers to open; an existing link is replaced.

    Raises:
        OSError: if no terminal is available, or the path is in use; the message says which.
    """

    def __init__(self, path: str) -> None:
        self._path = Path(path)
        self._decoder = StreamDecoder()
        # The far end is kept open, so that a driver can disconnect and reconnect.
        self._near, self._far = os.openpty()
        os.set_blocking(self._near, False)
        tty.setraw(self._far)
        try:
            if self._path.is_symlink():
                self._path.unlink()
            self._path.symlink_to(os.ttyname(self._far))
        except OSError as error:
            self._release()
            raise OSError(f"terminal {path} cannot be made: {error.strerror}") from None

    @property
    def address(self) -> str:
        """Path that a driver opens, for diagnostics."""
        return str(self._path)

    def receive(self) -> list[tuple[bytes, Any]]:
        """Return the received frames; there is only one peer."""
        try:
            data = os.read(self._near, MAX_READ_SIZE)
        except OSError:  # no data left
            return []
        return [(frame, self) for frame in self._decoder.feed(data)]

    def send(self, data: bytes, peer: Any) -> None:
        """Send a frame to the peer, if there is one; data that does not fit is lost."""
        if peer is not None:
            with suppress(OSError):
                os.write(self._near, pack(data))

    def reset(self) -> None:
        """Discard all data not yet read."""
        termios.tcflush(self._near, termios.TCIOFLUSH)
        self._decoder = StreamDecoder()

    def close(self) -> None:
        """Close the terminal and remove its symbolic link."""
        with suppress(OSError):
            if os.readlink(self._path) == os.ttyname(self._far):
                self._path.unlink()
        self._release()

    def _release(self) -> None:
        for end in (self._near, self._far):
            with suppress(OSError):
                os.close(end)
