"""Decoders, checks of goals and file readers on the fuzzers' corpus, and on what they find."""

import os
import re
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
from fuzz_targets import TARGETS
from fuzzing import corpus
from running import run_command

MINUTES = float(os.environ.get("FSS_FUZZ_MINUTES", "30"))  # for all targets
PROGRAM = Path(__file__).parents[1] / "support/fuzzing.py"


@pytest.mark.parametrize("name", TARGETS)
def test_each_input_of_the_corpus_is_read_or_refused(name):
    kept = corpus(name)
    assert kept
    for data in [*kept, *TARGETS[name].seeds()]:
        TARGETS[name](data)


@pytest.mark.slow
@pytest.mark.skipif(not find_spec("atheris"), reason="atheris is not installed")
@pytest.mark.parametrize("name", TARGETS)
def test_fuzzing_finds_nothing(name, tmp_path):
    seconds = max(1, round(60.0 * MINUTES / len(TARGETS)))
    command = sys.executable, PROGRAM, name, f"-max_total_time={seconds}"
    env = os.environ | {"PYTHONPATH": f"{os.environ.get('PYTHONPATH', '')}:{PROGRAM.parent}"}
    ended = run_command(*command, timeout=2.0 * seconds + 600.0, cwd=tmp_path, env=env)
    print(re.findall(r"cov: \d+ ft: \d+", ended.stderr)[-1:], *ended.stderr.splitlines()[-1:])
    assert ended.returncode == 0, ended.stderr[-5000:]
