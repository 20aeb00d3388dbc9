"""Test bed, simulated frame by frame: plant, sensors, and electronics of links and board.

This module does no communication: the caller advances the time, and datagrams are bytes. One frame
is one picture of VICON.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from secrets import randbelow
from typing import Any, NamedTuple

import numpy as np

from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm, Base
from fss_arm_model.extents import Extents
from fss_arm_model.files import ContentError, read_yaml, short, write_text
from fss_arm_model.units import SECOND
from fss_sim.board.board import Board
from fss_sim.faults import Event, Faults
from fss_sim.link.channel import Datagram
from fss_sim.link.link import Link
from fss_sim.link.power import Power
from fss_sim.link.radio import RadioChannel, Station
from fss_sim.noise import Noise
from fss_sim.plant.bed import Bed
from fss_sim.plant.joints import link_normals, outboard_momentum
from fss_sim.plant.plant import Plant
from fss_sim.plant.target import PassiveTarget
from fss_sim.plant.vehicle import Motion, Vehicle, World
from fss_sim.sensors import RATE, Readings, Sensors, compose
from fss_sim.vicon import BASE, NOT_VISIBLE, TARGET, TIP, MarkerResult, Pose, Room, Vicon

FRAME = SECOND // RATE  # [ns]
OUTAGE_FRAMES = RATE  # frames by which time advances while a test bed is not running
BOOT_NUMBERS = 65535  # number of boot numbers: 1 to 65535, which fit into the frames' field


class StateError(ValueError):
    """Exception for a file that does not contain the state of this test bed."""


@dataclass(frozen=True)
class State:
    """State of a test bed that survives a power loss: motion of its bodies, and counters.

    All errors depend only on the counters and the seed. Boot numbers start at a random offset, so
    that a test bed without a state file does not repeat those of its last run.
    """

    frame: int  # frames since the first start
    boots: int  # starts of the electronics
    rests: int  # rests of the arm, each with its own error of the sensors
    q: tuple[float, ...]  # (3 + n)
    qd: tuple[float, ...]  # (3 + n)
    target: tuple[float, ...] = 6 * (0.0,)  # pose and twist of the target
    holds: bool = False  # True if the gripper holds the target
    propellant: float = 0.0  # propellant used [kg]
    boot_offset: int = field(default_factory=partial(randbelow, BOOT_NUMBERS))  # of boot numbers

    @property
    def boot(self) -> int:
        """Boot number of the newest start, as in the frames of the protocol."""
        return boot_number(self.boot_offset, self.boots)

    def save(self, path: Path) -> None:
        """Write the state to a file, which is replaced atomically."""
        write_text(path, json.dumps(asdict(self)) + "\n")

    @classmethod
    def load(cls, path: Path, n: int) -> "State":
        """Read a state that `save` wrote for a test bed with n links.

        Raises:
            StateError: if the file does not contain such a state.
        """
        try:
            given = read_yaml(path)
            numbers = {name: int(given[name]) for name in ("frame", "boots", "rests")}
            if "boot_offset" in given:  # files of 0.1.0 have none
                numbers["boot_offset"] = int(given["boot_offset"])
            q, qd, target = (tuple(map(float, given[name])) for name in ("q", "qd", "target"))
            holds, propellant = bool(given["holds"]), float(given["propellant"])
        except ContentError as error:
            raise StateError(str(error)) from None
        except (ValueError, TypeError, KeyError, OverflowError) as error:
            reason = f"{error} is missing" if isinstance(error, KeyError) else error
            raise StateError(
                f"{path} does not contain the state of a test bed: {short(str(reason))}"
            ) from None
        if not len(q) == len(qd) == 3 + n or not np.isfinite((q, qd)).all():
            raise StateError(
                f"{path} contains {len(q)} coordinates, expected {3 + n} finite ones for {n} links"
            )
        return cls(**numbers, q=q, qd=qd, target=target, holds=holds, propellant=propellant)

    def after_restart(self) -> "State":
        """Return the state at the next start; its time is later than all published times."""
        return replace(self, frame=self.frame + OUTAGE_FRAMES, boots=self.boots + 1)


def boot_number(offset: int, boots: int) -> int:
    """Return the boot number of a test bed's start number `boots`; 65535 is followed by 1."""
    return (offset + boots - 1) % BOOT_NUMBERS + 1


class Report(NamedTuple):
    """Outputs of one frame."""

    readings: Readings
    telemetry: Sequence[Sequence[Datagram]]  # telemetry of each link that has arrived
    faults_changed: bool  # True if the active faults have changed
    board: Sequence[Datagram] = ()  # telemetry of the board that has arrived


class Testbed:
    """Floating arm with the electronics of its links and the sensors that observe it.

    Args:
        arm: true parameters of the arm.
        noise: sizes of the instruments' errors.
        seed: seed of all errors.
        state: initial state.
        rate: telemetry rate of the links [frames/s].
        keys: for each link, the key that signs its frames; key 0 is that of the board.
        torque_rate: samples of the torque converters per second.
        charge: charge of all batteries, 0 to 1.
        script: fault script.
        world: parameters of the plant, except those of the arm.
        board_rate: telemetry rate of the base's board [frames/s]; 0: no board.
        bed: table that several vehicles share (`place_on_table`); None: a table of its own.
        number: index of this vehicle on that table.
        power: parameters of batteries and loads.
        radio_channel: shared by all vehicles; None: no radio, so that only faults delay datagrams.
        vicon: cameras of the table; None: cameras of its own, if the noise model has markers.
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
        bed: Bed | None = None,
        number: int = 0,
        power: Power | None = None,
        radio_channel: RadioChannel | None = None,
        vicon: Vicon | None = None,
    ) -> None:
        self._target = np.reshape(state.target, (2, 3))  # as given
        self.bed = (
            bed
            or Plant(arm, state.q, state.qd, world, self._target, state.holds, state.propellant).bed
        )
        self.plant = self.bed.vehicles[number]
        links = arm.links if isinstance(arm, Arm) else ()
        self.sensors, self.radio_channel = Sensors(noise, seed, state.rests), radio_channel
        kinds = [*self.subjects, *(TARGET for _ in self.bed.targets)]
        own_vicon = Vicon(noise, Room(), seed, kinds) if noise.markers else None
        self.vicon = vicon or own_vicon
        self.marker_results: dict[int, MarkerResult] = {}  # of the last picture, by kind of subject
        self.faults = Faults(len(links), script)
        keys = keys or {}
        self.links = [
            Link(
                i,
                k,
                noise,
                seed,
                state.boots,
                rate,
                keys.get(i),
                torque_rate,
                charge,
                power,
                self._station(f"{i}"),
            )
            for i, k in enumerate(links, 1)
        ]
        self.board = (
            Board(
                noise,
                seed,
                state.boots,
                board_rate,
                keys.get(0),
                charge,
                power,
                self._station("board"),
            )
            if board_rate
            else None
        )
        self.frame, self._boots, self._boot_offset = state.frame, state.boots, state.boot_offset
        for part in self._electronics():
            part.start(self.boot, self.now, part.uptime)
        self._motions = self.plant.motions()
        self._measures_shear = noise.torque_crosstalk > 0.0 and bool(links)
        self._outboard_momentum = self._link_momenta() if links else np.zeros((0, 2))

    @property
    def now(self) -> int:
        """Time of the last frame since the first start [ns]."""
        return self.frame * FRAME

    @property
    def boot(self) -> int:
        """Boot number of the newest start, as in the frames of the protocol."""
        return boot_number(self._boot_offset, self._boots)

    def step(self) -> Report:
        """Advance by one frame."""
        return step([self])[0]

    def apply_commands(self) -> bool:
        """Command drives, valves and gripper until the next frame.

        Returns:
            True if the active faults have changed.
        """
        faults_changed = self.faults.advance(self.now / SECOND)
        self._switch_electronics()
        self.plant.thrusters.set_stuck(self.faults.stuck_open, self.faults.stuck_closed)
        if self.board:
            self.board.apply_commands(self.now, self.plant)
        for i, link in enumerate(self.links):
            self.plant.command(i, link.demand(self.now, self._motions[i]))
            self.plant.block(i, link.drive.blocked)
        return faults_changed

    def observe(self, faults_changed: bool) -> Report:
        """Return the outputs of the past frame."""
        self._motions = self._measured_motions()
        self.frame += 1
        plant, of = self.plant, self.faults
        rate, target = float(plant.qd[2]), self.target[0].tolist() if self.bed.targets else None
        # Without an arm the pose of the tip is not used. Rests are detected by the motion of the
        # drives, as links can still oscillate on their gears while the drives are at rest.
        tip = plant.tip if plant.n else (0.0, 0.0, 0.0)
        qd = np.array([motion.qd for motion in self._motions] or [0.0])
        readings = self.sensors.observe(
            self.frame,
            plant.base,
            tip,
            rate,
            qd,
            of.base,
            of.tip,
            of.gyro,
            target,
            self.marker_results,
            of.target,
        )
        telemetry = [
            link.report(self.now, self._motions[i], 1.0 / RATE, of.links[i], of.drives[i])
            for i, link in enumerate(self.links)
        ]
        board: Sequence[Datagram] = ()
        if self.board:
            board = self.board.report(self.now, plant, readings.rate, 1.0 / RATE, of.board)
        return Report(readings, telemetry, faults_changed, board)

    def receive(self, link: int, data: bytes, peer: Any = None, delay: int = 0) -> None:
        """Pass a datagram to a link, counted from 0, `delay` ns after the last frame.

        A link sends its telemetry to the peer whose command it accepted last.
        """
        self.links[link].receive(data, peer, self.now + delay, self.faults.links[link])

    def receive_base(self, data: bytes, peer: Any = None, delay: int = 0) -> None:
        """Pass a datagram to the base's board, as to a link."""
        if self.board:
            self.board.receive(data, peer, self.now + delay, self.faults.board)

    @property
    def subjects(self) -> dict[int, Pose]:
        """True poses of the vehicle's VICON subjects."""
        base = self.plant.base
        return {BASE: base, TIP: compose(base, self.plant.tip)} if self.plant.n else {BASE: base}

    def bodies(self, room: Room) -> Floats:
        """Return the vehicle's bodies that can hide markers, by Room.bodies."""
        around = self.plant.world.surroundings
        extents = Extents(around.table, around.base_radius, around.link_radius)
        return room.bodies(self.plant.p, self.plant.q, extents)

    @property
    def target(self) -> Floats:
        """Pose and twist of the target, (2, 3); those of the initial state if there is none."""
        targets = self.bed.targets
        return targets[0].state if targets else self._target

    def charge(self) -> None:
        """Charge all batteries; electronics with an empty battery start again."""
        for link in self.links:
            link.supply.battery.charge = 1.0
        if self.board:
            self.board.battery.charge = 1.0

    def _station(self, part: str) -> Station | None:
        name = f"{self.plant.name} {part}" if self.plant.name else part
        return self.radio_channel.station(name) if self.radio_channel else None

    def _measured_motions(self) -> list[Motion]:
        """Return the motions; with crosstalk, also the mean shear forces of the last frame."""
        motions = self.plant.motions()
        if not self._measures_shear:
            return motions
        before, self._outboard_momentum = self._outboard_momentum, self._link_momenta()
        forces = RATE * (self._outboard_momentum - before)
        across = np.sum(forces * link_normals(self.plant.p, self.plant.q), axis=1).tolist()
        return [m._replace(shear=f) for m, f in zip(motions, across, strict=True)]

    def _link_momenta(self) -> Floats:
        """Return the linear momentum of all links beyond each joint, (n, 2) [N s]."""
        return outboard_momentum(self.plant.p, self.plant.q, self.plant.qd)

    def _electronics(self) -> list[Link | Board]:
        return [*self.links, self.board] if self.board else [*self.links]

    def _switch_electronics(self) -> None:
        """Stop links and board that lose power; start those that regain it, disarmed."""
        faults = [*self.faults.links, self.faults.board]
        for part, its in zip(self._electronics(), faults, strict=False):
            powered = part.has_power(its)
            if part.running and not powered:
                part.stop()
            elif powered and not part.running:
                self._boots += 1
                part.start(self.boot, self.now)

    def state(self) -> State:
        """Return the state to save."""
        plant = self.plant
        q, qd, target = (tuple(x.ravel().tolist()) for x in (plant.q, plant.qd, self.target))
        return State(
            self.frame,
            self._boots,
            self.sensors.rests,
            q,
            qd,
            target,
            plant.payload is not None,
            plant.thrusters.propellant_used,
            self._boot_offset,
        )


def place_on_table(vehicles: Sequence[Vehicle], states: Sequence[State]) -> Bed:
    """Return a table with vehicles in their states and the target of the first vehicle's world.

    Only one vehicle can hold the target: the first one whose state says so. Other grips are open.
    """
    world = vehicles[0].world
    if world.target:
        at = np.reshape(states[0].target, (2, 3))
        targets = [PassiveTarget(world.target, at, world.surroundings)]
    else:
        targets = []
    holders = [one for one, state in zip(vehicles, states, strict=True) if targets and state.holds]
    for one in holders[:1]:
        one.closed = True
        one.attach(targets[0])
    return Bed(vehicles, targets, world.contact, world.tolerance)


def step(vehicles: Sequence[Testbed]) -> list[Report]:
    """Advance all vehicles of a table by one frame."""
    first = vehicles[0]
    faults_changed = [one.apply_commands() for one in vehicles]
    if first.radio_channel:
        first.radio_channel.interference = max(one.faults.radio.interference for one in vehicles)
    first.bed.advance(1.0 / RATE)
    if first.vicon:
        take_picture(first.vicon, vehicles)
    return [one.observe(of) for one, of in zip(vehicles, faults_changed, strict=True)]


def take_picture(vicon: Vicon, vehicles: Sequence[Testbed]) -> None:
    """Take one picture of all vehicles of a table, and give each vehicle its results."""
    first, targets = vehicles[0], vehicles[0].bed.targets
    subjects = [one.subjects for one in vehicles]
    poses = [pose for its in subjects for pose in its.values()]
    poses += [(*one.state[0].tolist(),) for one in targets]
    bodies = np.empty((0, 6))
    if vicon.occlusion:
        rows = [one.bodies(vicon.room) for one in vehicles]
        rows += [vicon.room.disc(TARGET, one.state[0], one.target.radius) for one in targets]
        bodies = np.concatenate(rows)
    frame = first.frame + 1
    results = iter(vicon.take_picture(frame, poses, bodies, frame // first.sensors.hold))
    for one, its in zip(vehicles, subjects, strict=True):
        one.marker_results = {kind: next(results) for kind in its}
    target = next(results, NOT_VISIBLE)
    for one in vehicles:
        one.marker_results[TARGET] = target
