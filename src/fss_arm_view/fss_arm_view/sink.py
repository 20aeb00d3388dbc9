"""Queue of drawings for rerun: bounded, limited in rate, counted, and outside the node's thread."""

import ctypes
import os
import signal
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from ipaddress import ip_address
from itertools import count
from pathlib import Path
from queue import Full, Queue
from tempfile import TemporaryDirectory
from threading import Thread
from typing import Any

import numpy as np
import rerun as rr

from .scene import TIMELINE, Drawing

PR_SET_PDEATHSIG = 1  # option of prctl(2)

NATIVE, WEB, FILE, CONNECT = "native", "web", "file", "connect"

Work = tuple[rr.RecordingStream, int | None, list[Drawing]]  # stream, time [ns] or None: always


class Sink:
    """Queue that accepts drawings without waiting; a thread passes them to rerun.

    `stream` may be replaced at any time; the previous stream is then disconnected.

    Drawings of an entity that come faster than `rate` are dropped and counted, except for bursts
    of one second's worth. So are drawings while `is_paused`, or that find the queue full.
    """

    def __init__(self, stream: rr.RecordingStream, rate: float, size: int) -> None:
        self.stream, self.rate, self.is_paused = stream, rate, False
        self.queue: Queue[Work | None] = Queue(size)
        self.tokens: dict[str, tuple[float, float]] = {}  # by entity: tokens left, at a time [s]
        self.counts: Counter[str] = Counter()
        self.thread = Thread(target=self._run, daemon=True)
        self.thread.start()

    def due(self, entity: str) -> bool:
        """Return True if the entity may be drawn now; this uses one of its tokens."""
        now, burst = time.monotonic(), max(self.rate, 1.0)
        available, since = self.tokens.get(entity, (burst, now))
        available = min(available + (now - since) * self.rate, burst)
        is_due = available >= 1.0 and not self.is_paused
        self.tokens[entity] = available - is_due, now
        self.counts["rate-limited"] += not is_due
        return is_due

    def enqueue(self, t: int | None, drawings: Iterable[Drawing]) -> bool:
        """Queue drawings at time t [ns], None: always; return False if the queue is full."""
        try:
            self.queue.put_nowait((self.stream, t, list(drawings)))
        except Full:
            self.counts["dropped"] += 1
            return False
        return True

    def close(self, timeout: float = 2.0) -> None:
        """Write the waiting drawings, for at most `timeout` [s] each to queue and to finish."""
        try:
            self.queue.put(None, timeout=timeout)
        except Full:
            return
        self.thread.join(timeout)

    def _run(self) -> None:
        stream = self.stream
        while (work := self.queue.get()) is not None:
            previous, (stream, t, drawings) = stream, work
            if previous is not stream:
                previous.disconnect()
            if t is not None:
                stream.set_time(TIMELINE, timestamp=np.datetime64(t, "ns"))
            for entity, drawn in drawings:
                parts = drawn if isinstance(drawn, list) else [drawn]
                stream.log(entity, *parts, static=t is None)
            self.counts["shown"] += 1
        with suppress(RuntimeError):  # the viewer has already exited
            stream.flush()
            stream.disconnect()  # before its server stops; otherwise rerun prints errors


class VehicleSink:
    """Sink for one of several vehicles: its entities are placed below its name."""

    def __init__(self, sink: Sink, name: str) -> None:
        self.sink, self.name = sink, name

    def due(self, entity: str) -> bool:
        """Return True if the vehicle's entity may be drawn now, as Sink.due."""
        return self.sink.due(f"{self.name} {entity}")

    def enqueue(self, t: int | None, drawings: Iterable[Drawing]) -> bool:
        """Queue drawings of the vehicle, as Sink.enqueue."""
        return self.sink.enqueue(
            t, [(self._vehicle_entity(entity), drawn) for entity, drawn in drawings]
        )

    def _vehicle_entity(self, entity: str) -> str:
        kind, _, rest = entity.partition("/")
        if kind == "table" and not rest.startswith(("legend/", "edge")):
            return f"table/{self.name}/{rest}"
        what, _, line = rest.partition("/")
        return f"plot/{what}/{self.name}/{line}" if kind == "plot" else entity


class Viewer:
    """Process of rerun, as a window or as a web server; it stops when its owner stops.

    In mode WEB the gate, another process, serves the live page, and relays all requests to rerun.

    Args:
        mode: NATIVE or WEB.
        bind: address to serve on.
        ports: sockets of the data and, in mode WEB, of the page, from `listen`.
        memory: memory limit for drawings, in rerun's notation.
        host_names: further host names of this computer.
    """

    def __init__(
        self,
        mode: str,
        bind: str,
        ports: Sequence[socket.socket],
        memory: str,
        host_names: Iterable[str] = (),
    ) -> None:
        program = rerun_program()
        common = "--memory-limit", memory, "--hide-welcome-screen"
        data_port, *page_ports = (port.getsockname()[1] for port in ports)
        if mode == NATIVE:
            ports[0].close()  # rerun opens it again
            self.url = f"rerun+http://{host(bind, '127.0.0.1')}:{data_port}/proxy"  # for drawings
            command = [program, "--bind", bind, "--port", data_port, *common]
            self.processes = [self._start(command, _stop_with_parent_when_idle)]
            return
        data, page = free_port(), free_port()
        self.url = f"rerun+http://127.0.0.1:{data}/proxy"
        command = [
            program,
            "--bind",
            "127.0.0.1",
            "--port",
            data,
            *common,
            "--serve-web",
            "--web-viewer-port",
            page,
            "--server-memory-limit",
            memory,
            "--newest-first",
            "--cors-allow-origin",
            f"http://{host(bind, '*')}:{page_ports[0]}",
        ]
        self._states, states = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        inherited = [end.fileno() for end in (*ports, states)]
        gate = [sys.executable, "-m", "fss_arm_view.gate", *inherited, data, page]
        self.processes = [
            self._start(command, _stop_with_parent_when_idle),
            self._start([*gate, " ".join(host_names)], _stop_with_parent, inherited),
        ]
        for end in (*ports, states):
            end.close()

    def send(self, state: str) -> None:
        """Pass a state to the page, or drop it if the gate is late."""
        with suppress(OSError):  # the gate has stopped, which `is_running` reports
            self._states.send(state.encode(), socket.MSG_DONTWAIT)

    def _start(
        self, command: list[Any], prepare: Callable[[], None], inherited: Sequence[int] = ()
    ) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [str(word) for word in command],
            # The allocator returns freed memory at once; otherwise memory grows for hours.
            env=os.environ | {"MIMALLOC_PURGE_DELAY": "0"},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            process_group=0,  # Ctrl-C is for the owner
            pass_fds=inherited,
            preexec_fn=prepare,
        )

    def is_running(self) -> bool:
        """Return True if all processes of the viewer are running."""
        return all(process.poll() is None for process in self.processes)

    def close(self) -> None:
        """Terminate the viewer's processes; kill those that do not exit within 5 s."""
        for process in self.processes:
            process.terminate()
        for process in self.processes:
            try:
                process.wait(5.0)
            except subprocess.TimeoutExpired:
                process.kill()


def rerun_program() -> Path:
    """Return the path of the rerun program."""
    import rerun_cli

    return Path(rerun_cli.__file__).parent / "rerun"


def disable_analytics() -> TemporaryDirectory[str]:
    """Disable rerun's analytics in this process and in the processes that it starts.

    The user's own configuration is not changed: the returned folder replaces it while it exists.
    """
    folder: TemporaryDirectory[str] = TemporaryDirectory(prefix="fss_arm_view_")
    os.environ["XDG_CONFIG_HOME"] = os.environ["XDG_DATA_HOME"] = folder.name
    command = [str(rerun_program()), "analytics", "disable"]
    subprocess.run(command, capture_output=True, check=True)
    return folder


def free_port() -> int:
    """Return a TCP port of the loopback interface that is free now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def listen(mode: str, bind: str, port: int, web_port: int) -> list[socket.socket]:
    """Open the ports of a mode: of the data, and of the page.

    Raises:
        ValueError: a port is in use, or the address does not belong to this computer.
    """
    options = {WEB: {"port": port, "web_port": web_port}, NATIVE: {"port": port}}
    family = socket.AF_INET6 if ip_address(bind).version == 6 else socket.AF_INET
    opened = []
    for option, number in options.get(mode, {}).items():
        try:
            opened.append(socket.create_server((bind, number), family=family))
        except OSError as error:
            for other in opened:
                other.close()
            raise ValueError(
                f"cannot open port {number} of {bind}: {os.strerror(error.errno or 0)};"
                f" another view may use it: choose another port with -p {option}:=PORT"
            ) from None
    return opened


def _stop_with_parent() -> None:
    """Ask Linux to terminate this process when its parent exits."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)


def _stop_with_parent_when_idle() -> None:
    """Call _stop_with_parent, and let this process run only when the processor is idle."""
    _stop_with_parent()
    with suppress(OSError):  # a container may forbid this
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))


def host(bind: str, if_unspecified: str) -> str:
    """Return an IP address in URL notation; `if_unspecified` for 0.0.0.0 and ::."""
    address = ip_address(bind)
    if address.is_unspecified:
        return if_unspecified
    return f"[{address}]" if address.version == 6 else bind


def new_file(path: str) -> str:
    """Create an empty file `path`, or NAME_1, NAME_2, ...: none is overwritten; return its name.

    Raises:
        ValueError: the file cannot be written.
    """
    file = first = Path(path)
    numbers = count(1)
    while file.exists():
        file = first.with_stem(f"{first.stem}_{next(numbers)}")
    try:
        file.touch()
    except OSError as error:
        raise ValueError(f"{path!r} cannot be written: {error.strerror}") from None
    return str(file)


def open_stream(mode: str, target: str, blueprint: Any) -> rr.RecordingStream:
    """Open a recording that is written to a file or sent to a viewer's address.

    Raises:
        ValueError: the file cannot be written, or the address is invalid.
    """
    # Rows are sent in batches: a browser processes few large chunks faster than many small ones.
    os.environ.setdefault("RERUN_FLUSH_TICK_SECS", "0.2")
    stream = rr.RecordingStream("fss_arm")
    try:
        if mode == FILE:
            stream.save(target, default_blueprint=blueprint)
        else:
            stream.connect_grpc(target, default_blueprint=blueprint)
    except (RuntimeError, OSError) as error:
        raise ValueError(f"cannot open {target!r}: {error}") from None
    return stream
