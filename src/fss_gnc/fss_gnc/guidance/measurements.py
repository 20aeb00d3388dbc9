"""Newest states that the guidance has received, and what is known of them at one time."""

from typing import Any

import numpy as np

from fss_arm_model.arrays import Floats
from fss_arm_model.units import SECOND
from fss_gnc.guidance.activity import HeldBody, Observation
from fss_gnc.guidance.other_vehicles import OtherVehicle
from fss_gnc.latest import Latest, body_at
from fss_gnc.reference import Body

STALE_AFTER = 2.0  # age after which the state of gripper and tank is unknown [s]
STALL_REPORT_TIME = 0.3  # time for which a report of control counts, which it repeats [s]


class Measurements:
    """Newest states of base, target, joints, gripper, tank and valves.

    Args:
        n: number of joints.
        max_age: largest age of the states of base, target and joints [s].
    """

    def __init__(self, n: int, max_age: float) -> None:
        self.n = n
        self.base = Latest[Body]("base/state", max_age)
        self.target = Latest[Body]("target/state", max_age)
        self.joints = Latest[Floats]("arm/joint_states", max_age)  # (3, n) q, qd, effort
        self.holds = Latest[bool]("gripper/state", STALE_AFTER)
        self.propellant = Latest[float]("base/propellant", STALE_AFTER)  # left [kg]
        self.armed = Latest[bool]("base/telemetry", STALE_AFTER)
        self.stall = Latest[str]("control/stall", STALL_REPORT_TIME)
        self.held_body: HeldBody | None = None  # as estimated by the navigation
        self.open_valves: tuple[int, ...] = ()  # valves that do not close, from 1
        self.unknown_push = False

    def set_gripper(self, now: int, holds: bool) -> None:
        """Store at `now` [ns] whether the gripper holds the target."""
        self.holds.store(now, holds)
        self.held_body = self.held_body if holds else None

    def problem(self, now: int) -> str:
        """Return why base or joints are unknown at `now` [ns]; empty if both are known."""
        return self.base.problem(now) or self.joints.problem(now)

    def observe(
        self, now: int, start_time: int, others: tuple[OtherVehicle, ...] = ()
    ) -> Observation:
        """Return what is known at `now` [ns]: base, target and joints are extrapolated to it.

        Args:
            now: present time [ns].
            start_time: start of the activity [ns].
            others: the other vehicles now.
        """
        joints, propellant = self.joints.valid_value(now), self.propellant.valid_value(now)
        states: tuple[Latest[Any], ...] = self.base, self.joints, self.target
        q, qd, effort = (None,) * 3 if joints is None else joints
        if q is not None and qd is not None:
            q = q + self.joints.age(now) * qd
        return Observation(
            (now - start_time) / SECOND,
            body_at(self.base, now),
            body_at(self.target, now),
            q,
            qd,
            effort,
            self.holds.valid_value(now),
            np.nan if propellant is None else propellant,
            last_q=None if self.joints.value is None else self.joints.value[0],
            joints_age=self.joints.age(now),
            held_body=self.held_body,
            open_valves=self.open_valves,
            unknown_push=self.unknown_push,
            armed=self.armed.valid_value(now),
            stall=self.stall.valid_value(now) or "",
            others=others,
            unknown=tuple(filter(None, (x.problem(now) for x in states))),
        )
