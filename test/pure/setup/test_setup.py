"""setup.sh: what a machine lacks, and a sourced ROS 2 Jazzy, whose place a folder takes."""

import os
import re
import shutil
import subprocess
import sys
from importlib.metadata import distributions
from pathlib import Path

import pytest
from running import run_command
from shell_scripts import mark_packages, write_script

ROOT = Path(__file__).parents[3]
VENV = ROOT / ".venv"
PACKAGES = "share/ament_index/resource_index/packages"
#: The ROS packages that the workspace is built on.
NEEDED = (
    *("ament_cmake", "rosidl_default_generators"),
    *("common_interfaces", "control_msgs", "tf2_msgs"),
)
TIMEOUT = 1500.0  # of a whole set-up [s]
NO_WHEELS = {"PIP_NO_INDEX": "1", "PIP_FIND_LINKS": ""}


class Distribution:
    """A folder that can be sourced as /opt/ros/jazzy is.

    Args:
        prefix: the folder.
        libraries: folders of shared libraries.
    """

    def __init__(self, prefix, libraries=()):
        self.prefix = prefix
        self.python_path = prefix / f"lib/python3.{sys.version_info.minor}/site-packages"
        self.python_path.mkdir(parents=True)
        exports = [
            "export ROS_DISTRO=jazzy",
            f"export AMENT_PREFIX_PATH={prefix} CMAKE_PREFIX_PATH={prefix}",
            f"export PYTHONPATH={self.python_path}",
            f"export LD_LIBRARY_PATH={':'.join(map(str, libraries))}",
        ]
        (prefix / "local_setup.bash").write_text("\n".join(exports) + "\n")
        (prefix / "setup.bash").write_text(f". {prefix}/local_setup.bash\n")


class Machine:
    """A copy of the workspace, on a machine whose commands a test can replace."""

    def __init__(self, folder):
        self.root, self.bin = folder / "workspace", folder / "bin"
        self.copy("scripts")
        python = os.path.realpath(sys.executable)  # not .venv's, which has a ROS of its own
        write_script(self.bin / "python3", f'exec {python} "$@"')
        self.env = {
            "PATH": f"{self.bin}:/usr/local/bin:/usr/bin:/bin",
            "HOME": str(folder),
            "PIP_CACHE_DIR": os.path.expanduser("~/.cache/pip"),
        }
        network = re.compile("pip_|ssl_|.*_proxy$", re.IGNORECASE)
        self.env |= {name: value for name, value in os.environ.items() if network.match(name)}

    def copy(self, name):
        leave = shutil.ignore_patterns("__pycache__", "*.egg-info")
        shutil.copytree(ROOT / name, self.root / name, ignore=leave)

    def replace(self, command, text):
        write_script(self.bin / command, text)

    def run(self, *commands, **env):
        """Run commands in one bash, in the workspace."""
        text = "\n".join(commands)
        return run_command("bash", "-ec", text, timeout=TIMEOUT, env=self.env | env, cwd=self.root)

    def setup(self, arguments="", **env):
        """Run the set-up, which must fail; return the lines that it ends in."""
        ended = self.run(f"scripts/setup.sh {arguments}", **env)
        assert (ended.returncode, ended.stdout) == (1, "")
        return [line for line in ended.stderr.splitlines() if "making .venv" not in line]


@pytest.fixture
def machine(tmp_path):
    return Machine(tmp_path)


def test_a_path_with_spaces_is_refused(tmp_path):
    assert "does not support spaces" in Machine(tmp_path / "with space").setup()[-1]


def test_what_the_set_up_does_not_support_is_refused(machine):
    assert "usage: scripts/setup.sh" in machine.setup("--fast")[-1]
    assert machine.setup(ROS_DISTRO="humble")[-1].startswith("setup: ROS 2 humble is sourced")


@pytest.mark.parametrize(
    ("command", "text", "words"),
    [
        ("uname", "echo Linux aarch64", "source a ROS 2 Jazzy"),
        ("df", "echo; echo /dev/x 9 9 102400 9% /", "too little disk: 100 MB are free"),
        (
            "c++",
            "exit 127",
            r"^setup: missing: a C\+\+ compiler; install with: sudo apt-get .*"
            r"--no-install-recommends g\+\+$",
        ),
        ("cmake", "echo cmake version 3.9.6", "missing: CMake 3.20 or later"),
    ],
)
def test_what_a_machine_lacks_is_named_with_the_next_step(machine, command, text, words):
    machine.replace("id", "echo 1000")
    machine.replace("apt-get", "exit 1")
    machine.replace(command, text)
    (line,) = machine.setup()
    assert re.search(words, line)


def test_root_installs_and_says_so(machine):
    machine.replace("make", "exit 127")
    machine.replace("id", "echo 0")
    machine.replace("apt-get", 'echo "$*" >>"$(dirname "$0")/calls"; echo noise; exit 0')
    assert [line.partition(";")[0] for line in machine.setup()] == [
        "setup: missing: make",
        "setup: after the installation still missing: make",
    ]
    assert (machine.bin / "calls").read_text() == (
        "update\ninstall -y --no-install-recommends make\n"
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("given", "said"),
    [
        (
            {"PIP_INDEX_URL": "http://127.0.0.1:9/simple", "PIP_RETRIES": "1"},
            r"setup: (?!.*127\.0\.0\.1).*index cannot be reached.*",
        ),
        ({"PIP_NO_INDEX": "1"}, r"setup: there is no wheel of setuptools==.* for Python 3\.1.*"),
    ],
)
def test_wheels_that_cannot_be_had_are_named_without_addresses(machine, given, said):
    (line,) = machine.setup(PIP_FIND_LINKS="", **given)
    assert re.fullmatch(said, line)
    assert not (machine.root / ".venv/.stamp").exists()


def test_the_wheels_own_environment_is_no_distribution(tmp_path):
    """env.sh says that ROS is jazzy, for tools that ask; set-up stays with the wheels."""
    text = (ROOT / "scripts/setup.sh").read_text()
    (probe,) = re.findall(r"^DISTRIBUTION='\n(.*?)^'", text, re.M | re.S)
    command = [VENV / "bin/python", "-c", probe]
    assert subprocess.run(command, capture_output=True).returncode == 1
    write_script(tmp_path / "rclpy/__init__.py", "")
    env = {"PYTHONPATH": str(tmp_path)}
    assert subprocess.run(["/usr/bin/python3", "-c", probe], env=env).returncode == 0


@pytest.fixture
def empty(tmp_path):
    """A distribution whose rclpy is an empty module, with all packages that are needed."""
    distribution = Distribution(tmp_path / "jazzy")
    (distribution.python_path / "rclpy").mkdir()
    (distribution.python_path / "rclpy/__init__.py").touch()
    mark_packages(distribution.prefix, *NEEDED)
    return distribution


#: Answers the set-up's question for a Python by itself, and leaves pip to the Python below, if it
#: has one: then the environment takes a second.
QUICK_VENV = """
case $2 in *_base_executable*) echo "$0"; exit ;; esac
[ "$2" != venv ] || ! {python} -c "import pip" || set -- "$@" --without-pip
exec {python} "$@"
"""


def test_the_environment_is_put_on_top_of_the_distribution(machine, empty):
    machine.replace("python3", QUICK_VENV.format(python=os.path.realpath(sys.executable)))
    pins = machine.root / "scripts/requirements-jazzy.txt"
    pins.write_text(re.sub("^setuptools==.*", "setuptools==0.1", pins.read_text(), flags=re.M))
    ended = machine.run(f". {empty.prefix}/setup.bash", "scripts/setup.sh", **NO_WHEELS)
    assert re.fullmatch(
        r"setup: making \.venv with Python 3\.1[12]\.\d+\n"
        r"setup: there is no wheel of setuptools==0\.1 for Python .*\n",
        ended.stderr,
    ), ended.stderr
    assert ended.returncode == 1
    config = (machine.root / ".venv/pyvenv.cfg").read_text()
    assert "include-system-site-packages = true" in config
    assert not (machine.root / ".venv/.stamp").exists()


def test_packages_are_looked_for_in_every_prefix(machine, empty, tmp_path):
    overlay = Distribution(tmp_path / "overlay")
    for name in ("control_msgs", "tf2_msgs"):
        (empty.prefix / PACKAGES / name).unlink()
    mark_packages(overlay.prefix, "control_msgs")
    machine.replace("id", "echo 1000")
    machine.replace("apt-get", "exit 1")
    both = f"export AMENT_PREFIX_PATH={overlay.prefix}:{empty.prefix}"
    ended = machine.run(f". {empty.prefix}/setup.bash", both, "scripts/setup.sh")
    assert ended.stderr == (
        "setup: missing: tf2_msgs; install with: sudo apt-get update && sudo apt-get install -y "
        "--no-install-recommends ros-jazzy-tf2-msgs\n"
    )
    assert ended.returncode == 1


def test_a_distribution_without_rclpy_is_left_for_the_wheels(machine, empty):
    shutil.rmtree(empty.python_path / "rclpy")
    machine.replace("uname", "echo Linux aarch64")  # for which there are no wheels
    ended = machine.run(f". {empty.prefix}/setup.bash", "scripts/setup.sh")
    first, last = ended.stderr.splitlines()
    assert first == "setup: ROS_DISTRO is jazzy, but no Python here can import rclpy: using wheels"
    assert "the ROS wheels are for Linux on x86_64" in last
    assert ended.returncode == 1


@pytest.fixture
def full(tmp_path):
    """A distribution with the ROS of .venv, but none of its other libraries."""
    (site,) = VENV.glob("lib/python3.*/site-packages")
    ros = [one for one in distributions(path=[str(site)]) if one.name.startswith("ros-")]
    modules = {file.parts[0] for one in ros for file in one.files or ()}
    modules = {name for name in modules if name != ".." and not name.endswith(".pth")}
    modules |= {"control_msgs", "tf2_msgs"}  # which setup.sh builds
    modules |= {"em.py", "lark"}  # which the message generators import
    folders = [site / name for name in modules if name.endswith(".libs")]
    distribution = Distribution(tmp_path / "jazzy", [VENV / "lib", *folders])
    for name in modules:
        (distribution.python_path / name).symlink_to(site / name)
    for name in ("share", "include"):
        (distribution.prefix / name).symlink_to(VENV / name)
    for path in VENV.glob("lib/*"):
        if not path.name.startswith("python"):
            (distribution.prefix / "lib" / path.name).symlink_to(path)
    yield distribution
    shutil.rmtree(tmp_path)  # a gigabyte, which pytest would keep


CHECK = """
import fss_arm_model.warm, fss_arm_msgs.msg, numpy, rclpy, rerun
rclpy.init()
node = rclpy.create_node("probe")
node.create_publisher(fss_arm_msgs.msg.LinkTelemetry, "telemetry", 1).publish(
    fss_arm_msgs.msg.LinkTelemetry())
node.destroy_node()
rclpy.shutdown()
print(rclpy.__file__, fss_arm_msgs.__file__, numpy.__file__, numpy.__version__)
"""


@pytest.mark.slow
@pytest.mark.skipif(not (VENV / "share/rclpy").exists(), reason="needs the ROS of the wheels")
def test_the_workspace_is_built_on_the_distribution(machine, full, domain):
    for name in ("src", "config"):
        machine.copy(name)
    shutil.copy(ROOT / "colcon.meta", machine.root)
    source = f". {full.prefix}/setup.bash"
    ended = machine.run(source, "scripts/setup.sh")
    assert ended.returncode == 0, ended.stderr
    assert "packages for jazzy" in ended.stderr
    again = machine.run(source, "scripts/setup.sh")
    assert (again.returncode, again.stderr) == (0, "")  # and does nothing

    # The build remembers the distribution, so that a new shell needs env.sh alone.
    checked = machine.run(". scripts/env.sh", f"python -c '{CHECK}'", ROS_DOMAIN_ID=str(domain))
    assert checked.returncode == 0, checked.stderr
    rclpy, messages, numpy, version = checked.stdout.split()
    assert Path(rclpy).is_relative_to(full.prefix)
    assert Path(messages).is_relative_to(machine.root / "install/fss_arm_msgs")
    assert Path(numpy).is_relative_to(machine.root / ".venv")
    pins = (ROOT / "scripts/requirements-jazzy.txt").read_text()
    assert f"\nnumpy=={version}\n" in pins
    # A distribution can use messages from C++, too.
    assert list((machine.root / "install/fss_arm_msgs/lib").glob("*__rosidl_typesupport_cpp.so"))

    run = ". scripts/env.sh; ros2 run"
    planned = machine.run(f"{run} fss_arm_motion plan point_to_point --goal 9 0 0 0")
    assert planned.returncode == 0, planned.stderr

    doctor = f"{run} fss_arm_bags doctor {ROOT}/test/data/first"
    assert "/joint_states" in machine.run(doctor).stdout
    uninstalled = machine.run(".venv/bin/python -m pip uninstall -q -y mcap", doctor)
    missing, command = uninstalled.stderr.strip().split("; install it with: ")
    assert missing == "doctor: mcap is missing"
    assert command.endswith("-c scripts/requirements-jazzy.txt mcap")
    assert "/joint_states" in machine.run(command, doctor).stdout


# --- the ros2 command line -----------------------------------------------------------------------

ROS2_PACKAGES = ["cli", "action", "interface", "node", "param", "pkg", "run", "service", "topic"]


def repository(folder, tag, packages):
    """Make a bare repository with one tag, of Python packages by their folders."""
    work = folder.with_suffix(".work")
    for place, name in packages.items():
        entry = f"{{'console_scripts': ['ros2 = {name}:main']}}" if name == "ros2cli" else "{}"
        module = "def main():\n    print('the real one')\n"
        (work / place).mkdir(parents=True)
        (work / place / f"{name}.py").write_text(module)
        (work / place / "setup.py").write_text(
            "from setuptools import setup\n"
            f"setup(name={name!r}, version='1', py_modules=[{name!r}], entry_points={entry})\n"
        )
    me = ["-c", "user.name=test", "-c", "user.email=test@example.org"]
    for command in (
        ["init", "-q"], ["add", "."], [*me, "commit", "-q", "-m", "all"], ["tag", tag],
        ["clone", "-q", "--bare", ".", str(folder)],
    ):  # fmt: skip
        subprocess.run(["git", *command], cwd=work, check=True)


@pytest.fixture
def small(machine):
    """A workspace whose set-up takes seconds: two packages, and nothing to build."""
    pins = machine.root / "scripts/requirements.txt"
    wanted = re.findall(r"^(?:setuptools|numpy)==.*\n", pins.read_text(), re.M)
    pins.write_text("".join(wanted))
    shutil.copy(ROOT / "colcon.meta", machine.root)
    model = machine.root / "src/fss_arm_model/fss_arm_model"
    write_script(model / "warm.py", '"""\n@kernel(\n"""')
    (model / "__init__.py").touch()
    machine.replace("cmake", "echo cmake version 3.30.0")
    build = "mkdir -p install log/build && ln -sfn build log/latest_build"
    machine.replace("colcon", build)
    machine.env["NUMBA_CACHE_DIR"] = str(machine.root / "cache")
    return machine


@pytest.mark.slow
def test_the_real_ros2_is_added_by_one_command(small, tmp_path):
    def sources(folder):
        """Git's own way to take a mirror in the place of a host."""
        return {
            "GIT_CONFIG_COUNT": "1",
            "GIT_CONFIG_KEY_0": f"url.file://{folder}/.insteadOf",
            "GIT_CONFIG_VALUE_0": "https://github.com/ros2/",
        }

    setup = (small.root / "scripts/setup.sh").read_text()
    tags = dict(re.findall(r"(\w+)=(0\.\d+\.\d+)", setup))
    names = {f"ros2{name}": f"ros2{name}" for name in ROS2_PACKAGES}
    repository(tmp_path / "mirror/ros2cli", tags["ROS2CLI"], names)
    own = {".": "rosidl_runtime_py"}
    repository(tmp_path / "mirror/rosidl_runtime_py", tags["ROSIDL_RUNTIME_PY"], own)

    command = "scripts/setup.sh --ros2cli"
    unreachable = small.run(command, **sources(tmp_path / "nowhere"))
    assert unreachable.returncode == 1
    last = unreachable.stderr.splitlines()[-1]
    assert last.startswith("setup: cannot clone https://github.com/ros2/ros2cli: fatal: ")
    ros2 = small.root / ".venv/bin/ros2"
    assert not ros2.exists()

    added = small.run(command, **sources(tmp_path / "mirror"))
    assert added.returncode == 0, added.stderr
    last = added.stderr.splitlines()[-1]
    assert re.fullmatch(r"setup: done in \d+ min \d+ s; next: scripts/demo.sh", last)
    assert small.run(str(ros2)).stdout == "the real one\n"
    again = small.run(command, **sources(tmp_path / "nowhere"))
    assert (again.returncode, again.stderr) == (0, "")
