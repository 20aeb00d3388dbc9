"""Tells what a bag holds and whether it is whole; repairs it on request."""

import argparse
import sys
from collections import defaultdict
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from rich import box
from rich.console import Console
from rich.table import Table

from .bags import BagError, Bags, find, is_sound, open_bags, repair
from .convert import seconds

SOUND, DAMAGED, UNREADABLE = 0, 1, 2


def main(args: Sequence[str] | None = None) -> int:
    """Entry point.

    Returns:
        0: the bags are whole, or are so now; 1: damaged, and not repaired; 2: not readable.
    """
    parser = argparse.ArgumentParser(
        prog="doctor",
        description=f"{__doc__} Exit code 0: whole, or repaired; 1: damaged; 2: not readable.",
    )
    parser.add_argument(
        "bags", metavar="BAG", nargs="+", type=Path, help="a bag, or a folder of bags"
    )
    parser.add_argument(
        "--repair",
        action="store_true",
        help="replace damaged bags by what can be recovered (not while they are recorded); "
        "the damaged files are kept as *.damaged",
    )
    options = parser.parse_args(args)
    console = Console(highlight=False, soft_wrap=True, width=None if sys.stdout.isatty() else 110)
    try:
        code = SOUND
        for bag in [bag for path in options.bags for bag in find(path)]:
            code = max(code, examine(bag, options.repair, console))
        return code
    except (BagError, OSError) as error:
        print(f"doctor: {error}", file=sys.stderr)
        return UNREADABLE


def examine(bag: Path, mend: bool, console: Console) -> int:
    """Print what a bag holds and its damage, and repair it if asked to; return the exit code."""
    if mend and (recovered := repair(bag)):
        console.print(f"repaired: {recovered}")
    whole = is_sound(bag)
    with open_bags(bag) as bags:
        console.print(table(bag, bags))
        for damage in bags.recovered:
            console.print(f"damaged: {damage}; doctor --repair makes it whole", style="red")
    return SOUND if whole else DAMAGED


def table(bag: Path, bags: Bags) -> Table:
    """One line a topic: how many messages, how often, and the longest silence between two."""
    receipts: dict[str, list[int]] = defaultdict(list)
    for topic, _, receipt, _ in bags.raw():
        receipts[topic].append(receipt)
    every = [receipt for times in receipts.values() for receipt in times]
    span = f"{seconds(max(every) - min(every)):.3f} s" if every else "empty"
    rows = Table(
        title=f"{bag}: {len(every)} messages, {span}", box=box.SIMPLE, title_justify="left"
    )
    rows.add_column("topic", overflow="fold")
    rows.add_column("type", overflow="fold")
    for heading in ("messages", "rate [Hz]", "longest gap [s]"):
        rows.add_column(heading, justify="right")
    for topic, about in bags.topics.items():
        times = receipts[topic]
        gaps = [b - a for a, b in pairwise(times)]
        rate = f"{len(gaps) / seconds(sum(gaps)):.2f}" if sum(gaps) else "-"
        gap = f"{seconds(max(gaps)):.3f}" if gaps else "-"
        rows.add_row(topic, about.msgtype, str(len(times)), rate, gap)
    return rows
