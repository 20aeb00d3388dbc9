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

from fss_arm_bags.layout import PACKED, storage_files
from fss_arm_bags.readers import FORMATS

BLOCK = 2**20  # [bytes] unpacked at once
JOURNALS = ("-wal", "-journal")
FOREIGN = f"FROM message_definitions WHERE encoding NOT IN {FORMATS}"  # unknown to rosbags


def readable(path: Path, folder: Callable[[], Path]) -> Path:
    """Return the bag if it is readable, else a readable copy in a new folder from `folder()`.

    Raises:
        OSError: a file cannot be read, or the disk is full.
    """
    files = storage_files(path)
    if not any(file.suffix == PACKED or _unsettled(file) for file in files):
        return path
    copy = folder() / path.name.removesuffix(PACKED)
    if path.is_file():
        _copy(path, copy)
        return copy
    copy.mkdir()
    for file in files:
        _copy(file, copy / file.name.removesuffix(PACKED))
    with suppress(FileNotFoundError):
        copyfile(path / "metadata.yaml", copy / "metadata.yaml")
    return copy


def _copy(file: Path, copy: Path) -> None:
    """Make a readable copy of a file, or of the part of it that can be decompressed."""
    if file.suffix == PACKED:
        cut = suppress(EOFError, zstd.ZstdError)  # the check of the copy reports it
        with zstd.open(file) as source, copy.open("wb") as target, cut:
            while block := source.read1(BLOCK):
                target.write(block)
    elif not _unsettled(file):
        copy.symlink_to(file.resolve())
        return
    else:
        for end in ("", *JOURNALS):
            with suppress(FileNotFoundError):
                copyfile(f"{file}{end}", f"{copy}{end}")
    if _unsettled(copy):
        with suppress(sqlite3.Error), closing(sqlite3.connect(copy)) as db:
            db.execute("PRAGMA journal_mode = DELETE")  # merges the journals
            with db:
                db.execute(f"DELETE {FOREIGN}")


def _unsettled(file: Path) -> bool:
    """Return True if rosbags would miss a part of an SQLite file, or reject a definition in it."""
    if file.suffix != ".db3":
        return False
    journals = (Path(f"{file}{end}") for end in JOURNALS)
    if any(journal.exists() and journal.stat().st_size for journal in journals):
        return True
    place = f"{file.resolve().as_uri()}?immutable=1"
    try:
        with closing(sqlite3.connect(place, uri=True)) as db:
            return bool(db.execute(f"SELECT 1 {FOREIGN}").fetchone())
    except sqlite3.Error:  # it has no definitions, or is not an SQLite file
        return False
