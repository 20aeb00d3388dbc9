"""Output and exit codes shared by the commands that estimate from bags."""

import argparse
from collections.abc import Callable
from typing import Any

from rich.console import Console

from fss_arm_calib import report, result
from fss_arm_calib.acceptance import FAIL, NOT_EVALUATED, PASS
from fss_arm_calib.calibration import write_description
from fss_arm_calib.outcome import Outcome

EXIT_CODES = {PASS: 0, FAIL: 2, NOT_EVALUATED: 3}


def report_outcome(
    outcome: Outcome[Any, Any],
    found: report.Report,
    kind: str,
    options: argparse.Namespace,
    console: Console,
    write: Callable[[str, Outcome[Any, Any]], None] = write_description,
    output_name: str = "calibrated description",
) -> None:
    """Print a result and write the requested files.

    Raises:
        OSError: a file cannot be written.
    """
    console.print(report.printable(found))
    if options.result:
        result.write(options.result, kind, outcome)
    if options.report:
        page = report.write(options.report, found)
        console.print(f"report written to {page}", soft_wrap=True)
    if options.output and outcome.verdict == PASS:
        write(options.output, outcome)
        console.print(f"{output_name} written to {options.output}", soft_wrap=True)
    elif options.output:
        reason = f"as the verdict is {outcome.verdict}"
        console.print(f"{options.output} not written, {reason}", soft_wrap=True)
