"""A kind of calibration in one record: by how much the first joint is turned, from rests."""

from dataclasses import dataclass, replace

import numpy as np

from fss_arm_calib.acceptance import (
    PASS,
    check_chi_square,
    check_clocks,
    check_data_amount,
    check_joint_names,
    format_count,
)
from fss_arm_calib.calibration import Calibration
from fss_arm_calib.kinematic.kind import KINEMATIC
from fss_arm_calib.messages import common_message
from fss_arm_calib.outcome import Estimate, make_outcome
from fss_arm_calib.settings import CalibrationSettings, max_data
from fss_arm_model.kinematics import tip_in_base
from fss_arm_model.planar import wrap
from fss_arm_model.settings import POSITIVE, setting
from fss_arm_msgs import msg


@dataclass(frozen=True)
class ToySettings(CalibrationSettings):
    """What is known of the headings."""

    tip_topic: str = setting("vicon/end_effector/end_effector", "topic of the end effector")
    max_observations: int = max_data(50, "rests")
    heading_deviation: float = setting(0.01, "1 sigma of a heading", unit="rad", check=POSITIVE)


def calibrate(observations, arm, s, streams, source):
    used = [o for o in observations if o.used]
    q, seen = np.array([o.q for o in used]), np.array([o.tip for o in used])
    number = check_data_amount(
        "observations", len(used), 2, format_count(len(used), "observation"), streams
    )
    checks = [check_joint_names(streams, arm), check_clocks(streams, s.joint_gap), number]
    estimate, found = Estimate(("turn",), ("rad",), np.zeros(1)), None
    if number.verdict == PASS:
        away = wrap(seen[:, 2] - tip_in_base(arm.vector(), q)[:, 2])
        left, sigma = away - np.mean(away), s.heading_deviation
        chi_square, freedom, found = float(np.sum((left / sigma) ** 2)), len(used) - 1, away
        estimate = replace(
            estimate,
            values=np.mean(away, keepdims=True),
            covariance=np.eye(1) * sigma**2 / len(q),
            deviations=np.array([sigma / len(q) ** 0.5]),
            weights=np.ones(len(q)),
            chi_square=chi_square,
            degrees_of_freedom=freedom,
        )
        checks.append(
            check_chi_square("fit", chi_square, freedom, s.min_probability, "no mere turn")
        )

    def calibrated():
        base = replace(arm.base, mount=(*arm.base.mount[:2], arm.base.mount[2] + np.mean(away)))
        return replace(arm, base=base)

    return make_outcome(
        observations,
        used,
        (q, seen),
        arm,
        s,
        ToySettings,
        streams,
        source,
        checks,
        estimate,
        found,
        calibrated,
    )


TOY = Calibration(
    name="toy",
    about="By how much the first joint is turned.",
    settings=ToySettings,
    data=replace(KINEMATIC.data, topic="calibration/toy_rests"),
    max_data=lambda s: s.max_observations,
    inputs=KINEMATIC.inputs,
    finder=KINEMATIC.finder,
    calibrate=calibrate,
    message=msg.Calibration,
    to_message=lambda outcome, frame: common_message("toy", outcome, frame),
)
