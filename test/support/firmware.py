"""The firmware's programs on this computer, built once and kept for the next run."""

import fcntl
import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import pytest
from running import free_port

from fss_arm_driver import protocol

# The search for leaks traces the process, which a container may forbid; the core has no heap.
os.environ.setdefault("ASAN_OPTIONS", "detect_leaks=0")

ROOT = Path(__file__).parents[2]
LINK, BASE = "fss_arm_driver", "fss_base_driver"  # the packages that have firmware

needs_arm = pytest.mark.skipif(
    not shutil.which("arm-none-eabi-g++"), reason="arm-none-eabi-g++ is not installed"
)
needs_emulator = pytest.mark.skipif(
    not shutil.which("qemu-system-arm"), reason="qemu-system-arm is not installed"
)


def build(target: str, package: str = LINK) -> Path:
    """Make one of a firmware's programs, or wait until another process has; return its path."""
    built = ROOT / "build" / ("firmware" if package == LINK else "base_firmware")
    built.mkdir(parents=True, exist_ok=True)
    sources = ROOT / "src" / package / "firmware"
    with (built / ".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        path = built / target
        made = subprocess.run(
            ["make", "-s", "-j2", "-C", sources, f"BUILD={built}", path],
            capture_output=True,
            text=True,
        )
    assert made.returncode == 0, made.stdout + made.stderr
    return path


@contextmanager
def firmware_url(package: str, way: str, keys: Path) -> Iterator[str]:
    """Run a firmware as a process, reached by `--udp 0`, `--tcp 0` or `--pty`; yield its URL."""
    program = [build("fss_link"), "--link", "1"] if package == LINK else [build("fss_base", BASE)]
    command = [*program, *way.split(), "--keys", str(keys)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout
        # "link 1 at udp 40001, signed"
        kind, place = process.stdout.readline().partition(" at ")[2].split()[:2]
        place = place.rstrip(",")
        yield {
            "udp": f"udp://127.0.0.1:{place}?bind={free_port()}",
            "tcp": f"tcp://127.0.0.1:{place}",
            "serial": f"serial://{place}",
        }[kind]
        process.kill()


# A Cortex-M3 whose program reads and writes this computer's pipes (semihosting).
EMULATOR = """qemu-system-arm -M mps2-an385 -nographic -monitor none -serial none
    -semihosting-config enable=on,target=native -kernel"""


class Core:
    """The firmware's core at a pipe: requests in, answers out."""

    def __init__(self, cortex_m3: bool = False, package: str = LINK) -> None:
        program = "core_pipe" if package == LINK else "base_pipe"
        emulated = [*EMULATOR.split(), build(f"{program}_m3.elf", package)] if cortex_m3 else None
        self.process = subprocess.Popen(
            emulated or [build(program, package)],
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


class Joint(NamedTuple):
    """What the simulated drive really does."""

    position: float  # [counts]
    velocity: float  # [counts/s]
    mode: int
    baud: int


class Electronics:
    """Electronics with their firmware, in simulated time, that speak a protocol."""

    def __init__(
        self, protocol: ModuleType, core: Core, begin: str, key: bytes | None, more: object
    ) -> None:
        self.protocol, self.core, self.key = protocol, core, key
        self.clock = 0  # [us]
        self.tell(f"start {begin} {key.hex() if key else '-'} {more}")

    def tell(self, request: str) -> None:
        """Let something happen to it."""
        assert self.core.ask(request) == "done"

    def send(self, frame: Any) -> bool:
        """Deliver a command or the bytes of a datagram; whether it was taken."""
        data = frame if isinstance(frame, bytes) else self.protocol.encode(frame, self.key)
        answer = self.core.ask(f"send {data.hex() or '-'}")
        assert answer in ("taken", "refused")
        return answer == "taken"

    def sent(self, request: str, microseconds: int, kind: type) -> list[Any]:
        """Let time pass; the frames, all of one kind, that it sent meanwhile."""
        frames = self.core.ask(f"{request} {microseconds}").replace("-", "").split()
        self.clock += microseconds
        found = [self.protocol.decode(bytes.fromhex(frame), self.key) for frame in frames]
        assert all(isinstance(frame, kind) for frame in found)
        return found


class FirmwareLink(Electronics):
    """A link's electronics, a simulated drive behind them."""

    def __init__(
        self, core: Core, number: int = 2, boot: int = 7, key: bytes | None = None, serial: int = 0
    ) -> None:
        super().__init__(protocol, core, f"{number} {boot}", key, serial)

    def restart(self, boot: int) -> None:
        """Restart the electronics alone; the drive goes on."""
        self.tell(f"restart 2 {boot} - 0")

    def run(self, seconds: float) -> list[protocol.Telemetry]:
        """Let time pass; what it sent meanwhile."""
        return self.sent("run", round(1e6 * seconds), protocol.Telemetry)

    def frame(self) -> protocol.Telemetry:
        """The next one that it sends."""
        return self.run(0.25)[-1]

    def orders(self) -> list[str]:
        """What the drive was told since the last call, but for readings."""
        answer = self.core.ask("orders")
        return [] if answer == "-" else answer.split("; ")

    def joint(self) -> Joint:
        """The drive and its motor."""
        position, velocity, mode, baud = self.core.ask("joint").split()
        return Joint(float(position), float(velocity), int(mode), int(baud))
