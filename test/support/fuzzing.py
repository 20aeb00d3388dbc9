"""Run a fuzzer's target with coverage guidance, by `atheris`; libFuzzer's options may follow.

    . scripts/env.sh; python test/support/fuzzing.py link_session -max_total_time=60

test/data/corpus/NAME.txt has its corpus: inputs in hexadecimal, one a line. `--keep` replaces it by
the inputs, old and found, that together reach the same code.
"""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import accumulate
from pathlib import Path
from tempfile import TemporaryDirectory

CORPUS = Path(__file__).parents[1] / "data/corpus"
PACKAGES = Path(__file__).parents[2] / "src"
MAX_INPUT, MAX_CORPUS = 2048, 8192  # of an input, and of those kept of a target [bytes]


def corpus(name: str) -> list[bytes]:
    """Return the inputs kept of a target."""
    path = CORPUS / f"{name}.txt"
    return [bytes.fromhex(line) for line in path.read_text().split()] if path.exists() else []


@contextmanager
def unpacked(inputs: list[bytes]) -> Iterator[Path]:
    """Yield a folder with a file for each input, as libFuzzer reads them."""
    with TemporaryDirectory() as name:
        for k, data in enumerate(inputs):
            Path(name, str(k)).write_bytes(data)
        yield Path(name)


def keep(name: str, found: Path) -> None:
    """Write the inputs of a folder that add coverage, the smallest first."""
    with TemporaryDirectory() as merged:
        command = [sys.executable, __file__, name, "-merge=1", merged, str(found)]
        subprocess.run(command, check=True, capture_output=True)
        inputs = sorted((p.read_bytes() for p in Path(merged).iterdir()), key=lambda d: (len(d), d))
    total = accumulate(map(len, inputs))
    kept = [data.hex() for data, size in zip(inputs, total, strict=True) if 0 < size < MAX_CORPUS]
    CORPUS.mkdir(parents=True, exist_ok=True)
    (CORPUS / f"{name}.txt").write_text("\n".join([*filter(None, kept), ""]))


def main() -> None:
    """Fuzz a target under atheris."""
    import atheris

    name, *options = sys.argv[1:]
    with atheris.instrument_imports(include=[path.name for path in PACKAGES.iterdir()]):
        from fuzz_targets import TARGETS
    target = TARGETS[name]
    if any(option.startswith("-merge") for option in options):
        # libFuzzer starts this program again, by a shell.
        atheris.Setup([f"{sys.executable} {__file__} {name}", *options], target)
        atheris.Fuzz()
    keeps, options = "--keep" in options, [option for option in options if option != "--keep"]
    with unpacked([*corpus(name), *target.seeds()]) as found:
        pid = os.fork()  # libFuzzer ends the process
        if not pid:
            atheris.Setup(
                [name, str(found), f"-max_len={MAX_INPUT}", "-timeout=20", *options], target
            )
            atheris.Fuzz()
        code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
        if keeps and not code:
            keep(name, found)
    sys.exit(code)


if __name__ == "__main__":
    main()
