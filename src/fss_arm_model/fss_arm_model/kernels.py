"""Compiled kernels, of any package, and where they are kept between processes.

numba stamps a cached kernel with the one file it stands in, and misses an edit of a function that
it calls from another. Here the folder of the cache carries a hash of every source of this package
and of the kernel's own, so that any edit begins an empty one. It lies in $NUMBA_CACHE_DIR, else in
$XDG_CACHE_HOME/fss_arm.

A process that calls no kernel never imports numba: what kernels are made of waits, too.
"""

import fcntl
import hashlib
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, cached_property
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]


@cache
def cache_folder(package: str) -> Path:
    """The folder for the kernels of a package that is being imported, its sources as they are."""
    sources = hashlib.sha256()
    for name in (__package__, package):
        root = Path(sys.modules[name].__path__[0])
        for source in sorted(root.rglob("*.py")):
            sources.update(f"{source.relative_to(root)}\0".encode() + source.read_bytes() + b"\0")
    key = sources.hexdigest()[:16]
    if own := os.environ.get("NUMBA_CACHE_DIR"):
        return Path(own, key)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache", "fss_arm", key)


_one_thread = Lock()  # numba has from a global where to keep a kernel


@contextmanager
def alone(folder: Path) -> Iterator[bool]:
    """Let one process at a time use a folder of the cache; False where it cannot be written to.

    numba stores a kernel and its loop in two files. Of two processes that compile at once, each
    may store one of a pair, and who loads that pair crashes.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = (folder / "lock").open("a")
    except OSError:
        yield False
        return
    import numba

    with lock, _one_thread:
        fcntl.flock(lock, fcntl.LOCK_EX)
        numba.config.CACHE_DIR = str(folder)
        yield True


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
        """The generalized ufunc; where it cannot be kept, each process compiles its own."""
        import numba  # takes longer to import than most nodes do to start

        cores = self.layout.replace("->", ",").split("),")
        types = [numba.float64[(slice(None),) * (core.count(",") + 1)] for core in cores]
        with alone(self.folder) as kept:
            wrap = numba.guvectorize([tuple(types)], self.layout, nopython=True, cache=kept)
            return wrap(self.function)

    def __call__(self, *inputs: npt.ArrayLike) -> Any:
        """The outputs."""
        return self.compiled(*inputs)


def kernel(layout: str) -> Callable[[Callable[..., None]], Kernel]:
    """Decorate a function of one state to become a Kernel."""
    return lambda function: Kernel(function, layout)


class Helper:
    """A function that kernels are made of, in any package; its name begins with an underscore.

    Only kernels call it. Division by zero gives inf, as in numpy, and never raises. To numba it
    is the dispatcher that numba itself would have made of the function.
    """

    def __init__(self, function: Callable[..., Any], **options: str) -> None:
        self.py_func, self.options = function, options
        self.__name__, self.__doc__ = function.__name__, function.__doc__

    @cached_property
    def dispatcher(self) -> Any:
        """What numba compiles."""
        import numba

        return numba.njit(error_model="numpy", **self.options)(self.py_func)

    @property
    def targetoptions(self) -> Any:
        """Where numba looks whether it is to be inlined."""
        return self.dispatcher.targetoptions

    @property
    def _numba_type_(self) -> Any:
        """Where numba looks for the type of what it does not know."""
        import numba

        return numba.types.Dispatcher(self.dispatcher)

    def __call__(self, *inputs: Any) -> Any:
        """From Python, as tests do."""
        return self.dispatcher(*inputs)


def helper(function: Callable[..., Any]) -> Helper:
    """Decorate a function that kernels call."""
    return Helper(function)


def inlined(function: Callable[..., Any]) -> Helper:
    """One of an innermost loop: a call that numba does not dissolve costs tens of nanoseconds."""
    return Helper(function, inline="always")
