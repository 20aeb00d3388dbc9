"""The quick starts, as somebody types them."""

import os
import re
import shutil
import subprocess
from pathlib import Path

import calib_rig
import pytest
import yaml
from calib_float import Float, postures
from running import DOMAIN, OWN, run_command

from fss_arm_bags.reader import open_bags
from fss_arm_calib.experiment.postures import DEFAULT_POSTURES
from fss_arm_model.description_file import load

ROOT = Path(__file__).resolve().parents[3]


def typed(page):
    """All that a page has one type."""
    blocks = re.findall(r"^```sh\n(.*?)^```", (ROOT / "docs" / page).read_text(), re.M | re.S)
    return re.sub(r"\\\n *", "", "".join(blocks))


def replaced(text, changes):
    """Return a text with each of these words replaced, all of which it has."""
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, str(new))
    return text


def shell(text, timeout):
    """Run it line by line, up to the first that fails; what it said."""
    env = os.environ | {"ROS_DOMAIN_ID": str(DOMAIN)}
    run = run_command("bash", "-ec", text, timeout=timeout, cwd=ROOT, env=env)
    assert run.returncode == 0, run.stdout + run.stderr
    return run.stdout


def laboratory(folder, links):
    """Return config/fss_sim.sh with ports, ROS domain, logs and results of this test."""
    changes = {
        'ROS_DOMAIN_ID="${ROS_DOMAIN_ID:-0}"': f"ROS_DOMAIN_ID={DOMAIN} FSS_LOGS={folder}/logs",
        "out/$fss_name": folder / "out",
        "links=4": f"links={links}",
        "port=$((20000 + 40 * ROS_DOMAIN_ID))": f"port={OWN.ports(1)[0]}",
        "bind=$((port + 20 + i))": "bind=0",
    }
    return replaced((ROOT / "config/fss_sim.sh").read_text(), changes)


@pytest.mark.slow
def test_without_hardware(tmp_path):
    (tmp_path / "lab.sh").write_text(laboratory(tmp_path, 4))
    text = typed("start/simulation.md").replace("config/fss_sim.sh", str(tmp_path / "lab.sh"))
    text = text.replace("out/fss_sim", str(tmp_path / "out"))
    text = text.replace("scripts/rehearse.sh NAME", ":")  # has a test of its own
    try:
        again = typed("explanation/calibration.md")
        again = again.replace("bags/monday", str(tmp_path / "out/bags"))
        said = shell(text.replace("scripts/setup.sh\n", "") + again, 600)
    finally:
        subprocess.run([ROOT / "scripts/fss_down.sh", tmp_path / "lab.sh"], check=False)
    assert re.search(r"/calibration/kinematic +pass", said)
    assert load(tmp_path / "out/arm.yaml").n == 4
    assert list((tmp_path / "out/report").glob("*.html"))
    known = re.sub(r"link_<i>", "link_1", (ROOT / "docs/reference/topics.md").read_text())
    with open_bags(tmp_path / "out/bags") as bags:
        heard = {re.sub(r"^/link_\d", "/link_1", topic) for topic in bags.topics}
    for topic in heard - {"/rosout", "/parameter_events"}:
        assert f"`{topic}`" in known or f"`{topic[1:]}`" in known, topic


@pytest.mark.slow
def test_an_arm_of_ones_own(tmp_path):
    """The last steps of the first hour, in simulated time: a busy computer loses no link."""
    page = (ROOT / "docs/start/first_hour.md").read_text().partition("\n## 9. ")[2]
    (description,) = re.findall(r"^```yaml\n(.*?)^```", page, re.M | re.S)
    (tmp_path / "my_arm.yaml").write_text(description)
    config = re.sub(
        r"--ros-args(?=(.*))",
        lambda node: (
            f"{node[0]} -p {'keep_clock' if 'preset' in node[1] else 'use_sim_time'}:=true"
        ),
        laboratory(tmp_path, 3),
    )
    (tmp_path / "fss_sim.sh").write_text(config.replace("preset:=", "speed:=0.0 -p preset:="))
    text = "".join(re.findall(r"^```sh\n(.*?)^```", page, re.M | re.S))
    text = text.replace("-p arm:=my_arm.yaml", "-p use_sim_time:=true -p arm:=my_arm.yaml")
    text = text.replace("config/fss_sim.sh", str(tmp_path / "fss_sim.sh"))
    text = re.sub(r"(my_(?:arm\.yaml|sim\.sh))", rf"{tmp_path}/\1", text)
    # On a busy computer the nodes take longer to start than these two wait.
    text = re.sub(r"^(scripts/fss_up.sh .*)", r"\1 || true", text, flags=re.M)
    text = text.replace("scripts/fss_arm.sh arm\n", "until scripts/fss_arm.sh arm; do :; done\n")
    try:
        said = shell(text, 900)
    finally:
        subprocess.run([ROOT / "scripts/fss_down.sh", tmp_path / "my_sim.sh"], check=False)
    assert "kinematic/solve: pass" in said
    assert load(tmp_path / "out/arm.yaml").n == 3


@pytest.mark.slow
def test_from_a_bag(tmp_path):
    shutil.copytree(ROOT / "test/data/first", tmp_path / "first")
    text = typed("start/bag.md").replace("test/data/first", str(tmp_path / "first"))
    text = text.replace("out/", f"{tmp_path}/").replace("DOMAIN_ID=42", f"DOMAIN_ID={DOMAIN}")
    text = re.sub(r"(fss_arm_calib kinematic.*)", r"\1 & trap 'kill %1' EXIT", text)
    said = shell(text, 120)
    assert "pass" in said
    assert load(tmp_path / "first.yaml").n == 4
    assert list((tmp_path / "fit").glob("*.html"))


def watched(text):
    """The same without comments; each node runs for some seconds and must not end before."""
    command = r"from_bag|recompute|design|doctor|replay"
    node = rf"^(ros2 run (?!\w+ (?:{command})).*)$"
    text = re.sub(r" *#.*", "", text)
    return re.sub(node, r"timeout -s INT -k 9 9 \1 || [ $? = 124 ]", text, flags=re.M)


@pytest.mark.slow
def test_tilt_and_hose(tmp_path):
    state = [0.1, -0.2, 0.4, 0.02, -0.01, 0.01, 2e-4, -1e-4]
    flight = Float(postures(2), state=state, rest=40.0, noise=(0.001, 0.009))
    calib_rig.record(tmp_path / "monday", flight.samples(rate=20))
    text = typed("explanation/drift.md").replace("bags/monday", str(tmp_path / "monday"))
    text = text.replace("drift.yaml", str(tmp_path / "drift.yaml"))
    text = text.replace("=arm.yaml", "=config/arm.yaml")
    said = shell(watched(text.replace(" arm.yaml", " config/arm.yaml")), 120)
    assert "tilt along x" in said
    told = yaml.safe_load((tmp_path / "drift.yaml").read_text())
    assert told.keys() == {"dynamic", "base_reaction"}


@pytest.mark.slow
def test_watching_the_base_react():
    of_others = r"^(ssh|ros2 run fss_arm_bags replay) .*"  # a computer, a bag
    shell(watched(re.sub(of_others, "", typed("how-to/view.md"), flags=re.M)), 60)


@pytest.mark.slow
def test_by_hand(tmp_path):
    """The README from the real links to the bag; the arm's commands find nobody who obeys."""
    calib_rig.record(tmp_path / "monday", calib_rig.Rig(DEFAULT_POSTURES[:8], rate=50.0).samples())
    readme = typed("../README.md")
    text = readme[readme.index("ros2 run fss_arm_driver link") :]
    changes = {
        "output:=bags/monday": f"output:={tmp_path / 'new'}",
        "bags/monday": tmp_path / "monday",
        "calibrated.yaml": tmp_path / "arm.yaml",
        "my_arm.yaml": "config/cad.yaml",
        "--report fit": f"--report {tmp_path / 'fit'}",
    }
    text = replaced(text, changes)
    said = shell(re.sub(r"^(scripts/.*)", r"! \1", watched(text), flags=re.M), 200)
    assert "pass" in said
    assert load(tmp_path / "arm.yaml").n == 4
    assert list((tmp_path / "new").iterdir())


@pytest.mark.slow
def test_dynamics(tmp_path):
    calib_rig.record(tmp_path / "sunday", calib_rig.Rig(DEFAULT_POSTURES[:8], rate=50.0).samples())
    calib_rig.record(tmp_path / "monday", Float(postures(8)).samples(rate=20))
    text = typed("explanation/dynamic.md")
    text = text.replace("scripts/rehearse.sh dynamic", ":")  # has a test of its own
    text = re.sub(r"^.*(--goal|tuesday).*\n", "", text, flags=re.M)  # of other bags and results
    changes = {
        "--report report": f"--report {tmp_path / 'report'} || [ $? -ge 2 ]",
        "--kinematic bags/sunday": "--kinematic bags/sunday || [ $? -ge 2 ]",
        **{f"bags/{day}": tmp_path / day for day in ("sunday", "monday")},
        **{f"{of}.yaml": tmp_path / f"{of}.yaml" for of in ("calibrated", "kinematics", "plan")},
        "=arm.yaml": "=config/arm.yaml",
        " arm.yaml": " config/arm.yaml",
    }
    text = replaced(text, changes)
    said = shell(watched(text), 400)
    assert "b_4" in said
    assert list((tmp_path / "report").glob("*.html"))
    assert len(yaml.safe_load((tmp_path / "plan.yaml").read_text())) > 0
