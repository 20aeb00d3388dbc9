"""Deployment over SSH of a small workspace with the real scripts.

The other computer is a network namespace of its own, if this process may make one.
"""

import fcntl
import os
import pwd
import re
import shutil
import signal
import subprocess
from contextlib import suppress
from functools import partial
from pathlib import Path
from random import Random
from threading import Event

import pytest
from running import OWN, wait_until
from running import run_command as run
from shell_scripts import write_script

SCRIPTS = Path(__file__).resolve().parents[3] / "scripts"
COPIED = "env.sh", "fss_deploy.sh", "fss/config.sh", "fss/check.sh", "fss/release.sh", "bin/ros2"
FILES = 400  # of the small workspace
KILLS = 50
TIMEOUT = 60.0  # [s]
PAUSE = partial(Event().wait, 0.01)
SETUP = """\
cd ${0%/*}/..
packages=install/share/ament_index/resource_index/packages
mkdir -p "$(readlink -m .venv)/bin" install/lib/fss_pkg $packages
ln -sf /bin/true .venv/bin/python
touch $packages/fss_pkg
printf '#!/bin/sh\\n[ "$*" = --help ]\\n' >install/lib/fss_pkg/tool
chmod +x install/lib/fss_pkg/tool
echo 'export AMENT_PREFIX_PATH=$COLCON_CURRENT_PREFIX' >install/setup.sh
sleep 0.1
"""


@pytest.fixture
def network():
    """Address of another computer, and the start of a command that runs there."""
    name, subnet = f"fss{os.getpid()}", f"10.213.{os.getpid() % 256}"
    if os.getuid() or not shutil.which("ip") or run("ip", "netns", "add", name).returncode:
        yield "127.0.0.1", ()
        return
    steps = (
        f"link add {name} type veth peer name eth netns {name}",
        f"address add {subnet}.1/30 dev {name}",
        f"link set {name} up",
        f"-n {name} address add {subnet}.2/30 dev eth",
        f"-n {name} link set eth up",
    )
    try:
        if any(run("ip", *step.split()).returncode for step in steps):
            yield "127.0.0.1", ()
        else:
            yield f"{subnet}.2", ("ip", "netns", "exec", name)
    finally:
        run("ip", "netns", "delete", name, check=True)


@pytest.fixture
def computer(tmp_path, network):
    """A home folder behind an SSH server with keys and a port of its own; address, RSYNC_RSH."""
    address, inside = network
    if not (shutil.which("rsync") and Path("/usr/sbin/sshd").exists()):
        pytest.skip("needs rsync and openssh-server")
    home, port = tmp_path / "home", OWN.ports(1)[0]
    home.mkdir()
    for key in ("host", "user"):
        run("ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", f"{tmp_path}/{key}", check=True)
    forced = f'cd {home}; HOME={home} exec sh -c \\"$SSH_ORIGINAL_COMMAND\\"'
    (tmp_path / "keys").write_text(f'command="{forced}" {(tmp_path / "user.pub").read_text()}')
    (tmp_path / "sshd_config").write_text(
        f"Port {port}\nListenAddress {address}\nHostKey {tmp_path}/host\nPidFile none\n"
        f"AuthorizedKeysFile {tmp_path}/keys\nStrictModes no\nUsePAM no\nMaxStartups 100\n"
    )
    if os.getuid() == 0:
        Path("/run/sshd").mkdir(exist_ok=True)
    log = (tmp_path / "sshd.log").open("w")
    server = subprocess.Popen(
        [*inside, "/usr/sbin/sshd", "-D", "-e", "-f", tmp_path / "sshd_config"], stderr=log
    )
    shell = f"ssh -p {port} -i {tmp_path}/user -o UserKnownHostsFile={tmp_path}/known"
    shell += " -o StrictHostKeyChecking=accept-new -o BatchMode=yes -o LogLevel=ERROR"
    wait_until(lambda: "listening" in (tmp_path / "sshd.log").read_text(), TIMEOUT, PAUSE)
    yield home, address, shell
    server.kill()
    server.wait()
    kill_in(home)


class Workspace:
    """A workspace with the real scripts, whose set-up takes a moment."""

    def __init__(self, folder, home, address, shell):
        self.root, self.home = folder / "workspace", home
        self.env = {**os.environ, "RSYNC_RSH": shell}
        self.host = f"{pwd.getpwuid(os.getuid()).pw_name}@{address}"
        for name in COPIED:
            (self.root / "scripts" / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(SCRIPTS / name, self.root / "scripts" / name)
        write_script(self.root / "scripts/setup.sh", SETUP)
        (self.root / "scripts/requirements.txt").write_text("pinned==1.0\n")
        (self.root / ".gitignore").write_text("/ignored\nlog/\nout/\n.venv/\ninstall/\n")
        (self.root / "ignored").touch()
        self.config = self.root / "config/lab.sh"
        self.config.parent.mkdir()
        self.config.write_text("node one fss_pkg tool\n")
        self.set_version("first")

    def set_version(self, version):
        """Write a version into all files."""
        (self.root / "src").mkdir(exist_ok=True)
        for k in range(FILES):
            (self.root / f"src/file_{k}").write_text(f"{version} {k}\n")

    def command(self, what):
        return [self.root / "scripts/fss_deploy.sh", self.host, what]

    def deploy(self, what=None):
        return run(*self.command(what or self.config), env=self.env)

    def current(self):
        """Return the number of the current release, and its version, which is one."""
        release = (self.home / "fss_arm/current").resolve()
        files = {f"file_{k}": k for k in range(FILES)}
        assert {path.name for path in (release / "src").iterdir()} == files.keys()
        texts = {name: (release / "src" / name).read_text().split() for name in files}
        assert all(int(texts[name][1]) == k for name, k in files.items())
        (version,) = {version for version, _ in texts.values()}
        assert (release / "RELEASE").read_text().split()[2] == "config/lab.sh"
        return int(release.name), version


@pytest.fixture
def workspace(tmp_path, computer):
    return Workspace(tmp_path, *computer)


def processes(home):
    """Return the processes of the computer: those whose home folder it is."""
    found = []
    for path in Path("/proc").glob("[0-9]*/environ"):
        with suppress(OSError):
            if f"HOME={home}\0".encode() in path.read_bytes():
                found.append(int(path.parent.name))
    return found


def kill_in(home):
    """Kill all processes of the computer, as a power failure does."""
    for pid in processes(home):
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)


@pytest.mark.slow
def test_a_release_is_copied_checked_listed_and_rolled_back(workspace):
    first = workspace.deploy()
    assert first.returncode == 0, first.stderr
    assert "all executables of config/lab.sh start" in first.stdout
    assert workspace.current() == (1, "first")
    release = workspace.home / "fss_arm/current"
    assert not (release / "ignored").exists()
    assert (release / "log/lab").resolve() == workspace.home / "fss_arm/log/lab"
    workspace.set_version("second")
    assert workspace.deploy().returncode == 0
    assert workspace.current() == (2, "second")
    assert (release / ".venv").resolve() == (workspace.home / "fss_arm/releases/1/.venv").resolve()
    config = workspace.home / "fss_arm/releases/1/config/lab.sh"
    assert config.stat().st_ino == (release / "config/lab.sh").stat().st_ino  # not stored twice
    lines = workspace.deploy("--list").stdout.splitlines()
    assert [re.sub(r"\d{4}-\S+", "TIME", line) for line in lines] == [
        "  1 unknown TIME config/lab.sh", "* 2 unknown TIME config/lab.sh",
    ]  # fmt: skip
    assert workspace.deploy("--rollback").returncode == 0
    assert workspace.current() == (1, "first")
    none = workspace.deploy("--rollback")
    assert none.stderr == "fss_deploy.sh: there is no release before the current one\n"
    assert workspace.deploy().returncode == 0
    assert workspace.current() == (3, "second")


@pytest.mark.slow
def test_what_cannot_be_deployed_leaves_the_release(workspace, tmp_path):
    assert workspace.deploy().returncode == 0
    elsewhere = tmp_path / "lab.sh"
    elsewhere.write_text("node one fss_pkg tool\n")
    assert "lab.sh is outside of" in workspace.deploy(elsewhere).stderr
    workspace.config.write_text("node one fss_pkg other\n")
    refused = workspace.deploy()
    assert "there is no executable 'other' in a package 'fss_pkg'" in refused.stderr
    assert refused.returncode == 1
    workspace.config.write_text("node one fss_pkg tool\n")
    script = workspace.home / "fss_arm/releases/1/node.sh"
    script.write_text("read line")
    node = subprocess.Popen(["sh", script.resolve()], stdin=subprocess.PIPE)
    try:
        for what in (None, "--rollback"):
            assert "nodes of a release run: stop them" in workspace.deploy(what).stderr
    finally:
        node.kill()
        node.wait()
    with (workspace.home / "fss_arm/lock").open() as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        assert "another deployment to this computer is in progress" in workspace.deploy().stderr
    assert workspace.current() == (1, "first")
    assert workspace.deploy("--list").stdout.count("\n") == 1


#: Steps of a deployment, by what is there after them in the folder of the release.
STEPS = "", "src/file_0", "src/file_77", ".venv", "out", "install/setup.sh", "RELEASE", "current"


def is_done(step, release):
    """Return True if a step of the deployment of a release has been made."""
    if step == "current":
        return (release.parents[1] / "current").resolve() == release
    return os.path.lexists(release / step)


@pytest.mark.slow
def test_after_a_kill_at_any_time_the_old_or_the_new_release_is_current(workspace):
    assert workspace.deploy().returncode == 0
    random, switched = Random(1), 0
    for _ in range(KILLS):
        number = 1 + int((workspace.home / "fss_arm/last").read_text())
        old, version = workspace.current()[1], f"version_{random.random()}"
        workspace.set_version(version)
        release = workspace.home / f"fss_arm/releases/{number}"
        process = subprocess.Popen(
            workspace.command(workspace.config), env=workspace.env, start_new_session=True,
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        step = random.choice(STEPS)
        wait_until(lambda: is_done(step, release) or process.poll() is not None, TIMEOUT, PAUSE)  # noqa: B023
        Event().wait(random.uniform(0.0, 0.3))
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        if random.random() < 0.5:  # the other computer, too
            kill_in(workspace.home)
        wait_until(lambda: not processes(workspace.home), TIMEOUT, PAUSE)
        now = workspace.current()[1]
        assert now in {old, version}
        switched += now == version
    assert 0 < switched < KILLS
    before = workspace.current()
    workspace.set_version("last")
    assert workspace.deploy().returncode == 0
    assert workspace.current()[1] == "last"
    assert workspace.deploy("--rollback").returncode == 0
    assert workspace.current() == before
