"""The base held by thrusters while the arm moves through postures, without ROS."""

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from fss_arm_calib.experiment.postures import default_postures
from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_model.description_file import described
from fss_arm_model.settings import NOT_NEGATIVE, POSITIVE, Settings, at_least, setting
from fss_arm_model.units import SECOND
from fss_base_driver.allocation import Allocation
from fss_gnc.control import PoseControl
from fss_gnc.control.settings import ControlSettings
from fss_gnc.navigation import Navigation
from fss_gnc.navigation.settings import NavigationSettings
from fss_gnc.reference import Reference
from fss_rehearsal.loops.capture import marker_free_noise
from fss_rehearsal.loops.parameters import ArmValues, Without
from fss_rehearsal.loops.settings import (
    CONTROL,
    NAVIGATION,
    NO_VALUES,
    WITHOUT_ELECTRONICS,
    WITHOUT_TOPICS,
)
from fss_sim.plant.drives import MODE_VELOCITY
from fss_sim.plant.plant import Plant
from fss_sim.plant.vehicle import Demand
from fss_sim.sensors import RATE, Sensors
from fss_sim.settings import TestbedSettings

PERIOD = 0.1  # of the control [s]
READING_PERIOD = 0.2  # of the joints' readings [s]
FEEDBACK = 2.0  # rate per error of a joint's angle [1/s]
MAX_OFFSET, MAX_TURN = 0.01, np.radians(1.0)  # of a successful run [m], [rad]


#: Parameters of navigation and control that have an effect without topics and without a target.
NavigationWithoutTarget = Annotated[
    NavigationSettings,
    WITHOUT_TOPICS,
    Without("target_*", "mass_error", "com_error", "momentum_walk"),
]
ControlWithoutTarget = Annotated[
    ControlSettings,
    Without("rate", "timeout", "max_age", "table", "full_tank", "target_*", "base_frame"),
]


@dataclass(frozen=True)
class MotionSettings(Settings):
    """Motion of the arm."""

    postures: int = setting(13, "number of postures after the first one", check=at_least(1))
    duration: float = setting(120.0, "duration of each move", unit="s", check=POSITIVE)
    rest: float = setting(6.0, "time at rest after each move", unit="s", check=NOT_NEGATIVE)

    def path(self, arm: Arm) -> Floats:
        """Return the stretched posture and the following ones, (postures + 1, n) [rad]."""
        postures = default_postures(arm)
        return np.vstack([np.zeros(arm.n), postures])[: self.postures + 1]


TESTBED, MOTION = TestbedSettings(), MotionSettings()


@dataclass(frozen=True)
class Motion:
    """Motion through postures (k, n) [rad], at rest after each one."""

    postures: Floats
    duration: float  # [s]
    rest: float = 6.0  # [s]

    @property
    def end(self) -> float:
        """Duration of the whole motion [s]."""
        return (len(self.postures) - 1) * (self.duration + self.rest)

    def at(self, t: float) -> tuple[Floats, Floats, Floats]:
        """Return angles, rates and accelerations of the joints, (n,) each."""
        k = min(int(t / (self.duration + self.rest)), len(self.postures) - 2)
        r = min((t - k * (self.duration + self.rest)) / self.duration, 1.0)
        way, T = self.postures[k + 1] - self.postures[k], self.duration
        shape = 10 * r**3 - 15 * r**4 + 6 * r**5, 30 * r**2 - 60 * r**3 + 30 * r**4
        bend = 60 * r - 180 * r**2 + 120 * r**3
        return self.postures[k] + way * shape[0], way / T * shape[1], way / T**2 * bend


@dataclass(frozen=True)
class Held:
    """Motion of the base while it was held."""

    offset: Floats  # (m, 3) offset of the base from its pose [m, m, rad]
    propellant: float  # [kg]

    @property
    def max_offset(self) -> float:
        """Largest distance from the pose [m]."""
        return float(np.hypot(*self.offset[:, :2].T).max())

    @property
    def max_turn(self) -> float:
        """Largest heading error [rad]."""
        return float(np.abs(self.offset[:, 2]).max())


def hold_base(
    motion: Motion,
    seed: int,
    testbed: TestbedSettings = TESTBED,
    navigation: NavigationSettings = NAVIGATION,
    control: ControlSettings = CONTROL,
    values: ArmValues = NO_VALUES,
) -> Held:
    """Hold the base during a motion of the arm."""
    s, arm = navigation, values.apply(described(testbed.arm))
    start = np.array(testbed.base)
    plant = Plant(arm, np.concatenate([start, motion.postures[0]]), None, testbed.world())
    valves, min_on_time = plant.thrusters.layout, plant.world.propulsion.minimum_on_time
    allocation = Allocation(valves, PERIOD, min_on_time)
    controller, filters = (
        PoseControl(described(control.arm), control),
        Navigation(described(s.arm), s),
    )
    sensors, offset = Sensors(marker_free_noise(testbed), seed), []
    for frame in range(round(motion.end * RATE)):
        now, t = round(frame / RATE * SECOND), frame / RATE
        q_m, qd_m, _ = motion.at(t)
        for i, rate in enumerate(qd_m + FEEDBACK * (q_m - plant.q[3:])):
            plant.command(i, Demand(int(MODE_VELOCITY), float(rate), abs(float(rate)), 2.0))
        readings = sensors.observe(frame, plant.base, plant.tip, float(plant.qd[2]), plant.qd[3:])
        if frame % round(READING_PERIOD * RATE) == 0:
            for i in range(arm.n):
                filters.add_joint_reading(i, now, float(plant.q[3 + i]), float(plant.qd[3 + i]))
        if frame % round(PERIOD * RATE) == 0:
            ahead = 0.1 * np.arange(6.0)
            rates = np.array([motion.at(now / SECOND + s)[1] for s in ahead])
            filters.inputs.set_plan(now, ahead, rates)
        if readings.rate is not None:
            filters.base.update_rate(now, readings.rate)
        if readings.base:
            filters.base.update_pose(now, *readings.base.pose)
        if frame % round(PERIOD * RATE) == 0:
            base = filters.base.state().extrapolate_to(now)
            q = np.concatenate([base.pose, plant.q[3:]])
            qd = np.concatenate([base.twist, plant.qd[3:]])
            planned = motion.at(t + 0.5 * PERIOD)[2] if control.feed_forward else None
            wrench = controller.wrench(q, qd, Reference.at_rest(start), PERIOD, planned)
            on_times = allocation.on_times(wrench)
            plant.thrust(on_times.tolist())
            filters.add_pulses(now, on_times)
        plant.advance(1.0 / RATE)
        offset.append(plant.q[:3] - start)
    return Held(np.array(offset), plant.thrusters.propellant_used)


def hold(
    seed: int,
    testbed: Annotated[
        TestbedSettings,
        WITHOUT_ELECTRONICS,
        Without("q", "target_*", "grip*", "contact*", "restitution", "encoder_error"),
    ] = TESTBED,
    navigation: NavigationWithoutTarget = NAVIGATION,
    control: ControlWithoutTarget = CONTROL,
    motion: MotionSettings = MOTION,
    arm: ArmValues = NO_VALUES,
) -> dict[str, Any]:
    """Hold the base; it succeeds if it stays within 1 cm and 1 degree."""
    moves = Motion(motion.path(described(testbed.arm)), motion.duration, motion.rest)
    held = hold_base(moves, seed, testbed, navigation, control, arm)
    return outcome(held.max_offset, held.max_turn, held.propellant)


def outcome(offset: float, turn: float, propellant: float) -> dict[str, Any]:
    """Return the row of a hold.

    Args:
        offset: largest distance of the base from its pose [m].
        turn: largest heading error [rad].
        propellant: used [kg].
    """
    excess = []
    if offset >= MAX_OFFSET:
        excess.append(f"offset {offset:.3f} m, at most {MAX_OFFSET:g} m")
    if turn >= MAX_TURN:
        excess.append(f"turn {np.degrees(turn):.1f} deg, at most {np.degrees(MAX_TURN):g} deg")
    return {
        "success": not excess,
        "reason": ", ".join(excess),
        "offset": offset,
        "turn": turn,
        "propellant": propellant,
    }
