"""Inspect a bag for damage before it is read: its files, and then its metadata.yaml.

A damaged MCAP file must be recovered. A wrong metadata.yaml can be rewritten from the files.
"""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rosbags.rosbag2 import Reader

from fss_arm_bags.definitions import DefinitionError, hash_of
from fss_arm_bags.integrity import Contents, DamageError, examine
from fss_arm_bags.layout import storage_files
from fss_arm_bags.metadata import file_list_problem, metadata_problem, read_metadata
from fss_arm_bags.readers import TopicReader
from fss_arm_bags.recovery import BagError
from fss_arm_model.files import short


@dataclass(frozen=True)
class Inspection:
    """State of a bag."""

    files: list[Path]  # files to read
    messages: int = 0  # number of messages, according to the indexes of the files
    checked: bool = False  # True if checksums cover all data
    damage: str = ""  # damage of a file, which must be recovered; empty: none
    metadata: str = ""  # problem of metadata.yaml, which only needs to be rewritten; empty: none


def inspect(path: Path, *, thorough: bool = False) -> Inspection:
    """Check a bag for damage, as far as its checksums and redundant data show it.

    Args:
        path: the bag, a file or a folder with metadata.yaml.
        thorough: check also data that readers do not use.

    Raises:
        BagError: it is damaged and of a kind that cannot be recovered.
        OSError: it cannot be read.
    """
    files, metadata, problem = storage_files(path), dict[str, Any](), ""
    if path.is_dir():
        try:
            metadata = dict(read_metadata(path))
        except DamageError as error:
            problem = str(error)
    if not files:
        raise BagError(f"{path}: contains no .mcap or .db3 file")
    if any(file.suffix != ".mcap" for file in files):
        return _inspect_sqlite(path, files, metadata, problem)
    contents: dict[Path, Contents] = {}
    for file in files:
        try:
            contents[file] = examine(file, thorough=thorough)
        except DamageError as error:
            name = f"{file.name}: " if len(files) > 1 else ""
            return Inspection(files, damage=f"{name}{error}")
    if path.is_dir() and not problem:
        problem = metadata_problem(metadata, contents, _hashes(contents))
    if path.is_dir() and not problem and thorough and not metadata.get("compression_mode"):
        problem = _open_error(path)
    count = sum(one.statistics.message_count for one in contents.values() if one.statistics)
    checked = all(one.checked for one in contents.values())
    return Inspection(files, count, checked, metadata=problem)


def _inspect_sqlite(
    path: Path, files: list[Path], metadata: Mapping[str, Any], problem: str
) -> Inspection:
    """Return the state of a bag of SQLite files, which have no checksums and are not recovered."""
    count = 0
    for file in files:
        try:
            with TopicReader(file) as reader:
                count += reader.message_count
        except Exception as error:  # rosbags parses without checks, so any exception is possible
            place = path if file == path else f"{path}: {file.name}"
            raise BagError(f"{place}: {short(str(error))}") from None
    if metadata and not problem:
        problem = file_list_problem(metadata, files)
    return Inspection(files, count, metadata=problem)


def is_sound(path: Path) -> bool:
    """Return True if a bag is complete, with its index and metadata.

    Raises:
        BagError: it is damaged and of a kind that cannot be recovered.
    """
    found = inspect(path, thorough=True)
    return not (found.damage or found.metadata)


def _open_error(path: Path) -> str:
    """Return the reason why rosbags does not open a bag; empty if it does."""
    try:
        with Reader(path):
            return ""
    except Exception as error:  # rosbags parses without checks, so any exception is possible
        return short(str(error)) or type(error).__name__


def _hashes(files: Mapping[Path, Contents]) -> dict[str, str]:
    """Return the RIHS01 of all types that have a definition in .msg."""
    hashes = {}
    for contents in files.values():
        for schema in contents.schemas.values():
            if schema.encoding == "ros2msg":
                with suppress(DefinitionError):
                    hashes[schema.name] = hash_of(schema.name, schema.data.decode(errors="replace"))
    return hashes
