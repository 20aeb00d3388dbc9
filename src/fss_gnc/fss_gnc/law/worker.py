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
from hashlib import sha256
from pathlib import Path

import numpy as np

from fss_arm_ros.realtime import yield_to_parent
from fss_gnc.law.contract import STRUCTURES, Inputs, LawError, from_record, to_record
from fss_gnc.law.forms import load

READY, OUTPUT, FAILED = b"r", b"o", b"f"
MAX_MESSAGE = 1 << 16  # [bytes]
MAX_TEXT = 1000  # of a failure
MAX_GROWTH = 512 << 20  # of a law's memory after its start [bytes]
PR_SET_PDEATHSIG = 1  # of prctl: signal at the end of the parent


def serve(law: str, joints: int, period: float, channel: socket.socket) -> None:
    """Load a law, and answer inputs until the node closes the channel."""
    running = load(law, joints, period)
    limit_memory()
    channel.send(READY + sha256(Path(running.path).read_bytes()).hexdigest()[:12].encode())
    while data := channel.recv(MAX_MESSAGE):
        record = np.frombuffer(data, STRUCTURES[Inputs])[0]
        outputs = running.step(from_record(Inputs, record, joints))
        channel.send(OUTPUT + to_record(outputs, joints).tobytes())
    running.terminate()


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


def failure_text(error: BaseException) -> str:
    """Return type, message and place of an exception in one line."""
    if isinstance(error, LawError):
        return str(error)
    text = f"{type(error).__name__}: {error}".rstrip(": ")
    ours, stack = os.path.dirname(__file__), traceback.extract_tb(error.__traceback__)
    frames = [f for f in stack if os.path.dirname(f.filename) != ours]
    place = f" ({os.path.basename(frames[-1].filename)}:{frames[-1].lineno})" if frames else ""
    return text[:MAX_TEXT] + place


def main(law: str, joints: str, period: str, parent: str, fd: str) -> int:
    """Run a law; return the exit code."""
    end_with(int(parent))
    yield_to_parent()  # an endless law must not keep the node from ending it
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C ends the node, which ends this process
    faulthandler.enable()
    channel = socket.socket(fileno=int(fd))
    try:
        serve(law, int(joints), float(period), channel)
    except BrokenPipeError:  # the node has ended
        return 0
    except BaseException as error:
        if not isinstance(error, LawError):
            traceback.print_exc()
        channel.send(FAILED + failure_text(error).encode())
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
