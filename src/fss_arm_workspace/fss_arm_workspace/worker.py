"""Background thread for work that newer requests supersede."""

from collections.abc import Callable
from threading import Condition, Thread
from typing import Any

Progress = Callable[[str, float], None]


class Superseded(Exception):  # noqa: N818
    """Exception that stops the current work: a newer request waits, or the worker is closed."""


class Worker:
    """Thread that processes one request at a time, and only the newest of the waiting ones.

    `work(request, progress)` must call progress regularly; it raises Superseded to stop the work.
    """

    def __init__(self, work: Callable[[Any, Progress], None]) -> None:
        self._work = work
        self._changed = Condition()
        self._waiting: Any = None
        self._closed = False
        self.busy = False
        self.status = "nothing yet"
        self.failure = ""
        self._thread = Thread(target=self._run, daemon=True)
        self._thread.start()

    def submit(self, request: Any) -> None:
        """Process this request next, and abort the current one."""
        with self._changed:
            self._waiting, self.busy = request, True
            self._changed.notify_all()

    def close(self) -> None:
        """Abort the current request, and wait for the thread to end."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self._thread.join()

    def _run(self) -> None:
        while True:
            with self._changed:
                while self._waiting is None and not self._closed:
                    self.busy = False
                    self._changed.wait()
                if self._closed:
                    return
                request, self._waiting = self._waiting, None
            try:
                self._work(request, self._progress)
                self.status, self.failure = "done", ""
            except Superseded:
                pass
            except Exception as error:
                text = str(error) if isinstance(error, ValueError) else repr(error)
                self.status, self.failure = "failed", text

    def _progress(self, what: str, share: float) -> None:
        self.status = f"{what}: {100.0 * share:.0f} %"
        if self._closed or self._waiting is not None:
            raise Superseded
