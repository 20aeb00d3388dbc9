"""Compile kernels of any package, and cache them between processes.

numba checks a cached kernel only against its own source file, and misses an edit of a function
that it calls from another file. Therefore the name of the cache folder contains a hash of every
source of this package and of the kernel's own, so that any edit starts an empty cache. The folder
is in $NUMBA_CACHE_DIR, else in $XDG_CACHE_HOME/fss_arm.

A process that calls no kernel never imports numba: helpers are compiled on first use, too.
"""

import fcntl
import hashlib
import logging
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, cached_property
from pathlib import Path
from threading import Lock, Timer
from typing import IO, Any

import numpy.typing as npt

WAIT_BEFORE_LOG = 2.0  # for another process that compiles, before this is logged [s]


@cache
def cache_folder(package: str) -> Path:
    """Return the cache folder of a package that is being imported, by the hash of its sources."""
    sources = hashlib.sha256()
    for name in (__package__, package):
        root = Path(sys.modules[name].__path__[0])
        for source in sorted(root.rglob("*.py")):
            sources.update(f"{source.relative_to(root)}\0".encode() + source.read_bytes() + b"\0")
    key = sources.hexdigest()[:16]
    if own := os.environ.get("NUMBA_CACHE_DIR"):
        return Path(own, key)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache", "fss_arm", key)


_one_thread = Lock()  # numba reads the cache folder from a global variable


@contextmanager
def cache_lock(folder: Path) -> Iterator[bool]:
    """Let one process at a time use a cache folder; yield False if it cannot be written.

    numba stores a kernel and its loop in two files. If two processes compile at once, each may
    store one file of a pair, and a process that loads this pair crashes.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = (folder / "lock").open("a")
    except OSError:
        yield False
        return
    import numba

    with lock, _one_thread:
        _acquire(lock)
        numba.config.CACHE_DIR = str(folder)
        yield True


def _acquire(lock: IO[str]) -> None:
    """Take a lock file; if this takes long, log why, because a kernel compiles for seconds."""
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        timer = Timer(WAIT_BEFORE_LOG, _log_wait)
        timer.start()
        try:
            fcntl.flock(lock, fcntl.LOCK_EX)
        finally:
            timer.cancel()


@cache
def _log_wait() -> None:
    logging.getLogger(__name__).warning(
        "waiting for another process that compiles the kernels (minutes after an update)"
    )


KERNELS: list["Kernel"] = []


class Kernel:
    """A function of one state that broadcasts over batches, compiled when it is first called.

    It takes arrays of float64 (of length 1 where the layout says "()") and writes its outputs,
    which come last. The layout is a generalized ufunc's, for example "(p),(m)->(m,m)". Loading
    each kernel at its first call rather than at import keeps the start of a process short.
    """

    def __init__(self, function: Callable[..., None], layout: str) -> None:
        self.function, self.layout = function, layout
        self.folder = cache_folder(function.__module__.partition(".")[0])
        self.__name__, self.__doc__ = function.__name__, function.__doc__
        KERNELS.append(self)

    @cached_property
    def compiled(self) -> Callable[..., Any]:
        """The generalized ufunc; if it cannot be cached, each process compiles its own."""
        import numba  # takes longer to import than most nodes do to start

        cores = self.layout.replace("->", ",").split("),")
        types = [numba.float64[(slice(None),) * (core.count(",") + 1)] for core in cores]
        with cache_lock(self.folder) as kept:
            wrap = numba.guvectorize([tuple(types)], self.layout, nopython=True, cache=kept)
            return wrap(self.function)

    def __call__(self, *inputs: npt.ArrayLike) -> Any:
        """Return the outputs."""
        return self.compiled(*inputs)


def kernel(layout: str) -> Callable[[Callable[..., None]], Kernel]:
    """Return a decorator that turns a function of one state into a Kernel."""
    return lambda function: Kernel(function, layout)


class Helper:
    """A function that kernels call, in any package.

    Only kernels call it. Division by zero gives inf, as in numpy, and never raises. For numba it is
    the dispatcher that numba itself would create from the function.
    """

    def __init__(self, function: Callable[..., Any], **options: str) -> None:
        self.py_func, self.options = function, options
        self.__name__, self.__doc__ = function.__name__, function.__doc__

    @cached_property
    def dispatcher(self) -> Any:
        """The function as numba's dispatcher."""
        import numba

        return numba.njit(error_model="numpy", **self.options)(self.py_func)

    @property
    def targetoptions(self) -> Any:
        """Options in which numba looks for inlining."""
        return self.dispatcher.targetoptions

    @property
    def _numba_type_(self) -> Any:
        """The type that numba uses for this object."""
        import numba

        return numba.types.Dispatcher(self.dispatcher)

    def __call__(self, *inputs: Any) -> Any:
        """Call the function from Python, as tests do."""
        return self.dispatcher(*inputs)


def helper(function: Callable[..., Any]) -> Helper:
    """Decorate a function that kernels call."""
    return Helper(function)


def inlined(function: Callable[..., Any]) -> Helper:
    """Decorate a function of an innermost loop: a call that is not inlined costs tens of ns."""
    return Helper(function, inline="always")
