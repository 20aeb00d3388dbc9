"""The documentation as a site, built by scripts/docs.sh from pages and docstrings."""

import shutil
from pathlib import Path

import pytest
from running import run_command

ROOT = Path(__file__).resolve().parents[3]
BUILD_TIMEOUT = 1500.0  # installs the packages, then reads and writes some hundred pages [s]


def build(root):
    return run_command(root / "scripts/docs.sh", timeout=BUILD_TIMEOUT)


@pytest.mark.slow
def test_the_site_has_the_pages_the_api_and_a_search():
    run = build(ROOT)
    assert (run.returncode, run.stderr) == (0, "")
    front = Path(run.stdout.splitlines()[-1])
    text = front.read_text()
    assert "floating spacecraft simulator" in text
    version = (ROOT / "CITATION.cff").read_text().partition("\nversion: ")[2].split("\n")[0]
    assert f"<title>FSS Arm {version}" in text
    api = (front.parent / "api/fss_arm_model/fss_arm_model.html").read_text()
    assert "Momentum of the free-floating system, and the generalized Jacobian of its arm" in api
    assert 'id="fss_arm_model.kinematics.tip_in_base"' in api
    assert "tip_in_base" in (front.parent / "searchindex.js").read_text()
    pages = [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), ROOT / "test/TRIALS.md"]
    for page in pages:
        assert (front.parent / page.relative_to(ROOT)).with_suffix(".html").exists(), page


@pytest.mark.slow
def test_a_link_that_leads_nowhere_is_an_error(tmp_path):
    for name in ("docs", "scripts"):
        shutil.copytree(ROOT / name, tmp_path / name)
    (tmp_path / "src").mkdir()  # without the API it takes seconds
    (tmp_path / "test").mkdir()
    for name in ("README.md", "CITATION.cff", "LICENSE", "test/TRIALS.md"):
        shutil.copy(ROOT / name, tmp_path / name)
    if (ROOT / ".cache/docs").exists():
        (tmp_path / ".cache").symlink_to(ROOT / ".cache")
    with (tmp_path / "docs/reference/words.md").open("a") as page:
        page.write("\n[a page](nowhere.md), [a part](../README.md#nowhere)\n")
    run = build(tmp_path)
    assert run.returncode != 0
    found = [line for line in run.stderr.splitlines() if "words.md" in line and "nowhere" in line]
    assert len(found) == 2, run.stderr
