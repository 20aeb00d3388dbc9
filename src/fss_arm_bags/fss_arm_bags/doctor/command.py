"""The command `doctor`."""

import sys
from collections.abc import Sequence
from math import isnan
from pathlib import Path

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from fss_arm_bags.doctor.health import Stream, findings, remark, streams
from fss_arm_bags.doctor.options import parser
from fss_arm_bags.doctor.repair import mends, repair
from fss_arm_bags.reader import Bags, find, open_bags
from fss_arm_bags.recovery import Recovered
from fss_arm_ros.command_line import in_one_line
from fss_arm_ros.convert import seconds

HEALTHY, ILL = 0, 2


@in_one_line("doctor")
def main(args: Sequence[str] | None = None) -> int:
    """Entry point.

    Returns:
        something is wrong with them.
        something is wrong.
    """
    options = parser().parse_args(args)
    console = Console(highlight=False, soft_wrap=True, width=None if sys.stdout.isatty() else 120)
    healthy = [examine(path, options.repair, console) for path in options.bags]
    return HEALTHY if all(healthy) else ILL


def examine(path: Path, mend: bool, console: Console) -> bool:
    """Print the contents and the problems of the bags of a path; repair them first on request."""
    for bag in find(path) if mend else ():
        if recovered := repair(bag):
            console.print(f"repaired: {escape(str(recovered))}")
    with open_bags(path, thorough=True) as bags:
        heard = streams(bags)
        console.print(table(path, bags, heard))
        wrong = [f"damaged: {one}; {remedy(one)}" for one in bags.recovered]
        wrong += bags.left_out
        if not bags.begins:
            wrong.append(f"{path}: holds no messages")
        for bag in bags.unchecked:
            said = f"{bag} has not all of it under checksums: not all damage to it can be seen"
            console.print(escape(said))
        for name, topic in bags.topics.items():
            wrong += [f"{name}: {what}" for what in findings(topic, heard[name], bags.span[0])]
            if said := remark(topic):
                console.print(f"{name} {said}")
    for line in wrong:
        console.print(escape(line), style="red")
    console.print("[red]not healthy[/]" if wrong else "[green]healthy[/]")
    return not wrong


def remedy(bag: Recovered) -> str:
    """Return what the user can do about a damaged bag, in words."""
    if not bag.messages:
        return "nothing of it can be saved"
    return f"{'doctor --repair' if mends(bag.path) else 'ros2 bag reindex'} makes it whole"


def table(path: Path, bags: Bags, heard: dict[str, Stream]) -> Table:
    """Return a table of the topics: types, counts, rates and longest gaps."""
    begin, end = bags.span
    count = sum(topic.messages for topic in bags.topics.values())
    span = f"{seconds(end - begin):.3f} s" if count else "empty"
    several = f" in {len(bags.paths)} bags" if len(bags.paths) > 1 else ""
    rows = Table(
        title=escape(f"{path}: {count} messages, {span}{several}"),
        box=box.SIMPLE,
        title_justify="left",
    )
    rows.add_column("topic", overflow="fold")
    rows.add_column("type", overflow="fold")
    for heading in ("messages", "rate [Hz]", "longest gap [s]"):
        rows.add_column(escape(heading), justify="right")
    for name, topic in bags.topics.items():
        rate, gap = heard[name].rate, heard[name].longest_gap
        numbers = ("-" if isnan(rate) else f"{rate:.2f}", "-" if isnan(gap) else f"{gap:.3f}")
        rows.add_row(name, topic.msgtype.replace("/msg/", "/"), str(topic.messages), *numbers)
    return rows
