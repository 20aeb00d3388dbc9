"""Drift calibration: solution, checks, and parameters for other nodes."""

from collections.abc import Sequence

import numpy as np
import yaml

from fss_arm_calib.acceptance import PASS, check_clocks, check_joint_names
from fss_arm_calib.drift import checks
from fss_arm_calib.drift.settings import DriftSettings
from fss_arm_calib.drift.solution import Solution, estimate_of, solution_of
from fss_arm_calib.outcome import LIVE, Outcome, make_outcome
from fss_arm_calib.segments.drifts import Drift
from fss_arm_calib.segments.streams import Streams
from fss_arm_model.description import Arm
from fss_arm_model.units import GRAVITY


def calibrate(
    drifts: Sequence[Drift],
    arm: Arm,
    settings: DriftSettings | None = None,
    streams: Streams | None = None,
    source: str = LIVE,
) -> Outcome[Drift, Solution]:
    """Solve for the external forces and torques on the base, and check the result.

    Even very short drifts are solved. The standard deviations are then large.

    Args:
        drifts: in order of time.
        arm: arm with the masses and inertias that move.
        settings: prior knowledge and criteria.
        streams: events in the streams that the drifts come from.
        source: name of the source of the drifts.
    """
    s, streams = settings or DriftSettings(), streams or Streams()
    used, known = [one for one in drifts if one.used], check_joint_names(streams, arm)
    found = [known, check_clocks(streams, s.joint_gap), checks.check_time(used, streams, s)]
    solution = solution_of(used, arm, s) if used and known.verdict == PASS else None
    found += checks.evaluate(solution, s) if solution else []
    parts = [(one.q, one.times, one.poses, one.frames, one.seconds) for one in used]
    return make_outcome(
        drifts,
        used,
        [np.array(part) for one in parts for part in one],
        arm,
        s,
        DriftSettings,
        streams,
        source,
        found,
        estimate_of(used, solution),
        solution,
    )


def parameters(outcome: Outcome[Drift, Solution]) -> str:
    """Return parameters for `dynamic` and `base_reaction`, as a ROS parameter file.

    `dynamic` treats tilt and momentum as unknown, with the deviations found here. `base_reaction`
    subtracts the tilt and treats its deviation as uncertainty.
    """
    if outcome.solution is None:
        raise ValueError("no solution: the external forces on the base are unknown")
    g, deviation = outcome.values[:2], outcome.deviations[:2]
    tilt = float(np.sqrt(np.max(g**2 + deviation**2))) / GRAVITY
    momenta, deviations = outcome.solution.result.momenta
    squares = np.mean(momenta**2 + deviations**2, axis=0)
    found = {
        "dynamic": {
            "tilt_deviation": tilt,
            "momentum_deviation": float(np.sqrt(squares[:2].max())),
            "spin_deviation": float(np.sqrt(squares[2])),
        },
        "base_reaction": {
            "tilt": [float(x) / GRAVITY for x in g],
            "tilt_deviation": float(deviation.max()) / GRAVITY,
        },
    }
    nodes = {node: {"ros__parameters": values} for node, values in found.items()}
    origin = f"# From {outcome.provenance.source}: {outcome.reason}\n"
    return origin + yaml.safe_dump(nodes, sort_keys=False)
