"""Two vehicles on crossing courses, without ROS: plant, sensors, navigation, guidance, control.

Guidance and control run at 10 Hz, navigation at 25 Hz. Each vehicle announces its state, plan and
outline five times a second; messages arrive 0.1 s late, or not at all.
"""

from collections import deque
from dataclasses import dataclass, replace
from math import inf, pi
from typing import Annotated, Any, NamedTuple

import numpy as np

from fss_arm_model.description_file import described
from fss_arm_model.settings import Settings, between, one_of, setting
from fss_arm_model.units import SECOND
from fss_base_driver.allocation import Allocation
from fss_gnc.control import PoseControl
from fss_gnc.control.settings import ControlSettings
from fss_gnc.guidance.activity import ActivityError, Commands, Craft, Observation, Outcome
from fss_gnc.guidance.base_motion import PathMotion, go_to, hold
from fss_gnc.guidance.mission_settings import MissionSettings
from fss_gnc.guidance.other_vehicles import VehicleTrack, announced
from fss_gnc.navigation.navigation import Navigation
from fss_gnc.navigation.settings import NavigationSettings
from fss_gnc.reference import Body
from fss_rehearsal.loops.capture import (
    FRAMES,
    FRAMES_PER_ESTIMATE,
    PERIOD,
    marker_free_noise,
)
from fss_rehearsal.loops.holding import ControlWithoutTarget, NavigationWithoutTarget
from fss_rehearsal.loops.parameters import Without
from fss_rehearsal.loops.settings import CONTROL, GUIDANCE, NAVIGATION, WITHOUT_ELECTRONICS
from fss_sim.plant.bed import Bed
from fss_sim.plant.drives import MODE_POSITION
from fss_sim.plant.vehicle import Demand, Vehicle
from fss_sim.sensors import RATE, Sensors
from fss_sim.settings import TestbedSettings

NAMES = "fss1", "fss2"  # in the order of their right of way
HALF_WAY = 1.3  # from the table's centre to start and goal [m]
SLOW_DURATION = 100.0  # duration of a motion that is overtaken [s]
READING_FRAMES = 20  # frames from one reading of the joints to the next
ANNOUNCEMENT_STEPS = 2  # steps of the guidance from one announcement to the next
ANNOUNCEMENT_DELAY = 1  # of its arrival [steps]
SILENT_FROM = 30.0  # time at which a vehicle falls silent, about half-way [s]
TIMEOUT = 500.0  # of a run [s]
REST_TIME = 5.0  # simulated after the last arrival [s]
CURLED = 1.3, 1.15, 1.15, 1.1  # posture of both arms [rad]

KINDS = "head-on", "crossing", "overtaking", "holding", "silent"


@dataclass(frozen=True)
class CrossingSettings(Settings):
    """Courses of two vehicles, and the loss of their messages."""

    kind: str = setting("crossing", "courses of the two vehicles", check=one_of(*KINDS))
    offset: float = setting(
        0.0, "offset of one course from the other", unit="m", check=between(-0.4, 0.4)
    )
    turn: float = setting(
        0.0, "turn of the vehicles on the way", unit="rad", check=between(-pi, pi)
    )
    delay: float = setting(
        0.0, "time from the first goal to the second one", unit="s", check=between(0.0, 60.0)
    )
    loss: float = setting(
        0.2, "fraction of the exchanged messages that is lost", check=between(0.0, 1.0)
    )
    silent: int = setting(
        1, "vehicle that falls silent, but still receives: 1 or 2", check=between(1, 2)
    )


TESTBED, COURSES = TestbedSettings(q=CURLED), CrossingSettings()


class Route(NamedTuple):
    """Course of one vehicle."""

    start: tuple[float, float, float]  # [m, m, rad]
    goal: tuple[float, float, float] | None  # None: it holds the start
    duration: float = 0.0  # [s]; 0: as short as possible
    delay: float = 0.0  # time of the goal [s]


def routes(s: CrossingSettings) -> tuple[Route, Route]:
    """Return the courses of both vehicles."""
    d, o, turn = HALF_WAY, 0.5 * s.offset, s.turn
    first = Route((-d, o, 0.0), (d, o, turn))
    if s.kind == "head-on":
        return first, Route((d, -o, pi), (-d, -o, pi - turn), delay=s.delay)
    if s.kind == "overtaking":
        return first, Route((-0.3, -o, 0.0), (0.2, -o, 0.0), SLOW_DURATION)
    if s.kind == "holding":
        return first, Route((0.0, -o, turn), None)
    return first, Route((o, -d, 0.5 * pi), (o, d, 0.5 * pi + turn), delay=s.delay)


class Pilot:
    """One vehicle with its instruments, navigation, guidance and control.

    Args:
        name: of the vehicle.
        seed: of all errors of its instruments.
        route: its course.
        testbed: plant and instruments.
        guidance: settings of the guidance.
        navigation: settings of the filters.
        control: gains.
    """

    def __init__(
        self,
        name: str,
        seed: int,
        route: Route,
        testbed: TestbedSettings,
        guidance: MissionSettings,
        navigation: NavigationSettings,
        control: ControlSettings,
    ) -> None:
        arm, q_m = described(testbed.arm), np.array(testbed.q)
        q = np.concatenate([route.start, q_m])
        self.name, self.route = name, route
        self.plant = Vehicle(arm, q, None, testbed.world(), name=name)
        for i in range(arm.n):
            self.plant.command(i, Demand(int(MODE_POSITION), float(q_m[i])))  # held
        self.craft = Craft(described(guidance.arm), replace(guidance, vehicles=NAMES))
        self.sensors = Sensors(marker_free_noise(testbed), seed)
        self.navigation = Navigation(described(navigation.arm), navigation)
        self.control = PoseControl(described(control.arm), control)
        propulsion, layout = self.plant.world.propulsion, self.plant.thrusters.layout
        self.allocation = Allocation(layout, PERIOD, propulsion.minimum_on_time)
        self.tracks = [
            VehicleTrack(other, NAMES.index(other) < NAMES.index(name))
            for other in NAMES
            if other != name
        ]
        self.activity: PathMotion | None = None
        self.commands = Commands("idle")
        self.start = self.direct = 0.0  # start of the motion, and its duration alone [s]
        self.moves = False  # True once it has its goal
        self.failure = ""

    def navigate(self, frame: int) -> None:
        """Update the navigation with the readings of a frame."""
        now, plant = round(frame / RATE * SECOND), self.plant
        readings = self.sensors.observe(
            frame, plant.base, plant.tip, float(plant.qd[2]), plant.qd[3:]
        )
        if frame % READING_FRAMES == 0:
            for i in range(plant.n):
                q, qd = float(plant.q[3 + i]), float(plant.qd[3 + i])
                self.navigation.add_joint_reading(i, now, q, qd)
        if readings.rate is not None:
            self.navigation.base.update_rate(now, readings.rate)
        if readings.base:
            self.navigation.base.update_pose(now, *readings.base.pose)
        self.navigation.predict(now)

    def observe(self, t: float) -> Observation:
        """Return what the guidance knows at a time [s]."""
        now = round(t * SECOND)
        state = self.navigation.base.state().extrapolate_to(now)
        found = (track.predicted(now) for track in self.tracks)
        return Observation(
            t - self.start,
            Body(state.pose, state.twist),
            None,
            self.plant.q[3:].copy(),
            self.plant.qd[3:].copy(),
            others=tuple(other for other in found if other),
        )

    def step(self, t: float) -> None:
        """Step guidance and control."""
        goal = self.route.goal
        if self.activity is None:
            self.activity = hold(self.craft, self.observe(t), [], 0.0)
        if goal and not self.moves and t >= self.route.delay + REST_TIME:
            self.moves, self.start = True, t
            duration = self.route.duration
            self.activity = go_to(self.craft, self.observe(t), goal, duration, 3600.0)
            self.direct = self.activity.path.end_time
        obs = self.observe(t)
        try:
            self.commands = self.activity.step(obs)
        except ActivityError as error:
            self.commands = Commands("abort", outcome=Outcome(False, str(error)))
        if outcome := self.commands.outcome:
            self.failure = self.failure or outcome.message
        times = np.zeros(len(self.plant.thrusters.layout))
        if self.commands.path is not None and not outcome:
            reference, q_qd = self.commands.path.at(obs.t), obs.floating_state
            wrench = self.control.wrench(*q_qd, reference, PERIOD, np.zeros(self.plant.n))
            times = self.allocation.on_times(wrench)
        self.navigation.add_pulses(round(t * SECOND), times)
        self.plant.thrust(times.tolist())

    def announcement(self, t: float) -> list[Any]:
        """Return functions that store its state, plan and outline in another vehicle's track."""
        now, obs = round(t * SECOND), self.observe(t)
        state, plan = self.navigation.base.state(), self.commands.plan
        variances = np.diag(state.covariance)
        deviations = np.sqrt([variances[:2].max(), variances[3:5].max()]).tolist()
        body, path = Body(state.pose, state.twist), plan and announced(plan, obs.t)
        own = self.activity.free_space.outline(obs) if self.activity else None
        return [
            lambda track: track.store_state(state.t, body, *deviations),
            lambda track: track.store_plan(now, path),
            lambda track: setattr(track, "outline", own),
        ]

    @property
    def lost(self) -> float:
        """Time until the arrival beyond that of a motion alone [s]; NaN: it has not arrived."""
        if not self.moves or self.activity is None or self.activity.arrival_time is None:
            return np.nan
        return self.activity.arrival_time - self.direct

    @property
    def is_done(self) -> bool:
        """True if it has arrived or has no goal, or has failed."""
        return bool(self.failure) or not self.route.goal or bool(np.isfinite(self.lost))


class Crossing:
    """One run with two vehicles on one table."""

    def __init__(self, seed: int, settings: CrossingSettings, *parts: Any) -> None:
        self.settings, self.rng = settings, np.random.default_rng(seed)
        courses = zip(NAMES, routes(settings), strict=True)
        self.pilots = [
            Pilot(name, 2 * seed + k, route, *parts) for k, (name, route) in enumerate(courses)
        ]
        world = self.pilots[0].plant.world
        vehicles = [pilot.plant for pilot in self.pilots]
        self.bed = Bed(vehicles, (), world.contact, world.tolerance)
        self.mail: deque[tuple[int, VehicleTrack, Any]] = deque()  # with the step of its arrival
        self.contact, self.gap, self.t = "", inf, 0.0

    def fly(self) -> None:
        """Fly until both vehicles have arrived, or one has failed."""
        frame, end = 0, TIMEOUT
        for pilot in self.pilots:
            pilot.navigate(0)
        while self.t < end:
            step = frame // FRAMES
            self.exchange(step)
            for pilot in self.pilots:
                pilot.step(self.t)
            for _ in range(FRAMES):
                self.bed.advance(1.0 / RATE)
                frame += 1
                self.record_contacts(frame / RATE)
                if frame % FRAMES_PER_ESTIMATE == 0:
                    for pilot in self.pilots:
                        pilot.navigate(frame)
            self.t = frame / RATE
            self.record_gap()
            if end == TIMEOUT and all(pilot.is_done for pilot in self.pilots):
                end = min(TIMEOUT, self.t + REST_TIME)

    def exchange(self, step: int) -> None:
        """Send and receive the announcements of a step."""
        s, silent = self.settings, ""
        if s.kind == "silent" and self.t >= SILENT_FROM:
            silent = NAMES[s.silent - 1]
        if step and step % ANNOUNCEMENT_STEPS == 0:
            for sender, receiver in zip(self.pilots, self.pilots[::-1], strict=True):
                for store in sender.announcement(self.t) if sender.name != silent else ():
                    if self.rng.random() >= s.loss:
                        arrival = step + ANNOUNCEMENT_DELAY
                        self.mail.append((arrival, receiver.tracks[0], store))
        while self.mail and self.mail[0][0] <= step:
            _, track, store = self.mail.popleft()
            store(track)

    def record_contacts(self, t: float) -> None:
        """Store the first contact."""
        for names in self.bed.contact_impulses:
            self.contact = self.contact or f"{' with '.join(names)} at {t:.1f} s"

    def record_gap(self) -> None:
        """Store the least gap between the two vehicles."""
        for one, other, gap in self.bed.clearances():
            if one.split()[0] != other.split()[0] and other != "table edge":
                self.gap = min(self.gap, gap)


def crossing(
    seed: int,
    crossing: CrossingSettings = COURSES,
    testbed: Annotated[
        TestbedSettings,
        WITHOUT_ELECTRONICS,
        Without("base", "target_*", "grip*", "encoder_error"),
    ] = TESTBED,
    guidance: Annotated[
        MissionSettings, Without("rate", "horizon", "max_age", "vehicles")
    ] = GUIDANCE,
    navigation: NavigationWithoutTarget = NAVIGATION,
    control: ControlWithoutTarget = CONTROL,
) -> dict[str, Any]:
    """Fly two vehicles past each other; it succeeds if both arrive and do not touch."""
    run = Crossing(seed, crossing, testbed, guidance, navigation, control)
    run.fly()
    first, second = run.pilots
    failures = [f"{p.name}: {p.failure}" for p in run.pilots if p.failure]
    late = [f"{p.name} has not arrived" for p in run.pilots if not p.is_done]
    return {
        "success": not (run.contact or failures or late),
        "reason": "; ".join([run.contact] * bool(run.contact) + failures + late),
        "contact": run.contact,
        "gap": run.gap,
        "lost_1": first.lost,
        "lost_2": second.lost,
        "time": run.t,
        "propellant": sum(p.plant.thrusters.propellant_used for p in run.pilots),
    }
