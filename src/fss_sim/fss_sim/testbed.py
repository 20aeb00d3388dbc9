"""The whole test bed, frame by frame: plant, sensors, and the electronics of the links.

Pure: time is what the caller lets pass, datagrams are bytes. One frame is one picture of VICON.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fss_arm_model.description import Arm
from fss_arm_model.extents import Extents
from fss_arm_model.files import read_yaml, shown, write_text
from fss_arm_model.kernels import Floats
from fss_arm_model.units import SECOND
from fss_sim.board.board import Board
from fss_sim.faults import Event, Faults
from fss_sim.link.channel import Datagram
from fss_sim.link.link import Link
from fss_sim.link.radio import Air, Radio
from fss_sim.noise import Noise
from fss_sim.plant.plant import Plant, World
from fss_sim.sensors import RATE, Sensors, Sight
from fss_sim.vicon import Pose, Room

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
        room: where VICON's cameras and markers are.
        radio: the channel that links and board share; None: what is sent is there at once.
    """

    def __init__(
        self,
        arm: Arm,
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
        room: Room | None = None,
        radio: Radio | None = None,
    ) -> None:
        target = np.reshape(state.target, (2, 3))
        self.plant = Plant(arm, state.q, state.qd, world, target, state.holds, state.propellant)
        self.room, self._p = room or Room(), arm.vector()
        self.sensors = Sensors(noise, seed, state.rests, self.room)
        self.faults = Faults(arm.n, script)
        keys = keys or {}
        self.air = Air(radio, f"{seed}, {state.boots}") if radio else None
        self.links = [
            Link(i, k, noise, seed, state.boots, rate, keys.get(i), torque_rate, charge, self.air)
            for i, k in enumerate(arm.links, 1)
        ]
        self.board = (
            Board(noise, seed, state.boots, board_rate, keys.get(0), self.air)
            if board_rate
            else None
        )
        self.frame, self._boots = state.frame, state.boots
        for part in self._electronics():
            part.start(self._boots, self.now, part.uptime)
        self._motions = self.plant.motions()

    @property
    def now(self) -> int:
        """Time of the last frame since the first begin [ns]."""
        return self.frame * FRAME

    def step(self) -> Report:
        """Let one frame's time pass."""
        faulted = self.faults.advance(self.now / SECOND)
        self._supply()
        if self.air:
            self.air.taken = self.faults.radio.interference
        self.plant.thrusters.stick(self.faults.stuck_open, self.faults.stuck_closed)
        if self.board:
            self.board.act(self.now, self.plant)
        for i, link in enumerate(self.links):
            self.plant.command(i, link.demand(self.now, self._motions[i]))
        self.plant.advance(1.0 / RATE)
        self._motions = self.plant.motions()
        self.frame += 1
        plant, of = self.plant, self.faults
        rate, qd = float(plant.qd[2]), plant.qd[3:]
        target = plant.target[0].tolist() if plant.world.target else None
        sight = self.sensors.observe(
            self.frame, plant.base, plant.tip, rate, qd, of.base, of.tip, of.gyro, target,
            self._bodies(target) if self.sensors.noise.vicon_occlusion else (),
        )  # fmt: skip
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

    def charge(self) -> None:
        """Make all batteries full; a link whose battery was empty starts again."""
        for link in self.links:
            link.instruments.battery.charge = 1.0

    def _bodies(self, target: Pose | None) -> Floats:
        """What stands in the cameras' way."""
        around = self.plant.world.surroundings
        extents = Extents(around.table, around.base_radius, around.link_radius)
        return self.room.bodies(self._p, self.plant.q, target, extents, around.base_radius)

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
        q, qd, target = (tuple(x.ravel().tolist()) for x in (plant.q, plant.qd, plant.target))
        used = plant.thrusters.used
        return State(self.frame, self._boots, self.sensors.rests, q, qd, target, plant.holds, used)
