"""A goal given to `design`, its plan made on the simulated test bed, and what comes of it."""

from typing import NamedTuple

import numpy as np
from sim_rehearsal import DYNAMIC, Rehearsal

from fss_arm_calib.dynamic.calibrate import calibrate
from fss_arm_calib.experiment.design import design, design_for_goal, expected_result
from fss_arm_calib.experiment.settings import Conditions
from fss_arm_model.description import paper_arm
from fss_arm_model.parameters import parameter_names, values
from fss_rehearsal.dynamic import MANEUVERS_PER_SESSION, PAUSE, TABLE, draw_truth

GOAL = ("b_1", "b_2", "b_3", "b_4")
FIXED, MOST = 16, 40  # maneuvers
KEPT = 0.2  # largest share by which what is achieved differs from what was promised
CONDITIONS = Conditions(rest=PAUSE, table=TABLE)
TWIST, TILT = (0.003, 0.003, 0.004), np.radians(0.001)  # at most, and of the table


class Rehearsed(NamedTuple):
    fixed: float  # time of as many maneuvers as always [min]
    count: int  # of maneuvers that the goal takes
    minutes: float  # that they take by the plan
    simulated: float  # that they took
    ratios: list  # of the deviations achieved to those promised
    square: float  # mean square of errors, in deviations promised
    verdict: str


def minutes(plan):
    return sum(one.length + PAUSE for one in plan) / 60.0


def rehearsed(seed, settings=DYNAMIC):
    arm = paper_arm()
    fixed = design(arm, FIXED, settings, CONDITIONS, seed=seed)
    result = expected_result(arm, fixed, settings, PAUSE)
    asked = dict(zip(result.problem.names, result.deviations, strict=True))
    goal = dict.fromkeys(GOAL, max(asked[name] for name in GOAL))
    plan = design_for_goal(arm, MOST, settings, CONDITIONS, goal, seed=seed)
    result = expected_result(arm, plan, settings, PAUSE)
    truth, rng = draw_truth(arm, settings, seed), np.random.default_rng(seed)
    maneuvers, lasts = [], 0
    for first in range(0, len(plan), MANEUVERS_PER_SESSION):  # then somebody puts the base back
        some = plan[first : first + MANEUVERS_PER_SESSION]
        run = Rehearsal(
            arms=(truth, arm),
            seed=100 * seed + first,
            preset="default",
            q=some[0].waypoints[0],
            twist=rng.uniform(-1.0, 1.0, 3) * TWIST,
            tilt=(TILT, -0.5 * TILT),
        )
        maneuvers += run.make_maneuvers(some, PAUSE)
        lasts += run.bed.now
    outcome = calibrate(maneuvers, arm, settings, run.maneuver_finder.streams())
    assert outcome.accepted == len(plan), outcome.reason
    at = [outcome.names.index(name) for name in GOAL]
    promised, found = result.deviations[at], outcome.deviations[at]
    true = dict(zip(parameter_names(arm.n), values(truth), strict=True))
    errors = (outcome.values[at] - [true[name] for name in GOAL]) / promised
    return Rehearsed(
        minutes(fixed),
        len(plan),
        minutes(plan),
        lasts / 60e9,
        (found / promised).tolist(),
        float(np.mean(errors**2)),
        outcome.verdict,
    )
