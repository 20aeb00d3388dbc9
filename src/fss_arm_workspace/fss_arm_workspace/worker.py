"""Work off the caller's thread that newer work supersedes."""

from collections.abc import Callable
from threading import Condition, Thread
from typing import Any

Progress = Callable[[str, float], None]


class Superseded(Exception):  # noqa: N818
    """Newer work waits, or the worker is closed: what is being done is no longer wanted."""


class Worker:
    """A thread that does one request at a time, and only the newest of those that wait.

    `work(request, progress)` calls progress now and then, which ends it by raising Superseded.
    """

    def __init__(self, work: Callable[[Any, Progress], None]) -> None:
        self._work = work
        self._changed = Condition()
        self._waiting: Any = None
        self._closed = False
        self.busy = False
        self.doing = "nothing yet"
        self.failure = ""
        self._thread = Thread(target=self._run, daemon=True)
        self._thread.start()

    def submit(self, request: Any) -> None:
        """Do this next, and give up what is being done."""
        with self._changed:
            self._waiting, self.busy = request, True
            self._changed.notify_all()

    def close(self) -> None:
        """Give up, and wait for the thread to end."""
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
                self.doing, self.failure = "done", ""
            except Superseded:
                pass
            except Exception as error:
                words = str(error) if isinstance(error, ValueError) else repr(error)
                self.doing, self.failure = "failed", words

    def _progress(self, what: str, share: float) -> None:
        self.doing = f"{what}: {100.0 * share:.0f} %"
        if self._closed or self._waiting is not None:
            raise Superseded
