"""Files that are replaced whole."""

from pathlib import Path


def write_text(path: str | Path, text: str) -> None:
    """Replace the file, and make its folder: a reader finds the old text or the new one.

    Raises:
        OSError: it cannot be written.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.part")
    part.write_text(text, encoding="utf-8")
    part.replace(path)
