"""Reception of frames of a motion-capture system, in a separate process.

While a system does not answer, the library motioncapture waits with Python's lock held. It writes
to the standard output, and it reads datagrams from any sender on the network without a check of
their sizes. Therefore a separate process runs it (`main` here), and is restarted when it ends. The
process writes lines of JSON: null once the library has connected, then for each frame [time of
arrival in ns, {name: pose}], and at the end a string if there is a reason to report.
"""

import ctypes
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from threading import Event, Thread

from fss_base_driver.mocap.subjects import Pose

PR_SET_PDEATHSIG = 1  # of prctl(2)
RESTART_INTERVAL = 1.0  # before a restart [s]
ENDED = "the receiver ended"
PROGRAM = f"import sys; from {__name__} import main; sys.exit(main())"


class Receiver(Thread):
    """Thread that runs the receiving process and calls `on_frame(arrival, poses)` for each frame.

    Args:
        system: of the library, or its `mock`.
        options: of the system, as OPTION=VALUE.
        on_frame: called in this thread; `arrival` is the time of day [ns].
        on_end: called with the reason why the process ended, unless it was closed.
    """

    def __init__(
        self,
        system: str,
        options: Sequence[str],
        on_frame: Callable[[int, dict[str, Pose]], None],
        on_end: Callable[[str], None],
    ) -> None:
        super().__init__(daemon=True)
        self.command = [sys.executable, "-c", PROGRAM, system, *options]
        self.on_frame, self.on_end = on_frame, on_end
        self.process: subprocess.Popen[str] | None = None
        self.connected = False  # some systems start to connect only after that
        self._closing = Event()
        self.start()

    def run(self) -> None:
        """Receive until closed."""
        while not self._closing.is_set():
            try:
                why = self._receive()
            except Exception as error:  # including errors of the callback
                why = f"{ENDED}: {error}"
            if not self._closing.is_set():
                self.on_end(why)
            self._closing.wait(RESTART_INTERVAL)

    def _receive(self) -> str:
        """Run the process until it ends; return why it ended."""
        self.connected = False
        with subprocess.Popen(self.command, stdout=subprocess.PIPE, text=True) as process:
            self.process = process
            if self._closing.is_set():  # `close` may have found no process to kill
                process.kill()
            try:
                why = self._read(process)
            except Exception:
                process.kill()
                raise
        return why or f"{ENDED} with {_in_words(process.returncode)}"

    def _read(self, process: "subprocess.Popen[str]") -> str:
        """Read frames; return the reason that the process gives for its end, if any."""
        why = ""
        for line in process.stdout or ():
            message = json.loads(line)
            if message is None:
                self.connected = True
            elif isinstance(message, str):
                why = f"{ENDED}: {message}"
            else:
                arrival, poses = message
                self.on_frame(arrival, {name: tuple(pose) for name, pose in poses.items()})
        return why

    def close(self) -> None:
        """Stop the process and this thread."""
        self._closing.set()
        if self.process:
            self.process.kill()
        self.join()


def _in_words(code: int) -> str:
    return signal.Signals(-code).name if code < 0 else f"exit code {code}"


def main() -> int:
    """Receive until the reader closes the pipe."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)  # also if the parent is killed
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides
    output = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    try:
        import motioncapture  # slow and large; only this process needs it

        system, *options = sys.argv[1:]
        capture = motioncapture.connect(system, dict(option.split("=", 1) for option in options))
        output.write("null\n")
        while True:
            capture.waitForNextFrame()
            arrival, poses = time.time_ns(), {}
            for name, body in capture.rigidBodies.items():
                r = body.rotation
                poses[name] = (*map(float, body.position), r.x, r.y, r.z, r.w)
            output.write(json.dumps([arrival, poses]) + "\n")
    except BrokenPipeError:
        return 0
    except Exception as error:  # the library raises no class of its own
        output.write(json.dumps(str(error)) + "\n")
        return 1
