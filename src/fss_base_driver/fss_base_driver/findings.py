"""Findings of the command `check`: for each valve a verdict from the base's motion."""

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from math import nan
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from rich.table import Table

from fss_arm_model.thrusters import THRUSTER_COUNT
from fss_base_driver.thrust import Body, Thrust, TrackError, estimate, verdict

PASS, FAIL, NOT_TRIED = "pass", "fail", "not tried"
EXIT_CODES = {PASS: 0, FAIL: 2, NOT_TRIED: 3}


class Finding(NamedTuple):
    """Result for one valve, numbered from 1."""

    valve: int
    verdict: str
    words: str
    thrust: Thrust | None = None


@dataclass
class Trial:
    """Record of the base's motion around one pulse."""

    valve: int = 0  # numbered from 0
    on_time: float = 0.0  # of the valve [s]
    begin: float = nan  # of the pulse [s]
    poses: list[tuple[float, float, float, float]] = field(default_factory=list)
    """Time [s], x, y [m], heading [rad], in any order."""
    rates: list[tuple[float, float]] = field(default_factory=list)  # time [s], turn rate [rad/s]
    open_valves: list[int] = field(default_factory=list)  # bits, as reported by the board


def judge_valve(trial: Trial, body: Body, layout: npt.ArrayLike, tolerance: float) -> Finding:
    """Evaluate a valve by the motion that its pulse has caused.

    Args:
        trial: the motion.
        body: base and arm.
        layout: (k, 3) force along x and y [N] and torque [N m] of each valve.
        tolerance: relative tolerance of thrust and lever.
    """
    valve = trial.valve
    if not any(bits >> valve & 1 for bits in trial.open_valves):
        return Finding(valve + 1, FAIL, "the board did not open it")
    poses = np.array(sorted(trial.poses)).reshape(-1, 4)
    poses[:, 3] = np.unwrap(poses[:, 3])
    try:
        found = estimate(body, poses, sorted(trial.rates), trial.begin, trial.on_time)
    except TrackError as error:
        return Finding(valve + 1, NOT_TRIED, str(error))
    words = verdict(found, layout, valve, tolerance)
    return Finding(valve + 1, FAIL if words else PASS, words, found)


def exit_code(findings: Iterable[Finding]) -> int:
    """Return the exit code of the gravest verdict."""
    verdicts = {found.verdict for found in findings}
    return next(EXIT_CODES[v] for v in (FAIL, NOT_TRIED, PASS) if v in verdicts)


def as_yaml(findings: Sequence[Finding], when: str) -> str:
    """Return the result as YAML; with all valves measured, also as the node's parameter."""
    lines = ["# Findings of `ros2 run fss_base_driver check`.", f"when: {json.dumps(when)}"]
    lines += ["valves:"]
    for found in sorted(findings):
        lines += [f"  - valve: {found.valve}", f"    verdict: {json.dumps(found.verdict)}"]
        lines += [f"    words: {json.dumps(found.words)}"] if found.words else []
        if thrust := found.thrust:
            lines += [f"    force: [{thrust.force[0]:.4f}, {thrust.force[1]:.4f}]  # [N]"]
            lines += [f"    torque: {thrust.torque:.5f}  # about the base's origin [N m]"]
            lines += [f"    deviation: [{thrust.deviation[0]:.4f}, {thrust.deviation[1]:.5f}]"]
    rows = {f.valve: [*f.thrust.force, f.thrust.torque] for f in findings if f.thrust}
    if len(rows) == THRUSTER_COUNT:
        numbers = [f"{x:.5f}" for valve in sorted(rows) for x in rows[valve]]
        lines += [
            "# The parameter of the node `base`, as measured:",
            f"layout: [{', '.join(numbers)}]",
        ]
    return "\n".join(lines) + "\n"


def table(findings: Sequence[Finding]) -> Table:
    """Return the result as a table."""
    shown = Table("valve", "force x, y [N]", "torque [N m]", "1 sigma [N, N m]", "", box=None)
    for found in sorted(findings):
        cells = ["-", "-", "-"]
        if thrust := found.thrust:
            cells[0] = f"{thrust.force[0]:+.3f}, {thrust.force[1]:+.3f}"
            cells[1] = f"{thrust.torque:+.4f}"
            cells[2] = f"{thrust.deviation[0]:.3f}, {thrust.deviation[1]:.4f}"
        words = f"{found.verdict}: {found.words}" if found.words else found.verdict
        shown.add_row(str(found.valve), *cells, words)
    return shown
