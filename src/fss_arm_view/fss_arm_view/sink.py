"""Drawings on their way to rerun: bounded, limited in rate, counted, and off the node's thread."""

import ctypes
import os
import signal
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterable
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

PR_SET_PDEATHSIG = 1  # of prctl(2)

NATIVE, WEB, FILE, CONNECT = "native", "web", "file", "connect"

Work = tuple[rr.RecordingStream, int | None, list[Drawing]]  # where, when [ns] or always, what


class Sink:
    """Takes drawings without ever waiting; a thread hands them to rerun.

    `stream` may be another one from any moment on; the one before is ended.

    What comes faster than `rate` for one entity, but for bursts of a second's worth, or finds the
    queue full, is dropped and counted.
    """

    def __init__(self, stream: rr.RecordingStream, rate: float, size: int) -> None:
        self.stream, self.rate = stream, rate
        self.queue: Queue[Work | None] = Queue(size)
        self.left: dict[str, tuple[float, float]] = {}  # turns of each entity, and when [s]
        self.counts: Counter[str] = Counter()
        self.thread = Thread(target=self._run, daemon=True)
        self.thread.start()

    def due(self, entity: str) -> bool:
        """Whether the entity may be shown again, which takes one of its turns."""
        now, most = time.monotonic(), max(self.rate, 1.0)
        turns, then = self.left.get(entity, (most, now))
        turns = min(turns + (now - then) * self.rate, most)
        is_due = turns >= 1.0
        self.left[entity] = turns - is_due, now
        self.counts["thinned out"] += not is_due
        return is_due

    def put(self, t: int | None, drawings: Iterable[Drawing]) -> bool:
        """Show drawings at time t [ns], or always; False if there is no room."""
        try:
            self.queue.put_nowait((self.stream, t, list(drawings)))
        except Full:
            self.counts["dropped"] += 1
            return False
        return True

    def close(self, timeout: float = 2.0) -> None:
        """Write what waits, but not for longer than `timeout` [s]."""
        try:
            self.queue.put(None, timeout=timeout)
        except Full:
            return
        self.thread.join(timeout)

    def _run(self) -> None:
        stream = self.stream
        while (work := self.queue.get()) is not None:
            before, (stream, t, drawings) = stream, work
            if before is not stream:
                before.disconnect()
            if t is not None:
                stream.set_time(TIMELINE, timestamp=np.datetime64(t, "ns"))
            for entity, drawn in drawings:
                parts = drawn if isinstance(drawn, list) else [drawn]
                stream.log(entity, *parts, static=t is None)
            self.counts["shown"] += 1
        with suppress(RuntimeError):  # nobody is there any more to take it
            stream.flush()


class Scoped:
    """A sink for one of several vehicles: what is drawn of it is below its name."""

    def __init__(self, sink: "Sink | Scoped", name: str) -> None:
        self.sink, self.name = sink, name
        self.counts: Counter[str] = sink.counts

    @property
    def stream(self) -> rr.RecordingStream:
        """That of all."""
        return self.sink.stream

    @stream.setter
    def stream(self, stream: rr.RecordingStream) -> None:
        self.sink.stream = stream

    def due(self, entity: str) -> bool:
        """As of the sink."""
        return self.sink.due(f"{self.name} {entity}")

    def put(self, t: int | None, drawings: Iterable[Drawing]) -> bool:
        """As of the sink."""
        return self.sink.put(t, [(self._own(entity), drawn) for entity, drawn in drawings])

    def close(self) -> None:
        """Nothing: the sink is that of all, who ends it."""

    def _own(self, entity: str) -> str:
        kind, _, rest = entity.partition("/")
        if kind == "table" and not rest.startswith(("legend/", "edge")):
            return f"table/{self.name}/{rest}"
        what, _, line = rest.partition("/")
        return f"plot/{what}/{self.name}/{line}" if kind == "plot" else entity


class Viewer:
    """The rerun program, as a window or as a server of the web page; ended with its owner.

    Whoever asks for the page or its data comes through the gate.

    Args:
        mode: NATIVE or WEB.
        bind: address that is served on.
        port: of the data.
        web_port: of the page.
        memory: for drawings, as rerun has it.
        names: of this computer, beside its own.
        said: file with what the strip above the page shows.
    """

    def __init__(
        self, mode: str, bind: str, port: int, web_port: int, memory: str,
        names: Iterable[str] = (), said: Path = Path("none"),
    ) -> None:  # fmt: skip
        program = rerun_program()
        common = "--memory-limit", memory, "--hide-welcome-screen"
        if mode == NATIVE:
            self.url = f"rerun+http://{host(bind, '127.0.0.1')}:{port}/proxy"  # to draw to
            command = [program, "--bind", bind, "--port", port, *common]
            self.processes = [self._start(command)]
            return
        data, page = free_port(), free_port()
        self.url = f"rerun+http://127.0.0.1:{data}/proxy"
        command = [
            program, "--bind", "127.0.0.1", "--port", data, *common, "--serve-web",
            "--web-viewer-port", page, "--server-memory-limit", memory, "--newest-first",
            "--cors-allow-origin", f"http://{host(bind, '*')}:{web_port}",
        ]  # fmt: skip
        gate = [bind, port, web_port, data, page, said, " ".join(names)]
        gate = [sys.executable, "-m", "fss_arm_view.gate", *gate]
        self.processes = [self._start(command), self._start(gate)]

    def _start(self, command: list[Any]) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [str(word) for word in command],
            # Its allocator gives back at once what was forgotten; else it grows for hours.
            env=os.environ | {"MIMALLOC_PURGE_DELAY": "0"},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
            preexec_fn=_end_with_owner,
        )

    def alive(self) -> bool:
        """Whether it still runs."""
        return all(process.poll() is None for process in self.processes)

    def close(self) -> None:
        """End it."""
        for process in self.processes:
            process.terminate()
        for process in self.processes:
            try:
                process.wait(5.0)
            except subprocess.TimeoutExpired:
                process.kill()


def rerun_program() -> Path:
    """Where it is."""
    import rerun_cli

    return Path(rerun_cli.__file__).parent / "rerun"


def keep_quiet() -> TemporaryDirectory[str]:
    """Have rerun, in this process and in those it starts, tell its maker nothing.

    The user's own choice is left alone: what this returns takes its place, for as long as it is.
    """
    folder: TemporaryDirectory[str] = TemporaryDirectory(prefix="fss_arm_view_")
    os.environ["XDG_CONFIG_HOME"] = os.environ["XDG_DATA_HOME"] = folder.name
    command = [str(rerun_program()), "analytics", "disable"]
    subprocess.run(command, capture_output=True, check=True)
    return folder


def free_port() -> int:
    """One that nobody listens on now, on the loopback."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _end_with_owner() -> None:
    """Have Linux end this process, too, when the one that started it is killed."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)


def host(bind: str, of_all: str) -> str:
    """An IP address as URLs have it; `of_all` for the one that stands for all of a computer's."""
    address = ip_address(bind)
    if address.is_unspecified:
        return of_all
    return f"[{address}]" if address.version == 6 else bind


def new_file(path: str) -> str:
    """Make an empty file of that name, or of NAME_1, NAME_2, ...: none is written over.

    Raises:
        ValueError: it cannot be written.
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
    """A recording that goes to a file or to a viewer's address.

    Raises:
        ValueError: the file cannot be written, or the address is none.
    """
    # Rows travel together: a browser takes a few large chunks sooner than many small ones.
    os.environ.setdefault("RERUN_FLUSH_TICK_SECS", "0.2")
    stream = rr.RecordingStream("fss_arm")
    try:
        if mode == FILE:
            stream.save(target, default_blueprint=blueprint)
        else:
            stream.connect_grpc(target, default_blueprint=blueprint)
    except (RuntimeError, OSError) as error:
        raise ValueError(f"{target!r} cannot be shown to: {error}") from None
    return stream
