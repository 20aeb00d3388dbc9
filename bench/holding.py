"""The base held by thrusters while the arm goes through postures, with errors of the sensors."""

from dataclasses import dataclass

import numpy as np

from fss_arm_model.description import paper_arm
from fss_arm_model.units import SECOND
from fss_base_driver.allocation import Allocation
from fss_gnc.control import PoseControl, PoseGains
from fss_gnc.navigation import Navigation
from fss_gnc.reference import Reference
from fss_sim.noise import PRESETS
from fss_sim.plant.drives import MODE_VELOCITY
from fss_sim.plant.plant import Plant
from fss_sim.plant.vehicle import Demand
from fss_sim.sensors import RATE, Sensors

PERIOD = 0.1  # of the control [s]
READING = 0.2  # from one of a joint to the next [s]


@dataclass(frozen=True)
class Motion:
    """Through postures (k, n), each within `duration`, at rest for `rest` after it [s]."""

    postures: np.ndarray
    duration: float
    rest: float = 6.0

    @property
    def end(self):
        """Duration of the whole motion [s]."""
        return (len(self.postures) - 1) * (self.duration + self.rest)

    def at(self, t):
        """Angles, rates and accelerations of the joints."""
        k = min(int(t / (self.duration + self.rest)), len(self.postures) - 2)
        r = min((t - k * (self.duration + self.rest)) / self.duration, 1.0)
        way, T = self.postures[k + 1] - self.postures[k], self.duration
        shape = 10 * r**3 - 15 * r**4 + 6 * r**5, 30 * r**2 - 60 * r**3 + 30 * r**4
        bend = 60 * r - 180 * r**2 + 120 * r**3
        return self.postures[k] + way * shape[0], way / T * shape[1], way / T**2 * bend


@dataclass(frozen=True)
class Held:
    """How well it was."""

    offset: np.ndarray  # (m, 3) of the base from its pose [m, m, rad]
    propellant: float  # [kg]

    @property
    def farthest(self):
        """[m]."""
        return float(np.hypot(*self.offset[:, :2].T).max())

    @property
    def most_turned(self):
        """[deg]."""
        return float(np.degrees(np.abs(self.offset[:, 2]).max()))


def hold(motion, feed_forward, seed=0, gains=None):
    """Run it."""
    arm = paper_arm()
    begin = np.zeros(3)
    plant = Plant(arm, np.concatenate([begin, motion.postures[0]]))
    propulsion, valves = plant.world.propulsion, plant.thrusters.layout
    allocation = Allocation(valves, PERIOD, propulsion.minimum_on_time)
    control = PoseControl(arm, gains or PoseGains())
    navigation = Navigation(arm)
    sensors, off = Sensors(PRESETS["default"], seed), []
    for frame in range(round(motion.end * RATE)):
        now, t = round(frame / RATE * SECOND), frame / RATE
        q_m, qd_m, _ = motion.at(t)
        for i, rate in enumerate(qd_m + 2.0 * (q_m - plant.q[3:])):
            plant.command(i, Demand(MODE_VELOCITY, float(rate), abs(float(rate)), 2.0))
        seen = sensors.observe(frame, plant.base, plant.tip, float(plant.qd[2]), plant.qd[3:])
        if frame % round(READING * RATE) == 0:
            for i in range(arm.n):
                navigation.add_joint_reading(i, now, float(plant.q[3 + i]), float(plant.qd[3 + i]))
        if frame % round(PERIOD * RATE) == 0:
            ahead = 0.1 * np.arange(6)
            rates = np.array([motion.at(now / SECOND + s)[1] for s in ahead])
            navigation.inputs.set_plan(now, ahead, rates)
        navigation.base.update_rate(now, seen.rate)
        navigation.base.update_pose(now, *seen.base.pose)
        if frame % round(PERIOD * RATE) == 0:
            base = navigation.base.state().extrapolate_to(now)
            q = np.concatenate([base.pose, plant.q[3:]])
            qd = np.concatenate([base.twist, plant.qd[3:]])
            qdd_m = motion.at(t + 0.5 * PERIOD)[2]
            known = qdd_m if feed_forward else None
            wrench = control.wrench(q, qd, Reference.at_rest(begin), PERIOD, known)
            on_times = allocation.on_times(wrench)
            plant.thrust(on_times)
            navigation.add_pulses(now, on_times)
        plant.advance(1.0 / RATE)
        off.append(plant.q[:3].copy())
    return Held(np.array(off), plant.thrusters.propellant_used)
