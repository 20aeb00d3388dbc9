"""Implementation of the command `design`."""

import argparse
import sys
from collections.abc import Mapping, Sequence
from dataclasses import fields
from functools import partial
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from rich.console import Console
from rich.progress import Progress

from fss_arm_bags.reader import BagError, open_bags
from fss_arm_calib.acceptance import format_count
from fss_arm_calib.bag_data import find_data
from fss_arm_calib.dynamic.kind import DYNAMIC
from fss_arm_calib.dynamic.problem import DynamicProblem
from fss_arm_calib.dynamic.settings import DynamicSettings
from fss_arm_calib.dynamic.solution import problem_of, problem_without_data
from fss_arm_calib.dynamic.solve import DynamicResult
from fss_arm_calib.experiment import postures
from fss_arm_calib.experiment.design import (
    design,
    design_for_goal,
    expected_result,
    meets_goal,
    parse_goal,
)
from fss_arm_calib.experiment.design_options import CONDITIONS, parser
from fss_arm_calib.experiment.excitation import plan_excitation
from fss_arm_calib.experiment.planned import Planned, plan_to_yaml
from fss_arm_calib.experiment.settings import JOINT, Conditions
from fss_arm_calib.kinematic.problem import FULL, KinematicProblem
from fss_arm_calib.kinematic.solve import solve
from fss_arm_calib.outcome import LIVE
from fss_arm_calib.precision import MASS_UNITS, unmeasured
from fss_arm_calib.result import read_arm
from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_model.description_file import described, from_yaml
from fss_arm_model.estimation.noise import assumed_noise
from fss_arm_model.kinematics import tip_in_base
from fss_arm_ros import report
from fss_arm_ros.command_line import in_one_line


def prior_from_bag(
    bag: str, arm: Arm, settings: DynamicSettings
) -> tuple[Arm, DynamicSettings, DynamicProblem]:
    """Return the knowledge from a bag's maneuvers: the arm if accepted, the noise, and them."""
    with open_bags(bag) as bags:
        finder = DYNAMIC.finder(arm, settings, [])
        found = find_data(bags, finder, DYNAMIC.inputs(settings, arm.n), settings.horizon)
    outcome = DYNAMIC.calibrate(found, arm, settings, finder.streams(), LIVE)
    if not outcome.used:
        why = f": {found[0].reason}" if found else ", it has none"
        raise BagError(f"no maneuver of {bag} can be used{why}")
    used = outcome.used
    if outcome.solution:
        settings = outcome.solution.noise.apply_to(settings)
        used = tuple(compress(used, outcome.solution.kept))
    arm = from_yaml(outcome.description) if outcome.description else arm
    problem = problem_of(used, arm, settings)
    return problem.arm, settings, problem


def plan_table(plan: Sequence[Planned]) -> report.Table:
    """Tabulate the maneuvers of a plan."""
    rows = [
        [str(k), one.kind, f"{one.length:.1f}", "  ".join(map(_in_degrees, one.waypoints[1:]))]
        for k, one in enumerate(plan, 1)
    ]
    return report.Table("Maneuvers", ["", "kind", "time [s]", "to [deg]"], rows, words=2)


def _in_degrees(q: Floats) -> str:
    return str(np.degrees(q).round().astype(int).tolist())


def expected_table(result: Any, columns: Mapping[str, Floats], note: str = "") -> report.Table:
    """Tabulate the expected values (p,) of a result's parameters, in SI units, by head."""
    names, units = result.problem.names, result.problem.units
    columns = {"assumed": result.values, **columns}
    rows = [
        [name, unit, *(f"{x:{'.5g' if k == 0 else '.2g'}}" for k, x in enumerate(row))]
        for name, unit, *row in zip(names, units, *columns.values(), strict=True)
    ]
    head = ["parameter", "unit", *columns]
    return report.Table("Expected result", head, rows, words=2, note=note)


def promised_deviations(result: DynamicResult) -> Floats:
    """Return the standard deviations (p,) that a result will have; inf: not determined."""
    lost = np.isin(result.problem.names, unmeasured(result.problem, result.deviations))
    return np.where(lost, np.inf, result.deviations)


def describe_expected(result: DynamicResult, count: int) -> str:
    """Return which masses and inertias `count` maneuvers determine, and an option for the rest."""
    names, units = np.array(result.problem.names), np.array(result.problem.units)
    lost = ~np.isfinite(promised_deviations(result))
    found = ", ".join(names[np.isin(units, MASS_UNITS) & ~lost]) or "no inertia"
    words = f"{format_count(count, 'maneuver')} determine {found}"
    if not lost.any():
        return words
    more = f"try --count {2 * count} --chosen '{' '.join(names[lost])}'"
    return f"{words}, not {', '.join(names[lost])}: {more}"


def propose_postures(
    options: argparse.Namespace, arm: Arm, conditions: Conditions, console: Console
) -> None:
    """Propose postures for the kinematic calibration."""
    q = postures.design_postures(arm, options.count, options.seed, settings=conditions)
    result = solve(KinematicProblem(q, tip_in_base(arm.vector(), q), arm, FULL))
    steps = [[str(k), _in_degrees(row)] for k, row in enumerate(q, 1)]
    console.print(report.Table("Postures", ["", "q [deg]"], steps))
    console.print(expected_table(result, {"± 1 sigma": result.deviations}))
    if options.output:
        given = {"ros__parameters": {"postures": q.ravel().round(6).tolist()}}
        text = yaml.safe_dump({"/**/experiment": given}, default_flow_style=None)
        head = "# For `experiment --ros-args --params-file`: joint readings, row after row [rad].\n"
        Path(options.output).write_text(head + text)
        console.print(f"postures written to {options.output}", soft_wrap=True)


def propose_excitation(
    options: argparse.Namespace, arm: Arm, conditions: Conditions, console: Console
) -> None:
    """Propose moves of single joints for the calibration of drives."""
    plan = plan_excitation(arm, conditions.repeats, conditions, options.seed)
    console.print(plan_table(plan))
    minutes = sum(one.length + conditions.rest for one in plan) / 60.0
    console.print(f"{len(plan)} maneuvers, {minutes:.1f} min; their result is not predicted")
    if options.output:
        _write_plan(options.output, plan, console)


def _write_plan(
    path: str, plan: Sequence[Planned], console: Console, result: DynamicResult | None = None
) -> None:
    deviations = promised_deviations(result) if result else ()
    promised = dict(zip(result.problem.names, deviations, strict=True)) if result else {}
    known = {name: x for name, x in promised.items() if np.isfinite(x)}
    Path(path).write_text(plan_to_yaml(plan, known), encoding="utf-8")
    console.print(f"plan written to {path}", soft_wrap=True)


def propose(options: argparse.Namespace, console: Console) -> None:
    """Choose maneuvers, show the expected deviations, and write the plan."""
    given = {f.name: getattr(options, f.name) for f in fields(DynamicSettings)}
    settings = DynamicSettings(**given)
    arm = described(settings.arm)
    limits = {name: getattr(options, name) for name in CONDITIONS}
    limits["table"] = tuple(limits["table"])
    if options.kinds == JOINT:
        propose_excitation(options, arm, Conditions(**limits), console)
        return
    conditions = Conditions(kinds=tuple(options.kinds.split()), **limits)
    if options.kinematic:
        propose_postures(options, arm, conditions, console)
        return
    maneuvers: DynamicProblem | None = None
    if options.bag:
        arm, settings, maneuvers = prior_from_bag(options.bag, arm, settings)
    elif options.result:
        arm = read_arm(options.result)
    goal = parse_goal(options.goal, problem_without_data(arm, settings).names)
    chosen = options.chosen.split()
    with Progress(console=console, transient=True) as bar:
        task = bar.add_task("choosing maneuvers", total=options.count)

        def progress(k: int) -> None:
            bar.update(task, completed=k)

        given = {"before": maneuvers, "seed": options.seed, "progress": progress}
        choose = partial(design_for_goal, goal=goal) if goal else partial(design, chosen=chosen)
        plan = choose(arm, options.count, settings, conditions, **given)
    result = expected_result(arm, plan, settings, conditions.rest, maneuvers)
    columns = {"± 1 sigma": promised_deviations(result)}
    columns |= {"random part": np.sqrt(np.diag(result.random)), "from prior": result.prior_share}
    note = "inf: not determined, most of it comes from the prior."
    for table in (plan_table(plan), expected_table(result, columns, note)):
        console.print(table)
    console.print(describe_expected(result, len(plan)), soft_wrap=True)
    if goal:
        missed = "" if meets_goal(result, goal) else describe_shortfall(result, plan, goal)
        words = f"not met by {missed}" if missed else "promised"
        minutes = sum(one.length + conditions.rest for one in plan) / 60.0
        console.print(f"goal {options.goal}: {words}, in {minutes:.1f} min", soft_wrap=True)
    noise = assumed_noise(settings).deviations[:2]
    console.print(
        f"assumed errors of a base pose: {1e3 * noise[0]:.2g} mm and {np.degrees(noise[1]):.2g} "
        f"degrees, independent {settings.fresh_rate:g} times per second",
        soft_wrap=True,
    )
    if options.output:
        _write_plan(options.output, plan, console, result)


def describe_shortfall(
    result: DynamicResult, plan: Sequence[Planned], goal: Mapping[str, float]
) -> str:
    """Name the parameter that misses the goal most, and the assumed one that matters most to it."""
    names, sigma = result.problem.names, result.deviations
    k = max(map(names.index, goal), key=lambda k: sigma[k] / goal[names[k]])
    words = f"{len(plan)} maneuvers: {names[k]} reaches {result.deviations[k]:.2g}"
    shifts = np.abs(result.bias[k])
    if not len(shifts):
        return words
    j = int(np.argmax(shifts))
    cause = f"{result.assumed_names[j]} is known only to {result.assumed_deviations[j]:.2g}"
    return f"{words}, {shifts[j]:.2g} of it because {cause}"


@in_one_line("design")
def main(args: Sequence[str] | None = None) -> int:
    """Run as `ros2 run fss_arm_calib design`."""
    options = parser().parse_args(args)
    propose(options, report.console())
    return 0


if __name__ == "__main__":
    sys.exit(main())
