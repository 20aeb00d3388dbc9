import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

import fss_arm_model

ENERGY = """
import numpy as np
from fss_arm_model import description, dynamics
p = description.paper_arm().vector()
print(dynamics.kinetic_energy(p, np.zeros(7), np.ones(7)))
"""


class Copy:
    """A copy of the package, and a folder for its kernels."""

    def __init__(self, folder: Path) -> None:
        self.package, self.cache = folder / "fss_arm_model", folder / "cache"
        source = Path(fss_arm_model.__file__).parent
        shutil.copytree(source, self.package, ignore=shutil.ignore_patterns("__pycache__"))

    def run(self, *arguments: str, **others: str) -> subprocess.CompletedProcess[str]:
        places = {"PYTHONPATH": str(self.package.parent), "NUMBA_CACHE_DIR": str(self.cache)}
        env = {**os.environ, **places, **others}
        command = [sys.executable, *arguments]
        return subprocess.run(command, env=env, text=True, capture_output=True, check=False)

    def energy(self) -> float:
        return float(self.run("-c", ENERGY).stdout)

    def kept(self) -> dict[Path, int]:
        return {f: f.stat().st_mtime_ns for f in self.cache.rglob("*") if f.is_file()}


@pytest.fixture
def copy(tmp_path):
    return Copy(tmp_path)


@pytest.mark.slow
def test_kernels_are_kept_until_any_source_changes(copy):
    first, kept = copy.energy(), copy.kept()
    assert kept
    assert copy.energy() == first
    assert copy.kept() == kept
    helpers = copy.package / "kinematics.py"  # dynamics.py, where the kernel is, stays as it was
    text = helpers.read_text()
    assert "return p[0] if k == 0 else" in text
    helpers.write_text(text.replace("return p[0] if k == 0 else", "return 9.0 if k == 0 else"))
    assert copy.energy() == pytest.approx(first - 1.0)  # the base 1 kg lighter, at v^2 = 2
    assert kept.items() <= copy.kept().items()


@pytest.mark.slow
def test_processes_that_compile_at_once_leave_a_whole_cache(copy):
    with ThreadPoolExecutor(2) as pool:
        energies = list(pool.map(lambda _: copy.energy(), range(2)))
    assert energies == 2 * [copy.energy()]


@pytest.mark.slow
def test_folder_that_cannot_be_written_to_is_done_without(copy):
    copy.cache.write_text("a file")
    assert copy.energy() > 0.0
    warm = copy.run("-m", "fss_arm_model.warm")
    assert warm.returncode == 1
    assert warm.stderr.count("\n") == 1
    assert "NUMBA_CACHE_DIR" in warm.stderr


def test_cache_lies_in_the_users_cache_folder(copy, tmp_path):
    code = "from fss_arm_model import _cache; print(_cache.cache_folder())"
    folder = copy.run("-c", code, NUMBA_CACHE_DIR="", XDG_CACHE_HOME=str(tmp_path / "home"))
    assert Path(folder.stdout.strip()).parent == tmp_path / "home" / "fss_arm"
