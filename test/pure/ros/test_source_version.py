"""The commit of a workspace and of a release."""

import subprocess

import pytest

from fss_arm_ros import source_version as module


@pytest.fixture
def workspace(tmp_path, monkeypatch):
    """A workspace in git, with a file, from which the module runs."""
    monkeypatch.setattr(module, "__file__", str(tmp_path / "src/package/package/module.py"))
    (tmp_path / "src").mkdir()
    (tmp_path / "src/file").write_text("1")
    identity = "-c", "user.name=a", "-c", "user.email=a@example.org"
    for words in (
        ("init", "-q"),
        ("add", "src/file"),
        (*identity, "commit", "-q", "-m", "test: a"),
    ):
        subprocess.run(["git", *words], cwd=tmp_path, check=True)
    return tmp_path


def version():
    return module.source_version.__wrapped__()  # without its cache


def test_uncommitted_changes_and_new_files_have_a_digest(workspace):
    commit = version()
    assert len(commit) == 10
    (workspace / "src/file").write_text("2")
    changed = version()
    (workspace / "src/law.py").touch()
    assert changed.startswith(f"{commit}+")
    assert version() not in {commit, changed}


def test_changes_of_other_files_have_no_digest(workspace):
    commit = version()
    (workspace / "notes.txt").write_text("more seeds")
    assert version() == commit


def test_a_release_has_its_commit_in_a_file(workspace):
    (workspace / "RELEASE").write_text("1a2b3c4d5e+12345678 2026-11-26T22:40:12 config/fss.sh\n")
    assert version() == "1a2b3c4d5e+12345678"


def test_without_git_it_is_unknown(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "__file__", str(tmp_path / "src/package/package/module.py"))
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    assert version() == module.UNKNOWN
