"""Failures of a law in its process, as the node receives them."""

import os
import signal
import subprocess
import sys
from pathlib import Path
from time import monotonic

import pytest
from faulty_laws import GOOD_STEPS
from law_bench import inputs
from running import run_command, wait_until

from fss_gnc.law.contract import LawError
from fss_gnc.law.process import LawProcess

LAWS = Path(__file__).parents[2] / "support/faulty_laws.py"
TIMEOUT = 60.0  # [s]


@pytest.fixture
def start():
    started = []

    def begin(name):
        started.append(LawProcess(f"{LAWS}:{name}", 4, 0.02))
        return started[-1]

    yield begin
    for process in started:
        process.close()


def answer(process):
    """Wait for READY or an output."""
    was_ready, deadline = process.ready, monotonic() + TIMEOUT
    while monotonic() < deadline:
        outputs = process.receive(1.0)
        if outputs or process.ready > was_ready:
            return outputs
    raise TimeoutError


def run(process, steps):
    answer(process)
    for _ in range(steps):
        process.send(inputs())
        outputs = answer(process)
    return outputs


REAL_TIME = """
import os, resource
from test_law_process import GOOD_STEPS, LAWS, LawProcess, inputs, run
os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))
os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
resource.setrlimit(resource.RLIMIT_RTTIME, (5_000_000, 5_000_000))  # ends the law if all else fails
process = LawProcess(f"{LAWS}:Endless", 4, 0.02)
run(process, GOOD_STEPS)
process.send(inputs())
print(process.receive(0.2))
process.kill()
"""


def test_an_endless_law_leaves_its_real_time_node_the_core():
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))
    except OSError:
        pytest.skip("the system permits no real-time priority")
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    path = f"{Path(__file__).parent}:{LAWS.parent}:{os.environ['PYTHONPATH']}"
    env = os.environ | {"PYTHONPATH": path}
    ended = run_command(sys.executable, "-c", REAL_TIME, timeout=TIMEOUT, env=env)
    assert (ended.stdout, ended.returncode) == ("None\n", 0), ended.stderr


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("Exceptional", r"^ZeroDivisionError: of the law \(faulty_laws.py:\d+\)$"),
        ("Segmentation", r"^SIGSEGV$"),
        ("Leak", "^MemoryError"),
        ("NotANumber", r"^wrench is \[0.01, nan, 0.01\], expected finite numbers$"),
        ("Exiting", "^exit code 3$"),
        ("Short", r"joint_velocities has shape \(2,\), expected \(4,\)"),
        ("Broken", r"^ValueError: no gains \(faulty_laws.py:\d+\)$"),
        ("Singular", r"^LinAlgError: Singular matrix \(faulty_laws.py:\d+\)$"),
        ("Piping", r"^BrokenPipeError: of the law \(faulty_laws.py:\d+\)$"),
    ],
)
def test_a_fault_is_reported_by_its_name(start, name, reason):
    process = start(name)
    with pytest.raises(LawError, match=reason):
        run(process, GOOD_STEPS + 50)


def test_a_syntax_error_is_reported_with_its_own_place(tmp_path):
    law = tmp_path / "law.py"
    law.write_text("class Law:\n    def step(self inputs): ...\n")
    process = LawProcess(f"{law}:Law", 4, 0.02)
    with pytest.raises(LawError, match=r"^SyntaxError: .* \(law.py, line 2\)$"):
        answer(process)
    process.close()


def test_a_killed_process_is_reported_by_its_signal(start):
    process = start("Good")
    run(process, 3)
    os.kill(process.pid, signal.SIGKILL)
    with pytest.raises(LawError, match=r"^SIGKILL$"):
        answer(process)
    process.send(inputs())  # changes nothing


def test_an_endless_law_ends_when_it_is_closed(start):
    process = start("Endless")
    run(process, GOOD_STEPS)
    process.send(inputs())
    assert process.receive(0.1) is None
    process.close()
    with pytest.raises(ProcessLookupError):
        os.kill(process.pid, 0)


NODE = """
from time import sleep
from law_bench import inputs
from fss_gnc.law.process import LawProcess
process = LawProcess({law!r}, 4, 0.02)
steps = 0
while steps < {steps}:
    steps += process.receive(1.0) is not None
    if process.ready:
        process.send(inputs())
print(process.pid, flush=True)
sleep(60)
"""


def test_an_endless_law_ends_when_its_node_is_killed():
    code = NODE.format(law=f"{LAWS}:Endless", steps=GOOD_STEPS)
    path = os.pathsep.join([str(LAWS.parent), os.environ.get("PYTHONPATH", "")])
    env, command = {**os.environ, "PYTHONPATH": path}, [sys.executable, "-c", code]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=env) as node:
        pid = int(node.stdout.readline())
        assert is_running(pid)
        node.kill()
    wait_until(lambda: not is_running(pid), TIMEOUT, os.sched_yield)


def is_running(pid):
    """Return True if a process exists and is no zombie."""
    status = Path(f"/proc/{pid}/status")
    return status.exists() and "State:\tZ" not in status.read_text()
