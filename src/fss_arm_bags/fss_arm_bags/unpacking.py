"""Make bags readable: decompress files, and merge the journals of SQLite files.

`ros2 bag record --compression-mode file` compresses each file as a whole. A recorder that was
killed leaves the last file uncompressed, and next to an SQLite file perhaps a journal.
"""

import sqlite3
from collections.abc import Callable
from contextlib import closing, suppress
from pathlib import Path
from shutil import copyfile

from backports import zstd

from fss_arm_bags.layout import COMPRESSED, storage_files
from fss_arm_bags.readers import DEFINITION_FORMATS

BLOCK_SIZE = 2**20  # unpacked at once [bytes]
JOURNALS = ("-wal", "-journal")
#: SQL for the definitions that rosbags cannot read.
UNKNOWN_DEFINITIONS = f"FROM message_definitions WHERE encoding NOT IN {DEFINITION_FORMATS}"


def make_readable(path: Path, folder: Callable[[], Path]) -> Path:
    """Return the bag if it is readable, else a readable copy in a new folder from `folder()`.

    Raises:
        OSError: a file cannot be read, or the disk is full.
    """
    files = storage_files(path)
    if not any(file.suffix == COMPRESSED or _needs_conversion(file) for file in files):
        return path
    copy = folder() / path.name.removesuffix(COMPRESSED)
    if path.is_file():
        _copy_readable(path, copy)
        return copy
    copy.mkdir()
    for file in files:
        _copy_readable(file, copy / file.name.removesuffix(COMPRESSED))
    with suppress(FileNotFoundError):
        copyfile(path / "metadata.yaml", copy / "metadata.yaml")
    return copy


def _copy_readable(file: Path, copy: Path) -> None:
    """Make a readable copy of a file, or of the part of it that can be decompressed."""
    if file.suffix == COMPRESSED:
        truncated = suppress(EOFError, zstd.ZstdError)  # the check of the copy reports it
        with zstd.open(file) as source, copy.open("wb") as target, truncated:
            while block := source.read1(BLOCK_SIZE):
                target.write(block)
    elif not _needs_conversion(file):
        copy.symlink_to(file.resolve())
        return
    else:
        for suffix in ("", *JOURNALS):
            with suppress(FileNotFoundError):
                copyfile(f"{file}{suffix}", f"{copy}{suffix}")
    if _needs_conversion(copy):
        with suppress(sqlite3.Error), closing(sqlite3.connect(copy)) as db:
            db.execute("PRAGMA journal_mode = DELETE")  # merges the journals
            with db:
                db.execute(f"DELETE {UNKNOWN_DEFINITIONS}")


def _needs_conversion(file: Path) -> bool:
    """Return True if rosbags would miss a part of an SQLite file, or reject a definition in it."""
    if file.suffix != ".db3":
        return False
    journals = (Path(f"{file}{suffix}") for suffix in JOURNALS)
    if any(journal.exists() and journal.stat().st_size for journal in journals):
        return True
    place = f"{file.resolve().as_uri()}?immutable=1"
    try:
        with closing(sqlite3.connect(place, uri=True)) as db:
            return bool(db.execute(f"SELECT 1 {UNKNOWN_DEFINITIONS}").fetchone())
    except sqlite3.Error:  # it has no definitions, or is not an SQLite file
        return False
