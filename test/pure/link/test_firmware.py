"""Common parts of the links' and the board's firmware, beside the Python codecs."""

import re
import subprocess
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import base_board
import pytest
from base_firmware import FirmwareBoard
from driver_frames import BOOT, DISARM, KEY, MOVE
from firmware import BASE, LINK, Core, Electronics, FirmwareLink, build, needs_arm, needs_emulator
from firmware_vectors import VECTORS

from fss_arm_driver import protocol as links
from fss_link.protocol import CommandFlag, StatusFlag

LATCHES = StatusFlag.ARMED | StatusFlag.STOPPED | StatusFlag.WATCHDOG


class Kind(NamedTuple):
    """One kind of electronics: its programs, its frames, and the size of its program [bytes]."""

    package: str
    vectors: str
    fuzz: str
    make: Callable[..., Electronics]
    disarm: Any
    arm: Any
    size: int
    memory: int
    names: tuple[str, ...]


KINDS = {
    "link": Kind(
        LINK, "firmware", "fuzz", FirmwareLink, DISARM, MOVE, 16_000, 4_000, ("fss::Link::poll",)
    ),
    "board": Kind(
        BASE,
        "base_firmware",
        "base_fuzz",
        FirmwareBoard,
        base_board.QUIET,
        base_board.GO,
        12_000,
        2_000,
        ("fss::Base::poll", "TC3_Handler"),
    ),
}


@pytest.fixture(scope="module", params=KINDS)
def kind(request) -> Kind:
    return KINDS[request.param]


@pytest.fixture(scope="module")
def core(kind) -> Iterator[Core]:
    core = Core(package=kind.package)
    yield core
    core.close()


def vectors(kind):
    """The file of examples, and what writes it."""
    file, cases = next(item for item in VECTORS.items() if item[0].stem == kind.vectors)
    return [line.split(" = ") for line in file.read_text().splitlines()], cases


def check_vectors(core, examples):
    for request, answer in examples:
        assert core.ask(request) == answer, request


def test_the_vectors_are_what_the_python_codec_says(kind):
    examples, cases = vectors(kind)
    assert examples == list(map(list, cases(seed=1, count=40)))
    reasons = {"length", "magic", "version", "kind", "crc", "signature", "field"}
    assert {answer.split()[0] for _, answer in examples} >= {"command", *reasons}


def test_the_firmware_agrees_with_the_vectors_and_on_random_frames(kind, core):
    examples, cases = vectors(kind)
    check_vectors(core, examples)
    check_vectors(core, cases(seed=2, count=400))


@pytest.mark.parametrize("inputs", [20_000, pytest.param(10_000_000, marks=pytest.mark.slow)])
def test_random_and_damaged_inputs(kind, inputs):
    program = build(kind.fuzz, kind.package)
    fuzz = subprocess.run([program, str(inputs)], capture_output=True, text=True)
    assert fuzz.returncode == 0, fuzz.stdout + fuzz.stderr


# --- attacks -------------------------------------------------------------------------------------


@pytest.fixture
def armed(kind, core) -> Electronics:
    """Electronics with a key, armed at one second; the last command has stamp 6."""
    made = kind.make(core, key=KEY)
    run(made, 1.0)
    assert made.send(replace(kind.disarm, clock=5))
    assert made.send(replace(kind.arm, clock=6))
    return made


def run(electronics, seconds):
    """Let time pass; latches of the last frame that it sent meanwhile."""
    return electronics.sent("run", round(1e6 * seconds), object)[-1].flags & LATCHES


def attacks(encode, disarm, arm):
    """Datagrams as one without the key may send them, to electronics as `armed` has them."""
    later = replace(arm, sequence=3, clock=7)
    stop = replace(disarm, flags=CommandFlag.STOP, sequence=9)
    signed = encode(later, KEY)
    return {
        "not signed": encode(later),
        "another key": encode(later, bytes(range(1, 17))),
        "replayed": encode(replace(arm, clock=6), KEY),
        "stop from before": encode(replace(stop, clock=6), KEY),
        "disarm from before": encode(replace(disarm, sequence=9, clock=4), KEY),
        "not signed stop": encode(replace(stop, clock=9)),
        "another start's": encode(replace(later, boot=BOOT - 1), KEY),
        "another frame's signature": encode(replace(later, clock=8), KEY)[:56] + signed[56:],
        "cut": signed[:-1],
        "longer": signed + b"\0",
        "empty": b"",
    }


@pytest.mark.parametrize("name", attacks(links.encode, DISARM, MOVE))
def test_an_attack_changes_nothing_and_does_not_put_off_the_watchdog(kind, armed, name):
    watchdog = 1e-3 * kind.arm.watchdog
    assert run(armed, 0.9 * watchdog) == StatusFlag.ARMED
    assert not armed.send(attacks(armed.protocol.encode, kind.disarm, kind.arm)[name])
    assert run(armed, 0.25 * watchdog) == StatusFlag.WATCHDOG
    assert armed.send(replace(kind.disarm, sequence=9, clock=7))


def test_a_recorded_session_cannot_be_played_after_a_silence(kind, armed):
    run(armed, 1.5e-3 * kind.arm.watchdog)
    for command in (replace(kind.disarm, clock=5), replace(kind.arm, clock=6)):
        assert not armed.send(command)
    assert run(armed, 0.25) == StatusFlag.WATCHDOG


# --- on the Due's processor ----------------------------------------------------------------------


@needs_arm
def test_it_fits_the_due_and_never_asks_for_memory(kind):
    program = build("due.elf", kind.package)
    sizes = subprocess.check_output(["arm-none-eabi-size", program], text=True).splitlines()[1]
    text, data, bss = (int(size) for size in sizes.split()[:3])
    assert text + data < kind.size
    assert data + bss < kind.memory
    symbols = subprocess.check_output(["arm-none-eabi-nm", "-C", program], text=True)
    assert all(name in symbols for name in kind.names)
    assert not re.search(r"malloc|operator new|sbrk", symbols)


@needs_arm
@needs_emulator
@pytest.mark.slow
def test_a_cortex_m3_agrees_with_the_vectors(kind):
    emulated = Core(cortex_m3=True, package=kind.package)
    check_vectors(emulated, vectors(kind)[0])
    emulated.close()
