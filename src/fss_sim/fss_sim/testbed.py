"""The whole test bed, frame by frame: plant, sensors, and the electronics of the links.

Pure: time is what the caller lets pass, datagrams are bytes. One frame is one picture of VICON.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from fss_arm_model.description import Arm, Base
from fss_arm_model.files import read_yaml, shown, write_text
from fss_arm_model.units import SECOND
from fss_sim.board.board import Board
from fss_sim.faults import Event, Faults
from fss_sim.link.channel import Datagram
from fss_sim.link.link import Link
from fss_sim.noise import Noise
from fss_sim.plant.bed import Bed
from fss_sim.plant.joints import axes, carried
from fss_sim.plant.plant import Floats, Motion, Plant, Vehicle, World
from fss_sim.plant.target import Passive
from fss_sim.sensors import RATE, Sensors, Sight

FRAME = SECOND // RATE  # [ns]
OUTAGE = RATE  # frames: how far time moves on while a testbed is not running


class StateError(ValueError):
    """A file does not hold the state of this test bed."""


@dataclass(frozen=True)
class State:
    """What a test bed keeps when its power goes: where the bodies are, and what it has counted."""

    frame: int  # frames since the first begin
    boots: int  # starts of the links' electronics
    rests: int  # of the arm, each with its own error of the sensors
    q: tuple[float, ...]  # (3 + n)
    qd: tuple[float, ...]  # (3 + n)
    target: tuple[float, ...] = 6 * (0.0,)  # its pose and twist
    holds: bool = False  # the gripper, the target
    propellant: float = 0.0  # used [kg]

    def save(self, path: Path) -> None:
        """Write it to a file, which at any time is whole."""
        write_text(path, json.dumps(asdict(self)) + "\n")

    @classmethod
    def load(cls, path: Path, n: int) -> "State":
        """Read what `save` wrote for a test bed of n links.

        Raises:
            StateError: the file holds something else.
        """
        try:
            given = read_yaml(path)
            numbers = {name: int(given[name]) for name in ("frame", "boots", "rests")}
            q, qd, target = (tuple(map(float, given[name])) for name in ("q", "qd", "target"))
            holds, propellant = bool(given["holds"]), float(given["propellant"])
        except (ValueError, TypeError, KeyError, OverflowError) as error:
            raise StateError(
                f"{path} does not hold the state of a test bed: {shown(error)}"
            ) from None
        if not len(q) == len(qd) == 3 + n or not np.isfinite((q, qd)).all():
            raise StateError(
                f"{path} holds {len(q)} coordinates, expected {3 + n} finite ones for {n} links"
            )
        return cls(**numbers, q=q, qd=qd, target=target, holds=holds, propellant=propellant)

    def resumed(self) -> "State":
        """The state at the next start; its time lies after all that was ever reported."""
        return replace(self, frame=self.frame + OUTAGE, boots=self.boots % 65535 + 1)


class Report(NamedTuple):
    """What comes out of one frame."""

    sight: Sight
    telemetry: Sequence[Sequence[Datagram]]  # that arrives, of each link
    faulted: bool  # the faults in force are others than before
    board: Sequence[Datagram] = ()  # of its telemetry that arrives


class Testbed:
    """A floating arm with its links' electronics and the sensors that observe it.

    Args:
        arm: the true parameters.
        noise: of the instruments.
        seed: of all errors.
        state: where to begin.
        rate: of the links' telemetry [frames/s].
        keys: by link, that frames are signed under.
        torque_rate: samples of the torque converters a second.
        charge: of the links' batteries, 0 to 1.
        script: faults to come.
        world: all that the plant is made of beside the arm.
        board_rate: of the telemetry of the base's board [frames/s]; 0: there is none.
        plant: the vehicle, if it shares the table with others (`together`).
    """

    def __init__(
        self,
        arm: Arm | Base,
        noise: Noise,
        seed: int,
        state: State,
        rate: float = 5.0,
        keys: Mapping[int, bytes] | None = None,
        torque_rate: int = 80,
        charge: float = 1.0,
        script: Sequence[Event] = (),
        world: World | None = None,
        board_rate: float = 0.0,
        plant: Vehicle | None = None,
    ) -> None:
        self._target = np.reshape(state.target, (2, 3))  # as given
        self.plant = plant or Plant(
            arm, state.q, state.qd, world, self._target, state.holds, state.propellant
        )
        links = arm.links if isinstance(arm, Arm) else ()
        self.sensors = Sensors(noise, seed, state.rests)
        self.faults = Faults(len(links), script)
        keys = keys or {}
        self.links = [
            Link(i, k, noise, seed, state.boots, rate, keys.get(i), torque_rate, charge)
            for i, k in enumerate(links, 1)
        ]
        self.board = (
            Board(noise, seed, state.boots, board_rate, keys.get(0)) if board_rate else None
        )
        self.frame, self._boots = state.frame, state.boots
        for part in self._electronics():
            part.start(self._boots, self.now, part.uptime)
        self._motions = self.plant.motions()
        self._strained = noise.torque_crosstalk > 0.0 and bool(links)
        self._carried = self._momenta() if links else np.zeros((0, 2))

    @property
    def now(self) -> int:
        """Time of the last frame since the first begin [ns]."""
        return self.frame * FRAME

    def step(self) -> Report:
        """Let one frame's time pass."""
        return step([self])[0]

    def act(self) -> bool:
        """Have drives, valves and gripper do what they are told until the next frame.

        Returns:
            Whether the faults in force are others than before.
        """
        faulted = self.faults.advance(self.now / SECOND)
        self._supply()
        self.plant.thrusters.stick(self.faults.stuck_open, self.faults.stuck_closed)
        if self.board:
            self.board.act(self.now, self.plant)
        for i, link in enumerate(self.links):
            self.plant.command(i, link.demand(self.now, self._motions[i]))
        return faulted

    def observe(self, faulted: bool) -> Report:
        """What comes out of the frame that has passed."""
        self._motions = self._measured()
        self.frame += 1
        plant, of = self.plant, self.faults
        rate, target = float(plant.qd[2]), self.target[0].tolist() if plant.bed.targets else None
        # Without an arm nobody asks where its tip is. Drives rest while links still swing on their
        # gears: errors of a rest are theirs.
        tip = plant.tip if plant.n else (0.0, 0.0, 0.0)
        qd = np.array([motion.qd for motion in self._motions] or [0.0])
        sight = self.sensors.observe(
            self.frame, plant.base, tip, rate, qd, of.base, of.tip, of.gyro, target
        )
        telemetry = [
            link.report(self.now, self._motions[i], 1.0 / RATE, of.links[i])
            for i, link in enumerate(self.links)
        ]
        board = self.board.report(self.now, plant, sight.rate, of.board) if self.board else ()
        return Report(sight, telemetry, faulted, board)

    def receive(self, link: int, data: bytes, peer: Any = None, late: int = 0) -> None:
        """Hand a datagram to a link, counted from 0, `late` ns after the last frame.

        A link's telemetry goes to the peer whose datagram it took last as a command.
        """
        self.links[link].put(data, peer, self.now + late, self.faults.links[link])

    def receive_base(self, data: bytes, peer: Any = None, late: int = 0) -> None:
        """Hand a datagram to the base's board, as to a link."""
        if self.board:
            self.board.put(data, peer, self.now + late, self.faults.board)

    @property
    def target(self) -> Floats:
        """Pose and twist of the target, (2, 3); those given if there is none."""
        targets = self.plant.bed.targets
        return targets[0].state if targets else self._target

    def charge(self) -> None:
        """Make all batteries full; a link whose battery was empty starts again."""
        for link in self.links:
            link.instruments.battery.charge = 1.0

    def _measured(self) -> list[Motion]:
        """The motions, with the mean forces of the last frame if instruments show them."""
        motions = self.plant.motions()
        if not self._strained:
            return motions
        before, self._carried = self._carried, self._momenta()
        forces = RATE * (self._carried - before)
        across = np.sum(forces * axes(self.plant.p, self.plant.q), axis=1).tolist()
        return [m._replace(shear=f) for m, f in zip(motions, across, strict=True)]

    def _momenta(self) -> npt.NDArray[np.float64]:
        """Momentum of what lies beyond each joint, (n, 2) [N s]."""
        return carried(self.plant.p, self.plant.q, self.plant.qd)

    def _electronics(self) -> list[Link | Board]:
        return [*self.links, self.board] if self.board else [*self.links]

    def _supply(self) -> None:
        """Take power from links and board, or give it back; one that starts never did so before."""
        faults = [*self.faults.links, self.faults.board]
        for part, its in zip(self._electronics(), faults, strict=False):
            powered = part.charged and not its.dead
            if part.running and not powered:
                part.stop()
            elif powered and not part.running:
                self._boots = self._boots % 65535 + 1
                part.start(self._boots, self.now)

    def state(self) -> State:
        """What to save."""
        plant = self.plant
        q, qd, target = (tuple(x.ravel().tolist()) for x in (plant.q, plant.qd, self.target))
        holds = any(one.holder is plant for one in plant.bed.targets)
        used = plant.thrusters.used
        return State(self.frame, self._boots, self.sensors.rests, q, qd, target, holds, used)


def together(vehicles: Sequence[Vehicle], states: Sequence[State]) -> None:
    """Put vehicles on one table, with the target of the first one's world, as their states have it.

    One that held another vehicle, or the target as the second one, has let go.
    """
    world = vehicles[0].world
    if world.target:
        at = np.reshape(states[0].target, (2, 3))
        targets = [Passive(world.target, at, world.surroundings)]
    else:
        targets = []
    holders = [one for one, state in zip(vehicles, states, strict=True) if targets and state.holds]
    for one in holders[:1]:
        one.closed = True
        one.take(targets[0])
    Bed(vehicles, targets, world.contact, world.tolerance)


def step(vehicles: Sequence[Testbed]) -> list[Report]:
    """Let one frame's time pass for all vehicles of a table."""
    faulted = [one.act() for one in vehicles]
    vehicles[0].plant.bed.advance(1.0 / RATE)
    return [one.observe(of) for one, of in zip(vehicles, faulted, strict=True)]
