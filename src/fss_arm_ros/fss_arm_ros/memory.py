"""Keeps a process that runs for weeks as small as what it holds (glibc; elsewhere nothing)."""

import ctypes
from contextlib import suppress

# Of mallopt: the first size that is given back to the system when freed [bytes], and how many heaps
# threads may have. Left alone, both grow with the largest message ever seen.
M_MMAP_THRESHOLD, M_ARENA_MAX = -3, -8
LARGE, HEAPS = 1 << 19, 2


def bound() -> None:
    """Have large blocks given back as soon as they are freed; before any are taken."""
    with suppress(OSError, AttributeError):  # another C library
        libc = ctypes.CDLL(None)
        libc.mallopt(M_MMAP_THRESHOLD, LARGE)
        libc.mallopt(M_ARENA_MAX, HEAPS)


def give_back() -> None:
    """Give back what a large computation took in small blocks; takes some milliseconds."""
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)
