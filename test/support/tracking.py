"""Base and target floating on the simulated table, and what navigation makes of their sensors."""

from dataclasses import dataclass

import numpy as np

from fss_arm_model.description import load
from fss_gnc.navigation import EstimatorSettings, Navigation
from fss_sim.link.instruments import Encoder
from fss_sim.noise import PRESETS
from fss_sim.plant.drives import VELOCITY
from fss_sim.plant.plant import Demand, Plant, World
from fss_sim.plant.target import Target
from fss_sim.sensors import RATE, Sensors

SECOND = 1_000_000_000
FRAME = SECOND // RATE
READ = 20  # frames from one reading of a joint to its next
PERIOD = 10  # frames from one command of the valves to the next


@dataclass(frozen=True)
class Tracked:
    """Squares of errors in terms of what they are said to be, by frame."""

    base: np.ndarray  # (k,) NEES of pose and twist, 6 degrees of freedom; NaN: not known
    target: np.ndarray  # (k,)
    nis: dict  # of the base, by what was measured
    rejected: dict  # of the base
    error: np.ndarray  # (k, 6) of the base


def nees(state, pose, twist):
    """The error's square by its covariance, and the error."""
    error = np.concatenate([state.pose - pose, state.twist - twist])
    error[2] = (error[2] + np.pi) % (2.0 * np.pi) - np.pi
    return error @ np.linalg.solve(state.covariance, error), error


def track(
    seed, frames, *, arm="config/truth.yaml", known=None, outage=(0, 0), moving=True,
    thrusting=True, preset="default", settings=None, gyro=True,
):  # fmt: skip
    """Fly with random pulses of thrusters and a moving arm; poses are missing in the outage."""
    rng = np.random.default_rng((7, seed))
    arm = load(arm)
    noise = PRESETS[preset]
    world = World(target=Target())
    q = np.concatenate([rng.uniform(-0.5, 0.5, 2), rng.uniform(-3, 3, 1), rng.uniform(-1, 1, 4)])
    qd = np.concatenate([rng.normal(0, [0.02, 0.02, 0.05]), np.zeros(4)])
    drifting = rng.normal(0, [0.02, 0.02, 0.15])
    plant = Plant(arm, q, qd, world, [[1.0, 1.0, 1.0], drifting])
    sensors = Sensors(noise, seed)
    navigation = Navigation(load(known) if known else arm, settings or EstimatorSettings())
    encoders = [Encoder(noise.encoder_error, rng.uniform(-np.pi, np.pi)) for _ in range(arm.n)]
    demands, base, target, errors = np.zeros(arm.n), [], [], []
    nis = {"pose": [], "gyro": []}
    for frame in range(frames):
        now = frame * FRAME
        if moving and frame % 150 == 100:  # a ramp to another rate, then to rest
            going = rng.random() < 0.7
            demands = rng.uniform(-0.2, 0.2, arm.n) * going
            slopes = rng.uniform(0.05, 0.5, arm.n)
            for i in range(arm.n):
                plant.command(i, Demand(VELOCITY, demands[i], abs(demands[i]), slopes[i]))
        if thrusting and frame % PERIOD == 0:
            on_times = np.round(rng.uniform(0.0, 0.1, 8) * (rng.random(8) < 0.3), 3)
            on_times[on_times < 0.01] = 0.0
            plant.thrust(on_times)
            navigation.pulses(now, on_times)
        plant.advance(1.0 / RATE)
        now += FRAME
        for i, motion in enumerate(plant.motions()):
            if frame % READ == 5 * i:
                e = encoders[i]
                navigation.joint(i, now, e.reading(motion.q), e.rate(motion.q, motion.qd))
        seen = sensors.observe(
            frame + 1, plant.base, plant.tip, float(plant.qd[2]), plant.qd[3:],
            target=plant.target[0].tolist(),
        )  # fmt: skip
        if gyro and navigation.base.rate(now, seen.rate):
            nis["gyro"].append(navigation.base.nis[2.0][-1])
        if not outage[0] <= frame < outage[1]:
            if navigation.base.pose(now, *seen.base.pose):
                nis["pose"].append((navigation.base.nis[1.0] or [0])[-1])
            navigation.target_pose(now, *seen.target.pose)
        navigation.predict(now)
        square, error = nees(navigation.base.state(), plant.q[:3], plant.qd[:3])
        base.append(np.nan if navigation.base.lost(now) else square)
        errors.append(error)
        target.append(nees(navigation.target.state(), *plant.target)[0])
    return Tracked(
        np.array(base), np.array(target), nis, navigation.base.rejected, np.array(errors)
    )
