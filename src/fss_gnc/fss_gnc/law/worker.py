"""The process that a law runs in: it answers each input with the law's output.

usage: python -m fss_gnc.law.worker LAW JOINTS PERIOD PARENT FD

PARENT is the pid of the node. FD is a socket that keeps the boundaries of messages. Each message to
the node begins with its kind: READY with a hash of the law's file, OUTPUT with the structure of
outputs, or FAILED with a text.
"""

import ctypes
import faulthandler
import os
import resource
import signal
import socket
import sys
import traceback
from contextlib import suppress
from hashlib import sha256
from pathlib import Path

import numpy as np

from fss_arm_ros.realtime import yield_to_parent
from fss_gnc.law.contract import STRUCTURES, Inputs, LawError, from_record, to_record
from fss_gnc.law.forms import load

READY, OUTPUT, FAILED = b"r", b"o", b"f"
MAX_MESSAGE = 1 << 16  # [bytes]
MAX_TEXT = 1000  # length of a failure's text [characters]; with its place it fits in a message
#: Growth of a law's memory after its start [bytes]. A law that leaks fails before it takes memory
#: from the nodes beside it; the tables that laws make in their first steps are far smaller.
MAX_GROWTH = 512 << 20
PR_SET_PDEATHSIG = 1  # of prctl: signal at the end of the parent


def serve(law: str, joints: int, period: float, channel: socket.socket) -> None:
    """Load a law, and answer inputs until the node closes the channel or ends."""
    running = load(law, joints, period)
    limit_memory()
    answer = READY + sha256(Path(running.path).read_bytes()).hexdigest()[:12].encode()
    while data := exchange(channel, answer):
        record = np.frombuffer(data, STRUCTURES[Inputs])[0]
        outputs = running.step(from_record(Inputs, record, joints))
        answer = OUTPUT + to_record(outputs, joints).tobytes()
    running.terminate()


def exchange(channel: socket.socket, answer: bytes) -> bytes:
    """Send an answer and return the next input; empty if the node has closed the channel."""
    try:
        channel.send(answer)
        return channel.recv(MAX_MESSAGE)
    except (BrokenPipeError, ConnectionResetError):
        return b""


def limit_memory() -> None:
    """Let allocations fail when the process's memory has grown by MAX_GROWTH."""
    with open("/proc/self/status") as status:
        used = next(int(line.split()[1]) for line in status if line.startswith("VmData:"))
    limit = (used << 10) + MAX_GROWTH
    resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))


def end_with(parent: int) -> None:
    """Have this process killed when its parent ends, whatever the law is doing."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # it has ended already
        sys.exit(1)


def failure_text(error: BaseException, folder: str) -> str:
    """Return type, message and place of an exception in one line.

    The place is the last one in the law's folder; if there is none, the last one of all.
    """
    text = " ".join(str(error).split())
    if isinstance(error, LawError):
        return text[:MAX_TEXT]
    text = f"{type(error).__name__}: {text}".rstrip(": ")
    if isinstance(error, SyntaxError):
        return text[:MAX_TEXT]  # its message names the place
    ours = os.path.dirname(__file__)
    stack = [(f.filename, f.lineno) for f in traceback.extract_tb(error.__traceback__)]
    places = [f for f in stack if os.path.dirname(f[0]) != ours and not f[0].startswith("<")]
    places = [f for f in places if os.path.dirname(os.path.abspath(f[0])) == folder] or places
    place = f" ({os.path.basename(places[-1][0])}:{places[-1][1]})" if places else ""
    return text[:MAX_TEXT] + place


def folder_of(law: str) -> str:
    """Return the folder of the file or module of a Python law."""
    place = law.rpartition(":")[0]
    file = getattr(sys.modules.get(place), "__file__", None) or place
    return os.path.dirname(os.path.abspath(file))


def main(law: str, joints: str, period: str, parent: str, fd: str) -> int:
    """Run a law; return the exit code."""
    end_with(int(parent))
    yield_to_parent()  # an endless law must not keep the node from ending it
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C ends the node, which ends this process
    faulthandler.enable()
    channel = socket.socket(fileno=int(fd))
    try:
        serve(law, int(joints), float(period), channel)
    except BaseException as error:
        if not isinstance(error, LawError):
            traceback.print_exc()
        with suppress(BrokenPipeError):  # the node has ended, or does not wait for the law's end
            channel.send(FAILED + failure_text(error, folder_of(law)).encode())
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
