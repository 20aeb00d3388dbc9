"""A mission flown on the plant with the errors of the sensors: navigation, control, guidance."""

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from fss_arm_model.clearance import gaps, links_and_base, sizes, with_edge, with_target
from fss_arm_model.description import paper_arm
from fss_arm_model.momentum import momentum
from fss_arm_model.units import SECOND
from fss_base_driver.allocation import Allocation
from fss_gnc.control import PoseControl
from fss_gnc.guidance.activity import ActivityError, Body, Commands, Craft, Observation, Outcome
from fss_gnc.guidance.capture import Capture
from fss_gnc.guidance.mission_settings import MissionSettings
from fss_gnc.navigation.navigation import Navigation
from fss_sim.noise import PRESETS
from fss_sim.plant.contact import Contact
from fss_sim.plant.drives import MODE_OFF, MODE_VELOCITY
from fss_sim.plant.plant import Plant
from fss_sim.plant.target import Gripper
from fss_sim.plant.vehicle import Demand, World
from fss_sim.sensors import RATE, Sensors

PERIOD = 0.1  # of guidance and control [s]
FRAMES = round(PERIOD * RATE)
LOOK = 4  # frames from one look of the navigation to the next
TOLD = 5  # frames from one reading of the joints to the next
HEARD, LATE = 4, 10  # frames until a reading is heard, and until a command is obeyed
AFTER = 30.0  # for which it is looked at what comes of a failure [s]
DEPTH = 0.04  # that the gripper may reach into the target's disc: its own reach, and a little [m]
POSTURE = 0.95, 1.3, 1.36, -1.23
SETTINGS = MissionSettings()


@dataclass(frozen=True)
class Case:
    """What is flown."""

    spin: float = 0.15  # of the target [rad/s]
    heading: float = -0.3
    distance: float = 1.6  # of the base from it [m]
    seed: int = 1
    drift: tuple[float, float] = (-0.006, 0.004)  # of it [m/s]
    fault: str = ""  # outage, open, closed, gyro, link, gripper
    phase: str = ""  # in which it happens
    lasts: float = 0.0  # of an outage [s]
    valve: int = 2  # that stays open or closed, from 0
    after: float = PERIOD  # the phase's begin [s]
    solid: bool = True  # whether bodies keep each other out
    gripper: Gripper = field(default_factory=Gripper)


@dataclass
class Flown:
    """What came of it."""

    case: Case
    phases: list[str] = field(default_factory=list)
    message: str = ""
    well: bool = False
    captured: bool = False
    time: float = 0.0  # [s]
    grip: float = np.nan  # when [s]
    propellant: float = 0.0  # [kg]
    torque: float = 0.0  # largest at a joint [N m]
    momentum: float = np.nan  # angular, at the grip [N m s]
    contact: str = ""  # of what with what; empty: none
    edge: float = np.inf  # least [m]
    spin: float = 0.0  # of the target at the end [rad/s]
    wall: float = 0.0  # [s]

    @property
    def safe(self):
        return not self.contact


class Flight:
    """One run."""

    def __init__(self, case, activity=None, settings=SETTINGS, truth=None):
        self.case, self.settings = case, settings
        self.arm = arm = paper_arm()
        side = np.exp(1j * np.radians(-135.0))
        centre = 0j
        at = centre + case.distance * side
        q = np.array([at.real, at.imag, -1.4, *POSTURE])
        target = [[centre.real, centre.imag, case.heading], [*case.drift, case.spin]]
        contact = Contact() if case.solid else None
        world = World(gripper=case.gripper, target=truth or settings.target, contact=contact)
        self.plant = Plant(arm, q, None, world, target)
        self.craft = Craft(arm, settings)
        self.activity = activity or Capture(self.craft)
        propulsion, self.valves = self.plant.world.propulsion, self.plant.thrusters.layout
        self.least = propulsion.minimum_on_time
        self.allocation = Allocation(self.valves, PERIOD, self.least)
        self.control = PoseControl(arm)
        self.navigation = Navigation(arm, body=settings.target)
        self.measured = None  # mass properties of what is held
        self.faults = []  # of valves: times, and those known then
        self.sensors = Sensors(PRESETS["default"], case.seed)
        rng = np.random.default_rng(case.seed)
        self.encoders = rng.uniform(-7e-4, 7e-4, arm.n)
        self.joints, self.demands = deque(), deque()
        self.heard = None  # of the joints: angles, rates, torques, when [s]
        self.frame, self.faulted = 0, np.inf
        self.last_near = 0.0  # when the gripper was at the fixture last [s]
        self.flown = Flown(case)
        self.film: list[tuple[float, np.ndarray, np.ndarray]] = []  # time, q, target's pose
        self.around = sizes(settings, settings.target_radius, settings.gripper_length)

    @property
    def t(self):
        return self.frame / RATE

    def struck(self, kind):
        """Whether this has failed now."""
        since = self.t - self.faulted
        lasts = self.case.lasts or np.inf
        return self.case.fault == kind and 0.0 <= since < lasts

    def fly(self, longest=600.0):
        """To its end, and what comes of it."""
        flown, orders = self.flown, None
        while self.t < longest:
            orders = self.order()
            if orders.phase not in flown.phases:
                flown.phases.append(orders.phase)
                if orders.phase == self.case.phase and np.isinf(self.faulted):
                    self.faulted = self.t + self.case.after
            if orders.outcome:
                break
            self.obey(orders)
            self.pass_time()
        flown.time, flown.propellant = self.t, self.plant.thrusters.propellant_used
        outcome = orders.outcome or Outcome(False, "it took too long")
        flown.well, flown.message = outcome.success, outcome.message
        flown.spin = float(self.plant.target[1, 2])
        if not flown.well or self.case.fault:
            until = self.t + AFTER
            while self.t < until:
                self.obey(Commands("idle", rates=np.zeros(self.arm.n)))
                self.pass_time()
        return flown

    def seen(self):
        now = round(self.t * SECOND)
        known = []
        for body in (self.navigation.base, self.navigation.target):
            if not body.events or body.lost_reason(now):
                known.append(None)
                continue
            state = body.state().extrapolate_to(now)
            known.append(Body(state.pose, state.twist))
        q = qd = effort = None
        if self.heard and not self.struck("link"):
            q, qd, effort, then = self.heard
            q = q + (self.t - then) * qd
        left = self.plant.thrusters.capacity - self.plant.thrusters.propellant_used
        last = self.heard[0] if self.heard else None
        held = self.measured if self.plant.holds else None
        holds = None if self.struck("gripper") else self.plant.holds
        faults = self.navigation.valves.faults
        open_valves = tuple(sorted(i + 1 for i in faults.open))
        return Observation(
            self.t, *known, q, qd, effort, holds, left, last, held, open_valves, faults.unknown_push
        )  # fmt: skip

    def order(self):
        self.now = seen = self.seen()
        try:
            return self.activity.step(seen)
        except ActivityError as error:
            return Commands("abort", outcome=Outcome(False, str(error)))

    def obey(self, orders):
        """Base by control and valves, joints late, gripper at once."""
        seen, times = self.now, np.zeros(len(self.valves))
        if orders.path is not None and seen.base is not None and seen.last_q is not None:
            q_m = seen.last_q if seen.q is None else seen.q
            qd_m = np.zeros(self.arm.n) if seen.qd is None else seen.qd
            q, qd = np.concatenate([seen.base.pose, q_m]), np.concatenate([seen.base.twist, qd_m])
            self.control.p = self.navigation.inputs.p
            wrench = self.control.wrench(
                q, qd, orders.path.at(self.t), PERIOD, np.zeros(self.arm.n)
            )
            times = self.allocation.on_times(wrench)
        self.command(times)
        if orders.close_gripper is not None and not self.struck("gripper"):
            self.plant.closed = bool(orders.close_gripper)
        if orders.rates is not None:
            self.demands.append((self.frame + LATE, orders.rates))

    def command(self, times):
        self.navigation.add_pulses(round(self.t * SECOND), times)
        times = np.array(times)
        if self.struck("open"):
            times[self.case.valve] = 2.0 * PERIOD
        elif self.struck("closed"):
            times[self.case.valve] = 0.0
        self.plant.thrust(times)

    def pass_time(self):
        """A period."""
        for _ in range(FRAMES):
            while self.demands and self.demands[0][0] <= self.frame:
                _, rates = self.demands.popleft()
                for i, rate in enumerate(rates):
                    demand = Demand(MODE_VELOCITY, float(rate), abs(float(rate)), 2.0)
                    lost = self.struck("link") and i == 1
                    self.plant.command(i, Demand(MODE_OFF) if lost else demand)
            self.plant.advance(1.0 / RATE)
            self.frame += 1
            self.look()
        self.judge()

    def look(self):
        plant = self.plant
        for names in plant.bed.contact_impulses:
            if names != ("gripper", "target") and not self.flown.contact:
                self.flown.contact = f"{' with '.join(names)} at {self.t:.1f} s"
        effort = plant._torques[:, 1]
        self.flown.torque = max(self.flown.torque, float(np.abs(effort).max()))
        now = round(self.t * SECOND)
        if self.frame % TOLD == 0:
            reading = plant.q[3:] + self.encoders, plant.qd[3:].copy(), effort.copy(), self.t
            self.joints.append((self.frame + HEARD, reading))
        if self.joints and self.joints[0][0] <= self.frame and not self.struck("link"):
            self.heard = self.joints.popleft()[1]
            q, qd, _, then = self.heard
            for i in range(self.arm.n):
                self.navigation.add_joint_reading(
                    i, round(then * SECOND), float(q[i]), float(qd[i])
                )
        if self.frame % LOOK:
            return
        sight = self.sensors.observe(
            self.frame, plant.base, plant.tip, float(plant.qd[2]), plant.qd[3:],
            target=plant.target[0].tolist(),
        )  # fmt: skip
        if not self.struck("gyro"):
            self.navigation.base.update_rate(now, sight.rate)
        if not self.struck("outage"):
            self.navigation.base.update_pose(now, *sight.base.pose)
            self.navigation.update_target_pose(now, *sight.target.pose)
        self.navigation.set_gripper(plant.holds)
        self.navigation.predict(now)
        if faults := self.navigation.detect_valve_faults(now):
            self.allocation = Allocation(
                self.valves, PERIOD, self.least, faults.open, faults.closed
            )
            self.faults.append((self.t, faults))
            self.measured = None
        if found := self.navigation.estimate_mass(now):
            self.measured = found.as_held_body

    def judge(self):
        """Who touches whom."""
        self.film.append((self.t, self.plant.q.copy(), self.plant.target[0].copy()))
        plant, flown, n = self.plant, self.flown, self.arm.n
        p, q = self.arm.vector(), plant.q
        edge = float(gaps(p, q, list(with_edge(n)), self.around).min())
        flown.edge = min(flown.edge, edge)
        own = float(gaps(p, q, list(links_and_base(n)), self.around).min())
        pairs = list(with_target(n))
        apart = gaps(p, q, pairs, self.around, plant.target[0, :2])
        apart[-1] += DEPTH
        if plant.holds:
            apart[-2:] = np.inf
            if not flown.captured:
                flown.captured, flown.grip = True, self.t
                flown.momentum = float(momentum(plant._p, plant.q, plant.qd)[2])
        if plant.approach.distance < 0.05:
            self.last_near = self.t
        half = 2.0 - 0.19
        out = np.abs(plant.target[0, :2]).max() > half and plant.holds
        for name, gap in (("edge", edge), ("itself", own), ("target", float(apart.min()))):
            if gap < 0.0 and not flown.contact:
                flown.contact = f"{name} at {self.t:.1f} s ({flown.phases[-1]})"
        if out and not flown.contact:
            flown.contact = f"held target with edge at {self.t:.1f} s"
