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
    "demo": "the main job: simulator, drivers, kinematic calibration, bag, and back",
    "dynamic": "a dynamic calibration: maneuvers designed, made, recorded and solved",
    "drift": "a drift calibration: tilt, hose and momentum, from a base that drifts",
    "capture": "go to a tumbling target by thrusters, grip it with the arm, stop it",
    "wifi_outage": "the Wi-Fi fails while the arm moves, and comes back",
    "power_failure": "a link's power fails while the arm moves, and comes back",
    "first_day": "a link is tried by itself, with a person's hand on its joint",
}
HELP = "\n".join(f"  {name:<14}{about}" for name, about in REHEARSALS.items())


def main(name: str, arguments: Sequence[str]) -> int:
    """Run a rehearsal; return the exit code: 0 if all checks held, 2 if not."""
    module = import_module(f"fss_rehearsal.{name}")
    parser = argparse.ArgumentParser(
        f"rehearse.sh {name}", description=module.__doc__,
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )  # fmt: skip
    parser.add_argument("--seed", type=int, default=1, help="of all that chance decides")
    parser.add_argument("--out", type=Path, help=f"folder for the results; None: out/{name}-TIME")
    module.add_options(parser)
    options = parser.parse_args(arguments)
    out, console = results(options.out, name), report.console()
    done = module.run(options, out, console)
    found = done.report(f"Rehearsal: {name}", REHEARSALS[name])
    console.print(report.printed(found))
    page = report.write(out / "report", found, *done.reports)
    for file, what in {str(page.relative_to(out)): "what happened", **done.files}.items():
        if (out / file).exists():
            console.print(f"{what:>24}  {out / file}", soft_wrap=True)
    return 0 if done.held else 2


if __name__ == "__main__":
    if len(sys.argv) < 2 or sys.argv[1] not in REHEARSALS:
        asked = sys.argv[1:2] in (["-h"], ["--help"])
        usage = f"usage: rehearse.sh NAME [--help] [OPTIONS]\n\n{__doc__}\n\n{HELP}"
        print(usage, file=sys.stdout if asked else sys.stderr)
        sys.exit(0 if asked else 2)
    sys.exit(rehearse(sys.argv[1], partial(main, sys.argv[1], sys.argv[2:])))
