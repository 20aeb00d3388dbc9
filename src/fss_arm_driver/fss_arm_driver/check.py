"""Test links, one at a time, and write the findings to a file."""

import argparse
import json
import sys
import time
from collections.abc import Mapping
from contextlib import closing
from dataclasses import asdict
from pathlib import Path

from fss_arm_driver.transport import open_transport
from fss_arm_driver.trials import COMPLETE, FAIL, NOT_TRIED, PASS, Finding, Rig, trials
from fss_arm_model.description import Arm
from fss_arm_model.description_file import described
from fss_arm_ros.command_line import Parser, in_one_line, interrupt_at_end
from fss_link.protocol import load_keys

SEARCH_TIMEOUT = 3.0  # for each link's number at a URL [s]
MAX_CURRENT = 0.4  # of the first of five steps: the paper's drives give 2.25 A [A]
EXIT_CODES = {PASS: 0, FAIL: 2, NOT_TRIED: 3}


def find(url: str, arm: Arm, keys: Mapping[int, bytes]) -> Rig | None:
    """Return the link that answers at a URL, with any number; None if none answers."""
    for number, link in enumerate(arm.links, 1):
        transport = open_transport(url, number, keys.get(number))
        rig = Rig(number, link, transport, keys.get(number))
        if rig.listen(SEARCH_TIMEOUT):
            return rig
        transport.close()
    return None


def as_yaml(findings: list[Finding], urls: dict[int, str], when: str) -> str:
    """Format the findings as YAML."""
    lines = [
        "# Findings of `ros2 run fss_arm_driver check`.",
        f"when: {json.dumps(when)}",
        "links:",
    ]
    for number, url in urls.items():
        lines += [f"  - link: {number}", f"    url: {json.dumps(url)}", "    findings:"]
        for finding in findings:
            if finding.link == number:
                values = {k: v for k, v in asdict(finding).items() if k != "link"}
                first, *rest = (f"{name}: {json.dumps(text)}" for name, text in values.items())
                lines += [f"      - {first}", *(f"        {line}" for line in rest)]
    return "\n".join(lines) + "\n"


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    p = Parser(
        prog="check",
        description=f"{__doc__} Joints turn by up to 20 degrees: keep the emergency "
        "stop at hand. No driver of these links may run.",
        epilog="Exit codes: 0 pass, 1 cannot be carried out, 2 fail, 3 a test was not carried out.",
    )
    p.add_argument(
        "urls",
        metavar="URL",
        nargs="+",
        help="address of a link, such as udp://192.168.1.11:5001?bind=6001",
    )
    p.add_argument("--arm", default="", help="the arm's description (default: the paper's)")
    p.add_argument("--keys", default="", help="file of the links' keys")
    p.add_argument(
        "--current", type=float, default=0.1, help="first step of current [A] (default 0.1)"
    )
    p.add_argument("--output", default="check.yaml", help="file to write (default check.yaml)")
    return p


@in_one_line("check")
def main() -> int:
    """Run as `ros2 run fss_arm_driver check`."""
    command = parser()
    given = command.parse_args()
    if not 0.0 < given.current <= MAX_CURRENT:
        command.error(f"--current is {given.current} A, expected above 0 to {MAX_CURRENT:g}")
    interrupt_at_end()
    return run(given)


def run(given: argparse.Namespace) -> int:
    """Run the tests of the command line.

    Raises:
        ValueError: a URL, the description or the keys are wrong.
        OSError: a file cannot be read or written.
    """
    arm = described(given.arm)
    keys = load_keys(given.keys) if given.keys else {}
    findings: list[Finding] = []
    places: dict[int, str] = {}
    number, url = 0, ""
    try:
        for url in given.urls:
            number = 0
            rig = find(url, arm, keys)
            if rig is None:
                findings.append(Finding(0, "answers", FAIL, f"nothing at {url}"))
                places.setdefault(0, url)
                print(f"{url}: no link answers: is it switched on? Does another driver use it?")
                continue
            number = rig.number
            with closing(rig.transport):
                if number in places:
                    why = f"at {url}, too: it has answered at {places[number]}"
                    findings.append(Finding(number, "answers", FAIL, why))
                    print(f"{url}: link {number} has answered at {places[number]}, too")
                    continue
                places[number] = url
                for finding in trials(rig, input, given.current):
                    findings.append(finding)
                    result = f"{finding.name}: {finding.verdict}: {finding.found}"
                    print(f"link {finding.link}: {result}")
    except (EOFError, KeyboardInterrupt) as end:
        why = "end of input" if isinstance(end, EOFError) else "interrupted"
        findings.append(Finding(number, COMPLETE, NOT_TRIED, why))
        places.setdefault(number, url)
        print(f"check: {why}", file=sys.stderr)
    finally:  # keep the findings in any case: they cost the operator time
        if findings:
            when = time.strftime("%Y-%m-%dT%H:%M:%S%z")
            Path(given.output).write_text(as_yaml(findings, places, when), encoding="utf-8")
            print(f"written to {given.output}")
    verdict = max((EXIT_CODES[finding.verdict] for finding in findings), default=0)
    failed = any(finding.verdict == FAIL for finding in findings)
    return EXIT_CODES[FAIL] if failed else verdict


if __name__ == "__main__":
    sys.exit(main())
