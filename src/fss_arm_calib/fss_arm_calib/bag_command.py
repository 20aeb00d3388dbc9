"""What commands that estimate from bags have alike: options, what they write, exit codes."""

import argparse
from argparse import BooleanOptionalAction
from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import Any

from rich.console import Console

from fss_arm_calib import report, result
from fss_arm_calib.acceptance import FAIL, NOT_EVALUATED, PASS
from fss_arm_calib.calibration import write_described
from fss_arm_calib.outcome import Outcome
from fss_arm_model.settings import default_in, meaning

EXIT_CODES = {PASS: 0, FAIL: 2, NOT_EVALUATED: 3}

EPILOG = "Exit codes: 0 pass, 1 the command cannot be carried out, 2 fail, 3 not evaluated."


def defaults(kind: type[Any], namespace: str) -> dict[str, Any]:
    """The defaults of settings for a vehicle, which is in a namespace."""
    return {f.name: default_in(f, namespace) for f in fields(kind)}


def outputs(p: argparse.ArgumentParser, written: str) -> None:
    """Options that every estimate from bags has: what to write, and of whom."""
    p.add_argument("--output", metavar="FILE", help=f"write the {written}, if it passes")
    p.add_argument(
        "--result", metavar="JSON", help="write the result, whatever its verdict; a CSV beside it"
    )
    p.add_argument("--report", metavar="DIR", help="write a page to read, and its drawings as PNG")
    p.add_argument(
        "--truth", metavar="YAML", help="description to compare with, in the report only"
    )
    p.add_argument("--namespace", default="", help="of the vehicle, if the bag has several: fss2")


def add_settings(
    p: argparse.ArgumentParser, kind: type[Any], names: Sequence[str] | None = None
) -> None:
    """An option for each setting of a dataclass, or for some by their names."""
    for f in (f for f in fields(kind) if names is None or f.name in names):
        flag, about = f"--{f.name.replace('_', '-')}", meaning(f)
        if isinstance(f.default, bool):
            p.add_argument(flag, action=BooleanOptionalAction, default=f.default, help=about)
            continue
        several = f.default if isinstance(f.default, tuple) else ()
        p.add_argument(
            flag,
            type=type(several[0] if several else f.default),
            nargs=len(several) or None,
            default=f.default,
            metavar=f.name.split("_")[-1].upper(),
            help=f"{about} (default: {'none' if f.default == '' else f.default})".replace(
                "%", "%%"
            ),
        )


def told(
    outcome: Outcome[Any, Any],
    found: report.Report,
    kind: str,
    options: argparse.Namespace,
    console: Console,
    write: Callable[[str, Outcome[Any, Any]], None] = write_described,
    written: str = "calibrated description",
) -> None:
    """Show a result, and write what was asked for.

    Raises:
        OSError: it cannot be written.
    """
    console.print(report.printed(found))
    if options.result:
        result.write(options.result, kind, outcome)
    if options.report:
        page = report.write(options.report, found)
        console.print(f"report written to {page}", soft_wrap=True)
    if options.output and outcome.verdict == PASS:
        write(options.output, outcome)
        console.print(f"{written} written to {options.output}", soft_wrap=True)
    elif options.output:
        reason = f"as the verdict is {outcome.verdict}"
        console.print(f"{options.output} not written, {reason}", soft_wrap=True)
