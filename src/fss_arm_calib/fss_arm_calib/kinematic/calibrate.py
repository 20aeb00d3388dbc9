"""Kinematic calibration from observations: the solution and its checks."""

from collections.abc import Sequence
from dataclasses import replace

from fss_arm_calib.acceptance import PASS, check_clocks, check_joint_names
from fss_arm_calib.kinematic import checks
from fss_arm_calib.kinematic.settings import KinematicSettings
from fss_arm_calib.kinematic.solution import (
    Solution,
    estimate_of,
    min_observations,
    problem_of,
    solution_of,
)
from fss_arm_calib.outcome import LIVE, Outcome, make_outcome
from fss_arm_calib.segments.rests import Observation
from fss_arm_calib.segments.streams import Streams
from fss_arm_calib.segments.telemetry import keep_since_homing
from fss_arm_model.description import Arm


def calibrate(
    observations: Sequence[Observation],
    arm: Arm,
    settings: KinematicSettings | None = None,
    streams: Streams | None = None,
    source: str = LIVE,
) -> Outcome[Observation, Solution]:
    """Solve for the arm's kinematics and check the result.

    Args:
        observations: in order of time. Observations from before the last homing of a link are
            left out, because homing changes the joint offsets.
        arm: the initial guess.
        settings: parametrization, standard deviations of an observation, and criteria.
        streams: events in the streams that the observations come from.
        source: name of the source of the observations.

    Raises:
        ValueError: the observations do not match the arm, or a setting is impossible.
    """
    s, streams = settings or KinematicSettings(), streams or Streams()
    comparable = keep_since_homing(observations)
    used = [o for o in comparable if o.used]
    problem = problem_of(used, arm, s)
    homings, number = checks.check_homings(observations), checks.check_number(problem, streams, s)
    if number.verdict != PASS and homings.reason:
        number = replace(number, reason=f"{number.reason}; {homings.reason}")
    found = [
        check_joint_names(streams, arm),
        homings,
        checks.check_rests(comparable, min_observations(problem, s), s),
        check_clocks(streams, s.joint_gap),
        number,
    ]
    solution = solution_of(problem, s) if number.verdict == PASS else None
    if solution:
        why = checks.misfit_causes(solution.result, solution.problem, s)
        reasons = (r and r + w for r, w in zip(solution.reasons, why, strict=True))
        solution = replace(solution, reasons=tuple(reasons))
        found += checks.evaluate(solution, s)
    return make_outcome(
        observations,
        used,
        (problem.q, problem.tip),
        arm,
        s,
        KinematicSettings,
        streams,
        source,
        found,
        estimate_of(problem, solution),
        solution,
        solution.result.calibrated if solution else None,
    )
