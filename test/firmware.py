"""The firmware's programs on this computer, built once and kept for the next run."""

import fcntl
import subprocess
from pathlib import Path

ROOT = Path(__file__).parents[1]
SOURCES = ROOT / "src/fss_arm_driver/firmware"
BUILT = ROOT / "build/firmware"


def build(target: str) -> Path:
    """Make one of the programs, or wait until another test process has; return its path."""
    BUILT.mkdir(parents=True, exist_ok=True)
    with (BUILT / ".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        path = BUILT / target
        made = subprocess.run(
            ["make", "-s", "-j2", "-C", SOURCES, f"BUILD={BUILT}", path],
            capture_output=True,
            text=True,
        )
    assert made.returncode == 0, made.stdout + made.stderr
    return path


class Core:
    """The firmware's core at a pipe: requests in, answers out."""

    def __init__(self) -> None:
        self.process = subprocess.Popen(
            [build("core_pipe")],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            bufsize=1,
        )

    def ask(self, request: str) -> str:
        """The answer to one request."""
        assert self.process.stdin
        assert self.process.stdout
        self.process.stdin.write(request + "\n")
        if answer := self.process.stdout.readline():
            return answer.rstrip("\n")
        _, report = self.process.communicate()
        raise AssertionError(f"the core failed at {request!r}:\n{report}")

    def close(self) -> None:
        """End it; a report of the sanitizers fails the test."""
        _, report = self.process.communicate()
        assert self.process.returncode == 0, report
