"""The scripts for the spacecraft, on real processes with a simulated test bed."""

import fcntl
import os
import pty
import re
import signal
import subprocess
from contextlib import suppress
from functools import partial
from pathlib import Path
from threading import Event

import pytest
from model_arms import short_arm
from running import DOMAIN, OWN, run_command, wait_until
from shell_scripts import script_package

from fss_arm_bags.inspection import is_sound
from fss_arm_bags.reader import find_bags, open_bags

SCRIPTS = Path(__file__).resolve().parents[3] / "scripts"
PAUSE = partial(Event().wait, 0.05)


class Laboratory:
    """A configuration of one's own, and its nodes."""

    def __init__(self, folder, *lines):
        self.logs = folder / "logs"
        self.config = folder / "lab.sh"
        settings = (f"export ROS_DOMAIN_ID={DOMAIN}", f"FSS_LOGS={self.logs}", "FSS_RESTARTS=1")
        self.config.write_text("\n".join((*settings, *lines)) + "\n")

    def run(self, script, *options):
        command = SCRIPTS / f"fss_{script}.sh", *options, self.config
        return run_command(*command, stdin=subprocess.DEVNULL)

    def pid(self, name):
        """The node's process, if it runs: it holds the lock then."""
        try:
            with (self.logs / f"{name}.node").open() as file:
                fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except FileNotFoundError:
            return None
        except BlockingIOError:
            return int((self.logs / f"{name}.node").read_text() or 0) or None
        return None

    def keeper(self, name):
        """The number of its keeper, and of the session that all of the node's processes are in."""
        return int((self.logs / f"{name}.keep").read_text())

    def events(self):
        log = self.logs / "events.log"
        return log.read_text() if log.exists() else ""


def members(session):
    """The processes of a session."""
    stats = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):  # it has just ended
            stats.append((int(stat.parent.name), stat.read_text().rsplit(")", 1)[1].split()))
    return [pid for pid, stat in stats if stat[0] != "Z" and int(stat[3]) == session]


@pytest.fixture
def laboratory(tmp_path):
    made = []

    def make(*lines):
        made.append(Laboratory(tmp_path, *lines))
        return made[-1]

    yield make
    for one in made:
        one.run("down")


@pytest.mark.slow
def test_nodes_outlive_the_line_are_started_again_and_stop_in_order(laboratory, tmp_path):
    arm, ports = short_arm(2, tmp_path), OWN.ports(2)
    names = ["record", "testbed", "link_1", "link_2", "arm"]
    lab = laboratory(
        f"node record fss_arm_bags record --ros-args -p output:={tmp_path / 'bags'}",
        f"node testbed fss_sim testbed --ros-args -p arm:={arm} -p ports:=[{ports[0]},{ports[1]}]",
        *(
            f"node link_{i} fss_arm_driver link --ros-args -p arm:={arm} -p link:={i} "
            f"-p 'url:=udp://127.0.0.1:{port}?bind=0' -p watchdog:=20.0 -p timeout:=10.0"
            for i, port in enumerate(ports, 1)
        ),
        f"node arm fss_arm_driver arm --ros-args -p arm:={arm} -p time_to_live:=10.0",
    )
    # The line drops while fss_up.sh still waits for the nodes' reports.
    child, line = pty.fork()
    if child == 0:
        os.execv(SCRIPTS / "fss_up.sh", ["fss_up.sh", str(lab.config)])
    wait_until(lambda: all(map(lab.pid, names)), 60, PAUSE)
    os.close(line)
    _, status = os.waitpid(child, 0)
    assert status != 0  # hung up, or it could not write any more

    pids = {name: lab.pid(name) for name in names}
    shown = lab.run("status", "--wait", "60")
    assert shown.returncode == 0, shown.stdout + shown.stderr
    assert re.search(r"link_2 +up .* ok +link_2 is disarmed", shown.stdout)
    assert re.search(r"/joint_states +\d", shown.stdout)
    assert {name: lab.pid(name) for name in names} == pids

    os.kill(pids["link_2"], signal.SIGKILL)
    wait_until(lambda: lab.pid("link_2") not in (None, pids["link_2"]), 60, PAUSE)
    assert "link_2 failed (exit code 137), starting it again (1 of 1)" in lab.events()
    assert lab.run("up").returncode == 0  # changes nothing
    del pids["link_2"]
    assert {name: lab.pid(name) for name in pids} == pids

    down = lab.run("down")
    assert down.returncode == 0, down.stderr
    assert down.stdout.splitlines() == [
        "all 2 links are disarmed",
        *(f"{name} has stopped" for name in reversed(names)),
    ]
    assert not any(map(lab.pid, names))
    assert not any(Path(f"/proc/{pid}").exists() for pid in pids.values())
    assert all(map(is_sound, find_bags(tmp_path / "bags")))
    with open_bags(tmp_path / "bags") as bags:
        assert bags.topics["/joint_states"].messages > 0


def test_a_node_that_keeps_failing_is_given_up_and_the_operator_told(laboratory):
    lab = laboratory("node record fss_arm_bags record")  # without the folder that it needs
    up = lab.run("up")
    assert up.returncode == 1
    assert re.search(r"record +failed", up.stdout)
    begin, first, last = lab.events().splitlines()
    assert "nodes are started: " in begin
    why = "record failed (output is empty"
    assert why in first
    assert first.endswith("), starting it again (1 of 1)")
    assert why in last
    assert last.endswith(f") 2 times and is not started again; see {lab.logs}/record.log")
    assert (lab.logs / "record.log").read_text().count("output is empty") == 2


@pytest.mark.slow
def test_a_node_that_ends_well_is_not_missed(laboratory):
    lab = laboratory("node record fss_arm_bags record --help")
    assert lab.run("up").returncode == 0
    shown = lab.run("status")
    assert shown.returncode == 0
    assert re.search(r"record +ended", shown.stdout)
    assert lab.events().endswith("record has ended\n")


@pytest.mark.slow
def test_a_node_that_lost_its_keeper_is_stopped_all_the_same(laboratory, tmp_path):
    lab = laboratory(f"node record fss_arm_bags record --ros-args -p output:={tmp_path}/bags")
    assert lab.run("up").returncode == 0
    os.kill(lab.keeper("record"), signal.SIGKILL)
    pid = lab.pid("record")
    assert pid is not None
    again = lab.run("up")
    assert (again.returncode, again.stderr) == (
        1,
        "fss_up.sh: record runs without its supervisor: fss_down.sh first\n",
    )
    assert lab.run("down").returncode == 0
    assert lab.pid("record") is None


@pytest.fixture
def armed(laboratory, tmp_path):
    """The nodes of an arm of one link, which is armed, and the sessions that they are in."""
    given = f"--ros-args -p arm:={short_arm(1, tmp_path)}"
    (port,) = OWN.ports(1)
    lab = laboratory(
        f"node testbed fss_sim testbed {given} -p ports:=[{port}]",
        f"node link_1 fss_arm_driver link {given} -p 'url:=udp://127.0.0.1:{port}?bind=0'",
        f"node arm fss_arm_driver arm {given}",
    )
    assert lab.run("up").returncode == 0
    assert lab.run("arm", "arm").stdout == "all 1 links are armed\n"
    return lab, [lab.keeper(name) for name in ("testbed", "link_1", "arm")]


@pytest.mark.slow
def test_a_driver_that_stands_still_is_woken_to_disarm_its_link(armed):
    lab, sessions = armed
    os.kill(lab.pid("link_1"), signal.SIGSTOP)
    down = lab.run("down")
    assert (down.returncode, down.stderr) == (0, "")
    assert down.stdout.splitlines()[0] == "all 1 links are disarmed"
    assert not [pid for session in sessions for pid in members(session)]


@pytest.mark.slow
def test_links_that_are_not_known_to_be_disarmed_show_in_the_exit_code(armed):
    lab, sessions = armed
    os.kill(lab.keeper("arm"), signal.SIGKILL)
    os.kill(lab.pid("arm"), signal.SIGKILL)
    down = lab.run("down")
    assert down.returncode == 1
    assert "a joint that is on will be held, under power" in down.stderr
    assert down.stdout.splitlines() == ["link_1 has stopped", "testbed has stopped"]
    assert not [pid for session in sessions for pid in members(session)]


def test_what_a_node_leaves_behind_is_ended_too(laboratory, tmp_path):
    prefix = script_package(tmp_path / "prefix", parent="sleep 61 9>&- & exec sleep 60")
    lab = laboratory(
        f"export AMENT_PREFIX_PATH={prefix}", "FSS_STOP_TIMEOUT=1", "node a pkg parent"
    )
    lab.run("up")
    session = lab.keeper("a")
    wait_until(lambda: len(members(session)) == 3, 20, PAUSE)
    down = lab.run("down")
    assert (down.returncode, down.stdout) == (1, "a was killed\n")
    assert "a did not stop and was killed" in lab.events()
    assert not members(session)


def test_what_cannot_be_ended_is_told_by_its_numbers(laboratory, tmp_path):
    prefix, able = script_package(tmp_path / "prefix", a="exec sleep 60"), tmp_path / "able"
    lab = laboratory(
        f"export AMENT_PREFIX_PATH={prefix}",
        "FSS_STOP_TIMEOUT=1",
        f"case $0 in *fss_down.sh) [ -e {able} ] || kill() {{ :; }} ;; esac",
        "node a pkg a",
        "node b pkg a",
    )
    lab.run("up")
    numbers = {lab.keeper("a"), lab.pid("a"), lab.keeper("b"), lab.pid("b")}
    down = lab.run("down")
    able.touch()
    assert down.returncode == 1
    assert down.stderr.count(" cannot be stopped, still there: ") == 2
    assert {int(word) for word in down.stderr.split() if word.isdigit()} == numbers


def test_a_ros2_that_stays_as_the_parent_of_what_it_runs_is_not_stopped_in_its_place(
    laboratory, tmp_path
):
    """As the real one does, which passes no signal on and keeps open files to itself."""
    ros2 = f'PATH=/usr/bin:/bin {SCRIPTS}/bin/ros2 "$@" 9>&-; exit $?'
    prefix = script_package(tmp_path / "prefix", sleeper="exec sleep 60", ros2=ros2)
    lab = laboratory(
        f"export AMENT_PREFIX_PATH={prefix} PATH={prefix}/lib/pkg:$PATH", "node a pkg sleeper"
    )
    lab.run("up")
    pid = wait_until(lambda: lab.pid("a"), 20, PAUSE)
    assert Path(f"/proc/{pid}/comm").read_text() == "sleep\n"
    down = lab.run("down")
    assert (down.returncode, down.stdout) == (0, "a has stopped\n")
    assert not Path(f"/proc/{pid}").exists()


def test_two_laboratories_do_not_share_a_domain(laboratory, tmp_path):
    node = f"node record fss_arm_bags record --ros-args -p output:={tmp_path / 'bags'}"
    first = laboratory(node)
    assert first.run("up").stdout.startswith(f"ROS domain {DOMAIN}, logs in {first.logs}\n")
    other = tmp_path / "other.sh"
    other.write_text(first.config.read_text().replace(str(first.logs), str(tmp_path / "logs_2")))
    up = run_command(SCRIPTS / "fss_up.sh", other)
    assert up.returncode == 1
    assert f"scripts/fss_down.sh {first.config}" in up.stderr
    assert first.pid("record")


def test_nodes_stop_though_nobody_reads_the_output(laboratory, tmp_path):
    lab = laboratory(
        *(
            f"node record_{k} fss_arm_bags record --ros-args -r __node:=record_{k} "
            f"-p output:={tmp_path / f'bags_{k}'}"
            for k in (1, 2)
        )
    )
    lab.run("up")
    reading, writing = os.pipe()
    os.close(reading)
    down = subprocess.run(
        [SCRIPTS / "fss_down.sh", lab.config], stdout=writing, check=False, timeout=60
    )
    os.close(writing)
    assert down.returncode == 0
    assert not lab.pid("record_1")
    assert not lab.pid("record_2")


@pytest.mark.slow
def test_without_a_name_the_running_configuration_is_meant(laboratory, tmp_path):
    lab = laboratory(f"node record fss_arm_bags record --ros-args -p output:={tmp_path / 'bags'}")

    def run(script):
        return run_command(SCRIPTS / f"fss_{script}.sh")

    assert "no configuration runs on this computer" in run("status").stderr
    lab.run("up")
    assert re.search(r"record +up", run("status").stdout)
    assert run("down").stdout == "record has stopped\n"
    again = lab.run("down")
    assert (again.returncode, again.stdout) == (
        0,
        f"no node of {lab.config} runs on this computer\n",
    )
