import fcntl
import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from running import run_command

import fss_arm_model

COMPILE_TIMEOUT = 1200.0  # [s]
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
        return run_command(sys.executable, *arguments, timeout=COMPILE_TIMEOUT, env=env)

    def energy(self) -> float:
        return float(self.run("-c", ENERGY).stdout)

    def cached_files(self) -> dict[Path, int]:
        return {f: f.stat().st_mtime_ns for f in self.cache.rglob("*") if f.is_file()}


@pytest.fixture
def copy(tmp_path):
    return Copy(tmp_path)


OTHER_PACKAGE = {
    "__init__.py": "",
    "helpers.py": """
from fss_arm_model.kernels import helper

@helper
def more(x):
    return x + 1.0
""",
    "room/__init__.py": "",
    "room/sums.py": """
from fss_arm_model.kernels import kernel
from fss_other.helpers import more

@kernel("()->()")
def total(x, out):
    out[0] = more(x[0])
""",
}


def test_kernels_of_other_packages_follow_their_own_sources_and_the_models(copy):
    other = copy.package.parent / "fss_other"
    for name, text in OTHER_PACKAGE.items():
        (other / name).parent.mkdir(parents=True, exist_ok=True)
        (other / name).write_text(text)

    def total() -> float:
        code = "from fss_other.room.sums import total; print(total(1))"
        return float(copy.run("-c", code).stdout)

    def edit(file: Path, old: str, new: str) -> None:
        assert old in file.read_text()
        file.write_text(file.read_text().replace(old, new))

    def kernels() -> set[Path]:
        return {f.parent for f in copy.cached_files() if "total" in f.name}

    assert total() == 2.0
    cached_files = copy.cached_files()
    assert total() == 2.0
    assert copy.cached_files() == cached_files
    edit(other / "helpers.py", "x + 1.0", "x + 2.0")  # not where the kernel stands
    assert total() == 3.0
    assert len(kernels()) == 2
    edit(copy.package / "units.py", "9.81", "9.8")
    assert total() == 3.0
    assert len(kernels()) == 3
    (copy.package / "units.py").write_text("GRAVITY = 9.81")
    code = "from fss_arm_model.warm import modules; print(*modules())"
    found = copy.run("-c", code).stdout.split()
    assert {"fss_other.room.sums", "fss_arm_model.dynamics"} <= {*found}


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


def test_a_wait_for_another_process_that_compiles_is_logged(tmp_path):
    code = f"""
from pathlib import Path
from fss_arm_model.kernels import cache_lock
with cache_lock(Path({str(tmp_path)!r})):
    print("compiling")
"""
    with (tmp_path / "lock").open("a") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        waiting = subprocess.Popen([sys.executable, "-c", code], **pipes)
        assert waiting.stderr.readline().startswith("waiting for another process that compiles")
    assert waiting.communicate() == ("compiling\n", "")


def test_cache_lies_in_the_users_cache_folder(copy, tmp_path):
    code = "from fss_arm_model import kernels; print(kernels.cache_folder('fss_arm_model'))"
    folder = copy.run("-c", code, NUMBA_CACHE_DIR="", XDG_CACHE_HOME=str(tmp_path / "home"))
    assert Path(folder.stdout.strip()).parent == tmp_path / "home" / "fss_arm"
