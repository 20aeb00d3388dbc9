"""Compiled kernels and where they are kept between processes.

numba stamps a cached kernel with the one file it stands in, and misses an edit of a function that
it calls from another. Here the folder of the cache carries a hash of every source of this package,
so that any edit begins an empty one. It lies in $NUMBA_CACHE_DIR, else in $XDG_CACHE_HOME/fss_arm.
"""

import fcntl
import hashlib
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any

import numba
import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]

SOURCES = Path(__file__).parent


def cache_folder() -> Path:
    """The folder that belongs to the sources as they are now."""
    sources = hashlib.sha256()
    for source in sorted(SOURCES.glob("*.py")):
        sources.update(source.name.encode() + b"\0" + source.read_bytes() + b"\0")
    key = sources.hexdigest()[:16]
    if own := os.environ.get("NUMBA_CACHE_DIR"):
        return Path(own, key)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache", "fss_arm", key)


def _use(folder: Path) -> bool:
    """Keep kernels in `folder`; where that cannot be written to, each process compiles its own."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    numba.config.CACHE_DIR = str(folder)
    return os.access(folder, os.W_OK)


CACHED = _use(cache_folder())


@contextmanager
def _alone() -> Iterator[None]:
    """Let one process at a time use the cache.

    numba stores a kernel and its loop in two files. Of two processes that compile at once, each
    may store one of a pair, and who loads that pair crashes.
    """
    if not CACHED:
        yield
        return
    with Path(numba.config.CACHE_DIR, "lock").open("a") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


KERNELS: list["Kernel"] = []


class Kernel:
    """A function of one state that broadcasts over batches, compiled when it is first called.

    It takes arrays of float64 (of length 1 where the layout says "()") and writes its outputs,
    which come last. The layout is a generalized ufunc's, for example "(p),(m)->(m,m)". Loading
    each kernel at its first call rather than at import keeps the start of a process short.
    """

    def __init__(self, function: Callable[..., None], layout: str) -> None:
        self.function, self.layout = function, layout
        self.__name__, self.__doc__ = function.__name__, function.__doc__
        KERNELS.append(self)

    @cached_property
    def compiled(self) -> Callable[..., Any]:
        """The generalized ufunc."""
        cores = self.layout.replace("->", ",").split("),")
        types = [numba.float64[(slice(None),) * (core.count(",") + 1)] for core in cores]
        wrap = numba.guvectorize([tuple(types)], self.layout, nopython=True, cache=CACHED)
        with _alone():
            return wrap(self.function)

    def __call__(self, *inputs: npt.ArrayLike) -> Any:
        return self.compiled(*inputs)


def kernel(layout: str) -> Callable[[Callable[..., None]], Kernel]:
    """Decorate a function of one state to become a Kernel."""
    return lambda function: Kernel(function, layout)


# Functions that kernels are made of: division by zero gives inf, as in numpy, and never raises.
helper = numba.njit(error_model="numpy")

# Those of innermost loops: a call that numba does not dissolve itself costs tens of nanoseconds.
inlined = numba.njit(error_model="numpy", inline="always")
