"""Links' telemetry while joints turn one after the other: of the test bed's plant, in process."""

from collections.abc import Sequence
from dataclasses import dataclass
from random import Random

import numpy as np
from calib_rig import START, Sample, feed

from fss_arm_calib.drives.calibrate import Telemetry
from fss_arm_calib.segments.excitations import Excitation, ExcitationFinder, Frame
from fss_arm_model.description import Arm
from fss_sim.link.instruments import Instruments, make_instruments
from fss_sim.noise import PRESETS as NOISES
from fss_sim.plant.joints import PRESETS as JOINTS
from fss_sim.plant.joints import link_normals, outboard_momentum
from fss_sim.plant.plant import Plant
from fss_sim.plant.vehicle import Demand, World

FRAME = 0.01  # [s]
PRESET = "laboratory"

Move = tuple[Sequence[float], float]  # to where [rad], in what time [s]


@dataclass(frozen=True)
class Flown:
    """What links reported, and what they measured with."""

    telemetry: list[Telemetry]
    instruments: list[Instruments]

    def zero(self, j: int) -> float:
        """Mean zero of a torque sensor as it warmed up [N m]."""
        seconds = 1e-9 * (self.telemetry[j].stamps - START)
        sensor = self.instruments[j].torque
        return float(sensor._zero + sensor._drift * np.mean(1.0 - np.exp(-seconds / 1200.0)))


def excitation(n: int, rng: np.random.Generator) -> list[Move]:
    """Each joint alone, to and fro, fast and slow, from two postures; never at the same beat."""
    moves: list[Move] = []
    for posture in np.radians([[0, 40, -60, 50], [30, -60, 40, -50]])[:, :n]:
        moves.append((posture, 4.0))
        for j in range(n):
            for way, time in ((1.2, 3), (0.8, 2.4), (1, 4), (0.3, 3), (0.12, 3), (0.06, 3)):
                away = posture.copy()
                away[j] += way if posture[j] < 0.0 else -way
                moves += [(away, time * rng.uniform(1.0, 1.1)) for away in (away, posture)]
    return moves


def fly(arm: Arm, moves: Sequence[Move], seed: int, rate: float = 5.0) -> Flown:
    """The telemetry of an arm whose drives follow trapezoids, with ramps of a third of the time."""
    plant = Plant(arm, np.zeros(3 + arm.n), world=World(JOINTS[PRESET]))
    instruments = [
        make_instruments(
            link.torque_sensor, NOISES[PRESET], Random(f"{seed} {i}"), 80, Random(f"{i} {seed}")
        )
        for i, link in enumerate(arm.links)
    ]
    step = round(1.0 / rate / FRAME)
    phases = np.random.default_rng(seed).integers(0, step, arm.n)
    rows: list[list[tuple[float, ...]]] = [[] for _ in arm.links]
    before, frame = outboard_momentum(plant.p, plant.q, plant.qd), 0
    sampled = [0] * arm.n
    for goal, time in moves:
        ways = np.abs(np.asarray(goal) - plant.q[3:])
        for i, way in enumerate(ways.tolist()):
            limits = max(1.5 * way / time, 1e-3), max(4.5 * way / time**2, 1e-3)
            plant.command(i, Demand(21, goal[i], *limits))
        for _ in range(round((time + 1.0) / FRAME)):
            plant.advance(FRAME)
            frame += 1
            now = outboard_momentum(plant.p, plant.q, plant.qd)
            shear = np.sum((now - before) / FRAME * link_normals(plant.p, plant.q), axis=1)
            before, clock = now, round(1e6 * FRAME * frame)
            for i, motion in enumerate(plant.motions()):
                of, drive = instruments[i], arm.links[i].drive
                of.torque.sample(clock, motion.torque, float(shear[i]))
                if of.torque.age(clock) < 1e6 * FRAME:
                    sampled[i] = clock  # a converter's own clock would have done so a little before
                if (frame + phases[i]) % step:
                    continue
                count = drive.direction * 2.0 * np.pi / drive.counts_per_turn
                rows[i].append(
                    (
                        START + 1000 * clock,
                        round(of.encoder.reading(motion.q) / count),
                        round(10.0 * of.encoder.rate(motion.q, motion.qd) / count),
                        round(100.0 * drive.direction * motion.current),
                        of.torque.counts,
                        (clock - sampled[i]) // 1000,
                    )
                )
    return Flown([_telemetry(one) for one in rows], instruments)


def samples(telemetry: Sequence[Telemetry]) -> list[Sample]:
    """It as links send it, in order of time."""
    found = []
    for i, one in enumerate(telemetry, 1):
        columns = (one.position, one.velocity, one.current, one.torque, one.torque_age)
        rows = zip(*(column.tolist() for column in columns), strict=True)
        found += [
            Sample(t, i, Frame(*row, boot=1, homings=1))
            for t, row in zip(one.stamps.tolist(), rows, strict=True)
        ]
    return sorted(found, key=lambda one: (one.t, one.stream))


def excitations(telemetry: Sequence[Telemetry], arm: Arm) -> list[Excitation]:
    """What a finder makes of it."""
    return feed(ExcitationFinder(arm), samples(telemetry))


def _telemetry(rows: list[tuple[float, ...]]) -> Telemetry:
    stamps, *columns = zip(*rows, strict=True)
    return Telemetry(np.array(stamps, np.int64), *(np.array(c, float) for c in columns))
