"""Real-time scheduling of a node's process, as far as the system permits it.

`scripts/fss_up.sh` sets the variables in the environment of nodes that the configuration marks.
"""

import ctypes
import os
import resource
from collections.abc import Iterator

LOCK_CURRENT, LOCK_FUTURE, LOCK_ON_FAULT = 1, 2, 4  # flags of mlockall, Linux 4.4


def apply() -> list[str]:
    """Set priority, cores and locked memory of this process; call before it has threads.

    Reads FSS_PRIORITY, a priority of SCHED_FIFO from 2 to 98 (without it nothing is done; a law in
    a process of its own is 1 below its node), and FSS_CORES, numbers of cores such as `1` or `2,3`
    (empty: any).

    Returns:
        What the system did not permit, a line each.
    """
    priority, cores = os.environ.get("FSS_PRIORITY", ""), os.environ.get("FSS_CORES", "")
    if not priority:
        return []
    try:
        return list(_apply(int(priority), [int(core) for core in cores.split(",") if core]))
    except ValueError:
        return [f"FSS_PRIORITY is {priority!r}, FSS_CORES {cores!r}, expected numbers: not used"]


def _apply(priority: int, cores: list[int]) -> Iterator[str]:
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError as error:
        limit = resource.getrlimit(resource.RLIMIT_RTPRIO)[0]
        yield (
            f"no real-time priority {priority} ({error.strerror}; this user's limit is {limit}): "
            "the node runs with normal priority"
        )
    try:
        if cores:
            os.sched_setaffinity(0, cores)
    except OSError as error:
        which = ", ".join(map(str, cores))
        yield f"cannot run on core {which} alone ({error.strerror}): the node runs on any core"
    if problem := _lock_memory():
        yield f"memory is not locked ({problem}): it may be swapped out"


def _lock_memory() -> str:
    """Keep this process's memory from being swapped out; return why not, if so.

    With a limit, later allocations would fail once it is reached.
    """
    limit = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
    if limit != resource.RLIM_INFINITY and os.geteuid():
        return f"this user's limit is {limit >> 10} kB, expected unlimited"
    try:
        libc = ctypes.CDLL(None, use_errno=True)
        failed = libc.mlockall(LOCK_CURRENT | LOCK_FUTURE | LOCK_ON_FAULT)
    except (OSError, AttributeError):
        return "the system has no mlockall"
    return os.strerror(ctypes.get_errno()) if failed else ""


def yield_to_parent() -> None:
    """Run below the real-time priority that this process has inherited, if any."""
    if os.sched_getscheduler(0) == os.SCHED_FIFO:
        own = os.sched_getparam(0).sched_priority
        os.sched_setparam(0, os.sched_param(max(1, own - 1)))
