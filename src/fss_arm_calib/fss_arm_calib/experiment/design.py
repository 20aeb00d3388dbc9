"""Maneuvers worth making: those that determine chosen parameters best, before the arm moves.

A maneuver is a sequence of straight moves in joint space, each from rest to rest with the trapezoid
of the drives. Candidates stay within joint limits and torque, off the table's edge and the arm's
own links, and within a time. One after the other, that one is taken which shrinks the volume of the
chosen parameters' uncertainty most for the time that it takes, rest included (D-optimality); with a
goal, the sum of their variances by those asked for (A-optimality), which the worst rules. Errors
of what is assumed count as well: what no maneuver can mend is not sought. Each maneuver has its
start's pose and momentum as unknowns, and the table may be tilted: what counts is what a drifting
base leaves visible.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import inf, nan, sqrt

import numpy as np
import yaml

from fss_arm_calib.dynamic.problem import (
    DynamicProblem,
    DynamicResult,
    information,
    propagated,
    solve,
)
from fss_arm_calib.dynamic.settings import HEADING, DynamicSettings
from fss_arm_calib.dynamic.solution import known_beforehand
from fss_arm_calib.estimation.least_squares import Floats
from fss_arm_calib.estimation.noise import assumed
from fss_arm_model.base_motion import Law, Path, base_poses, path, stack
from fss_arm_model.description import Arm
from fss_arm_model.dynamics import bias, inertia_matrix
from fss_arm_model.settings import (
    POSITIVE,
    Check,
    SettingError,
    at_least,
    one_of,
    setting,
)
from fss_arm_motion.guard import Guard, GuardError
from fss_arm_motion.guard_settings import GuardSettings

SINGLE, SWEEP, LOOP = "single", "sweep", "loop"
KINDS = (SINGLE, SWEEP, LOOP)

RAMP = 1.0 / 3.0  # share of a move's time in which it accelerates, and again decelerates
PAUSE = 0.5  # between two moves of a maneuver, in which the arm is found to have arrived [s]
STRENGTH = 0.7  # of the drives' torque, to leave them some to correct with
STEP = np.radians(5.0)  # joint angles are multiples of it
ATTEMPTS = 3  # plans for a goal, of which the shortest is taken


@dataclass(frozen=True)
class Planned:
    """A maneuver to make."""

    kind: str
    waypoints: Floats  # (w + 1, n) joint readings, the first is where it begins [rad]
    durations: Floats  # (w,) of each move [s]

    @property
    def length(self) -> float:
        """How long it takes [s]."""
        return float(self.durations.sum() + PAUSE * (len(self.durations) - 1))

    def law(self) -> tuple[Law, Floats]:
        """Angles and rates over time, and the times between which they are smooth."""
        way = np.diff(self.waypoints, axis=0)
        begins = np.concatenate([[0.0], np.cumsum(self.durations + PAUSE)[:-1]])

        def law(t: Floats) -> tuple[Floats, Floats]:
            k = np.clip(np.searchsorted(begins, t, "right") - 1, 0, len(way) - 1)
            s, rate, _ = profile((t - begins[k]) / self.durations[k])
            step = way[k]
            rate = rate / self.durations[k]
            return self.waypoints[k] + step * s[:, None], step * rate[:, None]

        corners = np.array([0.0, RAMP, 1.0 - RAMP, 1.0])
        return law, (begins[:, None] + self.durations[:, None] * corners).ravel()


def profile(x: Floats) -> tuple[Floats, Floats, Floats]:
    """Way from 0 to 1 of a move, its rate and acceleration, over the share x of its time."""
    x = np.clip(x, 0.0, 1.0)
    top = 1.0 / (1.0 - RAMP)
    y = np.minimum(x, 1.0 - x)
    ramp = y < RAMP
    way = np.where(ramp, 0.5 * top / RAMP * y**2, top * (y - 0.5 * RAMP))
    rate = np.where(ramp, top / RAMP * y, top)
    acceleration = np.where(ramp, np.where(x < 0.5, top / RAMP, -top / RAMP), 0.0)
    return np.where(x < 0.5, way, 1.0 - way), rate, acceleration


@dataclass(frozen=True)
class Conditions(GuardSettings):
    """What a maneuver must keep to; the base begins at rest at the table's centre.

    Raises:
        SettingError: a condition is impossible.
    """

    duration: float = setting(8.0, "longest maneuver", unit="s", check=POSITIVE)
    rest: float = setting(5.0, "rest before and after a maneuver", unit="s", check=POSITIVE)
    repeats: int = setting(3, "most repeats of a closed loop", check=at_least(1))
    total: float = setting(
        inf, "most time that all maneuvers and rests take", unit="s",
        check=Check("a positive number", lambda value: value > 0.0),
    )  # fmt: skip
    kinds: tuple[str, ...] = setting(KINDS, "kinds of maneuvers", check=one_of(*KINDS))

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.kinds:
            raise SettingError(f"kinds is empty, expected some of {', '.join(KINDS)}")


class NoManeuver(ValueError):  # noqa: N818
    """No maneuver keeps to the conditions."""


def torques(arm: Arm, q: Floats, qd: Floats, qdd: Floats) -> Floats:
    """Joint torques of the floating arm without momentum, (k, n) each [N m].

    With no force on the base, H_b a_b = -(H_bm qdd + h_b).
    """
    p, held = arm.vector(), np.zeros((len(q), 3))
    state = np.concatenate([held, q], axis=1)
    H = inertia_matrix(p, state)
    base, coupling = H[:, :3, :3], H[:, :3, 3:]
    twist = -np.linalg.solve(base, coupling @ qd[..., None])[..., 0]
    h = bias(p, state, np.concatenate([twist, qd], axis=1))
    force = coupling @ qdd[..., None] + h[:, :3, None]
    a_b = -np.linalg.solve(base, force)
    return np.asarray((H[:, 3:, :3] @ a_b + H[:, 3:, 3:] @ qdd[..., None])[..., 0] + h[:, 3:])


def timed(arm: Arm, begin: Floats, end: Floats) -> float:
    """The shortest time for a move that speed, acceleration and torque of the drives allow [s].

    Without momentum the torques of a path scale with the inverse square of its time.
    """
    drives = [link.drive for link in arm.links]
    way = end - begin
    top = 1.0 / (1.0 - RAMP)
    speed = max(top * abs(d) / k.max_velocity for d, k in zip(way, drives, strict=True))
    gain = max(top / RAMP * abs(d) / k.max_acceleration for d, k in zip(way, drives, strict=True))
    least = max(speed, sqrt(gain), 0.1)
    s, rate, acceleration = profile(np.linspace(0.0, 1.0, 31) + 1e-9)
    needed = np.abs(
        torques(arm, begin + s[:, None] * way, rate[:, None] * way, acceleration[:, None] * way)
    )
    limits = np.array([STRENGTH * k.torque_constant * k.max_current for k in drives])
    return max(least, float(np.sqrt((needed / limits).max())))


def candidates(
    arm: Arm, begin: Floats, count: int, conditions: Conditions, rng: np.random.Generator
) -> list[Planned]:
    """Random maneuvers from a posture that keep to the conditions, at most so many."""
    low = np.ceil(np.array([k.q_min for k in arm.links]) / STEP * 0.95)
    high = np.floor(np.array([k.q_max for k in arm.links]) / STEP * 0.95)
    found: list[Planned] = []
    guard = Guard(arm, conditions)
    for _ in range(3 * count):
        if len(found) == count:
            break
        kind = conditions.kinds[rng.integers(len(conditions.kinds))]
        ways = STEP * rng.integers(low, high, (int(rng.integers(1, 4)), arm.n), endpoint=True)
        if kind == SINGLE:
            joint = rng.integers(arm.n)
            ways = np.where(np.arange(arm.n) == joint, ways[:1], begin)
        elif kind == LOOP:
            corners = np.concatenate([ways[:2], begin[None]])
            ways = np.tile(corners, (int(rng.integers(1, conditions.repeats + 1)), 1))
        planned = within(guard, kind, np.concatenate([begin[None], ways]), conditions)
        if planned:
            found.append(planned)
    return found


def within(guard: Guard, kind: str, waypoints: Floats, conditions: Conditions) -> Planned | None:
    """The maneuver through the waypoints, if it keeps to the conditions."""
    pairs = list(pairwise(waypoints))
    if any(np.abs(b - a).max() < 2.0 * STEP for a, b in pairs):
        return None
    durations: list[float] = []
    for a, b in pairs:
        durations.append(timed(guard.arm, a, b))
        if sum(durations) + PAUSE * (len(durations) - 1) > conditions.duration:
            return None
    planned = Planned(kind, waypoints, np.array(durations))
    law, edges = planned.law()
    try:
        guard.check_posture(waypoints[0], base=np.zeros(3))
        guard.check_path(edges, *law(edges), base=np.zeros(3))
    except GuardError:
        return None
    return planned


def windowed(planned: Planned, settings: DynamicSettings, rest: float) -> tuple[Path, Floats]:
    """The path, knots in the windows before and after it, and independent poses in each of them."""
    window = min(settings.max_duration, (rest - settings.settle_time) / 2.0)
    bins = max(1, round(window / settings.bin))
    middles = window / bins * (np.arange(bins) + 0.5)
    law, edges = planned.law()
    times = np.concatenate([middles - window, planned.length + settings.settle_time + middles])
    return path(law, edges, times), np.full(2 * bins, max(1.0, settings.fresh_rate * window / bins))


def problem(
    arm: Arm,
    plan: Sequence[Planned],
    settings: DynamicSettings,
    rest: float,
    before: DynamicProblem | None = None,
) -> DynamicProblem:
    """What would be solved after a plan, its poses those predicted for an arm as described.

    Args:
        arm: as far as it is known.
        plan: the maneuvers.
        settings: what will be estimated and what is known beforehand.
        rest: before and after a maneuver [s].
        before: maneuvers made already.
    """
    paths, fresh = zip(*(windowed(one, settings, rest) for one in plan), strict=True)
    deviations = assumed(settings).deviations[[0, 0, 1]]
    if settings.residuals == HEADING:
        deviations[:2] = inf
    sigma = [*(deviations / np.sqrt(np.array(fresh))[..., None])]
    if before:
        paths = (*paths, *(Path(*rows) for rows in zip(*before.path, strict=True)))
        sigma += [*before.sigma]
    batch = stack(paths)
    most = batch.marks.shape[1]
    sigma = [np.pad(s, ((0, most - len(s)), (0, 0)), constant_values=inf) for s in sigma]
    poses = base_poses(arm.vector(), batch, np.zeros(8))
    return known_beforehand(arm, settings, batch, poses, np.array(sigma))


def expected(
    arm: Arm,
    plan: Sequence[Planned],
    settings: DynamicSettings,
    rest: float,
    before: DynamicProblem | None = None,
) -> DynamicResult:
    """The result to expect of a plan, as `problem` has it: its deviations are what counts."""
    return solve(problem(arm, plan, settings, rest, before), bounded=False)


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
    enough: Callable[[Sequence[Planned]], bool] = lambda _: False,
) -> list[Planned]:
    """Maneuvers, each beginning where the last one ended.

    Args:
        arm: as far as it is known.
        count: how many, at most.
        settings: what will be estimated and what is known beforehand.
        conditions: what maneuvers keep to.
        chosen: names of the parameters that matter; all that are estimated by default.
        goal: deviations to come near to, by name; it chooses.
        before: maneuvers made already.
        begin: (n) where the arm is [rad]; 0 by default.
        seed: of the candidates.
        tried: candidates for each maneuver.
        progress: called with the number of maneuvers found.
        enough: whether a plan so far will do.

    Raises:
        NoManeuver: nothing keeps to the conditions.
        ValueError: a name is not estimated.
    """
    conditions, rng = conditions or Conditions(), np.random.default_rng(seed)
    goal = goal or {}
    chosen = list(goal) or chosen
    place = np.zeros(arm.n) if begin is None else np.asarray(begin, dtype=float)
    plan: list[Planned] = []
    total = information(before).sum(axis=0) if before else np.zeros(())
    elapsed = conditions.rest
    while len(plan) < count and not (plan and enough(plan)):
        options = candidates(arm, place, tried, conditions, rng)
        if not options:
            sides = " x ".join(f"{side:g}" for side in conditions.table)
            raise NoManeuver(
                f"none of {3 * tried} maneuvers keeps to {conditions.duration:g} s, the joints' "
                f"torque, the arm's clearance and a table of {sides} m"
            )
        model = problem(arm, options, settings, conditions.rest)
        if unknown := set(chosen) - set(model.names):
            raise ValueError(f"{', '.join(sorted(unknown))} is not estimated")
        which = [k for k, name in enumerate(model.names) if not chosen or name in chosen]
        asked = np.array([goal[model.names[k]] for k in which]) if goal else np.empty(0)
        each = information(model)
        vague = _vague(model, settings)
        spans = np.array([one.length + conditions.rest for one in options])
        now, then = (
            _size(propagated(model, vague + some)[..., which, :][..., which], asked)
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


def to_goal(
    arm: Arm,
    count: int,
    settings: DynamicSettings,
    conditions: Conditions,
    goal: Mapping[str, float],
    before: DynamicProblem | None = None,
    seed: int = 0,
    progress: Callable[[int], None] = lambda _: None,
) -> list[Planned]:
    """Of several plans that promise the deviations asked for, the one that takes the least time.

    The first one, if none promises them. Arguments and errors are those of `design`.
    """
    best: list[Planned] = []

    def kept(plan: Sequence[Planned]) -> bool:
        return meets(expected(arm, plan, settings, conditions.rest, before), goal)

    for k in range(ATTEMPTS):
        plan = design(
            arm, count, settings, conditions, goal=goal, before=before, seed=(seed, k),
            progress=progress, enough=kept,
        )  # fmt: skip
        if plan and (kept(plan) or not best):
            best = plan
            if kept(plan):  # the next one is to be shorter
                span = conditions.rest + sum(one.length + conditions.rest for one in plan)
                conditions = replace(conditions, total=span)
    return best


def goal_of(words: str, names: Sequence[str]) -> dict[str, float]:
    """The deviations asked for, by name, of words as `b_i 0.002 I_4 0.001`, in SI units.

    Raises:
        ValueError: a word names nothing estimated, or what follows it is no positive number.
    """
    pairs, goal = words.split(), dict[str, float]()
    for word, value in zip(pairs[::2], [*pairs[1::2], ""], strict=False):
        stem = word.removesuffix("_i")
        each = [k for k in names if k.rpartition("_")[0] == stem != word and k != f"{stem}_0"]
        own = [word] if word in names else each
        try:
            asked = float(value)
        except ValueError:
            asked = nan
        if not own or not asked > 0.0:
            known = " ".join(names)
            raise ValueError(
                f"goal has {word!r} {value!r}, expected a name and a deviation; of {known}, or b_i"
            )
        goal |= dict.fromkeys(own, asked)
    return goal


def meets(result: DynamicResult, goal: Mapping[str, float]) -> bool:
    """Whether the deviations are as small as asked for."""
    sigma = dict(zip(result.problem.names, result.deviations, strict=True))
    return all(sigma[name] <= asked for name, asked in goal.items())


def _vague(model: DynamicProblem, settings: DynamicSettings) -> Floats:
    """Information (p + c, p + c) of what is vaguely known where there is no prior.

    Without it the first few maneuvers, which cannot determine all parameters, had no order.
    """
    basis = model.choice.basis
    typical = basis.T @ settings.deviations(model.arm.n) / basis.sum(axis=0)
    found = np.zeros(len(model.names) + len(model.unsure))
    found[: len(typical)] = np.where(np.isfinite(model.prior), 0.0, typical**-2.0)
    return np.diag(found)


def _size(covariance: Floats, asked: Floats) -> Floats:
    """Logarithm of the determinant, or of the sum of variances by those of what is asked for."""
    if len(asked):
        shares = np.diagonal(covariance, axis1=-2, axis2=-1) / asked**2
        return np.asarray(np.log(shares.sum(axis=-1)))
    return np.asarray(np.linalg.slogdet(covariance)[1])


def to_yaml(plan: Sequence[Planned], promised: Mapping[str, float] | None = None) -> str:
    """A plan as `experiment` reads it, and the deviations it promises for a report to compare."""
    rows = [
        {
            "kind": one.kind,
            "q": np.round(one.waypoints, 6).tolist(),
            "durations": np.round(one.durations, 3).tolist(),
        }
        for one in plan
    ]
    head = "# Maneuvers: joint readings, the first is where it begins [rad]; times of moves [s].\n"
    told = {"promised": {k: float(f"{x:.4g}") for k, x in promised.items()}} if promised else {}
    given = {"maneuvers": rows, **told}
    return head + yaml.safe_dump(given, sort_keys=False, default_flow_style=None)


def from_yaml(text: str, n: int) -> list[Planned]:
    """The plan that to_yaml wrote.

    Raises:
        ValueError: it is something else, or for another number of joints.
    """
    try:
        rows = yaml.safe_load(text)["maneuvers"]
        plan = [
            Planned(str(row["kind"]), np.array(row["q"], float), np.array(row["durations"], float))
            for row in rows
        ]
    except (yaml.YAMLError, TypeError, KeyError, ValueError) as error:
        raise ValueError(f"not a plan of maneuvers: {error}") from None
    for k, one in enumerate(plan, 1):
        if one.waypoints.shape != (len(one.durations) + 1, n) or not (one.durations > 0.0).all():
            raise ValueError(
                f"maneuver {k} has waypoints {one.waypoints.shape} and {len(one.durations)} "
                f"durations, expected (w + 1, {n}) and w of them, above 0"
            )
    return plan
