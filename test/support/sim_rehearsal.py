"""Experiments under fault scripts, with the joints and errors of a preset."""

from dataclasses import replace
from math import pi

import numpy as np

from fss_arm_calib.dynamic.calibrate import calibrate as calibrate_dynamics
from fss_arm_calib.experiment.postures import DEFAULT_POSTURES
from fss_arm_calib.kinematic.calibrate import calibrate
from fss_arm_calib.kinematic.settings import KinematicSettings
from fss_arm_model.description_file import load
from fss_arm_model.layout import kinematic_index
from fss_rehearsal.loops.calibration import DYNAMIC as DYNAMIC
from fss_rehearsal.loops.calibration import Experiment
from fss_sim.faults import read_script
from fss_sim.noise import PRESETS
from fss_sim.plant.joints import PRESETS as JOINTS
from fss_sim.plant.plant import World
from fss_sim.plant.surroundings import Surroundings
from fss_sim.testbed import State
from fss_sim.vicon import Vicon


class Rehearsal(Experiment):
    """The experiment: truth and guess are those of a folder, or given."""

    def __init__(
        self,
        config=None,
        script="",
        noise=None,
        seed=1,
        postures=DEFAULT_POSTURES,
        preset="paper",
        room=None,
        arms=None,
        q=(0.0,) * 4,
        twist=(0.0,) * 3,
        tilt=(0.0,) * 2,
        dynamic=DYNAMIC,
        **options,
    ):
        truth, guess = arms or (load(config / "truth.yaml"), load(config / "cad.yaml"))
        q, qd = np.array([[0.0, 0.0, 0.0, *q], [*twist, 0.0, 0.0, 0.0, 0.0]]).tolist()
        state = State(frame=0, boots=1, rests=0, q=tuple(q), qd=tuple(qd))
        noise = replace(PRESETS[preset], **(noise or {}))
        super().__init__(
            truth,
            guess,
            noise,
            World(JOINTS[preset], Surroundings(tilt=tilt)),
            state,
            seed,
            KinematicSettings(),
            dynamic,
            script=read_script(script),
            vicon=Vicon(noise, room, seed, [0, 1]) if room else None,
            **options,
        )
        self.postures = list(np.asarray(postures))

    def run(self):
        """Run the whole experiment; return the kinematic calibration."""
        super().run(self.postures)
        settings = KinematicSettings(parametrization="full")
        return calibrate(self.observations, self.guess, settings, self.finder.streams())

    def dynamic(self):
        """The dynamic calibration from the moves between the postures, kinematics known."""
        streams = self.maneuver_finder.streams()
        return calibrate_dynamics(self.maneuvers, self.truth, DYNAMIC, streams)

    def errors(self, result):
        """Of each parameter, in its standard deviations."""
        off = np.array(result.values) - self.truth.vector()[kinematic_index(4)]
        angles = np.array(result.estimate.units) == "rad"
        off[angles] = (off[angles] + pi) % (2 * pi) - pi
        return off / np.sqrt(np.diag(np.asarray(result.covariance).reshape(len(off), -1)))
