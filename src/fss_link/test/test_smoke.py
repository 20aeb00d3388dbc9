"""Smoke tests for `colcon test`: modules import, executables answer `--help`."""

import subprocess
from importlib import import_module
from pathlib import Path
from pkgutil import walk_packages

import pytest
from ament_index_python.packages import get_package_prefix

PACKAGE = Path(__file__).resolve().parents[1].name
EXECUTABLES = sorted(Path(get_package_prefix(PACKAGE), "lib", PACKAGE).glob("[!.]*"))


def test_every_module_can_be_imported() -> None:
    package = import_module(PACKAGE)
    for module in walk_packages(package.__path__, f"{PACKAGE}."):
        import_module(module.name)


@pytest.mark.parametrize("executable", EXECUTABLES, ids=lambda path: path.name)
def test_every_executable_answers(executable: Path) -> None:
    run = subprocess.run([executable, "--help"], capture_output=True, text=True, timeout=60)
    assert run.returncode == 0, run.stderr
    assert executable.name in run.stdout
