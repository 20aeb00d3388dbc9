"""Pseudo-terminals that links are reached by, in place of RS-232."""

import os
import termios
import tty
from contextlib import suppress
from pathlib import Path
from typing import Any

from fss_arm_driver.protocol import StreamDecoder, pack

LARGEST = 8192  # bytes read at once


class LinkTerminal:
    """One link's pseudo-terminal. Nothing blocks, and nothing raises once it is open.

    Args:
        path: a symbolic link to the terminal that drivers open; replaced if it is a link already.

    Raises:
        OSError: there is no terminal to be had, or the path is taken; the message says which.
    """

    def __init__(self, path: str) -> None:
        self._path = Path(path)
        self._decoder = StreamDecoder()
        # The far end is kept open, so that a driver may come and go.
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
    def place(self) -> str:
        """What a driver opens."""
        return str(self._path)

    def receive(self) -> list[tuple[bytes, Any]]:
        """The frames that have come; there is but one peer."""
        try:
            data = os.read(self._near, LARGEST)
        except OSError:  # no more
            return []
        return [(frame, self) for frame in self._decoder.feed(data)]

    def send(self, data: bytes, peer: Any) -> None:
        """Send a frame to the peer, if there is one; what the line does not take is lost."""
        if peer is not None:
            with suppress(OSError):
                os.write(self._near, pack(data))

    def reset(self) -> None:
        """Forget what has come."""
        termios.tcflush(self._near, termios.TCIOFLUSH)
        self._decoder = StreamDecoder()

    def close(self) -> None:
        """Take the terminal away."""
        with suppress(OSError):
            if os.readlink(self._path) == os.ttyname(self._far):
                self._path.unlink()
        self._release()

    def _release(self) -> None:
        for end in (self._near, self._far):
            with suppress(OSError):
                os.close(end)
