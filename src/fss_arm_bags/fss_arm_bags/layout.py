"""List the files of a bag."""

from collections.abc import Iterable, Mapping
from pathlib import Path, PurePath
from typing import Any

COMPRESSED = ".zstd"  # suffix of a file that is compressed as a whole
STORAGE_SUFFIXES = (".mcap", ".db3", f".mcap{COMPRESSED}", f".db3{COMPRESSED}")


def storage_files(path: Path) -> list[Path]:
    """Return the storage files of a bag, in the order in which they were written.

    While a file is being compressed it exists twice; then the compressed copy does not count.
    """
    if path.is_file():
        return [path]
    found = {p.name: p for p in path.iterdir() if p.name.endswith(STORAGE_SUFFIXES) and p.is_file()}
    names = {name.removesuffix(COMPRESSED): name for name in sorted(found, reverse=True)}
    return [found[names[name]] for name in sorted(names, key=lambda name: (len(name), name))]


def listed_names(about: Mapping[str, Any]) -> list[str]:
    """Return the names of the storage files in metadata.yaml, without the suffix of compression."""
    return sorted(
        PurePath(name).name.removesuffix(COMPRESSED) for name in about["relative_file_paths"]
    )


def file_names(files: Iterable[Path]) -> list[str]:
    """Return the names of existing files, without the suffix of compression."""
    return sorted(file.name.removesuffix(COMPRESSED) for file in files)
