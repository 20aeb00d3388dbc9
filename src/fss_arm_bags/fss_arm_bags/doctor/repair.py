"""A damaged bag replaced by what can be recovered of it."""

from fcntl import LOCK_NB, LOCK_SH, flock
from os import link
from pathlib import Path
from tempfile import TemporaryDirectory

from fss_arm_bags.reader import open_bags
from fss_arm_bags.recovery import BagError, Recovered, is_sound, recover, storage_files


def repair(path: Path) -> Recovered | None:
    """Replace a damaged bag by what can be recovered of it; None: it was sound.

    The damaged files stay beside it with `.damaged` appended to their names.

    Raises:
        BagError: nothing can be recovered, or the bag is being recorded.
        OSError: the result cannot be written.
    """
    if is_sound(path) and _reads_through(path):
        return None
    files = storage_files(path)
    if not files or any(file.suffix != ".mcap" for file in files):
        raise BagError(f"{path}: damaged; only MCAP files can be repaired")
    first, *others = files
    if any(map(_locked, files)):
        raise BagError(f"{path}: is being recorded; stop the recorder first")
    with TemporaryDirectory(dir=first.parent, prefix=".repair_") as folder:
        copy = Path(folder, first.stem)  # its file has the name of the first, and takes its place
        recovered = recover(path, copy)
        metadata = path / "metadata.yaml"
        if metadata.exists() and not _kept(first).exists():  # else of an interrupted repair
            _keep(metadata)
        for file in files:
            _keep(file)
        if path.is_dir():  # metadata.yaml first: until the file follows, the bag shows its damage
            (copy / "metadata.yaml").replace(metadata)
        (copy / first.name).replace(first)
        for file in others:
            file.unlink(missing_ok=True)
    return recovered


def _reads_through(path: Path) -> bool:
    """Whether no chunk of a bag that has its index is damaged."""
    try:
        with open_bags(path) as bags:
            for _ in bags.raw():
                pass
    except BagError:
        return False
    return True


def _locked(file: Path) -> bool:
    """Whether a recorder has it open."""
    with file.open("rb") as stream:
        try:
            flock(stream, LOCK_SH | LOCK_NB)
        except BlockingIOError:
            return True
        except OSError:  # a file system without locks
            pass
    return False


def _keep(file: Path) -> None:
    """Let a damaged file be found beside what takes its place."""
    kept = _kept(file)
    try:
        link(file, kept)
    except FileExistsError:
        if not kept.samefile(file):  # else of a repair that was interrupted
            raise
    except OSError:  # a file system without second names, as exFAT
        file.rename(kept)


def _kept(file: Path) -> Path:
    """Where a damaged file is kept."""
    return file.with_name(f"{file.name}.damaged")
