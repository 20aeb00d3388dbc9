"""Commit of the workspace that a program runs from."""

import os
import subprocess
from functools import cache
from hashlib import sha1
from pathlib import Path

UNKNOWN = "unknown"
CODE = "src", "scripts", "docs/examples"  # folders


@cache
def source_version() -> str:
    """Return the commit of this workspace, with a digest of changes of its code, if any.

    Uncommitted changes outside of CODE, as of notes or a campaign's file, do not count.

    A deployed release has it in its file RELEASE; otherwise git is asked.
    """
    folder = Path(__file__).resolve().parents[3]

    def git(*words: str) -> bytes:
        command = ["git", "-C", str(folder), *words]
        return subprocess.run(command, capture_output=True, check=True).stdout

    release = folder / "RELEASE"
    if release.exists():
        return release.read_text().split()[0]
    try:
        commit = git("rev-parse", "--short=10", "HEAD").decode().strip()
        new_files = git("ls-files", "--others", "--exclude-standard", "--", *CODE).split(b"\n")
        changes = git("diff", "HEAD", "--", *CODE) + b"".join(
            name + (folder / os.fsdecode(name)).read_bytes() for name in new_files if name
        )
    except (OSError, subprocess.CalledProcessError):
        return UNKNOWN
    return f"{commit}+{sha1(changes).hexdigest()[:8]}" if changes else commit


if __name__ == "__main__":
    print(source_version())
