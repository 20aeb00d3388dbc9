"""Dynamic calibration as a calibration kind: topics, messages and record."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from fss_arm_calib.calibration import Calibration, Data, Input
from fss_arm_calib.dynamic.calibrate import calibrate
from fss_arm_calib.dynamic.measurements import measurements
from fss_arm_calib.dynamic.report import dynamic_report
from fss_arm_calib.dynamic.settings import DynamicSettings
from fss_arm_calib.dynamic.solution import Solution
from fss_arm_calib.messages import (
    common_message,
    flatten,
    joints_input,
    poses_input,
    rates_input,
    reshape_rows,
    set_header,
    telemetry_inputs,
)
from fss_arm_calib.outcome import Outcome
from fss_arm_calib.segments.maneuvers import Maneuver, ManeuverFinder
from fss_arm_calib.segments.poses import BASE, TIP
from fss_arm_msgs import msg
from fss_arm_ros.convert import stamp_ns, to_time


def inputs(s: DynamicSettings, n: int) -> list[Input]:
    """Return the inputs: joints and base; gyro, end effector and telemetry may be absent."""
    return [
        *telemetry_inputs(n),
        joints_input(s.joints_topic),
        rates_input(s.gyro_topic),
        poses_input(s.tip_topic, TIP, needed=False),
        poses_input(s.base_topic, BASE),
    ]


def to_message(outcome: Outcome[Maneuver, Solution], frame_id: str) -> msg.DynamicCalibration:
    """Convert the outcome to the message that is published."""
    message, found = msg.DynamicCalibration(), outcome.solution
    message.calibration = common_message("dynamic", outcome, frame_id)
    if not found:
        return message
    r = found.result
    message.random_covariance = flatten(r.random)
    message.known = flatten(r.problem.prior_deviations)
    message.prior_share = flatten(r.prior_share)
    message.at_bound = list(r.at_bound)
    message.assumed = list(r.assumed_names)
    message.assumed_deviations = flatten(r.assumed_deviations)
    message.bias = flatten(r.bias)
    message.combinations = [c.name for c in found.combinations]
    message.combination_units = [c.unit for c in found.combinations]
    message.combination_values = [c.value for c in found.combinations]
    message.combination_before = [c.before for c in found.combinations]
    message.combination_deviations = [c.deviation for c in found.combinations]
    message.directions = [d.text(outcome.names) for d in found.directions]
    message.direction_kinds = [d.kind for d in found.directions]
    message.direction_gains = [d.gain for d in found.directions]
    message.momenta = flatten(found.momenta)
    return message


def maneuvers_message(maneuvers: Sequence[Maneuver], frame_id: str) -> msg.Maneuvers:
    """Convert all maneuvers to the message that is published."""
    ones = [
        msg.Maneuver(
            start=to_time(m.start),
            end=to_time(m.end),
            samples=[len(times) for times in m.times],
            times=flatten(m.times),
            q=flatten(m.q),
            qd=flatten(m.qd),
            marks=list(m.marks),
            poses=flatten(m.poses),
            frames=list(m.frames),
            seconds=list(m.seconds),
            time_offset=m.time_offset,
            used=m.used,
            reason=m.reason,
            tip=list(m.tip),
        )
        for m in maneuvers
    ]
    return set_header(msg.Maneuvers(maneuvers=ones), ones, frame_id)


def maneuvers_from_message(message: msg.Maneuvers) -> list[Maneuver]:
    """Return the maneuvers in a message."""

    def of_joints(one: msg.Maneuver, numbers: Any) -> tuple[tuple[float, ...], ...]:
        edges = pairwise(np.cumsum([0, *one.samples]))
        return tuple(tuple(map(float, numbers[a:b])) for a, b in edges)

    return [
        Maneuver(
            start=stamp_ns(one.start),
            end=stamp_ns(one.end),
            times=of_joints(one, one.times),
            q=of_joints(one, one.q),
            qd=of_joints(one, one.qd),
            marks=tuple(map(float, one.marks)),
            poses=reshape_rows(one.poses, 3),
            frames=tuple(map(int, one.frames)),
            seconds=tuple(map(float, one.seconds)),
            tip=tuple(map(float, one.tip)),
            time_offset=float(one.time_offset),
            used=bool(one.used),
            reason=one.reason,
        )
        for one in message.maneuvers
    ]


DYNAMIC = Calibration(
    name="dynamic",
    about=DynamicSettings.ABOUT,
    settings=DynamicSettings,
    data=Data(
        "maneuver", Maneuver, "calibration/maneuvers", maneuvers_message, maneuvers_from_message,
        lambda one: f"joints {list(one.moved_joints)} moved",
    ),
    max_data=lambda s: s.max_maneuvers,
    inputs=inputs,
    finder=lambda arm, s, _: ManeuverFinder(arm.n, s),
    calibrate=calibrate,
    measurements=measurements,
    message=msg.DynamicCalibration,
    to_message=to_message,
    compared_fields=("combination_values", "momenta"),
    report=dynamic_report,
    prior_results={"calibration/kinematic": msg.KinematicCalibration},
)  # fmt: skip
