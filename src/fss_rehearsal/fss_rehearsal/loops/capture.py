"""A capture mission without ROS: plant, sensors' errors, navigation, control and guidance.

Navigation runs at 25 Hz, guidance and control at 10 Hz. Readings of the joints are 40 to 90 ms old,
and commands to them take effect 0.1 s late.
"""

from collections import deque
from dataclasses import asdict, dataclass, field
from functools import partial
from math import cos, inf, nan, sin
from typing import Annotated, Any

import numpy as np

from fss_arm_driver.arm.stream import Ramp
from fss_arm_model.arrays import Floats
from fss_arm_model.clearance import gaps, links_and_base, sizes, with_edge, with_target
from fss_arm_model.description_file import described
from fss_arm_model.held import combined_momentum
from fss_arm_model.kinematics import joint_positions, tip_pose
from fss_arm_model.momentum import momentum
from fss_arm_model.settings import SettingError
from fss_arm_model.units import SECOND
from fss_base_driver.allocation import Allocation
from fss_gnc.control import PoseControl
from fss_gnc.control.settings import ControlSettings
from fss_gnc.guidance.activity import (
    Activity,
    ActivityError,
    Commands,
    Craft,
    Observation,
    Outcome,
)
from fss_gnc.guidance.capture import Capture
from fss_gnc.guidance.mission_settings import MissionSettings
from fss_gnc.navigation.body_filter import BodyFilter
from fss_gnc.navigation.navigation import Navigation
from fss_gnc.navigation.settings import NavigationSettings
from fss_gnc.reference import Body
from fss_rehearsal.loops.faults import LOST_LINK, FaultSettings
from fss_rehearsal.loops.parameters import ArmValues, Without
from fss_rehearsal.loops.settings import (
    CONTROL,
    GUIDANCE,
    NAVIGATION,
    NO_VALUES,
    TESTBED,
    WITHOUT_ELECTRONICS,
    WITHOUT_TOPICS,
)
from fss_sim.noise import Noise
from fss_sim.plant.drives import MODE_OFF, MODE_VELOCITY
from fss_sim.plant.plant import Plant
from fss_sim.plant.vehicle import Demand
from fss_sim.sensors import RATE, Sensors
from fss_sim.settings import TestbedSettings

PERIOD = 0.1  # of guidance and control [s]
FRAMES = round(PERIOD * RATE)
FRAMES_PER_ESTIMATE = 4  # frames from one update of the navigation to the next
FRAMES_PER_READING = 5  # frames from one reading of the joints to the next
READING_DELAY, COMMAND_DELAY = 4, 10  # age of readings and commands of joints [frames]
TIMEOUT = 600.0  # longest mission [s]
OBSERVATION_TIME = 30.0  # simulated after a failed mission [s]
GRIPPER_DEPTH = 0.04  # that the gripper may reach into the target's disc, its reach included [m]
NEAR_FIXTURE = 0.05  # distance of the gripper from the fixture at which a grip may follow [m]
NO_FAULT = FaultSettings()


@dataclass
class Flown:
    """Result of a mission."""

    phases: list[str] = field(default_factory=list)
    message: str = ""
    well: bool = False  # True if the activity ended as planned
    captured: bool = False
    time: float = 0.0  # duration [s]
    grip: float = nan  # time of the grip [s]
    propellant: float = 0.0  # propellant used [kg]
    torque: float = 0.0  # largest torque at a joint [N m]
    momentum: float = nan  # angular momentum at the grip [N m s]
    contact: str = ""  # first contact, except of gripper and target; empty: none
    nudges: int = 0  # frames in which the gripper touched the target
    pushed: float = 0.0  # sum of all contact impulses [N s]
    slips: int = 0  # number of times that the target slid after it had rested in the gripper
    losses: int = 0  # number of times that it slid out of the gripper
    grip_force: float = 0.0  # largest force of the grip, if the gripper has limits [N]
    grip_torque: float = 0.0  # largest torque of the grip, then [N m]
    edge: float = inf  # smallest distance to the table's edge [m]
    spin: float = 0.0  # turn rate of the target at the end [rad/s]

    @property
    def safe(self) -> bool:
        """True if no bodies touched, except gripper and target."""
        return not self.contact


def marker_free_noise(testbed: TestbedSettings) -> Noise:
    """Return the instruments' errors for a loop without VICON's markers.

    Raises:
        SettingError: the poses would be computed from markers.
    """
    noise = testbed.noise()
    if noise.markers:
        raise SettingError(
            f"testbed.preset is {testbed.preset!r}, expected one without VICON's markers: default, "
            "paper or ideal"
        )
    return noise


class Flight:
    """One mission.

    Args:
        seed: seed of all errors.
        testbed: plant, initial state and sensors.
        guidance: settings of the mission.
        navigation: settings of the filters.
        control: gains.
        fault: fault to inject.
        arm: values in which the true arm differs from its description.
        activity: flown activity; None: the capture.
        estimates_mass: True if the navigation estimates the held target's mass.
    """

    def __init__(
        self,
        seed: int,
        testbed: TestbedSettings = TESTBED,
        guidance: MissionSettings = GUIDANCE,
        navigation: NavigationSettings = NAVIGATION,
        control: ControlSettings = CONTROL,
        fault: FaultSettings = NO_FAULT,
        arm: ArmValues = NO_VALUES,
        activity: Activity | None = None,
        estimates_mass: bool = True,
    ) -> None:
        self.settings, self.fault = guidance, fault
        self.estimates_mass = estimates_mass
        self.arm = arm.apply(described(testbed.arm))
        noise = marker_free_noise(testbed)
        q = np.array(testbed.state_from_parameters(self.arm.n).q)
        target = [list(testbed.target_pose), list(testbed.target_twist)]
        self.plant = Plant(self.arm, q, None, testbed.world(), target)
        self.craft = Craft(described(self.settings.arm), self.settings)
        self.activity = activity or Capture(self.craft)
        propulsion, self.valves = self.plant.world.propulsion, self.plant.thrusters.layout
        self.min_on_time = propulsion.minimum_on_time
        self.allocation = Allocation(self.valves, PERIOD, self.min_on_time)
        s, assumed_arm = navigation, described(navigation.arm)
        self.control = PoseControl(assumed_arm, control)
        self.navigation = Navigation(assumed_arm, s, s.target_errors(), s.assumed_body(), s)
        self.held_body: Any = None  # newest estimate of the held body
        self.faults: list[Any] = []  # known faults of valves, with the time of detection [s]
        self.sensors = Sensors(noise, seed)
        limit = noise.encoder_error
        self.encoders = np.random.default_rng(seed).uniform(-limit, limit, self.arm.n)
        self.readings: deque[Any] = deque()
        self.demands: deque[Any] = deque()
        self.ramps = [Ramp(0.0, link.drive.max_acceleration) for link in self.arm.links]
        self.reading: Any = None  # newest received angles, rates, torques and their time [s]
        self.frame, self.faulted = 0, inf
        self.last_near = 0.0  # last time at which the gripper was at the fixture [s]
        self.flown = Flown()
        self.film: list[tuple[float, Floats, Floats]] = []  # time, q, target's pose
        self.sizes = sizes(self.settings, testbed.target_radius, self.settings.gripper_length)
        self.target_limits = 0.5 * np.array(testbed.table) - testbed.target_radius

    @property
    def t(self) -> float:
        """Time since the start [s]."""
        return self.frame / RATE

    def is_faulty(self, kind: str) -> bool:
        """Return True while this fault is active."""
        since = self.t - self.faulted
        return self.fault.kind == kind and 0.0 <= since < (self.fault.duration or inf)

    def fly(self) -> Flown:
        """Fly the mission; after a failure or a fault, also the drift that follows."""
        flown, outcome = self.flown, Outcome(False, "it took too long")
        while self.t < TIMEOUT:
            observation = self.observe()
            commands = self.step_activity(observation)
            if commands.phase not in flown.phases:
                flown.phases.append(commands.phase)
                if commands.phase == self.fault.phase and np.isinf(self.faulted):
                    self.faulted = self.t + self.fault.delay
            if commands.outcome:
                outcome = commands.outcome
                break
            self.command(commands, observation)
            self.advance()
        flown.time, flown.propellant = self.t, self.plant.thrusters.propellant_used
        flown.well, flown.message = outcome.success, outcome.message
        flown.spin = float(self.plant.target[1, 2])
        if not flown.well or self.fault.kind:
            end, idle = self.t + OBSERVATION_TIME, Commands("idle", rates=np.zeros(self.arm.n))
            while self.t < end:
                self.command(idle, observation)
                self.advance()
        return flown

    def observe(self) -> Observation:
        """Return what the guidance knows."""
        q = qd = effort = None
        if self.reading and not self.is_faulty("link"):
            q, qd, effort, then = self.reading
            q = q + (self.t - then) * qd
        thrusters, faults = self.plant.thrusters, self.navigation.valves.faults
        return Observation(
            self.t,
            self._known_body(self.navigation.base),
            self._known_body(self.navigation.target),
            q,
            qd,
            effort,
            None if self.is_faulty("gripper") else self.plant.holds,
            thrusters.capacity - thrusters.propellant_used,
            last_q=self.reading[0] if self.reading else None,
            held_body=self.held_body if self.plant.holds else None,
            open_valves=tuple(sorted(i + 1 for i in faults.open)),
            unknown_push=faults.unknown_push,
        )

    def _known_body(self, body: BodyFilter) -> Body | None:
        now = round(self.t * SECOND)
        if not body.events or body.lost_reason(now):
            return None
        state = body.state().extrapolate_to(now)
        return Body(state.pose, state.twist)

    def step_activity(self, observation: Observation) -> Commands:
        """Return the activity's commands; an error aborts the mission."""
        try:
            return self.activity.step(observation)
        except ActivityError as error:
            return Commands("abort", outcome=Outcome(False, str(error)))

    def command(self, commands: Commands, observation: Observation) -> None:
        """Command valves and gripper now, and the joints with a delay."""
        base, last_q, times = observation.base, observation.last_q, np.zeros(len(self.valves))
        if commands.path is not None and base is not None and last_q is not None:
            q_m = last_q if observation.q is None else observation.q
            qd_m = np.zeros(self.arm.n) if observation.qd is None else observation.qd
            q, qd = np.concatenate([base.pose, q_m]), np.concatenate([base.twist, qd_m])
            self.control.p = self.navigation.inputs.p
            reference = commands.path.at(self.t)
            wrench = self.control.wrench(q, qd, reference, PERIOD, np.zeros(self.arm.n))
            times = self.allocation.on_times(wrench)
        self.navigation.add_pulses(round(self.t * SECOND), times)
        self.plant.thrust(self._with_stuck_valve(times).tolist())
        if commands.close_gripper is not None and not self.is_faulty("gripper"):
            self.plant.closed = bool(commands.close_gripper)
        if commands.rates is not None:
            self.demands.append((self.frame + COMMAND_DELAY, commands.rates))

    def _with_stuck_valve(self, times: Floats) -> Floats:
        times = np.array(times)
        if self.is_faulty("open"):
            times[self.fault.valve - 1] = 2.0 * PERIOD
        elif self.is_faulty("closed"):
            times[self.fault.valve - 1] = 0.0
        return times

    def advance(self) -> None:
        """Simulate one period."""
        for _ in range(FRAMES):
            while self.demands and self.demands[0][0] <= self.frame:
                _, rates = self.demands.popleft()
                for i, rate in enumerate(rates.tolist()):
                    acceleration = self.ramps[i].acceleration(rate, self.t)
                    demand = Demand(int(MODE_VELOCITY), rate, abs(rate), acceleration)
                    is_lost = self.is_faulty("link") and i == LOST_LINK
                    self.plant.command(i, Demand(int(MODE_OFF)) if is_lost else demand)
            self.plant.advance(1.0 / RATE)
            self.frame += 1
            self.record_contacts()
            self.record_grip()
            self.read_joints()
            if self.frame % FRAMES_PER_ESTIMATE == 0:
                self.navigate()
        self.record_state()

    def record_contacts(self) -> None:
        """Add the contacts of a frame to the result."""
        for names, impulse in self.plant.bed.contact_impulses.items():
            self.flown.pushed += impulse
            self.flown.nudges += names == ("gripper", "target")
            if names != ("gripper", "target") and not self.flown.contact:
                self.flown.contact = f"{' with '.join(names)} at {self.t:.1f} s"

    def record_grip(self) -> None:
        """Add the loads and slips of the grip to the result."""
        flown, fingers = self.flown, self.plant.fingers
        flown.slips, flown.losses = fingers.slips, fingers.losses
        flown.grip_force = max(flown.grip_force, fingers.force)
        flown.grip_torque = max(flown.grip_torque, fingers.torque)

    def read_joints(self) -> None:
        """Sample the joints, and pass on the sample that arrives."""
        plant = self.plant
        effort = np.array([motion.torque for motion in plant.motions()])
        self.flown.torque = max(self.flown.torque, float(np.abs(effort).max()))
        if self.frame % FRAMES_PER_READING == 0:
            reading = plant.q[3:] + self.encoders, plant.qd[3:].copy(), effort, self.t
            self.readings.append((self.frame + READING_DELAY, reading))
        if not self.readings or self.readings[0][0] > self.frame:
            return
        reading = self.readings.popleft()[1]
        if self.is_faulty("link"):
            return
        self.reading = q, qd, _, then = reading
        for i in range(self.arm.n):
            stamp = round(then * SECOND)
            self.navigation.add_joint_reading(i, stamp, float(q[i]), float(qd[i]))

    def navigate(self) -> None:
        """Update the navigation with the sensors' readings."""
        now, plant, navigation = round(self.t * SECOND), self.plant, self.navigation
        readings = self.sensors.observe(
            self.frame,
            plant.base,
            plant.tip,
            float(plant.qd[2]),
            plant.qd[3:],
            target=tuple(plant.target[0].tolist()),
        )
        if readings.rate is not None and not self.is_faulty("gyro"):
            navigation.base.update_rate(now, readings.rate)
        if readings.base and readings.target and not self.is_faulty("outage"):
            navigation.base.update_pose(now, *readings.base.pose)
            navigation.update_target_pose(now, *readings.target.pose)
        navigation.set_gripper(plant.holds)
        navigation.predict(now)
        if faults := navigation.detect_valve_faults(now):
            self.allocation = Allocation(
                self.valves, PERIOD, self.min_on_time, faults.open, faults.closed
            )
            self.faults.append((self.t, faults))
            self.held_body = None
        if self.estimates_mass and (found := navigation.estimate_mass(now)):
            self.held_body = found.as_held_body

    def record_state(self) -> None:
        """Add a frame to the film, and clearances and grip to the result."""
        plant, flown, n = self.plant, self.flown, self.arm.n
        self.film.append((self.t, plant.q.copy(), plant.target[0].copy()))
        p, q = self.arm.vector(), plant.q
        edge = float(gaps(p, q, list(with_edge(n)), self.sizes).min())
        flown.edge = min(flown.edge, edge)
        itself = float(gaps(p, q, list(links_and_base(n)), self.sizes).min())
        target_gaps = gaps(p, q, list(with_target(n)), self.sizes, plant.target[0, :2])
        target_gaps[-1] += GRIPPER_DEPTH
        if plant.holds:
            target_gaps[-2:] = inf
            if not flown.captured:
                flown.captured, flown.grip = True, self.t
                flown.momentum = self.angular_momentum()
        if plant.approach.distance < NEAR_FIXTURE:
            self.last_near = self.t
        for name, gap in (("edge", edge), ("itself", itself), ("target", float(target_gaps.min()))):
            if gap < 0.0 and not flown.contact:
                flown.contact = f"{name} at {self.t:.1f} s ({flown.phases[-1]})"
        is_off = bool((np.abs(plant.target[0, :2]) > self.target_limits).any())
        if is_off and plant.holds and not flown.contact:
            flown.contact = f"held target with edge at {self.t:.1f} s"

    def angular_momentum(self) -> float:
        """Return that of vehicle and target about their common centre of mass [N m s]."""
        plant, target = self.plant, self.plant.world.target
        if plant.payload or target is None:  # the payload is part of the last link
            return float(momentum(plant.p, plant.q, plant.qd)[2])
        return float(combined_momentum(plant.p, plant.q, plant.qd, target, plant.target)[2])


def capture(
    seed: int,
    testbed: Annotated[TestbedSettings, WITHOUT_ELECTRONICS] = TESTBED,
    guidance: Annotated[MissionSettings, Without("rate", "horizon", "max_age")] = GUIDANCE,
    navigation: Annotated[NavigationSettings, WITHOUT_TOPICS] = NAVIGATION,
    control: Annotated[
        ControlSettings,
        Without(
            "arm",
            "rate",
            "timeout",
            "max_age",
            "feed_forward",
            "table",
            "full_tank",
            "target_*",
            "base_frame",
        ),
    ] = CONTROL,
    fault: FaultSettings = NO_FAULT,
    arm: ArmValues = NO_VALUES,
) -> dict[str, Any]:
    """Fly one capture; it succeeds if the target is held and stopped at the end."""
    fault.check()
    flight = Flight(seed, testbed, guidance, navigation, control, fault, arm)
    flown = flight.fly()
    return {
        **asdict(flown),
        "phases": ", ".join(flown.phases),
        "success": flown.captured and flown.well,
        "reason": flown.message,
        "picture": partial(draw_end, flight),
    }


def draw_end(flight: Flight) -> Any:
    """Return a matplotlib figure of the table in the last seconds at the fixture."""
    from matplotlib.figure import Figure
    from matplotlib.patches import Circle

    figure = Figure(figsize=(4.6, 4.6), layout="constrained")
    ax = figure.subplots()
    p, radius = flight.arm.vector(), flight.sizes[0]
    frames = [frame for frame in flight.film if frame[0] >= flight.last_near - 4.0][:100]
    for k, (_, q, target) in enumerate(frames[:: max(1, len(frames) // 8)]):
        shade: Any = {"alpha": min(0.15 + 0.1 * k, 1.0), "lw": 1.2}
        joints = np.vstack([joint_positions(p, q), tip_pose(p, q)[:2]])
        ax.plot(*joints.T, "o-", color="tab:blue", ms=2, **shade)
        ax.add_patch(Circle((q[0], q[1]), radius, fill=False, ec="tab:blue", **shade))
        ax.add_patch(
            Circle((target[0], target[1]), flight.sizes[2], fill=False, ec="tab:orange", **shade)
        )
        x, y = target[:2] + flight.sizes[2] * np.array([cos(target[2]), sin(target[2])])
        ax.plot(x, y, "s", color="tab:red", ms=3, alpha=shade["alpha"])
    outcome = flight.flown.contact or flight.flown.message or "captured"
    ax.set_title(f"{outcome}\n{frames[0][0]:.1f} to {frames[-1][0]:.1f} s", size=8)
    ax.set_aspect("equal")
    ax.set(xlabel="x [m]", ylabel="y [m]")
    return figure
