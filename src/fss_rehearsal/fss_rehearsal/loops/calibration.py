"""The experiment of the calibrations without ROS: test bed, the links' drivers, and estimation.

Telemetry, readings and poses pass through the same code as in the nodes; the operator, who arms
links again, and the node `experiment` are a few lines each.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from math import nan, radians
from typing import Annotated, Any

import numpy as np

from fss_arm_calib.acceptance import PASS
from fss_arm_calib.dynamic.calibrate import calibrate as calibrate_dynamics
from fss_arm_calib.dynamic.settings import DynamicSettings
from fss_arm_calib.experiment.postures import default_postures
from fss_arm_calib.experiment.waypoints import maneuver_waypoints
from fss_arm_calib.kinematic.calibrate import calibrate as calibrate_kinematics
from fss_arm_calib.kinematic.settings import KinematicSettings
from fss_arm_calib.outcome import Outcome
from fss_arm_calib.segments.maneuvers import Maneuver, ManeuverFinder
from fss_arm_calib.segments.poses import BASE, TIP
from fss_arm_calib.segments.rests import (
    SAME_POSTURE,
    Observation,
    RestFinder,
    rejected_without_repeat,
)
from fss_arm_driver.arm.move import Move, plan
from fss_arm_driver.session import LinkSession, Sample
from fss_arm_model.description import Arm
from fss_arm_model.description_file import described
from fss_arm_model.parameters import parameter_names, values, with_values
from fss_arm_model.units import SECOND
from fss_link.session import Arming, CommandError
from fss_rehearsal.loops.parameters import WITHOUT_NODES, ArmValues, Without
from fss_sim.faults import read_script
from fss_sim.noise import Noise
from fss_sim.plant.vehicle import World
from fss_sim.sensors import Readings
from fss_sim.settings import TestbedSettings
from fss_sim.testbed import State, Testbed

FRAMES_PER_COMMAND = 20
EPOCH = 1_700_000_000 * SECOND
POSITION_MODE = 21
ARRIVED = 0.005  # largest angle from a posture at arrival [rad]
MOVE_TIMEOUT = 20.0  # [s]
OBSERVATION_TIMEOUT = 6.0  # for an observation of a rest [s]
ROUNDS = 2  # rounds of postures whose rest was rejected
GUESS_ERRORS = 0.015, 0.01  # largest errors of the guesses of b [m] and I [kg m^2]

TESTBED, NO_VALUES = TestbedSettings(arm="truth"), ArmValues()
KINEMATIC = KinematicSettings(
    arm="cad", parametrization="full", position_deviation=0.001, heading_deviation=radians(0.1)
)
# White noise of every frame, with a margin for the encoders.
DYNAMIC = DynamicSettings(
    position_deviation=0.0005, heading_deviation=radians(0.1), fresh_rate=100.0
)
#: Parameters of the test bed without effect in an experiment without ROS, thrusters and target.
WITHOUT_THRUSTERS = Without(
    *WITHOUT_NODES,
    "target_*",
    "grip*",
    "contact*",
    "restitution",
    "thrust*",
    "specific_impulse",
    "minimum_on_time",
    "valve_delay",
)


class Experiment:
    """An experiment on a simulated test bed, and the data that calibrations find in it.

    Args:
        truth: the true arm.
        guess: the arm that drivers and calibrations assume.
        noise: sizes of the instruments' errors.
        world: parameters of the plant.
        state: initial state.
        seed: seed of all errors.
        kinematic: settings of the search for rests.
        dynamic: settings of the search for maneuvers.
        options: further arguments of the Testbed.
    """

    #: Receives samples of the links and the readings of motion capture and gyro, in each frame.
    recorder: Callable[[Mapping[int, Sample], Readings], None] = staticmethod(lambda *_: None)

    def __init__(
        self,
        truth: Arm,
        guess: Arm,
        noise: Noise,
        world: World,
        state: State,
        seed: int,
        kinematic: KinematicSettings,
        dynamic: DynamicSettings,
        **options: Any,
    ) -> None:
        self.truth, self.guess = truth, guess
        self.bed = Testbed(truth, noise, seed, state, world=world, **options)
        self.links = [LinkSession(i, k) for i, k in enumerate(guess.links, 1)]
        self.finder, self.observations = RestFinder(guess.n, kinematic), list[Observation]()
        self.maneuver_finder = ManeuverFinder(guess.n, dynamic)
        self.maneuvers: list[Maneuver] = []
        self.samples: list[list[Any]] = [[] for _ in self.links]
        self.deviations: list[list[float]] = [[] for _ in self.links]  # of the samples' stamps [s]
        self.arming_asked = [0] * guess.n
        self.has_commands = False  # True: drivers send without waiting for their next period

    @property
    def now(self) -> int:
        """Time of the drivers' computer [ns]."""
        return EPOCH + self.bed.now

    def step(self) -> None:
        """Simulate a frame; pass its outputs to drivers and calibrations, and send commands."""
        report, samples = self.bed.step(), dict[int, Sample]()
        for i, datagrams in enumerate(report.telemetry):
            for datagram in datagrams:
                if sample := self.links[i].feed(datagram.data, self.now):
                    self.samples[i].append(sample)
                    samples[i] = sample
                    self.deviations[i].append(self.links[i].deviation(self.now))
                    reading = i + 1, sample.stamp, sample.position
                    self.observations += self.finder.add_reading(*reading)
                    self.maneuvers += self.maneuver_finder.add_reading(*reading, sample.velocity)
        for name, seen in ((BASE, report.readings.base), (TIP, report.readings.tip)):
            if seen:
                pose = None if seen.occluded else seen.pose
                self.observations += self.finder.add_pose(name, self.now, pose)
                if name == BASE:
                    self.maneuvers += self.maneuver_finder.add_pose(name, self.now, pose)
        if report.readings.rate is not None:
            self.maneuvers += self.maneuver_finder.add_rate(self.now, report.readings.rate)
        self.recorder(samples, report.readings)
        if self.has_commands or self.bed.frame % FRAMES_PER_COMMAND == 0:
            self.has_commands = False
            for i, link in enumerate(self.links):
                self.bed.receive(i, link.command(self.now), peer="driver")

    def arm_links(self) -> bool:
        """Arm the links that are disarmed, as an operator does; return True if all are armed."""
        for i, link in enumerate(self.links):
            if link.arming is Arming.DISARMED and not link.obstacle(self.now):
                link.arm(self.now)
                self.arming_asked[i] += 1
        return all(link.armed for link in self.links)

    def angles(self) -> tuple[float, ...]:
        """Return the last readings of the joints, (n,) [rad]."""
        return tuple(samples[-1].position for samples in self.samples)

    def move_to(self, posture: Sequence[float]) -> bool:
        """Move to a posture and wait at rest; return True if the rest was observed and used."""
        arrival, seen, end = None, len(self.observations), self.bed.now + MOVE_TIMEOUT * SECOND
        move = None
        while self.bed.now < end:
            if self.bed.frame % FRAMES_PER_COMMAND == 0:
                if not self.arm_links():
                    move = None
                elif arrival is None:
                    q = self.angles()
                    move = move or plan(self.guess, q, tuple(posture))
                    self.send(move)
                    if np.abs(np.subtract(q, posture)).max() < ARRIVED:
                        arrival = self.bed.now
                elif move:
                    self.send(move)
            self.step()
            if arrival is not None:
                if len(self.observations) > seen and self.observations[-1].used:
                    return True
                if self.bed.now > arrival + OBSERVATION_TIMEOUT * SECOND:
                    return False
        return False

    def make_maneuvers(self, maneuvers: Sequence[Any], pause: float) -> list[Maneuver]:
        """Make maneuvers as the node `experiment` does; return those that were found.

        Raises:
            TimeoutError: a waypoint was not reached.
        """
        for stop in maneuver_waypoints(maneuvers, pause):
            move, since, end = None, 0, self.bed.now + MOVE_TIMEOUT * SECOND
            start = self.bed.now + round(stop.delay * SECOND)
            while not since or self.bed.now < since + stop.pause * SECOND:
                if not since and self.bed.now >= end:
                    raise TimeoutError(f"waypoint {stop.q} was not reached in {MOVE_TIMEOUT} s")
                is_due = not move or self.bed.frame % FRAMES_PER_COMMAND == 0
                if is_due and self.bed.now >= start and self.arm_links():
                    q = self.angles()
                    self.has_commands = not move
                    move = move or plan(self.guess, q, tuple(stop.q), stop.duration)
                    self.send(move)
                    if np.abs(np.subtract(q, stop.q)).max() < ARRIVED:
                        since = since or self.bed.now
                self.step()
        self.maneuvers += self.maneuver_finder.close()
        return self.maneuvers

    def send(self, move: Move) -> None:
        """Command the links to make a move; a link that was lost just now ignores it."""
        for link, part in zip(self.links, move.profiles, strict=True):
            with suppress(CommandError):
                link.set(
                    POSITION_MODE,
                    part.target,
                    part.velocity,
                    part.acceleration,
                    self.now + SECOND,
                    self.now,
                )

    def run(self, postures: Sequence[Sequence[float]]) -> None:
        """Visit all postures; repeat those whose rest was rejected."""
        for posture in postures:
            self.move_to(posture)
        for _ in range(ROUNDS):
            for lost in rejected_without_repeat(self.observations, SAME_POSTURE):
                self.move_to(lost.q)
        self.observations += self.finder.close()
        self.maneuvers += self.maneuver_finder.close()


@dataclass(frozen=True)
class Score:
    """Errors of a calibration relative to the truth."""

    passed: bool
    nees: float  # normalized squared error per parameter; 1: consistent
    largest: float  # largest error [standard deviations]
    errors: dict[str, float]  # root mean square error by kind of parameter: a, theta, ... [SI]


def score(outcome: Outcome[Any, Any], truth: Arm) -> Score:
    """Return the errors of an outcome; of parameters that are not of the arm: none."""
    true = dict(zip(parameter_names(truth.n), values(truth), strict=True))
    chosen = [k for k, name in enumerate(outcome.names) if name in true]
    names = [outcome.names[k] for k in chosen]
    error = np.array(outcome.values)[chosen] - [true[name] for name in names]
    is_angle = np.array([name.startswith("theta") for name in names])
    error[is_angle] = (error[is_angle] + np.pi) % (2.0 * np.pi) - np.pi
    if not chosen or not np.isfinite(outcome.covariance).all():
        return Score(False, nan, nan, {})
    covariance = np.asarray(outcome.covariance).reshape(2 * (len(outcome.names),))
    covariance = covariance[np.ix_(chosen, chosen)]
    kinds = {name: name.split("_")[0] + "_0" * (name in ("I_0", "m_0")) for name in names}
    errors = {
        kind: float(np.sqrt(np.mean(error[[kinds[name] == kind for name in names]] ** 2)))
        for kind in dict.fromkeys(kinds.values())
    }
    return Score(
        outcome.verdict == PASS,
        float(error @ np.linalg.solve(covariance, error) / len(error)),
        float(np.abs(error / np.sqrt(np.diag(covariance))).max()),
        errors,
    )


def draw_guess(truth: Arm, settings: DynamicSettings, seed: int) -> Arm:
    """Return a description with random errors of the settings' deviations; b and I are worse."""
    n, rng = truth.n, np.random.default_rng(seed)
    off = settings.deviations(truth) * rng.standard_normal(5 * n + 6)
    off[3 * n + 6 :] = rng.uniform(-1.0, 1.0, 2 * n) * np.repeat(GUESS_ERRORS, n)
    return with_values(truth, values(truth) + off)


def calibration(
    seed: int,
    testbed: Annotated[TestbedSettings, WITHOUT_THRUSTERS] = TESTBED,
    kinematic: Annotated[KinematicSettings, Without("*_topic", "max_observations")] = KINEMATIC,
    dynamic: Annotated[
        DynamicSettings, Without("arm", "*_topic", "plan", "max_maneuvers")
    ] = DYNAMIC,
    arm: ArmValues = NO_VALUES,
) -> dict[str, Any]:
    """Visit the default postures; calibrate kinematics from the rests, dynamics from the moves.

    The dynamic calibration starts from a random guess. The run succeeds if both calibrations pass.
    """
    truth, guess = arm.apply(described(testbed.arm)), described(kinematic.arm)
    state = replace(testbed.state_from_parameters(truth.n), boot_offset=0)
    experiment = Experiment(
        truth,
        guess,
        testbed.noise(),
        testbed.world(),
        state,
        seed,
        kinematic,
        dynamic,
        rate=testbed.telemetry_rate,
        torque_rate=testbed.torque_rate,
        charge=testbed.battery,
        power=testbed.power(),
        script=read_script(testbed.script()),
        radio_channel=testbed.radio_channel(str(seed)),
        vicon=testbed.vicon(seed, (0, 1)),
    )
    experiment.run(default_postures(guess).tolist())
    streams = experiment.finder.streams(), experiment.maneuver_finder.streams()
    kinematics = calibrate_kinematics(experiment.observations, guess, kinematic, streams[0])
    first_guess = draw_guess(truth, dynamic, seed)
    dynamics = calibrate_dynamics(experiment.maneuvers, first_guess, dynamic, streams[1])
    scores = {"kinematic": score(kinematics, truth), "dynamic": score(dynamics, truth)}
    failed = [
        f"{kind}: {outcome.reason}"
        for kind, outcome in (("kinematic", kinematics), ("dynamic", dynamics))
        if outcome.verdict != PASS
    ]
    figures = {"success": not failed, "reason": "; ".join(failed)}
    for kind, found in scores.items():
        figures |= {
            f"{kind}_nees": found.nees,
            f"{kind}_largest": found.largest,
            f"{kind}_passed": found.passed,
        }
        figures |= {f"{kind}_error_{name}": error for name, error in found.errors.items()}
    return figures
