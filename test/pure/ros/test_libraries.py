"""The error about a missing library: which command installs it, and which errors pass."""

import sys

import pytest

from fss_arm_ros.libraries import require, required_libraries


def line_about(module):
    with pytest.raises(SystemExit) as ended, required_libraries("view"):
        raise ModuleNotFoundError(f"No module named {module!r}", name=module)
    return ended.value.code


def test_where_pip_installed_ros_pip_restores_the_pinned_libraries():
    assert line_about("rerun") == (
        f"view: rerun-sdk is missing; install it with: {sys.executable} -m pip install "
        "--no-deps -r scripts/requirements.txt"
    )


def test_beside_a_distribution_apt_installs_what_rosdep_knows_and_pip_the_rest(monkeypatch):
    monkeypatch.setattr(sys, "prefix", "/usr")
    assert line_about("serial").endswith(" with: sudo apt install python3-serial")
    assert line_about("rerun").endswith(
        " -m pip install -c scripts/requirements-jazzy.txt rerun-sdk"
    )


@pytest.mark.parametrize("name", ["fss_arm_view.scene", "rerun.blueprint", "PIL", None])
def test_other_errors_pass(name):
    with pytest.raises(ModuleNotFoundError), required_libraries("view"):
        raise ModuleNotFoundError("of our own, or within a library", name=name)


def test_a_library_is_required_without_its_import(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "costly.py").write_text("raise AssertionError")
    require("costly")
    with pytest.raises(ModuleNotFoundError) as error:
        require("no_such_library")
    assert error.value.name == "no_such_library"
