"""A law in a process of its own, so that its failure ends only that process."""

import os
import signal
import socket
import subprocess
import sys
from contextlib import suppress

import numpy as np

from fss_gnc.law.contract import STRUCTURES, Inputs, LawError, Outputs, from_record, to_record
from fss_gnc.law.worker import FAILED, MAX_MESSAGE, OUTPUT, READY

END_TIMEOUT = 1.0  # for a law to terminate [s]


class LawProcess:
    """Process of a law; one step at a time.

    Args:
        law: MODULE:CLASS, FILE.py:CLASS, LIBRARY.so or FILE.fmu.
        joints: number of joints.
        period: nominal time between two steps [s].
    """

    def __init__(self, law: str, joints: int, period: float) -> None:
        self.joints, self.ready, self.hash = joints, False, ""  # hash: of the law's file
        self._channel, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        arguments = [law, str(joints), repr(period), str(os.getpid()), str(theirs.fileno())]
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "fss_gnc.law.worker", *arguments],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
            )

    @property
    def pid(self) -> int:
        """Number of the process."""
        return self._process.pid

    def send(self, inputs: Inputs) -> None:
        """Start a step of the law."""
        with suppress(BrokenPipeError, ConnectionResetError):  # `receive` reports the reason
            self._channel.send(to_record(inputs, self.joints).tobytes())

    def receive(self, timeout: float) -> Outputs | None:
        """Return the law's answer; None if there is none within a time [s].

        Raises:
            LawError: the law has failed; the message names the exception or the signal.
        """
        self._channel.settimeout(timeout)
        try:
            data = self._channel.recv(MAX_MESSAGE)
        except (TimeoutError, BlockingIOError):
            return None
        except ConnectionResetError:  # it ended with an input unread
            data = b""
        kind, content = data[:1], data[1:]
        if kind == READY:
            self.ready, self.hash = True, content.decode()
            return None
        if kind == OUTPUT:
            return self._outputs(content)
        raise LawError(content.decode(errors="replace") if kind == FAILED else self._exit_reason())

    def _outputs(self, data: bytes) -> Outputs:
        try:
            record = np.frombuffer(data, STRUCTURES[Outputs])[0]
            outputs = from_record(Outputs, record, self.joints)
            outputs.require_finite()
        except ValueError as error:
            raise LawError(str(error)) from None
        return outputs

    def _exit_reason(self) -> str:
        try:
            code = self._process.wait(END_TIMEOUT)
        except subprocess.TimeoutExpired:
            return "it closed its connection to the node"
        return signal.Signals(-code).name if code < 0 else f"exit code {code}"

    def kill(self) -> None:
        """End the process at once."""
        self._process.kill()
        self._process.wait()
        self._channel.close()

    def close(self) -> None:
        """Let the law terminate; kill it if that takes long."""
        self._channel.close()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(END_TIMEOUT)
        self.kill()
