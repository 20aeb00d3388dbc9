"""Command `doctor`: list what bags hold and how healthy they are, and repair damage."""

import sys
from collections.abc import Sequence
from math import isnan
from pathlib import Path
from textwrap import fill

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from fss_arm_bags.doctor.health import Stream, findings, remark, streams
from fss_arm_bags.doctor.options import parser
from fss_arm_bags.doctor.repair import can_repair, repair
from fss_arm_bags.reader import BagError, Bags, find_bags, open_bags
from fss_arm_bags.recovery import Recovered
from fss_arm_ros.command_line import USER_ERROR, in_one_line, in_words
from fss_arm_ros.convert import seconds

HEALTHY, UNHEALTHY = 0, 2  # exit codes
WIDTH = 80  # [columns]
COMMANDS = "arm/joint_commands"  # a topic that is silent if nothing commands the joints on it


@in_one_line("doctor")
def main(args: Sequence[str] | None = None) -> int:
    """Entry point.

    Returns:
        The largest exit code of the bags: 0 healthy, 1 not readable, 2 damaged or with findings.
    """
    options = parser().parse_args(args)
    console = Console(highlight=False, soft_wrap=True, width=None if sys.stdout.isatty() else WIDTH)
    return max(exit_code(path, options.repair, console) for path in options.bags)


def exit_code(path: Path, with_repair: bool, console: Console) -> int:
    """Repair on request, examine the bags of a path, and return the exit code; print errors."""
    try:
        if with_repair and not repair_all(path, console):
            return USER_ERROR
        return HEALTHY if examine(path, console) else UNHEALTHY
    except (BagError, OSError) as error:
        print(f"doctor: {in_words(error)}", file=sys.stderr)
        return USER_ERROR


def repair_all(path: Path, console: Console) -> bool:
    """Repair each damaged bag of a path and print the result; return False if one failed.

    Raises:
        BagError: there is no bag.
    """
    succeeded = True
    for bag in find_bags(path):
        try:
            if recovered := repair(bag):
                console.print(f"repaired: {escape(str(recovered))}")
        except (BagError, OSError) as error:
            print(f"doctor: {in_words(error)}", file=sys.stderr)
            succeeded = False
    return succeeded


def examine(path: Path, console: Console) -> bool:
    """Print contents and problems of the bags of a path.

    Returns:
        True if the bags are healthy.

    Raises:
        BagError: a bag cannot be read.
        OSError: a file cannot be opened.
    """
    with open_bags(path, thorough=True) as bags:
        by_topic = streams(bags)
        console.print(table(path, bags, by_topic))
        problems = [f"damaged: {one}; {remedy(one)}" for one in bags.recovered]
        problems += bags.left_out
        remarks: dict[str, list[str]] = {}  # topics by what is remarkable about them
        if not bags.starts:
            problems.append(f"{path}: contains no messages")
        for bag in bags.unchecked:
            note = f"{bag}: not all data have checksums, so some damage cannot be detected"
            console.print(escape(note))
        for name, topic in bags.topics.items():
            if not topic.messages and name.endswith(COMMANDS):
                continue
            problems += [
                f"{name}: {problem}" for problem in findings(topic, by_topic[name], bags.span[0])
            ]
            if note := remark(topic):
                remarks.setdefault(note, []).append(name)
    for note, names in remarks.items():
        line = f"{note}: {', '.join(names)}"
        console.print(escape(fill(line, WIDTH, subsequent_indent="  ", break_on_hyphens=False)))
    for line in problems:
        console.print(escape(line), style="red")
    console.print("[red]not healthy[/]" if problems else "[green]healthy[/]")
    return not problems


def remedy(bag: Recovered) -> str:
    """Return the next step for a damaged bag, as text."""
    if not bag.messages:
        return "nothing can be recovered"
    return f"repair it with {'doctor --repair' if can_repair(bag.path) else 'ros2 bag reindex'}"


def table(path: Path, bags: Bags, by_topic: dict[str, Stream]) -> Table:
    """Return a table of the topics: types, counts, rates and longest gaps."""
    start, end = bags.span
    count = sum(topic.messages for topic in bags.topics.values())
    span = f"{seconds(end - start):.3f} s" if count else "empty"
    several = f" in {len(bags.paths)} bags" if len(bags.paths) > 1 else ""
    rows = Table(
        title=escape(f"{path}: {count} messages, {span}{several}"),
        box=box.SIMPLE,
        title_justify="left",
        show_edge=False,
        pad_edge=False,
        collapse_padding=True,
    )
    rows.add_column("topic", overflow="fold")
    rows.add_column("type", overflow="fold")
    for heading in ("count", "rate\n[Hz]", "longest\ngap [s]"):
        rows.add_column(escape(heading), justify="right")
    for name, topic in bags.topics.items():
        rate, gap = by_topic[name].rate, by_topic[name].longest_gap
        numbers = ("-" if isnan(rate) else f"{rate:.2f}", "-" if isnan(gap) else f"{gap:.3f}")
        kind = topic.msgtype.rpartition("/")[2]
        rows.add_row(escape(name), escape(kind), str(topic.messages), *numbers)
    return rows
