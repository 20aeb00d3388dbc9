"""The shell scripts: what they leave in a shell, and the one line that every failure ends in.

test_setup.py has those of setup.sh.
"""

import fcntl
import os
import re
import runpy
import shlex
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from io import StringIO
from itertools import pairwise
from math import inf, radians
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from rclpy.clock import Clock
from rclpy.serialization import serialize_message
from rich.console import Console
from running import run_command as run
from sensor_msgs.msg import JointState
from shell_scripts import script_package, write_script

from fss_arm_msgs.msg import LinkTelemetry
from fss_arm_ros.source_version import source_version
from fss_arm_ros.timing import MISSED, Timing
from fss_listener import Listener, Received

ROOT = Path(__file__).parents[3]
STAND_IN = ROOT / "scripts/bin/ros2"
SCRIPTS = [
    str(path.relative_to(ROOT))
    for pattern in ("scripts/**/*.sh", "scripts/bin/*", ".ci/run", "config/*.sh")
    for path in sorted(ROOT.glob(pattern))
]


def test_shellcheck_finds_nothing():
    check = run("shellcheck", "-x", *SCRIPTS, cwd=ROOT)
    assert check.returncode == 0, check.stdout


@pytest.mark.parametrize("name", [n for n in SCRIPTS if "fss" in n])
def test_the_scripts_for_the_spacecraft_are_plain_sh(name):
    assert re.search(r"^#!/bin/sh$|^# shellcheck shell=sh\b", (ROOT / name).read_text(), re.M)


# --- env.sh --------------------------------------------------------------------------------------

SHELLS = [
    pytest.param(
        shell,
        marks=pytest.mark.skipif(not shutil.which(shell), reason=f"{shell} is not installed"),
    )
    for shell in ("bash", "zsh", "dash")
]
BARE = {"PATH": "/usr/local/bin:/usr/bin:/bin", "HOME": "/nonexistent"}
SOURCE = f". {ROOT}/scripts/env.sh"


@pytest.mark.parametrize("options", ["", "set -eu; "])
@pytest.mark.parametrize("shell", SHELLS)
def test_env_leaves_the_shells_options_alone(shell, options):
    program = f'{options}before=$-; {SOURCE}; echo "<$before> <$->"; set | grep ^_fss || true'
    shown = run(shell, "-c", program, env=BARE, cwd=ROOT)
    assert shown.stderr == ""
    before, after = shown.stdout.split()  # what the script forgot to unset would come after
    assert before == after


@pytest.mark.parametrize("shell", SHELLS)
def test_env_gives_the_workspace_to_a_bare_shell(shell):
    names = "ROS_DISTRO ROS_AUTOMATIC_DISCOVERY_RANGE ROS_LOG_DIR FASTRTPS_DEFAULT_PROFILES_FILE"
    program = (
        f"{SOURCE}; {SOURCE}; command -v python; echo $PATH; "
        f"for name in {names}; do eval echo \\$$name; done; "
        "python -c 'import rclpy, fss_arm_msgs.msg, fss_arm_model, sys; "
        "print(sys.dont_write_bytecode)'"
    )
    shown = run(shell, "-c", program, env=BARE | {"PYTHONDONTWRITEBYTECODE": "1"}, cwd=ROOT)
    assert (shown.returncode, shown.stderr) == (0, "")
    python, path, distro, reach, logs, profiles, forgets = shown.stdout.splitlines()
    assert python == f"{ROOT}/.venv/bin/python"
    folders = path.split(":")
    assert (folders[0], folders[-1]) == (f"{ROOT}/.venv/bin", f"{ROOT}/scripts/bin")
    assert len(folders) == len(set(folders))
    assert distro == "jazzy"
    assert reach == "SYSTEM_DEFAULT"
    assert logs == f"{ROOT}/log/ros"
    assert profiles == f"{ROOT}/config/fastdds.xml"
    assert forgets == "False"  # what it compiles is kept


def test_env_keeps_what_the_user_chose():
    chosen = BARE | {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET", "ROS_LOG_DIR": "/mine"}
    names = "$ROS_AUTOMATIC_DISCOVERY_RANGE $ROS_LOG_DIR $FASTRTPS_DEFAULT_PROFILES_FILE"
    shown = run("bash", "-c", f"{SOURCE}; echo {names}", env=chosen)
    assert shown.stdout.split() == ["SUBNET", "/mine", f"{ROOT}/config/fastdds_network.xml"]


def test_env_says_in_one_line_what_it_lacks(tmp_path):
    write_script(tmp_path / "scripts/env.sh", (ROOT / "scripts/env.sh").read_text())
    shown = run("bash", "-c", f"set -u; . {tmp_path}/scripts/env.sh || echo $? $-", env=BARE)
    assert shown.stderr == (f"env.sh: there is no .venv yet; run {tmp_path}/scripts/setup.sh\n")
    assert shown.stdout.startswith("1 ")
    assert "u" in shown.stdout
    elsewhere = run("dash", "-c", SOURCE, env=BARE, cwd=tmp_path.parent)
    assert elsewhere.stderr.count("\n") == 1


# --- the spacecraft's configuration --------------------------------------------------------------


def write_units(folder: Path, *config: Path | str, **env: str) -> None:
    """Write the units of a configuration, by default of config/fss.sh."""
    written = run("scripts/fss_systemd.sh", folder, *config, cwd=ROOT, env=os.environ | env)
    assert (written.returncode, written.stderr) == (0, "")


@pytest.mark.parametrize(
    ("name", "first"), [("fss", ["record"]), ("fss_sim", ["record", "testbed"])]
)
def test_systemd_takes_the_units_of_each_configuration(tmp_path, name, first):
    write_units(tmp_path, f"config/{name}.sh")
    links = [f"link_{i}" for i in range(1, 5)]
    nodes = [*first, *links, "arm", "kinematic", "base_reaction"]
    units = {tmp_path / f"{name}-{node}.service" for node in nodes}
    assert set(tmp_path.iterdir()) == units | {tmp_path / f"{name}.target"}
    after = dict(pairwise(nodes))
    for node, following in after.items():
        unit = (tmp_path / f"{name}-{following}.service").read_text()
        assert f"After={name}-{node}.service" in unit
        assert "keep.sh" not in unit  # systemd alone starts again
    if shutil.which("systemd-analyze"):
        verified = run("systemd-analyze", "verify", *tmp_path.iterdir())
        assert (verified.returncode, verified.stderr) == (0, "")


def test_units_reach_the_nodes_and_leave_the_logs_to_their_user(tmp_path):
    reach = {
        "ROS_DOMAIN_ID": "7",
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET",
        "ROS_STATIC_PEERS": "192.168.1.10;192.168.1.20",
        "ROS_DISCOVERY_SERVER": "192.168.1.10:11811;192.168.1.20:11811",
        "ROS_SUPER_CLIENT": "TRUE",
    }
    config = tmp_path / "lab.sh"
    settings = [f"FSS_LOGS={tmp_path}/logs", *(f'export {k}="{v}"' for k, v in reach.items())]
    config.write_text("\n".join([*settings, "node arm p x", "node b p y"]) + "\n")
    write_units(tmp_path / "units", config)
    for node in ("arm", "b"):
        unit = (tmp_path / f"units/lab-{node}.service").read_text()
        given = re.findall(r'^Environment="(.*?)=(.*)"$', unit, re.M)
        assert sorted(given) == sorted(reach.items())
        assert f"StandardOutput=append:{tmp_path}/logs/{node}.log\n" in unit
        assert (tmp_path / f"logs/{node}.log").is_file()  # else systemd would make it as root


@pytest.mark.parametrize(("process", "said"), [({"MAINPID": "7"}, "disarm\n"), ({}, "")])
def test_systemd_disarms_by_the_arm_node_if_there_is_one_left(tmp_path, process, said):
    config = tmp_path / "lab.sh"
    config.write_text(f"FSS_LOGS={tmp_path}/logs\nnode arm p x\nnode b p y\n")
    write_units(tmp_path / "units", config)
    assert "ExecStop=" not in (tmp_path / "units/lab-b.service").read_text()
    (command,) = re.findall(
        r"^ExecStop=-(.*)$", (tmp_path / "units/lab-arm.service").read_text(), re.M
    )
    words = shlex.split(command.replace("$$", "$").replace(f"{ROOT}/scripts/fss_arm.sh", "echo"))
    stopped = run(*words, env=BARE | process)
    assert (stopped.returncode, stopped.stdout, stopped.stderr) == (0, said, "")


def test_units_of_two_vehicles_are_told_apart(tmp_path):
    write_units(tmp_path, "config/fss_two_sim.sh")
    unit = (tmp_path / "fss_two_sim-fss2-arm.service").read_text()
    assert "After=fss_two_sim-fss2-link_4.service" in unit
    assert "fss_two_sim.sh fss2/arm\n" in unit
    assert "fss_arm.sh --vehicle fss2 disarm" in unit
    assert "fss_two_sim-fss1-record.service" in (tmp_path / "fss_two_sim.target").read_text()
    assert "FSS_NAMESPACE" not in unit
    write_units(tmp_path, FSS_NAMESPACE="fss2")
    unit = (tmp_path / "fss-fss2-arm.service").read_text()
    assert 'Environment="FSS_NAMESPACE=fss2"' in unit


@pytest.mark.parametrize("command", ["fss_up.sh", "fss_status.sh", "fss_arm.sh stop"])
def test_a_configuration_that_is_nowhere_is_named(command):
    name, *words = command.split()
    shown = run(ROOT / "scripts" / name, *words, "/nowhere/at/all.sh")
    assert shown.returncode == 1
    there = " ".join(f"config/{path.name}" for path in sorted((ROOT / "config").glob("*.sh")))
    problem = f"/nowhere/at/all.sh: no such configuration; there are {there} in {ROOT}"
    assert shown.stderr == f"{name}: {problem}\n"


VEHICLES = """
FSS_NAMESPACE=
node testbed p x
for v in fss1 fss2; do
  FSS_NAMESPACE=$v
  node arm p y a
done
"""
NODES = '. scripts/fss/config.sh; read_config lab.sh; say() { echo "$* in $FSS_NAMESPACE"; }; '


@pytest.mark.parametrize(
    ("config", "vehicle", "seen"),
    [
        (VEHICLES, "", ["testbed p x in", "fss1/arm p y a in fss1", "fss2/arm p y a in fss2"]),
        (VEHICLES, "fss2", ["fss2/arm p y a in fss2"]),
        ("node arm p y", "", ["arm p y in"]),
        ("node arm p y", "/lab/fss2", ["lab/fss2/arm p y in lab/fss2"]),
        ("FSS_NAMESPACE=fss3; node arm p y", "", ["fss3/arm p y in fss3"]),
    ],
)
def test_nodes_are_in_the_namespace_of_their_vehicle(tmp_path, config, vehicle, seen):
    (tmp_path / "lab.sh").write_text(f"FSS_LOGS={tmp_path}/logs\n{config}\n")
    program = NODES.replace("lab.sh", f"{tmp_path}/lab.sh")
    env = os.environ | {"FSS_NAMESPACE": vehicle}
    where = f"fss_scripts={ROOT}/scripts; "
    shown = run("sh", "-euc", f"{where}{program}each_node say; echo $fss_nodes", cwd=ROOT, env=env)
    assert shown.stderr == ""
    *lines, names = shown.stdout.splitlines()
    assert [line.strip() for line in lines] == seen
    assert names.split() == [line.split()[0] for line in seen]


@pytest.mark.parametrize(
    ("text", "vehicle", "words"),
    [
        ("", "", "has no node"),
        ("node", "", "node '': expected letters"),
        ("node a-b p x", "", "node 'a-b': expected letters"),
        ("node a p", "", "node a: expected NAME PACKAGE EXECUTABLE"),
        ("node a p x; node a p y", "", "node a is defined twice"),
        ("node a p x", "", "node a: there is no executable 'x' in a package 'p'"),
        ("exit 0", "", "lab.sh: stopped before its end"),
        *(
            (
                f"ROS_DOMAIN_ID={domain}\nnode record fss_arm_bags record",
                "",
                f"ROS_DOMAIN_ID is '{domain}', expected a whole number from 0 to 232",
            )
            for domain in ("abc", "-1", "233")
        ),
        ("realtime 1 any node a p x", "", "the priority is '1', expected a whole number from 2"),
        ("realtime 50 0,x node a p x", "", "the cores are '0,x', expected numbers such as 2,3"),
        ("realtime 50 nod a p x", "", "the cores are 'nod', expected numbers"),
        ("realtime 50 any nod a p x", "", "'nod' follows the cores, expected node"),
        (VEHICLES, "fss3", "has no node in the namespace fss3"),
        ("FSS_NAMESPACE=2nd; node a p x", "", "FSS_NAMESPACE is '2nd', expected the name of"),
        ("FSS_NAMESPACE=a-b; node a p x", "", "FSS_NAMESPACE is 'a-b', expected letters"),
    ],
)
def test_a_wrong_configuration_ends_in_one_line(tmp_path, text, vehicle, words):
    (tmp_path / "lab.sh").write_text(f"FSS_LOGS={tmp_path}/logs\n{text}\n")
    option = ["--vehicle", vehicle] if vehicle else []
    shown = run("scripts/fss_up.sh", *option, tmp_path / "lab.sh", cwd=ROOT)
    assert (shown.returncode, shown.stdout) == (1, "")
    assert shown.stderr.startswith("fss_up.sh: ")
    assert words in shown.stderr
    assert shown.stderr.count("\n") == 1


@pytest.fixture
def status(monkeypatch) -> dict[str, Any]:
    """The names of fss_status.py."""
    monkeypatch.setenv("ROS_DOMAIN_ID", "64")
    return runpy.run_path(str(ROOT / "scripts/fss_status.py"))


def listener_of(*reports: DiagnosticStatus, **more: Any) -> SimpleNamespace:
    """Return what the screen reads of a listener that has received these reports."""
    named = {report.name: report for report in reports}
    values = {"measured": {}, "results": {}, "reports": named, "report": named.get}
    return SimpleNamespace(**(values | more))


@contextmanager
def running(folder: Path, *names: str) -> Iterator[None]:
    """Hold the locks of nodes, as their processes do."""
    with ExitStack() as files:
        for name in names:
            fcntl.flock(files.enter_context((folder / f"{name}.node").open("w")), fcntl.LOCK_EX)
        yield


def lines_of(shown: Any, width: int = 80) -> list[str]:
    """Return the lines that something has on a terminal of this width."""
    screen = StringIO()
    Console(file=screen, width=width).print(shown)
    return [line.strip() for line in screen.getvalue().splitlines() if line.strip()]


def test_the_status_has_the_commit_and_the_hash_of_each_law(status):
    values = [KeyValue(key="law", value="pd.py:Pd"), KeyValue(key="hash of its file", value="1a2b")]
    listener = listener_of(DiagnosticStatus(name="controller", values=values))
    _, _, commit, law = lines_of(status["version_table"](listener))
    assert commit.split() == ["commit", source_version()]
    assert law.split() == ["pd.py:Pd", "1a2b"]


def test_a_process_with_no_node_of_its_name_is_told_from_one_that_is_mute(tmp_path, status):
    processes = status["Processes"](tmp_path, ["links", "arm"], ["vicon"])
    ok = DiagnosticStatus(name="arm", level=DiagnosticStatus.OK, message="all is well")
    with running(tmp_path, "links", "arm", "vicon"):
        lines = lines_of(status["node_table"](processes, listener_of(ok)), 120)
    shown = {line.split()[0]: line for line in lines}
    assert "runs, has not reported" in shown["links"]
    assert shown["arm"].endswith("all is well")
    assert "runs, but" not in shown["vicon"]


@pytest.mark.parametrize(("last", "end"), [(inf, 50.0), (45.0, 45.0)])
def test_slow_nodes_are_waited_for_while_others_become_healthy(tmp_path, status, last, end):
    clock, reports, due = [0.0], {}, {"links": 15.0, "arm": 30.0, "late": last}

    def listen(seconds):
        clock[0] += seconds
        reports.update({name: DiagnosticStatus() for name in due if clock[0] >= due[name]})

    listener = SimpleNamespace(reports=reports, report=reports.get)
    processes = status["Processes"](tmp_path, list(due), [])
    with running(tmp_path, *due):
        status["wait_for_health"](processes, listener, 20.0, listen, lambda: clock[0])
    assert clock[0] == pytest.approx(end, abs=0.2)


def test_a_link_is_shown_in_degrees_within_80_columns(tmp_path, status):
    kinds = {"/fss2/link_1/telemetry": LinkTelemetry, "/fss2/joint_states": JointState}
    heard = {topic: Received(kind) for topic, kind in kinds.items()}
    link = LinkTelemetry(link=1, armed=True, position=1, flags=8, current=-120, battery=165)
    for q, name in ((radians(-12.34), "joint_1"), (radians(5.0), "joint_2")):
        heard["/fss2/joint_states"].add(
            serialize_message(JointState(name=[name], position=[q]))
        )  # a message each
    heard["/fss2/link_1/telemetry"].add(serialize_message(link))
    listener = listener_of(measured=heard)
    listener.angles = partial(Listener.angles, listener)
    shown = status["screen"](status["Processes"](tmp_path, [], []), listener)
    lines = lines_of(shown)
    row = next(line for line in lines if line.startswith("fss2/link_1")).split()
    assert row[:5] == ["fss2/link_1", "armed", "-12.3", "-1.20", "16.5"]
    link.battery = 0  # not reported yet
    heard["/fss2/link_1/telemetry"].add(serialize_message(link))
    (row,) = (line.split() for line in lines_of(status["link_table"](listener)) if "fss2" in line)
    assert row[4] == "-"


def test_what_is_not_healthy_is_named_with_its_state(tmp_path, status):
    names = "arm", "link", "record", "view"
    processes = status["Processes"](tmp_path, [*names, "base"], ["vicon"])
    levels = {"arm": DiagnosticStatus.OK, "link": DiagnosticStatus.ERROR}
    reports = [DiagnosticStatus(name=name, level=level) for name, level in levels.items()]
    (tmp_path / "record.keep").write_text("failed\n")
    (tmp_path / "base.keep").write_text("ended\n")
    with running(tmp_path, "arm", "link", "view", "vicon"):
        found = status["problems"](processes, listener_of(*reports))
    assert found == ["record is failed", "view does not report", "link reports an error"]
    words = status["summary"]([*found, "arm reports an error"], "log/fss")
    groups = "record is failed; view does not report; link, arm report errors"
    assert words == f"not healthy: {groups}; logs: log/fss"


def workspace_of(folder: Path, ros2: str) -> Path:
    """Copy the scripts and configurations into a folder, with a script in place of ros2."""
    for part in ("scripts", "config"):
        shutil.copytree(ROOT / part, folder / part)
    write_script(folder / "scripts/bin/ros2", ros2)
    write_script(folder / "scripts/env.sh", "")
    return folder


def test_timing_is_shown_within_80_columns(status):
    node = SimpleNamespace(get_clock=Clock, get_parameter=lambda _: SimpleNamespace(value=False))
    timing = Timing(100.0, node)
    timing.add_step()
    timing.add_command(time.time_ns())
    timing.add_step()
    values = [KeyValue(key=key, value=f"{value:.6g}") for key, value in timing.values().items()]
    unknown = [KeyValue(key=MISSED, value="n/a"), KeyValue(key="period p50 [ms]", value="[b]")]
    names = ["fss2/control", "fss2/navigation"]
    reports = [DiagnosticStatus(name=name, values=values) for name in names]
    listener = listener_of(*reports, DiagnosticStatus(name="x", values=unknown))
    rows = [line.split() for line in lines_of(status["timing_table"](listener))]
    assert [row[0] for row in rows if len(row) == 8] == names
    assert ["x", "n/a"] in rows


def test_a_marked_node_has_its_priority_and_cores(tmp_path):
    (tmp_path / "lab.sh").write_text(
        "node b p x\nrealtime 60 1,2 node a p x\nrealtime 50 any node c p x\nnode d p x\n"
    )
    script = (
        'fss_scripts=scripts; . scripts/fss/config.sh; read_config "$0"; '
        'show() { echo "$1 $fss_priority $fss_cores"; }; each_node show'
    )
    shown = run("sh", "-c", script, tmp_path / "lab.sh", cwd=ROOT)
    assert shown.stdout.splitlines() == ["b  ", "a 60 1,2", "c 50 ", "d  "]
    write_units(tmp_path / "units", tmp_path / "lab.sh")
    limits = "LimitRTPRIO=60\nLimitMEMLOCK=infinity\n"
    assert limits in (tmp_path / "units/lab-a.service").read_text()
    assert "LimitRTPRIO" not in (tmp_path / "units/lab-b.service").read_text()
    own = workspace_of(tmp_path, 'echo "$FSS_PRIORITY $FSS_CORES"')
    for name, seen in (("a", "60 1,2"), ("c", "50 "), ("d", " ")):
        shown = run(own / "scripts/fss/node.sh", tmp_path / "lab.sh", name, env=BARE)
        assert shown.stdout == f"{seen}\n"


def test_a_failed_node_says_why_and_events_are_those_of_this_session(tmp_path, status):
    (tmp_path / "link.keep").write_text("failed\n")
    (tmp_path / "link.log").write_text("[INFO] begins\nlink: the port is taken\n\n")
    for name, state in (("arm", "failed"), ("record", "stopped")):
        (tmp_path / f"{name}.keep").write_text(f"{state}\n")
        (tmp_path / f"{name}.log").write_text(f"[ERROR] [1795718826.249418224] [{name}]: lost\n")
    events = ["old link failed", "nodes are started: link", "link failed (1)"]
    (tmp_path / "events.log").write_text("\n".join(events) + "\n")
    processes = status["Processes"](tmp_path, ["link", "arm", "record"], [])
    lines = lines_of(status["screen"](processes, listener_of()))
    assert any(re.fullmatch(r"link +failed +link: the port is taken", line) for line in lines)
    assert any(re.fullmatch(r"arm +failed +\[arm\]: lost", line) for line in lines)
    assert any(re.fullmatch(r"record +stopped", line) for line in lines)  # as requested
    assert lines[-2:] == events[1:]
    assert "no node reports in ROS domain 64" in lines


def check_help(told, script):
    """Check the output of a script's --help, which fits a narrow terminal."""
    assert (told.returncode, told.stderr) == (0, "")
    assert f"usage: {script}.sh" in told.stdout
    assert not told.stdout.startswith("#")
    assert max(map(len, told.stdout.splitlines())) <= 80


@pytest.mark.parametrize("name", ["up", "down", "status", "systemd", "deploy", "security"])
def test_help_is_what_the_script_says_of_itself(name):
    check_help(run(ROOT / f"scripts/fss_{name}.sh", "--help"), f"fss_{name}")


@pytest.mark.parametrize("name", ["rehearse", "demo", "mission", "dataset", "fmu", "docs", "setup"])
def test_help_comes_without_a_set_up(tmp_path, name):
    scripts = shutil.copytree(ROOT / "scripts", tmp_path / "scripts")
    if name != "setup":
        write_script(scripts / "setup.sh", "exit 9")
    used = "rehearse" if name in ("demo", "mission") else name
    check_help(run(scripts / f"{name}.sh", "--help"), used)
    assert [path.name for path in tmp_path.iterdir()] == ["scripts"]


def line_of_fss_up(folder):
    """Return the line in which starting a recorder fails."""
    config = folder / "lab.sh"
    config.write_text(f"FSS_LOGS={folder}/logs\nnode record fss_arm_bags record\n")
    up = run("scripts/fss_up.sh", config, cwd=ROOT)
    assert (up.returncode, up.stderr.count("\n")) == (1, 1)
    return up.stderr


def test_a_full_disk_is_named_before_a_node_is_started(tmp_path):
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs/events.log").symlink_to("/dev/full")
    problem = f"fss_up.sh: cannot write to {tmp_path}/logs: is the disk full?"
    assert line_of_fss_up(tmp_path).startswith(problem)
    assert not (tmp_path / "logs/record.keep").exists()


def test_a_node_that_cannot_be_started_is_named_with_the_reason(tmp_path):
    (tmp_path / "logs/record.keep").mkdir(parents=True)  # in place of the lock's file
    line = line_of_fss_up(tmp_path)
    assert line.startswith("fss_up.sh: record cannot be started: ")
    assert "record.keep: " in line
    assert line.endswith(f"; scripts/fss_down.sh {tmp_path}/lab.sh, then try again\n")


@pytest.mark.parametrize(
    ("name", "lockstep", "seen"),
    [
        ("testbed", "true", "--ros-args -p keep_clock:=true -p lockstep:=true"),
        ("arm", "true", "--ros-args -p use_sim_time:=true"),
        ("arm", "false", ""),
    ],
)
def test_in_lockstep_the_nodes_use_the_clock_of_the_test_bed(tmp_path, name, lockstep, seen):
    workspace_of(tmp_path, 'echo "$@"')
    lines = "node testbed fss_sim testbed", "node arm fss_arm_driver arm"
    (tmp_path / "lab.sh").write_text("\n".join((f"lockstep={lockstep}", *lines)))
    shown = run(tmp_path / "scripts/fss/node.sh", tmp_path / "lab.sh", name, env=BARE)
    package = "fss_sim" if name == "testbed" else "fss_arm_driver"
    assert shown.stdout.strip() == f"run {package} {name} {seen}".strip(), shown.stderr


@pytest.mark.skipif(os.getuid() != 0, reason="only root can become another user")
@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("setup.sh", "setup: cannot write to .*, which is root's: make a clone of your own"),
        ("fss_up.sh config/fss.sh", "fss_up.sh: mkdir: .*denied; make a clone of your own"),
        ("fss_arm.sh arm", "env.sh: .* cannot run the Python of .*; make a clone of your own and"),
    ],
)
def test_an_ordinary_user_in_a_clone_of_root_is_told_to_make_another(command, words):
    name, *arguments = command.split()
    with TemporaryDirectory() as folder:
        root = Path(folder)
        root.chmod(0o755)
        for part in ("scripts", "config"):
            shutil.copytree(ROOT / part, root / part)
        (root / ".venv/bin").mkdir(parents=True)
        (root / ".venv/bin/python").symlink_to("/root/python3")
        other_user = {"user": 65534, "group": 65534, "extra_groups": []}
        ended = run(root / "scripts" / name, *arguments, env=BARE, cwd=root, **other_user)
    assert ended.returncode == 1
    assert re.match(words, ended.stderr)
    assert ended.stderr.count("\n") == 1


# --- the stand-in for ros2 -----------------------------------------------------------------------


@pytest.fixture
def prefix(tmp_path: Path) -> Path:
    """An ament prefix with the package `pkg`, whose executables are `hello` and `other`."""
    programs = {"hello": 'printf "<%s>" "$@"; exit 3', "other": "exit 0"}
    prefix = script_package(tmp_path / "ament prefix", **programs)
    (prefix / "lib/pkg/data.txt").touch()
    return prefix


@pytest.fixture
def ros2(prefix: Path) -> Callable[..., subprocess.CompletedProcess[str]]:
    env = BARE | {"AMENT_PREFIX_PATH": f"/nowhere:{prefix}"}
    return lambda *arguments: run(STAND_IN, *arguments, env=env)


def test_run_passes_arguments_and_exit_code_on(ros2):
    shown = ros2("run", "pkg", "hello", "--ros-args", "-p", "name:=a b", "")
    assert (shown.stdout, shown.returncode) == ("<--ros-args><-p><name:=a b><>", 3)


@pytest.mark.parametrize("package", [(), ("pkg",)])
def test_executables_are_listed(ros2, package):
    shown = ros2("pkg", "executables", *package)
    assert (shown.stdout, shown.returncode) == ("pkg hello\npkg other\n", 0)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), "stand-in has only"),
        (("topic", "list"), "for the others: scripts/setup.sh --ros2cli"),
        (("pkg", "list"), "stand-in has only"),
        (("run",), "stand-in has only"),
        (("run", "pkg"), "usage"),
        (("run", "nope", "hello"), "package 'nope' not found; see: ros2 pkg executables\n"),
        (("run", "pkg", "nope"), "no executable 'nope', expected one of hello other\n"),
        (("run", "pkg", "data.txt"), "no executable 'data.txt'"),
        (("pkg", "executables", "nope"), "package 'nope' not found"),
        (("pkg", "executables", "pkg", "pkg"), "usage"),
    ],
)
def test_what_it_cannot_do_ends_in_one_line(ros2, arguments, words):
    shown = ros2(*arguments)
    assert shown.returncode != 0
    assert shown.stdout == ""
    assert words in shown.stderr
    assert shown.stderr.count("\n") == 1


def test_a_shell_without_the_workspace_is_told_what_to_source():
    shown = run(STAND_IN, "run", "fss_arm_calib", "from_bag", env=BARE)
    problem = "package 'fss_arm_calib' not found: source scripts/env.sh first"
    assert (shown.returncode, shown.stderr) == (1, f"ros2: {problem}\n")


def test_it_steps_aside_for_the_real_one(tmp_path):
    real = write_script(tmp_path / "real/ros2", 'echo "real $*"')
    env = BARE | {"PATH": f"{STAND_IN.parent}:{BARE['PATH']}:{real.parent}"}
    assert run(STAND_IN, "topic", "list", env=env).stdout == "real topic list\n"


def test_what_it_runs_it_becomes_whatever_the_real_one_does(tmp_path, prefix):
    real = write_script(tmp_path / "real/ros2", 'echo "real $*"')
    env = {"PATH": f"{real.parent}:{BARE['PATH']}", "AMENT_PREFIX_PATH": str(prefix)}
    write_script(prefix / "lib/pkg/hello", "echo $$")
    with subprocess.Popen([STAND_IN, "run", "pkg", "hello"], env=env, stdout=subprocess.PIPE) as it:
        assert it.stdout is not None
        assert it.stdout.read() == f"{it.pid}\n".encode()
    assert run(STAND_IN, "run", "--prefix", "x", "pkg", "hello", env=env).stdout.startswith("real ")


def test_two_workspaces_stand_ins_do_not_call_each_other(tmp_path):
    other = write_script(tmp_path / "other/ros2", STAND_IN.read_text())
    env = BARE | {"PATH": f"{STAND_IN.parent}:{BARE['PATH']}:{other.parent}"}
    assert run("timeout", "10", other, "topic", "list", env=env).returncode == 1
