"""Python libraries from outside ROS: how to install each, and the error when one is missing."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path


@dataclass(frozen=True)
class Library:
    """A library by its name for pip and its rosdep key, which Ubuntu's package shares."""

    pip: str
    rosdep: str = ""  # empty: only pip installs it


#: Libraries by the module that is imported.
LIBRARIES = {
    "backports": Library("backports-zstd"),
    "dask": Library("dask"),
    "distributed": Library("distributed"),
    "fmpy": Library("fmpy"),
    "gymnasium": Library("gymnasium"),
    "matplotlib": Library("matplotlib", "python3-matplotlib"),
    "mcap": Library("mcap"),
    "motioncapture": Library("motioncapture"),
    "numba": Library("numba", "python3-numba"),
    "numpy": Library("numpy", "python3-numpy"),
    "pyarrow": Library("pyarrow"),
    "rerun": Library("rerun-sdk"),
    "rerun_cli": Library("rerun-sdk"),
    "rich": Library("rich", "python3-rich"),
    "rosbags": Library("rosbags"),
    "scipy": Library("scipy", "python3-scipy"),
    "serial": Library("pyserial", "python3-serial"),
    "yaml": Library("pyyaml", "python3-yaml"),
}


def require(module: str) -> None:
    """Check that a library is installed, without importing it.

    Raises:
        ModuleNotFoundError: it is missing.
    """
    if find_spec(module) is None:
        raise ModuleNotFoundError(f"No module named {module!r}", name=module)


@contextmanager
def required_libraries(program: str) -> Iterator[None]:
    """Exit with one line if a library of LIBRARIES is missing; other errors pass."""
    try:
        yield
    except ModuleNotFoundError as error:
        if library := LIBRARIES.get(error.name or ""):
            line = f"{program}: {library.pip} is missing; install it with: {_command(library)}"
            raise SystemExit(line) from None
        raise


def _command(library: Library) -> str:
    """Return the command that installs a library, to be run in the workspace's folder.

    The requirements hold pip to versions that fit ROS, whose messages are built for its numpy.
    """
    pip = f"{sys.executable} -m pip install"
    ros = find_spec("rclpy")
    if ros is not None and Path(str(ros.origin)).is_relative_to(sys.prefix):  # pip installed ROS
        return f"{pip} --no-deps -r scripts/requirements.txt"
    if library.rosdep:
        return f"sudo apt install {library.rosdep}"
    return f"{pip} -c scripts/requirements-jazzy.txt {library.pip}"
