"""Common parts of the links' and the board's firmware, beside the Python codecs."""

import re
import subprocess
from collections.abc import Iterator
from typing import NamedTuple

import pytest
from firmware import BASE, LINK, Core, build, needs_arm, needs_emulator
from firmware_vectors import VECTORS


class Kind(NamedTuple):
    """One kind of electronics: its programs, and the size of its program [bytes]."""

    package: str
    vectors: str
    fuzz: str
    size: int
    memory: int
    names: tuple[str, ...]


LINK_NAMES, BOARD_NAMES = ("fss::Link::poll",), ("fss::Base::poll", "TC3_Handler")
KINDS = {
    "link": Kind(LINK, "firmware", "fuzz", 16_000, 4_000, LINK_NAMES),
    "board": Kind(BASE, "base_firmware", "base_fuzz", 12_000, 2_000, BOARD_NAMES),
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
