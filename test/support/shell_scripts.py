"""Executable shell scripts, and ROS packages made of them."""

from pathlib import Path


def write_script(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)
    return path


def mark_packages(prefix: Path, *names: str) -> None:
    """Have ament find these packages in a prefix."""
    for name in names:
        marker = prefix / "share/ament_index/resource_index/packages" / name
        marker.parent.mkdir(parents=True, exist_ok=True)
        marker.touch()


def script_package(prefix: Path, **programs: str) -> Path:
    """Make a prefix with the package `pkg`, whose executables are scripts."""
    mark_packages(prefix, "pkg")
    for name, text in programs.items():
        write_script(prefix / "lib/pkg" / name, text)
    return prefix
