"""Run a rehearsal by name: each writes a bag, figures, and a page that reports what happened."""

import sys
from collections.abc import Sequence
from difflib import get_close_matches
from functools import partial
from importlib import import_module
from pathlib import Path

from fss_arm_ros import report
from fss_arm_ros.command_line import USER_ERROR, Parser
from fss_rehearsal.processes import rehearse, results, short_path

DESCRIPTION = """\
Rehearse on a simulated test bed. Each rehearsal writes a bag, figures, and
report/index.html, which compares what was expected with what happened."""
#: Modules with `add_options` and `run`, imported on request.
REHEARSALS = {
    "demo": "kinematic calibration, live and again from the bag",
    "dynamic": "dynamic calibration: design maneuvers, run and solve them",
    "drift": "drift calibration: tilt, hose and momentum",
    "capture": "approach a tumbling target, grip it with the arm, stop it",
    "wifi_outage": "the Wi-Fi fails while the arm moves, and returns",
    "power_failure": "the power of a link fails while the arm moves, and returns",
    "first_day": "`check` of a single link, with a simulated hand on its joint",
}
HELP = "\n".join(f"  {name:<15}{about}" for name, about in REHEARSALS.items())


def name_problem(given: Sequence[str]) -> str:
    """Return the error for a missing or unknown name of a rehearsal."""
    if not given:
        return f"NAME is missing, expected one of {', '.join(REHEARSALS)}"
    near = get_close_matches(given[0], REHEARSALS, n=1)
    hint = f"is it {near[0]}?" if near else f"expected one of {', '.join(REHEARSALS)}"
    return f"no rehearsal {given[0]!r}; {hint}"


def main(name: str, arguments: Sequence[str]) -> int:
    """Run a rehearsal; return the exit code: 0 if all checks passed, 2 if not."""
    module = import_module(f"fss_rehearsal.{name}")
    parser = Parser(f"rehearse.sh {name}", description=module.__doc__)
    parser.add_argument(
        "--seed", type=int, default=1, help="seed of all random numbers (default 1)"
    )
    parser.add_argument(
        "--out", type=Path, help=f"folder for the results (default out/{name}-TIME)"
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
            console.print(f"{content:>24}  {short_path(out / file)}", soft_wrap=True)
    return 0 if rehearsed.passed else 2


if __name__ == "__main__":
    if len(sys.argv) < 2 or sys.argv[1] not in REHEARSALS:
        if sys.argv[1:2] in (["-h"], ["--help"]):
            print(f"usage: rehearse.sh NAME [--help] [OPTIONS]\n\n{DESCRIPTION}\n\n{HELP}")
            sys.exit(0)
        print(f"rehearse.sh: {name_problem(sys.argv[1:2])}", file=sys.stderr)
        sys.exit(USER_ERROR)
    sys.exit(rehearse(sys.argv[1], partial(main, sys.argv[1], sys.argv[2:])))
