"""Data sheet of the data set, its citation and checksums."""

from collections.abc import Iterable, Sequence
from dataclasses import asdict
from hashlib import sha256
from pathlib import Path

import yaml

from fss_rehearsal.dataset.arms import BLIND, LINKS
from fss_rehearsal.dataset.bags import DRIFT_TRUTH, KINDS, USED_PRESETS
from fss_sim.noise import PRESETS
from fss_sim.plant.joints import PRESETS as JOINTS

CHECKSUMS, BLIND_CHECKSUMS = "SHA256SUMS", "blind_truth.sha256"
TEMPLATE = "data_sheet.md"
CITATION = """\
cff-version: 1.2.0
message: If you use this data set, please cite it.
title: "Calibration of planar arms on a floating base: data set"
type: dataset
license: Apache-2.0
version: "{commit}, seed {seed}"
authors:
  - name: FSS Arm maintainers
"""


def markdown(rows: Sequence[Sequence[str]]) -> str:
    """Return a table, the first row of which is the head."""
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join([lines[0], "|---" * len(rows[0]) + "|", *lines[1:]])


def write_checksums(file: Path, folder: Path, paths: Iterable[Path]) -> None:
    """Write SHA-256 of files, with paths relative to a folder, as `sha256sum -c` reads it."""
    lines = (f"{sha256(p.read_bytes()).hexdigest()}  {p.relative_to(folder)}\n" for p in paths)
    file.write_text("".join(lines))


def write_presets(folder: Path) -> None:
    """Write the presets' errors and joints, and the truth of drifts."""
    presets = {
        name: {"instruments": asdict(PRESETS[name]), "joints": asdict(JOINTS[name])}
        for name in USED_PRESETS
    }
    (folder / "presets.yaml").write_text(yaml.safe_dump(presets, sort_keys=False))
    (folder / "truth/drift.yaml").write_text(yaml.safe_dump(DRIFT_TRUTH, sort_keys=False))


def write_sheet(folder: Path, commit: str, seed: int, results: Sequence[Sequence[str]]) -> None:
    """Write data sheet, citation and checksums of a complete data set."""
    known = ", ".join(name for name in LINKS if name not in BLIND)
    arm_rows = [
        f"| `{name}` | {n} | {'published as a hash' if name in BLIND else 'known'} |"
        for name, n in LINKS.items()
    ]
    plain = Path(__file__).with_name("least_squares.py").read_text()
    text = (
        Path(__file__)
        .with_name(TEMPLATE)
        .read_text()
        .format(
            bags=len(LINKS) * len(USED_PRESETS) * len(KINDS),
            arms=len(LINKS),
            commit=commit,
            seed=seed,
            known=known,
            blind=", ".join(BLIND),
            blind_checksums=BLIND_CHECKSUMS,
            checksums=CHECKSUMS,
            arm_rows="\n".join(arm_rows),
            plain="plain least squares",
            lines=plain.count("\n"),
            results=markdown(results),
        )
    )
    (folder / "README.md").write_text(text)
    (folder / "CITATION.cff").write_text(CITATION.format(commit=commit, seed=seed))
    files = sorted(p for p in folder.rglob("*") if p.is_file() and p.name != CHECKSUMS)
    write_checksums(folder / CHECKSUMS, folder, files)
