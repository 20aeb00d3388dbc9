"""Result files: JSON for the next calibration and for programs, and CSV for people.

docs/reference/result.md describes their contents.
"""

import csv
from dataclasses import asdict
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np

from fss_arm_calib.acceptance import PASS
from fss_arm_calib.outcome import Outcome
from fss_arm_model.description import Arm
from fss_arm_model.description_file import from_yaml
from fss_arm_model.files import ContentError, write_text
from fss_arm_ros import state_file
from fss_arm_ros.dates import now

SCHEMA = "fss_arm_calib/result/1"

#: Fields of an Estimate that are stored as lists, and under `fit`.
LISTS = ["names", "units", "initial", "values", "deviations", "covariance"]
LISTS += ["undetermined", "at_bound", "unmeasured"]
FIT_FIELDS = ["position_residual", "heading_residual", "chi_square", "degrees_of_freedom"]
FIT_FIELDS += ["condition_number", "iterations", "last_update"]


def contents(kind: str, outcome: Outcome[Any, Any]) -> dict[str, Any]:
    """Return the contents of the JSON file; numbers that are not finite become null there."""
    e, streams = outcome.estimate, outcome.streams
    return {
        "schema": SCHEMA,
        "kind": kind,
        "arm": outcome.arm.name,
        "written": now(),
        "verdict": outcome.verdict,
        "reason": outcome.reason,
        "checks": [asdict(check) for check in outcome.checks],
        **{name: np.array(getattr(e, name)).tolist() for name in LISTS},
        "fit": {name: getattr(e, name) for name in FIT_FIELDS},
        "used": outcome.accepted,
        "left_out": outcome.left_out,
        "time_offset": streams.offset.value,
        "time_offset_deviation": streams.offset.deviation,
        "provenance": asdict(outcome.provenance),
        "description": outcome.description,
    }


def table(outcome: Outcome[Any, Any]) -> str:
    """Return the CSV file: a row for each parameter, with its row of the covariance at the end."""
    e, text = outcome.estimate, StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(["name", "unit", "initial", "value", "deviation", *e.names])
    columns = e.names, e.units, e.initial, e.values, e.deviations, e.covariance.tolist()
    for name, unit, initial, value, deviation, row in zip(*columns, strict=True):
        numbers = [float(initial), float(value), float(deviation), *row]
        rows.writerow([name, unit, *map(repr, numbers)])
    return text.getvalue()


def write(path: str | Path, kind: str, outcome: Outcome[Any, Any]) -> None:
    """Write a result as JSON, and as CSV next to it."""
    state_file.write(path, contents(kind, outcome))
    write_text(Path(path).with_suffix(".csv"), table(outcome))


def read_passed(path: str | Path, kind: str = "") -> dict[str, Any]:
    """Read a result that has passed, of the given kind of calibration; empty: of any kind.

    Raises:
        ContentError: the file is not such a result, or the result has not passed.
    """
    found = state_file.read(path, None)
    if found is None:
        raise FileNotFoundError(f"no such file: {path}")
    if not isinstance(found, dict) or found.get("schema") != SCHEMA:
        raise ContentError(f"{path}: schema", found and dict(found).get("schema"), SCHEMA)
    for name, expected in (("kind", kind or str(found.get("kind"))), ("verdict", PASS)):
        if found.get(name) != expected:
            raise ContentError(f"{path}: {name}", found.get(name), expected)
    return found


def read_arm(path: str | Path, kind: str = "") -> Arm:
    """Read the calibrated arm, with its covariance; arguments and errors as of `read_passed`."""
    return from_yaml(str(read_passed(path, kind).get("description")))
