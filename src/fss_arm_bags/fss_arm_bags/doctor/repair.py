"""Replace a damaged bag by what can be recovered of it."""

from fcntl import LOCK_NB, LOCK_SH, flock
from os import link
from pathlib import Path
from tempfile import TemporaryDirectory

from fss_arm_bags.inspection import inspect
from fss_arm_bags.layout import storage_files
from fss_arm_bags.recovery import BagError, Recovered, recover


def can_repair(path: Path) -> bool:
    """Return True if a damaged bag is of a kind that can be repaired."""
    return all(file.suffix == ".mcap" for file in storage_files(path))


def repair(path: Path) -> Recovered | None:
    """Replace a damaged bag by what can be recovered; None: it is sound or of another kind.

    The damaged files stay beside it with `.damaged` appended to their names.

    Raises:
        BagError: nothing can be recovered, or the bag is being recorded.
        OSError: the result cannot be written.
    """
    if not can_repair(path):
        return None
    found = inspect(path, thorough=True)
    damage = found.damage or found.metadata
    if not damage:
        return None
    files = found.files
    first, *others = files
    if any(map(_is_locked, files)):
        raise BagError(f"{path}: is being recorded; stop the recorder first")
    with TemporaryDirectory(dir=first.parent, prefix=".repair_") as folder:
        copy = Path(folder, first.stem)  # its file has the name of the first one and replaces it
        recovered = recover(path, copy, damage)
        metadata = path / "metadata.yaml"
        repeated = _damaged_path(first).exists()  # an earlier repair was interrupted
        if metadata.exists() and not repeated:
            _keep_damaged(metadata)
        for file in files:
            _keep_damaged(file)
        if path.is_dir():  # metadata.yaml first: until the file follows, the bag shows its damage
            (copy / "metadata.yaml").replace(metadata)
        (copy / first.name).replace(first)
        for file in others:
            file.unlink(missing_ok=True)
    return recovered


def _is_locked(file: Path) -> bool:
    """Return True if a recorder has the file open."""
    with file.open("rb") as stream:
        try:
            flock(stream, LOCK_SH | LOCK_NB)
        except BlockingIOError:
            return True
        except OSError:  # a file system without locks
            pass
    return False


def _keep_damaged(file: Path) -> None:
    """Keep a damaged file under another name, next to the file that replaces it."""
    kept = _damaged_path(file)
    try:
        link(file, kept)
    except FileExistsError:
        if not kept.samefile(file):  # the link of an interrupted repair is the same file
            raise
    except OSError:  # a file system without hard links, such as exFAT
        file.rename(kept)


def _damaged_path(file: Path) -> Path:
    """Return the path under which a damaged file is kept."""
    return file.with_name(f"{file.name}.damaged")
