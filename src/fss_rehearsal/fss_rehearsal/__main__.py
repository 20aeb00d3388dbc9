"""Run a rehearsal by name: each writes a bag, figures, and a page that reports what happened."""

import argparse
import sys
from collections.abc import Sequence
from functools import partial
from importlib import import_module
from pathlib import Path

from fss_arm_calib import report
from fss_rehearsal.processes import rehearse, results

#: Modules with `add_options` and `run`, imported on request.
REHEARSALS = {
    "demo": "kinematic calibration: simulator, drivers, experiment, and again from the bag",
    "dynamic": "dynamic calibration: maneuvers are designed, run, recorded and solved",
    "drift": "drift calibration: tilt, hose and momentum from a drifting base",
    "capture": "approach a tumbling target by thrusters, grip it with the arm, stop it",
    "wifi_outage": "the Wi-Fi fails while the arm moves, and returns",
    "power_failure": "the power of a link fails while the arm moves, and returns",
    "first_day": "`check` of a single link, with a simulated hand on its joint",
}
HELP = "\n".join(f"  {name:<14}{about}" for name, about in REHEARSALS.items())


def main(name: str, arguments: Sequence[str]) -> int:
    """Run a rehearsal; return the exit code: 0 if all checks passed, 2 if not."""
    module = import_module(f"fss_rehearsal.{name}")
    parser = argparse.ArgumentParser(
        f"rehearse.sh {name}",
        description=module.__doc__,
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument("--seed", type=int, default=1, help="seed of all random numbers")
    parser.add_argument(
        "--out", type=Path, help=f"folder for the results; default: out/{name}-TIME"
    )
    parser.add_argument("--details", action="store_true", help="print all tables and checks")
    module.add_options(parser)
    options = parser.parse_args(arguments)
    out, console = results(options.out, name), report.console()
    rehearsed = module.run(options, out, console)
    summary = rehearsed.report(f"Rehearsal: {name}", REHEARSALS[name])
    console.print(report.printable(summary, options.details), highlight=False)
    page = report.write(out / "report", summary, *rehearsed.reports)
    for file, content in {str(page.relative_to(out)): "report", **rehearsed.files}.items():
        if (out / file).exists():
            console.print(f"{content:>24}  {out / file}", soft_wrap=True)
    return 0 if rehearsed.passed else 2


if __name__ == "__main__":
    if len(sys.argv) < 2 or sys.argv[1] not in REHEARSALS:
        help_requested = sys.argv[1:2] in (["-h"], ["--help"])
        usage = f"usage: rehearse.sh NAME [--help] [OPTIONS]\n\n{__doc__}\n\n{HELP}"
        print(usage, file=sys.stdout if help_requested else sys.stderr)
        sys.exit(0 if help_requested else 2)
    sys.exit(rehearse(sys.argv[1], partial(main, sys.argv[1], sys.argv[2:])))
