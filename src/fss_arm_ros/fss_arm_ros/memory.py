"""Limits on the memory that glibc keeps after it is freed, for processes that run for weeks."""

import ctypes
from contextlib import suppress

# Parameters of mallopt: size from which freed blocks return to the system [bytes], and number of
# heaps. By default, both grow with the largest message received.
M_MMAP_THRESHOLD, M_ARENA_MAX = -3, -8
LARGE, HEAPS = 1 << 19, 2


def bound() -> None:
    """Return large blocks to the system when they are freed; call before allocating any."""
    with suppress(OSError, AttributeError):  # another C library
        libc = ctypes.CDLL(None)
        libc.mallopt(M_MMAP_THRESHOLD, LARGE)
        libc.mallopt(M_ARENA_MAX, HEAPS)


def give_back() -> None:
    """Return the small blocks freed after a large computation; takes some milliseconds."""
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)
