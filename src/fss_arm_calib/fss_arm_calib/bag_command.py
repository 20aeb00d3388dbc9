"""Output and exit codes shared by the commands that estimate from bags."""

import argparse
from typing import Any

from rich.console import Console

from fss_arm_calib import report, result
from fss_arm_calib.acceptance import FAIL, NOT_EVALUATED, PASS
from fss_arm_calib.calibration import Calibration
from fss_arm_calib.outcome import Outcome

EXIT_CODES = {PASS: 0, FAIL: 2, NOT_EVALUATED: 3}


def report_outcome(
    outcome: Outcome[Any, Any],
    found: report.Report,
    kind: Calibration[Any, Any],
    options: argparse.Namespace,
    console: Console,
) -> None:
    """Print a result and write the requested files.

    Raises:
        OSError: a file cannot be written.
    """
    console.print(report.printable(found, options.details), highlight=False)
    if options.result:
        result.write(options.result, kind.name, outcome)
    if options.report:
        page = report.write(options.report, found)
        console.print(f"report written to {page}", soft_wrap=True)
    if options.output and outcome.verdict == PASS:
        kind.write(options.output, outcome)
        console.print(f"{kind.output_name} written to {options.output}", soft_wrap=True)
    elif options.output:
        reason = f"as the verdict is {outcome.verdict}"
        console.print(f"{options.output} not written, {reason}", soft_wrap=True)
