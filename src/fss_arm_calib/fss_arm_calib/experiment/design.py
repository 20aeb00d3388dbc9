"""Design of maneuvers that determine chosen parameters best, before the arm moves.

Candidates respect the limits of joints, torques and time, and keep clear of the table's edge and of
the arm's own links. The design is greedy: it adds the candidate that most reduces the volume of the
chosen parameters' uncertainty per time, rest included (D-optimality). With a goal, it reduces the
sum of their variances, relative to the requested ones (A-optimality); the worst parameter dominates
this sum. Errors of assumed parameters are included, so the design does not try to reduce
uncertainty that no maneuver can reduce. Each maneuver has its initial pose and momentum as
unknowns, and the table may be tilted, so only information that remains with a drifting base counts.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import compress
from math import inf

import numpy as np

from fss_arm_calib.dynamic.identifiability import information, propagate_covariance
from fss_arm_calib.dynamic.problem import DynamicProblem
from fss_arm_calib.dynamic.settings import DynamicSettings
from fss_arm_calib.dynamic.solution import pose_deviations, problem_with_priors
from fss_arm_calib.dynamic.solve import DynamicResult, solve
from fss_arm_calib.experiment.planned import NoManeuver, Planned, plan_law
from fss_arm_calib.experiment.settings import LOOP, SINGLE, Conditions, parse_goal_words
from fss_arm_model.arrays import Floats
from fss_arm_model.base_motion import base_poses
from fss_arm_model.description import Arm
from fss_arm_model.estimation.least_squares import Mask
from fss_arm_model.guard.guard import Guard, GuardError
from fss_arm_model.joint_path import Path, path, stack
from fss_arm_model.straight_moves import PAUSE, speed_limited_duration, torque_limited_duration

ANGLE_STEP = np.radians(5.0)  # joint angles are multiples of it
MOVE_ENDS = slice(None, -1), slice(1, None)  # start and end waypoints of the moves
MAX_PLANS = 3  # number of plans for a goal; the shortest is taken


def candidates(
    arm: Arm, begin: Floats, count: int, conditions: Conditions, rng: np.random.Generator
) -> list[Planned]:
    """Draw at most `count` random maneuvers from a posture that satisfy the conditions."""
    found: list[Planned] = []
    guard, left = Guard(arm, conditions), 3 * count
    try:
        guard.check_posture(begin, base=np.zeros(3))
    except GuardError:
        return found
    low = np.ceil(np.array([k.q_min for k in arm.links]) / ANGLE_STEP * 0.95).astype(int)
    high = np.floor(np.array([k.q_max for k in arm.links]) / ANGLE_STEP * 0.95).astype(int)

    n, first = arm.n, begin[None]

    def draw() -> tuple[str, Floats]:
        kind = conditions.kinds[rng.integers(len(conditions.kinds))]
        ways = ANGLE_STEP * rng.integers(low, high, (int(rng.integers(1, 4)), n), endpoint=True)
        if kind == SINGLE:
            joint, way = rng.integers(n), ways[0]
            ways = first.copy()
            ways[0, joint] = way[joint]
        elif kind == LOOP:
            repeats = int(rng.integers(1, conditions.repeats + 1))
            ways = np.concatenate([ways[:2], first] * repeats)
        return kind, np.concatenate([first, ways])

    while left and len(found) < count:
        some = [draw() for _ in range(min(left, count - len(found)))]
        left -= len(some)
        found += select_feasible(guard, some, conditions)
    return found


def select_feasible(
    guard: Guard, some: Sequence[tuple[str, Floats]], conditions: Conditions
) -> list[Planned]:
    """Select the maneuvers, each a kind and waypoints, that satisfy the conditions."""
    arm, counts = guard.arm, np.array([len(knots) - 1 for _, knots in some])
    first = np.cumsum(counts) - counts  # index of each maneuver's first move
    begins, ends = (np.concatenate([knots[part] for _, knots in some]) for part in MOVE_ENDS)
    way = ends - begins

    def is_short(durations: Floats) -> Mask:
        whole = np.add.reduceat(durations, first) + PAUSE * (counts - 1)
        return np.asarray(whole <= conditions.duration)

    long_moves = np.minimum.reduceat(np.abs(way).max(axis=1), first) >= 2.0 * ANGLE_STEP
    durations = speed_limited_duration(arm, way)
    worth = np.repeat(long_moves & is_short(durations), counts)
    durations[worth] = torque_limited_duration(arm, begins[worth], ends[worth])
    each = zip(some, np.split(durations, first[1:]), strict=True)
    plan = [Planned(*one, lasts) for one, lasts in compress(each, long_moves & is_short(durations))]
    return list(compress(plan, _are_clear(guard, plan))) if plan else []


def _are_clear(guard: Guard, plan: Sequence[Planned]) -> Mask:
    """Return a mask of the maneuvers on which the arm stays clear."""
    (law, edges), clear = plan_law(plan), np.empty(len(plan), dtype=bool)
    q, qd = law(edges)
    counts = np.array([len(one.durations) for one in plan])
    for count in np.unique(counts):
        which = counts == count
        times, angles, rates = (part[which, : 4 * count] for part in (edges, q, qd))
        clear[which] = guard.clear(times, angles, rates, np.zeros(3))
    return clear


def windowed_paths(
    plan: Sequence[Planned], settings: DynamicSettings, rest: float
) -> tuple[Path, float]:
    """Return paths with marks in the windows around each maneuver, and independent poses a mark."""
    window = min(settings.max_duration, (rest - settings.settle_time) / 2.0)
    bins = max(1, round(window / settings.bin))
    middles = window / bins * (np.arange(bins) + 0.5)
    ends = np.array([[one.length + settings.settle_time] for one in plan])
    times = np.concatenate(np.broadcast_arrays(middles - window, ends + middles), axis=1)
    return path(*plan_law(plan), times), max(1.0, settings.fresh_rate * window / bins)


def predicted_problem(
    arm: Arm,
    plan: Sequence[Planned],
    settings: DynamicSettings,
    rest: float,
    before: DynamicProblem | None = None,
) -> DynamicProblem:
    """Return the dynamic problem after a plan, with the poses predicted for the described arm.

    `rest` is the time before and after a maneuver [s], `before` are maneuvers already executed.
    """
    batch, fresh = windowed_paths(plan, settings, rest)
    sigma = np.tile(pose_deviations(settings) / np.sqrt(fresh), (*batch.marks.shape[:2], 1))
    if before:
        paths = [Path(*rows) for part in (batch, before.path) for rows in zip(*part, strict=True)]
        batch, parts = stack(paths), (sigma, before.sigma)
        rows = [np.full((len(s), batch.marks.shape[1], 3), inf) for s in parts]
        for padded, part in zip(rows, parts, strict=True):
            padded[:, : part.shape[1]] = part
        sigma = np.concatenate(rows)
    poses = base_poses(arm.vector(), batch, np.zeros(8))
    return problem_with_priors(arm, settings, batch, poses, sigma)


def expected_result(
    arm: Arm,
    plan: Sequence[Planned],
    settings: DynamicSettings,
    rest: float,
    before: DynamicProblem | None = None,
) -> DynamicResult:
    """Return the expected result of a plan (see `problem`); only its deviations are meaningful."""
    return solve(predicted_problem(arm, plan, settings, rest, before), bounded=False)


def design(
    arm: Arm,
    count: int,
    settings: DynamicSettings,
    conditions: Conditions | None = None,
    chosen: Sequence[str] = (),
    goal: Mapping[str, float] | None = None,
    before: DynamicProblem | None = None,
    begin: Floats | None = None,
    seed: int | tuple[int, ...] = 0,
    tried: int = 200,
    progress: Callable[[int], None] = lambda _: None,
    stop_when: Callable[[Sequence[Planned]], bool] = lambda _: False,
) -> list[Planned]:
    """Choose at most `count` maneuvers, each of which starts where the last one ended.

    The first one starts at `begin` (n) [rad], by default 0. The parameters that matter are those of
    the `goal`, the requested deviations by name, or else the `chosen` ones, by default all. For
    each maneuver, `tried` candidates are drawn. `progress` is called with the number of maneuvers
    found; the design stops early when `stop_when` returns True for a plan.

    Raises:
        NoManeuver: no candidate satisfies the conditions.
        ValueError: a name is not estimated.
    """
    conditions, rng = conditions or Conditions(), np.random.default_rng(seed)
    goal = goal or {}
    chosen = list(goal) or chosen
    place = np.zeros(arm.n) if begin is None else np.asarray(begin, dtype=float)
    plan: list[Planned] = []
    total = information(before).sum(axis=0) if before else np.zeros(())
    elapsed = conditions.rest
    while len(plan) < count and not (plan and stop_when(plan)):
        options = candidates(arm, place, tried, conditions, rng)
        if not options:
            sides = " x ".join(f"{side:g}" for side in conditions.table)
            raise NoManeuver(
                f"none of {3 * tried} maneuvers keeps to {conditions.duration:g} s, the joints' "
                f"torque, the arm's clearance and a table of {sides} m"
            )
        model = predicted_problem(arm, options, settings, conditions.rest)
        if unknown := set(chosen) - set(model.names):
            raise ValueError(f"{', '.join(sorted(unknown))} is not estimated")
        which = [k for k, name in enumerate(model.names) if not chosen or name in chosen]
        asked = np.array([goal[model.names[k]] for k in which]) if goal else np.empty(0)
        each = information(model)
        vague = _weak_priors(model, settings)
        spans = np.array([one.length + conditions.rest for one in options])
        now, then = (
            _log_size(propagate_covariance(model, vague + some)[..., which, :][..., which], asked)
            for some in (total, total + each)
        )
        best = int(np.argmax((now - then) / spans))
        elapsed += options[best].length + conditions.rest
        if elapsed > conditions.total:
            break
        plan.append(options[best])
        total = total + each[best]
        place = options[best].waypoints[-1]
        progress(len(plan))
    return plan


def design_for_goal(
    arm: Arm,
    count: int,
    settings: DynamicSettings,
    conditions: Conditions,
    goal: Mapping[str, float],
    before: DynamicProblem | None = None,
    seed: int = 0,
    progress: Callable[[int], None] = lambda _: None,
) -> list[Planned]:
    """Return the shortest of several plans that promise the requested deviations.

    If none promises them, return the first plan. Arguments and errors are those of `design`.
    """
    best: list[Planned] = []
    choose = partial(design, arm, count, settings, goal=goal, before=before, progress=progress)

    def promises_goal(plan: Sequence[Planned]) -> bool:
        return meets_goal(expected_result(arm, plan, settings, conditions.rest, before), goal)

    for k in range(MAX_PLANS):
        plan = choose(conditions=conditions, seed=(seed, k), stop_when=promises_goal)
        if plan and (promises_goal(plan) or not best):
            best = plan
            if promises_goal(plan):  # the next plan must be shorter
                span = conditions.rest + sum(one.length + conditions.rest for one in plan)
                conditions = replace(conditions, total=span)
    return best


def parse_goal(words: str, names: Sequence[str]) -> dict[str, float]:
    """Parse the requested deviations by name, such as `b_i 0.002 I_4 0.001`, in SI units.

    Raises:
        ValueError: a word names no estimated parameter, or no positive number follows it.
    """
    goal = dict[str, float]()
    for word, asked in parse_goal_words(words):
        stem = word.removesuffix("_i")
        each = [k for k in names if k.rpartition("_")[0] == stem != word and k != f"{stem}_0"]
        own = [word] if word in names else each
        if not own:
            raise ValueError(f"goal has {word!r}, expected one of {' '.join(names)}, or b_i")
        goal |= dict.fromkeys(own, asked)
    return goal


def meets_goal(result: DynamicResult, goal: Mapping[str, float]) -> bool:
    """Return True if the deviations are as small as requested."""
    sigma = dict(zip(result.problem.names, result.deviations, strict=True))
    return all(sigma[name] <= asked for name, asked in goal.items())


def _weak_priors(model: DynamicProblem, settings: DynamicSettings) -> Floats:
    """Return the information (p + c, p + c) of weak priors for parameters without a prior.

    They make it possible to rank the first few maneuvers, which cannot determine all parameters.
    """
    typical = model.choice.mean(settings.deviations(model.arm))
    found = np.zeros(len(model.names) + len(model.uncertain))
    found[: len(typical)] = np.where(np.isfinite(model.prior), 0.0, typical**-2.0)
    return np.diag(found)


def _log_size(covariance: Floats, asked: Floats) -> Floats:
    """Return the logarithm of the determinant or, with a goal, of the sum of relative variances."""
    if len(asked):
        shares = np.diagonal(covariance, axis1=-2, axis2=-1) / asked**2
        return np.asarray(np.log(shares.sum(axis=-1)))
    return np.asarray(np.linalg.slogdet(covariance)[1])
