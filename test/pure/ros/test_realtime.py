"""Real-time scheduling of a process, in processes of their own."""

import os
import sys

import pytest
from running import run_command

SHOW = """
import os
from fss_arm_ros import realtime
refused = realtime.apply()
print(os.sched_getscheduler(0) == os.SCHED_FIFO, os.sched_getparam(0).sched_priority)
locked = open("/proc/self/status").read().split("VmLck:")[1].split()[0]
print(sorted(os.sched_getaffinity(0)), locked)
print(*refused, sep="\\n")
"""
REFUSE = """
import errno, os, resource
def refuse(*_):
    raise PermissionError(errno.EPERM, os.strerror(errno.EPERM))
os.sched_setscheduler = os.sched_setaffinity = refuse
os.geteuid, resource.getrlimit = lambda: 1000, lambda _: (8 << 20, 8 << 20)
"""


def shown(script, **environment):
    env = os.environ | environment
    done = run_command(sys.executable, "-c", script, check=True, env=env)
    return done.stdout.splitlines()


def test_an_unmarked_node_changes_nothing():
    policy, memory, refused = shown(SHOW)
    assert policy == "False 0"
    assert memory.split("] ")[1] == "0"
    assert refused == ""


def test_a_marked_node_has_what_the_system_permits():
    policy, memory, *refused = shown(SHOW, FSS_PRIORITY="60", FSS_CORES="0")
    said = " ".join(refused)
    assert policy == "True 60" or "no real-time priority 60" in said
    assert memory.startswith("[0] ") or "core 0 alone" in said
    assert int(memory.split("] ")[1]) or "memory is not locked" in said


def test_what_is_not_permitted_is_said():
    *_, first, second, third = shown(REFUSE + SHOW, FSS_PRIORITY="60", FSS_CORES="0")
    assert first == (
        "no real-time priority 60 (Operation not permitted; this user's limit is 8388608): "
        "the node runs with normal priority"
    )
    assert second == (
        "cannot run on core 0 alone (Operation not permitted): the node runs on any core"
    )
    assert third == (
        "memory is not locked (this user's limit is 8192 kB, expected unlimited): "
        "it may be swapped out"
    )


@pytest.mark.parametrize(("own", "then"), [(60, 59), (2, 1)])
def test_a_law_is_below_its_node(own, then):
    script = f"""
import os
from fss_arm_ros.realtime import yield_to_parent
os.sched_getscheduler = lambda _: os.SCHED_FIFO
os.sched_getparam = lambda _: os.sched_param({own})
os.sched_setparam = lambda _, param: print(param.sched_priority)
yield_to_parent()
"""
    assert shown(script) == [str(then)]
