"""A copy of the installed rclpy with other private names, as a later version may have."""

import re
from compileall import compile_dir
from pathlib import Path

import rclpy

PRIVATE = re.compile(r"\b_[a-z][a-z_]*\b")
#: Names of the C++ extension and of other packages, which the copy cannot change.
FOREIGN = {"_rclpy", "_rclpy_pybind11"}


def private_names(source):
    """Return the private names that a module's source uses."""
    return set(PRIVATE.findall(source)) - FOREIGN


def copy_with_renamed_privates(folder):
    """Copy rclpy to `folder`; each private name of executors.py gets another name, everywhere.

    Returns:
        The names before.
    """
    installed = Path(rclpy.__file__).parent
    names = private_names((installed / "executors.py").read_text())
    pattern = re.compile(rf"\b({'|'.join(sorted(names))})\b")
    for file in installed.rglob("*"):
        copy = folder / "rclpy" / file.relative_to(installed)
        if file.is_dir() or "__pycache__" in file.parts:
            continue
        copy.parent.mkdir(parents=True, exist_ok=True)
        if file.suffix == ".py":
            copy.write_text(pattern.sub(r"\1_renamed", file.read_text()))
        else:
            copy.symlink_to(file)
    compile_dir(folder, quiet=1)  # once, not in each process that imports it
    return names
