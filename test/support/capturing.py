"""Captures by their geometry: spin, heading and distance of the target, and a fault."""

from dataclasses import dataclass, field

import numpy as np

from fss_gnc.guidance.mission_settings import MissionSettings
from fss_gnc.navigation.settings import NavigationSettings
from fss_rehearsal.loops import capture
from fss_rehearsal.loops.faults import FaultSettings
from fss_rehearsal.loops.settings import POSTURE
from fss_sim.plant.target import Gripper
from fss_sim.settings import TestbedSettings

SETTINGS = MissionSettings()


@dataclass(frozen=True)
class Case:
    spin: float = 0.15  # of the target [rad/s]
    heading: float = -0.3
    distance: float = 1.6  # of the base from it [m]
    seed: int = 1
    drift: tuple[float, float] = (-0.006, 0.004)  # of it [m/s]
    fault: str = ""
    phase: str = ""
    lasts: float = 0.0  # of an outage [s]
    valve: int = 2  # stuck, from 0
    after: float = capture.PERIOD  # the phase's start [s]
    solid: bool = True  # bodies touch
    gripper: Gripper = field(default_factory=Gripper)


def testbed(case, target):
    at = case.distance * np.exp(1j * np.radians(-135.0))
    g = case.gripper
    return TestbedSettings(
        base=(float(at.real), float(at.imag), -1.4),
        q=POSTURE,
        encoder_error=7e-4,
        target_mass=target.mass,
        target_inertia=target.inertia,
        target_fixture=target.fixture,
        target_pose=(0.0, 0.0, case.heading),
        target_twist=(*case.drift, case.spin),
        contact=case.solid,
        grip_closing_time=g.closing_time,
        grip_force=g.force,
        grip_torque=g.torque,
    )


def Flight(case, activity=None, settings=SETTINGS, truth=None, learns=True):
    assumed = settings.target
    return capture.Flight(
        case.seed,
        testbed(case, truth or assumed),
        settings,
        NavigationSettings(target_mass=assumed.mass, target_inertia=assumed.inertia),
        None,
        FaultSettings(case.fault, case.phase, case.after, case.lasts, case.valve + 1),
        activity=activity,
        estimates_mass=learns,
    )
