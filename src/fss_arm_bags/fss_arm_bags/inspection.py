"""What is wrong with a bag before it is read."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from fss_arm_bags.integrity import Contents, DamageError, disagreement, examine, metadata
from fss_arm_bags.recovery import BagError, storage_files
from fss_arm_model.files import short


@dataclass(frozen=True)
class Inspected:
    """The state of a bag."""

    files: list[Path] = field(default_factory=list)  # to read; none: as rosbags opens it
    messages: int = 0  # by their indexes
    checked: bool = False  # all of it is under checksums
    damage: str = ""  # of a file that is to be recovered
    metadata: str = ""  # what is wrong with metadata.yaml alone


def inspect(path: Path, *, thorough: bool = False) -> Inspected:
    """Look for damage of a bag, as far as its checksums and what it says twice tell it.

    Args:
        path: the bag.
        thorough: look also at what readers do without.

    Raises:
        BagError: it is of a kind of which nothing can be recovered, and damaged.
        OSError: it cannot be read.
    """
    files = storage_files(path)
    about: Mapping[str, Any] = {}
    wrong = ""
    if path.is_dir():
        try:
            about = metadata(path)
        except DamageError as error:
            wrong = str(error)
    if any(file.suffix != ".mcap" for file in files) or about.get("compression_mode") or not files:
        if wrong and path.is_dir():
            raise BagError(f"{path}: {wrong}")
        if wrong := _refused(path):
            raise BagError(f"{path}: {wrong}")
        return Inspected()
    known: dict[Path, Contents] = {}
    for file in files:
        try:
            known[file] = examine(file, thorough=thorough)
        except DamageError as error:
            name = f"{file.name}: " if len(files) > 1 else ""
            return Inspected(files, damage=f"{name}{error}")
    checked = all(contents.checked for contents in known.values())
    count = sum(c.statistics.message_count for c in known.values() if c.statistics)
    try:
        hashes = _hashes(known)
    except Exception as error:  # as above
        return Inspected(files, damage=f"a definition is not understood: {short(str(error))}")
    if path.is_dir() and not wrong:
        wrong = disagreement(about, known, hashes)
    if path.is_dir() and not wrong and thorough:
        wrong = _refused(path)
    return Inspected(files, count, checked, metadata=wrong)


def is_sound(path: Path) -> bool:
    """Whether a bag is whole, with its index and metadata.

    Raises:
        BagError: it is of a kind of which nothing can be recovered, and damaged.
    """
    found = inspect(path, thorough=True)
    return not (found.damage or found.metadata)


def _refused(path: Path) -> str:
    """Why rosbags does not open a bag; empty: it does."""
    try:
        with Reader(path):
            return ""
    except Exception as error:  # rosbags parses what there is as it comes
        return short(str(error)) or type(error).__name__


def _hashes(files: Mapping[Path, Contents]) -> dict[str, str]:
    """RIHS01 of all types."""
    hashes = {}
    for contents in files.values():
        for schema in contents.schemas.values():
            if schema.encoding == "ros2msg":
                store = get_typestore(Stores.EMPTY)
                store.register(get_types_from_msg(schema.data.decode(), schema.name))
                hashes[schema.name] = store.hash_rihs01(schema.name)
    return hashes
