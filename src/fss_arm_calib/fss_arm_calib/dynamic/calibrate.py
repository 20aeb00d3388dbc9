"""Dynamic calibration from maneuvers: the solution and its checks."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from fss_arm_calib.acceptance import PASS, check_clocks, check_joint_names
from fss_arm_calib.dynamic import checks
from fss_arm_calib.dynamic.settings import DynamicSettings
from fss_arm_calib.dynamic.solution import Solution, estimate_of, problem_of, solution_of
from fss_arm_calib.outcome import LIVE, Outcome, make_outcome
from fss_arm_calib.segments.maneuvers import Maneuver
from fss_arm_calib.segments.streams import Streams
from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm


def calibrate(
    maneuvers: Sequence[Maneuver],
    arm: Arm,
    settings: DynamicSettings | None = None,
    streams: Streams | None = None,
    source: str = LIVE,
) -> Outcome[Maneuver, Solution]:
    """Solve for the arm's dynamics and check the result.

    Args:
        maneuvers: in order of time.
        arm: the initial guess, and the values of assumed parameters.
        settings: parameters to estimate, prior knowledge, and criteria.
        streams: events in the streams that the maneuvers come from.
        source: name of the source of the maneuvers.

    Raises:
        ValueError: the maneuvers do not match the arm, or a setting is impossible.
    """
    s, streams = settings or DynamicSettings(), streams or Streams()
    used = [one for one in maneuvers if one.used]
    number = checks.check_number(maneuvers, streams, s)
    found = [check_joint_names(streams, arm), check_clocks(streams, s.joint_gap), number]
    found.append(checks.check_gyro(streams))
    found += checks.check_tips(used, arm, s)
    solution = solution_of(problem_of(used, arm, s), s) if number.verdict == PASS else None
    found += checks.evaluate(solution, s) if solution else []
    return make_outcome(
        maneuvers,
        used,
        [array for one in used for array in _arrays(one)],
        arm,
        s,
        DynamicSettings,
        streams,
        source,
        found,
        estimate_of(arm, s, used, solution),
        solution,
        solution.result.calibrated if solution else None,
    )


def _arrays(one: Maneuver) -> list[npt.NDArray[np.int64] | Floats]:
    flat = [np.concatenate(part) for part in (one.times, one.q, one.qd)]
    rest = (one.marks, one.poses, one.frames, one.seconds, one.tip)
    return [*flat, *map(np.array, rest)]
