"""Base and target floating on the simulated table, and what navigation makes of their sensors."""

from dataclasses import dataclass

import numpy as np

from fss_arm_model.description_file import load
from fss_arm_model.held import Target
from fss_arm_model.units import SECOND
from fss_gnc.navigation import Navigation
from fss_gnc.navigation.body_filter import POSE
from fss_gnc.navigation.body_filter import RATE as TURN_RATE
from fss_sim.link.instruments import Encoder
from fss_sim.noise import PRESETS
from fss_sim.plant.drives import MODE_VELOCITY
from fss_sim.plant.plant import Plant
from fss_sim.plant.surroundings import Surroundings
from fss_sim.plant.vehicle import Demand, World
from fss_sim.sensors import RATE, Sensors, compose
from fss_sim.vicon import BASE, TARGET, TIP, Room, Vicon

FRAME = SECOND // RATE
READ = 20  # frames from one reading of a joint to its next
PLANNED = 5  # frames from one telling of the plan to the next
PERIOD = 10  # frames from one command of the valves to the next


@dataclass(frozen=True)
class Tracked:
    """Squares of errors in terms of what they are said to be, by frame."""

    base: np.ndarray  # (k,) NEES of pose and twist, 6 degrees of freedom; NaN: not known
    target: np.ndarray  # (k,)
    nis: dict  # of the base, by what was measured
    error: np.ndarray  # (k, 6) of the base


def nees(state, pose, twist):
    """The error's square by its covariance, and the error."""
    error = np.concatenate([state.pose - pose, state.twist - twist])
    error[2] = (error[2] + np.pi) % (2.0 * np.pi) - np.pi
    return error @ np.linalg.solve(state.covariance, error), error


def ramp(was, wanted, slopes, t):
    """Rates of joints on their way from one to another."""
    return was + np.clip(wanted - was, -slopes * t, slopes * t)


def look_at(vicon, frame, plant):
    """What a picture gives of base, tip and target."""
    room, pose = vicon.room, plant.target[0]
    bodies = np.concatenate([room.bodies(plant.p, plant.q), room.disc(TARGET, pose, 0.19)])
    poses = [plant.base, compose(plant.base, plant.tip), pose]
    return dict(enumerate(vicon.take_picture(frame, poses, bodies)))


def track(
    seed,
    frames,
    *,
    known=None,
    outage=(0, 0),
    moving=True,
    thrusting=True,
    planned=True,
    told=True,
    gyro=True,
    noise=PRESETS["default"],
    settings=None,
    of_target=None,
):
    """Fly with random pulses of thrusters and a moving arm; poses are missing in the outage."""
    rng, arm = np.random.default_rng((7, seed)), load("config/truth.yaml")
    # Bodies that go through each other: what a bump does, no navigation knows beforehand.
    around = Surroundings(table=(20.0, 20.0))
    world = World(surroundings=around, target=Target(), contact=None)
    q = np.concatenate([rng.uniform(-0.1, 0.1, 2), rng.uniform(-3, 3, 1), rng.uniform(-1, 1, 4)])
    qd = np.concatenate([rng.normal(0, [0.02, 0.02, 0.05]), np.zeros(4)])
    drifting = rng.normal(0, [0.02, 0.02, 0.15])
    plant = Plant(arm, q, qd, world, [[1.0, 1.0, 1.0], drifting])
    sensors = Sensors(noise, seed)
    vicon = Vicon(noise, Room(), seed, (BASE, TIP, TARGET)) if noise.markers else None
    navigation = Navigation(load(known) if known else arm, settings, of_target)
    encoders = [Encoder(noise.encoder_error, rng.uniform(-np.pi, np.pi)) for _ in range(arm.n)]
    base, target, errors = [], [], []
    was, wanted, slopes, since = *np.zeros((2, arm.n)), np.ones(arm.n), 0.0  # of the rates
    nis = {"pose": [], "gyro": []}
    for frame in range(frames):
        now = frame * FRAME
        if moving and frame % 150 == 100:  # a ramp to another rate, then to rest
            was, since = ramp(was, wanted, slopes, frame / RATE - since), frame / RATE
            wanted = -np.sign(plant.q[3:]) * rng.uniform(0.0, 0.2, arm.n) * (rng.random() < 0.7)
            slopes = rng.uniform(0.05, 0.5, arm.n)
            for i in range(arm.n):
                plant.command(i, Demand(MODE_VELOCITY, wanted[i], abs(wanted[i]), slopes[i]))
        if planned and frame % PLANNED == 2:  # as the node arm tells it
            ahead = 0.1 * np.arange(6)
            rates = [ramp(was, wanted, slopes, now / SECOND + s - since) for s in ahead]
            navigation.inputs.set_plan(now, ahead, np.array(rates))
        if thrusting and frame % PERIOD == 0:
            on_times = np.round(rng.uniform(0.0, 0.1, 8) * (rng.random(8) < 0.3), 3)
            on_times[on_times < 0.01] = 0.0
            plant.thrust(on_times)
            if told:
                navigation.add_pulses(now, on_times)
        plant.advance(1.0 / RATE)
        now += FRAME
        for i, motion in enumerate(plant.motions()):
            if frame % READ == 5 * i:
                e = encoders[i]
                navigation.add_joint_reading(
                    i, now, e.reading(motion.q), e.rate(motion.q, motion.qd)
                )
        seen = sensors.observe(
            frame + 1,
            plant.base,
            plant.tip,
            float(plant.qd[2]),
            plant.qd[3:],
            target=plant.target[0].tolist(),
            marker_results=vicon and look_at(vicon, frame + 1, plant),
        )
        at = now - seen.base.age - round(SECOND * noise.vicon_latency)
        if gyro and navigation.base.update_rate(now, seen.rate):
            nis["gyro"].append(navigation.base.nis[TURN_RATE][-1])
        looks = not outage[0] <= frame < outage[1]
        has_base = looks and not seen.base.occluded
        if has_base and navigation.base.update_pose(at, *seen.base.pose) and frame:
            nis["pose"].append(navigation.base.nis[POSE][-1] / 3.0)
        if looks and not seen.target.occluded:
            navigation.update_target_pose(at, *seen.target.pose)
        navigation.predict(now)
        square, error = nees(navigation.base.state(), plant.q[:3], plant.qd[:3])
        base.append(np.nan if navigation.base.lost_reason(now) else square)
        errors.append(error)
        target.append(nees(navigation.target.state(), *plant.target)[0])
    return Tracked(np.array(base), np.array(target), nis, np.array(errors))
