"""The link's firmware on this computer, under sanitizers, beside the Python codec."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from firmware import Core
from firmware_vectors import cases

VECTORS = Path(__file__).parents[1] / "vectors/firmware.txt"


@pytest.fixture(scope="module")
def core() -> Iterator[Core]:
    core = Core()
    yield core
    core.close()


def test_the_vectors_are_what_the_python_codec_says():
    lines = VECTORS.read_text().splitlines()
    assert lines == [f"{request} = {answer}" for request, answer in cases(seed=1, count=40)]


def test_the_firmware_agrees_with_the_vectors(core):
    lines = VECTORS.read_text().splitlines()
    answers = {answer.split()[0] for line in lines for answer in [line.split(" = ")[1]]}
    assert answers >= {"command", "length", "magic", "version", "kind", "crc", "signature", "field"}
    for line in lines:
        request, answer = line.split(" = ")
        assert core.ask(request) == answer, request


def test_the_firmware_agrees_with_the_python_codec_on_random_frames(core):
    for request, answer in cases(seed=2, count=400):
        assert core.ask(request) == answer, request
