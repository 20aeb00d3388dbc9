"""Show the parameters of each physical link, by serial number, and their history."""

import argparse
import sys
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from math import hypot
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fss_arm_calib.result import read_passed
from fss_arm_model.description_file import from_yaml, link_file, load, read_link, save_links
from fss_arm_model.files import ContentError
from fss_arm_ros import report
from fss_arm_ros.command_line import Parser, in_one_line
from fss_arm_ros.dates import is_simulated

if TYPE_CHECKING:
    from rich.table import Table

DESCRIPTION = f"""{__doc__} With --result, a calibration's values are written to the files of its
links first, beside the arm's description, which becomes a list of serial numbers."""

#: Parameters of a link that calibrations estimate, by their names in results, with their units.
ESTIMATED = {"a": "m", "theta_0": "rad", "m": "kg", "b": "m", "I": "kg m^2"}
LINKS_WIDTH = 110  # columns of the table where the output is not a terminal
ATTRIBUTES = {"m": "mass", "I": "inertia"}  # attributes of a Link that have another name


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    p = Parser("links", description=DESCRIPTION)
    p.add_argument("arm", metavar="ARM", help="file of the arm's description")
    p.add_argument("--result", metavar="JSON", help="result of a calibration that has passed")
    return p


def history_entry(found: Mapping[str, Any], place: int) -> dict[str, Any]:
    """Return the entry of a result in the history of the link at a place: values and deviations."""
    estimates = zip(found["names"], found["values"], found["deviations"], strict=True)
    known = {
        name: [value, deviation] for name, value, deviation in estimates if deviation is not None
    }
    made = found["provenance"]
    day = datetime.fromtimestamp(1e-9 * made["end"], UTC).isoformat(" ", "minutes")[:16]
    return {
        "date": found["written"] if "written" in found and is_simulated(made["end"]) else day,
        "bag": made["source"],
        "kind": found["kind"],
        **{name: known[f"{name}_{place}"] for name in ESTIMATED if f"{name}_{place}" in known},
    }


def write_back(path: Path, found: Mapping[str, Any]) -> None:
    """Write the values of a result to the files of its links.

    Repeated calls with the same result leave one entry in the history.

    Raises:
        ContentError: the result is of other links, or the links have no serial numbers.
    """
    arm, calibrated = load(path), from_yaml(found["description"])
    here, there = ([link.serial for link in one.links] for one in (arm, calibrated))
    if 0 in here:
        raise ContentError(f"{path}: serials of the links", here, "one for each")
    if here != there:
        raise ContentError("serials of the links in the result", there, f"{here}, as {path} has")
    histories = {}
    for place, serial in enumerate(here, 1):
        file, new = link_file(path.parent, serial), history_entry(found, place)
        before = read_link(file)[1] if file.exists() else []
        same = [all(h.get(k) == new[k] for k in ("date", "bag", "kind")) for h in before]
        kept = [h for h, is_same in zip(before, same, strict=True) if not is_same]
        histories[serial] = [*kept, new]
    save_links(calibrated, path, histories)


def links_table(path: Path) -> "Table":
    """Tabulate the links of an arm, those with a file beside it, and their calibrations."""
    from rich.markup import escape  # imported here because --help does not need it
    from rich.table import Table

    table = Table("link", "place", "when", "from")
    arm = load(path)
    for name, unit in ESTIMATED.items():
        table.add_column(escape(f"{name} [{unit}]"), justify="right")
    places = {link.serial: f"{i}" for i, link in enumerate(arm.links, 1)}
    known = {link.serial: (link, list[dict[str, Any]]()) for link in arm.links if link.serial}
    files = map(read_link, path.parent.glob("link_*.yaml"))
    known |= {link.serial: (link, history) for link, history in files}
    if not known:
        where, expected = f"{path}: serials of the links", "one at least that is not 0"
        raise ContentError(where, [0] * arm.n, expected)
    for link, history in sorted(known.values(), key=lambda one: one[0].serial):
        now = [f"{getattr(link, ATTRIBUTES.get(name, name)):.5g}" for name in ESTIMATED]
        table.add_row(f"{link.serial}", places.get(link.serial, "-"), "now", "", *now)
        before: dict[str, Sequence[float]] = {}
        for one in history:
            words = f"{one.get('kind', '')} {one.get('bag', '')}".strip()
            cells = [_cell(one.get(name), before.get(name)) for name in ESTIMATED]
            table.add_row("", "", f"{one.get('date', '')}", words, *cells)
            before.update({name: one[name] for name in ESTIMATED if name in one})
    return table


def _cell(found: Sequence[float] | None, before: Sequence[float] | None) -> str:
    """Format a value, its deviation, and its change in combined deviations since the one before."""
    if found is None:
        return ""
    value, deviation = found
    text = f"{value:.5g} ± {deviation:.1g}"
    if before is None or not (both := hypot(deviation, before[1])):
        return text
    return f"{text}\n{(value - before[0]) / both:+.1f} sigma"


@in_one_line("links")
def main(args: Sequence[str] | None = None) -> int:
    """Run as `ros2 run fss_arm_calib links`."""
    options = parser().parse_args(args)
    path = Path(options.arm)
    if options.result:
        write_back(path, read_passed(options.result))
    report.console(LINKS_WIDTH).print(links_table(path))
    return 0


if __name__ == "__main__":
    sys.exit(main())
