"""The main job without ROS, in simulated time: test bed, the links' drivers, the calibration.

What the nodes do, in the same order of things: telemetry in, readings and poses to the calibration,
the person's part (arming again) and the experiment's (from posture to posture) in a few lines.
"""

from contextlib import suppress
from dataclasses import replace
from math import pi, radians

import numpy as np

from fss_arm_calib.dynamic.calibrate import calibrate as calibrate_dynamics
from fss_arm_calib.dynamic.settings import DynamicSettings
from fss_arm_calib.experiment.postures import DEFAULT_POSTURES
from fss_arm_calib.experiment.waypoints import maneuver_waypoints
from fss_arm_calib.kinematic.calibrate import calibrate
from fss_arm_calib.kinematic.settings import KinematicSettings
from fss_arm_calib.segments.maneuvers import ManeuverFinder
from fss_arm_calib.segments.rests import BASE, TIP, RestFinder, rejected_without_repeat
from fss_arm_driver.move import plan
from fss_arm_driver.session import LinkSession
from fss_arm_model.description_file import load
from fss_arm_model.layout import kinematic_index
from fss_arm_model.units import SECOND
from fss_link.session import Arming, CommandError
from fss_sim import testbed
from fss_sim.faults import read_script
from fss_sim.noise import PRESETS
from fss_sim.plant.joints import PRESETS as JOINTS
from fss_sim.plant.surroundings import Surroundings
from fss_sim.plant.vehicle import World
from fss_sim.testbed import State
from fss_sim.vicon import Vicon

COMMANDS = 20  # frames from one command to the next
EPOCH = 1_700_000_000 * SECOND
# White noise of every frame, with something left for the encoders.
DYNAMIC = DynamicSettings(
    position_deviation=0.0005, heading_deviation=radians(0.1), fresh_rate=100.0
)
WAIT = 6.0  # for an observation of a rest [s]
ROUNDS = 2  # of postures whose rest was rejected


class Rehearsal:
    """An experiment under a fault script, with the joints and errors of a preset.

    Truth and guess are those of a folder, or given; the arm begins at q, the base drifts by a
    twist, on a tilted table.
    """

    def __init__(
        self, config=None, script="", noise=None, seed=1, postures=DEFAULT_POSTURES, preset="paper",
        room=None, arms=None, q=(0.0,) * 4, twist=(0.0,) * 3, tilt=(0.0,) * 2,
        dynamic=DYNAMIC, **options,
    ):  # fmt: skip
        self.truth, self.guess = arms or (load(config / "truth.yaml"), load(config / "cad.yaml"))
        q, qd = np.array([[0.0, 0.0, 0.0, *q], [*twist, 0.0, 0.0, 0.0, 0.0]]).tolist()
        state = State(frame=0, boots=1, rests=0, q=tuple(q), qd=tuple(qd))
        noise = replace(PRESETS[preset], **(noise or {}))
        self.bed = testbed.Testbed(
            self.truth,
            noise,
            seed,
            state,
            script=read_script(script),
            world=World(JOINTS[preset], Surroundings(tilt=tilt)),
            vicon=Vicon(noise, room, seed, [0, 1]) if room else None,
            **options,
        )
        self.links = [LinkSession(i, k) for i, k in enumerate(self.guess.links, 1)]
        self.finder, self.observations = RestFinder(4, KinematicSettings()), []
        self.maneuver_finder, self.maneuvers = ManeuverFinder(4, dynamic), []
        self.postures, self.samples = list(np.asarray(postures)), [[] for _ in self.links]
        self.arming_asked = [0] * 4

    @property
    def now(self):
        return EPOCH + self.bed.now

    def step(self):
        """A frame: what comes of it to drivers and calibration, and their commands."""
        report = self.bed.step()
        for i, datagrams in enumerate(report.telemetry):
            for datagram in datagrams:
                if sample := self.links[i].feed(datagram.data, self.now):
                    self.samples[i].append(sample)
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
        if self.bed.frame % COMMANDS == 0:
            for i, link in enumerate(self.links):
                self.bed.receive(i, link.command(self.now), peer="driver")

    def arm(self):
        """As a person does who sees a link that is not armed."""
        for i, link in enumerate(self.links):
            if link.arming is Arming.DISARMED and not link.obstacle(self.now):
                link.arm(self.now)
                self.arming_asked[i] += 1

    def go(self, posture, timeout=20.0):
        """Move there and wait for the rest to be observed; whether it was."""
        done, seen, end = None, len(self.observations), self.bed.now + timeout * SECOND
        order = None
        while self.bed.now < end:
            if self.bed.frame % COMMANDS == 0:
                self.arm()
                if not all(link.armed for link in self.links):
                    order = None
                elif done is None:
                    q = tuple(samples[-1].position for samples in self.samples)
                    order = order or plan(self.guess, q, tuple(posture))
                    self.send(order)
                    if np.abs(np.subtract(q, posture)).max() < 0.005:
                        done = self.bed.now
                elif order:
                    self.send(order)
            self.step()
            if done is not None:
                if len(self.observations) > seen and self.observations[-1].used:
                    return True
                if self.bed.now > done + WAIT * SECOND:
                    return False
        return False

    def make(self, maneuvers, pause, timeout=20.0):
        """Maneuvers, as the node `experiment` makes them; what comes of them."""
        for stop in maneuver_waypoints(maneuvers, pause):
            order, since, end = None, 0, self.bed.now + timeout * SECOND
            while not since or self.bed.now < since + stop.pause * SECOND:
                assert since or self.bed.now < end, "it does not arrive"
                if self.bed.frame % COMMANDS == 0:
                    self.arm()
                    if all(link.armed for link in self.links):
                        q = tuple(samples[-1].position for samples in self.samples)
                        order = order or plan(self.guess, q, tuple(stop.q), stop.duration)
                        self.send(order)
                        near = np.abs(np.subtract(q, stop.q)).max() < 0.005
                        since = since or near * self.bed.now
                self.step()
        self.maneuvers += self.maneuver_finder.close()
        return self.maneuvers

    def send(self, order):
        for link, part in zip(self.links, order.profiles, strict=True):
            with suppress(CommandError):  # it was lost just now
                link.set(
                    21, part.target, part.velocity, part.acceleration, self.now + SECOND, self.now
                )

    def run(self):
        """The whole experiment; the calibration that comes of it."""
        for posture in self.postures:
            self.go(posture)
        for _ in range(ROUNDS):
            for lost in rejected_without_repeat(self.observations, np.radians(1.0)):
                self.go(lost.q)
        self.observations += self.finder.close()
        self.maneuvers += self.maneuver_finder.close()
        settings = KinematicSettings(parametrization="full")
        return calibrate(self.observations, self.guess, settings, self.finder.streams())

    def dynamic(self):
        """The dynamic calibration from the moves between the postures, kinematics known."""
        streams = self.maneuver_finder.streams()
        return calibrate_dynamics(self.maneuvers, self.truth, DYNAMIC, streams)

    def errors(self, result):
        """Of each parameter, in its standard deviations."""
        true = self.truth.vector()[kinematic_index(4)]
        off = np.array(result.values) - true
        angles = np.array(result.estimate.units) == "rad"
        off[angles] = (off[angles] + pi) % (2 * pi) - pi
        return off / np.sqrt(np.diag(np.asarray(result.covariance).reshape(len(off), -1)))
