"""Parameters of the test-bed node, and the objects that they configure."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from fss_arm_model.description import Arm, Base
from fss_arm_model.description_file import described
from fss_arm_model.files import read_text
from fss_arm_model.held import Target
from fss_arm_model.settings import (
    FINITE,
    NOT_NEGATIVE,
    Check,
    SettingError,
    Settings,
    above,
    at_least,
    between,
    like,
    one_of,
    setting,
)
from fss_arm_model.vehicle import Vehicle
from fss_sim.link.power import Power
from fss_sim.link.pty import LinkTerminal
from fss_sim.link.radio import Radio, RadioChannel
from fss_sim.link.tcp import LinkListener
from fss_sim.link.udp import LinkSocket
from fss_sim.noise import PRESETS, Noise
from fss_sim.plant.contact import Contact
from fss_sim.plant.joints import PRESETS as JOINTS
from fss_sim.plant.joints import Joints
from fss_sim.plant.surroundings import Surroundings
from fss_sim.plant.target import Gripper
from fss_sim.plant.thrusters import Propulsion
from fss_sim.plant.vehicle import World
from fss_sim.sensors import RATE
from fss_sim.testbed import State
from fss_sim.vicon import Room, Vicon

Wire = LinkSocket | LinkListener | LinkTerminal


def _preset_setting(presets: Mapping[str, Joints] | Mapping[str, Noise], name: str) -> Any:
    """Return a field for a number that a preset sets; a value below 0 selects the preset's."""
    about = next(f.metadata for f in fields(presets["default"]) if f.name == name)
    values = ", ".join(f"{key} {getattr(preset, name):g}" for key, preset in presets.items())
    return field(
        default=-1.0,
        metadata={
            **about,
            "about": f"{about['about']}; below 0: that of the preset ({values})",
            "check": FINITE,
        },
    )


def _overrides(values: dict[str, float]) -> dict[str, float]:
    """Return the values that override the preset."""
    return {name: value for name, value in values.items() if not value < 0.0}


@dataclass(frozen=True)
class PlantSettings(Settings):
    """Parameters of base and arm, of the forces on them, and of the target."""

    preset: str = setting(
        "default",
        "preset of the joints and of the errors of all instruments",
        check=one_of(*PRESETS),
    )
    rotor_inertia: float = _preset_setting(JOINTS, "rotor_inertia")
    gear_ratio: float = like(Joints, "gear_ratio")
    viscous_friction: float = _preset_setting(JOINTS, "viscous")
    coulomb_friction: float = _preset_setting(JOINTS, "coulomb")
    static_friction: float = _preset_setting(JOINTS, "static")
    stribeck_speed: float = _preset_setting(JOINTS, "stribeck_speed")
    friction_cancelled: float = _preset_setting(JOINTS, "cancelled")
    gear_stiffness: float = _preset_setting(JOINTS, "stiffness")
    gear_damping: float = _preset_setting(JOINTS, "damping")
    dead_band: float = _preset_setting(JOINTS, "dead_band")
    torque_ripple: float = _preset_setting(JOINTS, "ripple")
    current_bandwidth: float = _preset_setting(JOINTS, "current_bandwidth")
    tilt: tuple[float, ...] = like(Surroundings, "tilt")
    film_damping: float = like(Surroundings, "film")
    tether_drag: float = like(Surroundings, "tether")
    tether_twist: float = like(Surroundings, "tether_twist")
    table: tuple[float, ...] = like(Surroundings, "table")
    thrust: float = like(Propulsion, "thrust")
    thruster_lever: float = like(Propulsion, "lever")
    specific_impulse: float = like(Propulsion, "specific_impulse")
    minimum_on_time: float = like(Propulsion, "minimum_on_time")
    valve_delay: float = like(Propulsion, "valve_delay")
    tank_volume: float = like(Propulsion, "tank_volume")
    tank_pressure: float = like(Propulsion, "tank_pressure")
    bearing_flow: float = like(Propulsion, "bearing_flow")
    bearing_pressure: float = like(Propulsion, "bearing_pressure")
    pad_friction: float = like(Surroundings, "pad_friction")
    tolerance: float = setting(
        0.0,
        "tolerance of the integrator's error control, per step and coordinate, SI units; 0: "
        "fixed steps of 1 ms",
        check=NOT_NEGATIVE,
    )
    target_mass: float = setting(
        0.0,
        "mass of a second spacecraft simulator, the target; 0: no target",
        unit="kg",
        check=NOT_NEGATIVE,
    )
    target_inertia: float = like(Target, "inertia")
    target_pose: tuple[float, ...] = setting(
        (1.0, 1.0, 0.0), "initial pose of the target", unit="m, m, rad", check=FINITE, size=3
    )
    target_twist: tuple[float, ...] = setting(
        (0.0, 0.0, 0.0),
        "initial velocity of the target in the world, and its turn rate",
        unit="m/s, m/s, rad/s",
        check=FINITE,
        size=3,
    )
    target_fixture: tuple[float, ...] = like(Target, "fixture")
    grip_reach: float = like(Gripper, "reach")
    grip_angle: float = like(Gripper, "angle")
    target_radius: float = like(Target, "radius")
    grip_speed: float = like(Gripper, "speed")
    grip_closing_time: float = like(Gripper, "closing_time")
    grip_force: float = like(Gripper, "force")
    grip_torque: float = like(Gripper, "torque")
    gripper_length: float = like(Gripper, "length")
    contact: bool = setting(True, "true: bodies collide; false: they pass through each other")
    restitution: float = like(Contact, "restitution")
    contact_friction: float = like(Contact, "friction")
    vicon_cameras: tuple[float, ...] = like(Room, "cameras")
    base_markers: tuple[float, ...] = like(Room, "base_markers")
    tip_markers: tuple[float, ...] = like(Room, "tip_markers")
    target_markers: tuple[float, ...] = like(Room, "target_markers")
    heights: tuple[float, ...] = like(Room, "heights")
    marker_stalk: float = like(Room, "stalk")
    wifi: bool = setting(
        False, "true: links and base share a radio channel; false: datagrams arrive at once"
    )
    wifi_rate: float = like(Radio, "rate")
    wifi_overhead: float = like(Radio, "overhead")
    wifi_loss: float = like(Radio, "loss")
    wifi_burst_interval: float = like(Radio, "burst_interval")
    wifi_burst_length: float = like(Radio, "burst_length")
    wifi_burst_loss: float = like(Radio, "burst_loss")
    wifi_retries: int = like(Radio, "retries")
    wifi_patience: float = like(Radio, "patience")

    def joints(self) -> Joints:
        """Return the joints of the preset, with the values that override it."""
        values = {
            "rotor_inertia": self.rotor_inertia,
            "viscous": self.viscous_friction,
            "coulomb": self.coulomb_friction,
            "static": self.static_friction,
            "stribeck_speed": self.stribeck_speed,
            "cancelled": self.friction_cancelled,
            "stiffness": self.gear_stiffness,
            "damping": self.gear_damping,
            "dead_band": self.dead_band,
            "ripple": self.torque_ripple,
            "current_bandwidth": self.current_bandwidth,
        }
        return replace(JOINTS[self.preset], gear_ratio=self.gear_ratio, **_overrides(values))

    def world(self) -> World:
        """Return the parameters of the plant, except those of the arm."""
        tether = self.tether_drag, self.tether_twist
        return World(
            self.joints(),
            Surroundings(
                self.tilt, self.film_damping, *tether, self.table, pad_friction=self.pad_friction
            ),
            Propulsion(
                self.thrust,
                self.thruster_lever,
                self.specific_impulse,
                self.minimum_on_time,
                self.valve_delay,
                self.tank_volume,
                self.tank_pressure,
                bearing_flow=self.bearing_flow,
                bearing_pressure=self.bearing_pressure,
            ),
            Gripper(
                self.grip_reach,
                self.grip_angle,
                self.grip_speed,
                self.gripper_length,
                self.grip_closing_time,
                self.grip_force,
                self.grip_torque,
            ),
            Target(self.target_mass, self.target_inertia, self.target_fixture, self.target_radius)
            if self.target_mass
            else None,
            self.tolerance,
            Contact(self.restitution, self.contact_friction) if self.contact else None,
        )

    def vicon_room(self) -> Room:
        """Return the positions of VICON's cameras and markers."""
        places = self.base_markers, self.tip_markers, self.target_markers
        return Room(self.vicon_cameras, *places, self.heights, self.marker_stalk)

    def radio(self) -> Radio | None:
        """Return the radio channel that links and base share, if there is one."""
        if not self.wifi:
            return None
        values = (getattr(self, f"wifi_{f.name}") for f in fields(Radio))
        return Radio(*values)


@dataclass(frozen=True)
class TestbedSettings(PlantSettings):
    """Parameters of a TestbedNode."""

    vehicles: str = setting(
        "",
        "file of several vehicles (docs/how-to/vehicles.md), with the settings of each that "
        "differ from these parameters; empty: one vehicle",
    )
    arm: str = setting("", "file of the true arm's description; empty: the paper's arm")
    serials: tuple[int, ...] = setting(
        (),
        "serial numbers that the links report, starting at the base, 0: none; empty: those "
        "of the description",
        check=between(0, 2**31 - 1),
    )
    without_arm: bool = setting(False, "true: simulate the base of the description without its arm")
    host: str = setting("127.0.0.1", "IP address on which the links' ports are opened")
    transports: tuple[str, ...] = setting(
        (),
        "transport of each link: udp, tcp, or serial (a pseudo-terminal, like RS-232); one for "
        "all links or one for each; empty: serial if terminals are given, else udp",
        check=one_of("udp", "tcp", "serial"),
    )
    ports: tuple[int, ...] = setting(
        (),
        "UDP or TCP ports of the links, 0: any free port; empty: 5001, 5002, ...",
        check=between(0, 65535),
    )
    terminals: tuple[str, ...] = setting(
        (),
        "paths of the links' pseudo-terminals, one for each link; used only for transport serial",
    )
    board_port: int = setting(
        0,
        "UDP or TCP port of the base's board, for the node base; 0: no board, the test bed itself "
        "subscribes to thrusters/command and gripper/command, and publishes fog/imu and "
        "gripper/state",
        check=between(0, 65535),
    )
    board_transport: str = setting(
        "udp", "transport of the board's port: udp or tcp", check=one_of("udp", "tcp")
    )
    board_terminal: str = setting(
        "", "path of the board's pseudo-terminal (like RS-232), in place of a port"
    )
    board_rate: float = setting(
        20.0, "rate of the board's telemetry frames", unit="Hz", check=above(0.0, RATE)
    )
    telemetry_rate: float = setting(
        5.0, "rate of each link's telemetry frames", unit="Hz", check=above(0.0, RATE)
    )
    keys: str = setting("", "file of the links' keys; empty: frames are not signed")
    seed: int = setting(1, "seed of all random numbers", check=at_least(0))
    position_noise: float = _preset_setting(PRESETS, "position_noise")
    heading_noise: float = _preset_setting(PRESETS, "heading_noise")
    vicon_hold: float = _preset_setting(PRESETS, "vicon_hold")
    rest_position_error: float = _preset_setting(PRESETS, "rest_position_error")
    rest_heading_error: float = _preset_setting(PRESETS, "rest_heading_error")
    gyro_noise: float = _preset_setting(PRESETS, "gyro_noise")
    vicon_latency: float = _preset_setting(PRESETS, "vicon_latency")
    vicon_jitter: float = _preset_setting(PRESETS, "vicon_jitter")
    marker_noise: float = _preset_setting(PRESETS, "marker_noise")
    vicon_edge_error: float = _preset_setting(PRESETS, "vicon_edge_error")
    vicon_occlusion: float = _preset_setting(PRESETS, "vicon_occlusion")
    vicon_merge_distance: float = _preset_setting(PRESETS, "vicon_merge_distance")
    vicon_merge_swap: float = _preset_setting(PRESETS, "vicon_merge_swap")
    gyro_bias: float = _preset_setting(PRESETS, "gyro_bias")
    gyro_walk: float = _preset_setting(PRESETS, "gyro_walk")
    gyro_scale: float = _preset_setting(PRESETS, "gyro_scale")
    encoder_error: float = _preset_setting(PRESETS, "encoder_error")
    encoder_eccentricity: float = _preset_setting(PRESETS, "encoder_eccentricity")
    torque_noise: float = _preset_setting(PRESETS, "torque_noise")
    torque_zero: float = _preset_setting(PRESETS, "torque_zero")
    torque_crosstalk: float = _preset_setting(PRESETS, "torque_crosstalk")
    torque_drift: float = _preset_setting(PRESETS, "torque_drift")
    torque_rate: int = setting(
        80,
        "sample rate of a torque sensor's A/D converter",
        unit="Hz",
        check=Check("10 or 80", lambda rate: rate in (10, 80), 10, 80),
    )
    clock_drift: float = _preset_setting(PRESETS, "clock_drift")
    battery: float = setting(
        1.0, "initial charge of all batteries, as a share", check=above(0.0, 1.0)
    )
    battery_energy: float = like(Power, "energy")
    battery_resistance: float = like(Power, "resistance")
    faults: str = setting("", "file of a fault script (docs/explanation/simulator.md); empty: none")
    base: tuple[float, ...] = setting(
        (0.0, 0.0, 0.0), "initial pose of the base", unit="m, m, rad", check=FINITE, size=3
    )
    twist: tuple[float, ...] = setting(
        (0.0, 0.0, 0.0),
        "initial velocity of the base's origin in the world, and turn rate; joints are at rest",
        unit="m/s, m/s, rad/s",
        check=FINITE,
        size=3,
    )
    q: tuple[float, ...] = setting(
        (), "initial joint readings, without encoder errors; empty: all 0", unit="rad", check=FINITE
    )
    keep_clock: bool = setting(
        False, "true: publish /clock (nodes need use_sim_time); false: follow the ROS clock"
    )
    speed: float = setting(
        1.0,
        "speed of the published clock (keep_clock), in multiples of real time; 0: as fast as "
        "the drivers can follow",
        check=Check("0, or 0.01 to 100", lambda x: x == 0.0 or 0.01 <= x <= 100.0, 0.0, 100.0),
    )
    lockstep: bool = setting(
        False,
        "true: the published clock waits for each node that uses it, so that a mission on a busy "
        "computer takes longer but does not change",
    )
    paused: bool = setting(False, "true: start with the published clock paused, to be stepped")
    truth_rate: float = setting(
        10.0, "rate of sim/truth and gripper/state", unit="Hz", check=above(0.0, RATE)
    )
    state_file: str = setting(
        "", "file in which the state is saved, to resume from it; empty: none"
    )
    world_frame: str = setting("world", "frame_id of the VICON poses")
    base_topic: str = like(Vehicle, "base_topic")
    tip_topic: str = like(Vehicle, "tip_topic")
    target_topic: str = like(Vehicle, "target_topic")
    base_frame: str = like(Vehicle, "base_frame")
    frame_prefix: str = like(Vehicle, "frame_prefix")

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.speed != 1.0 or self.paused or self.lockstep) and not self.keep_clock:
            raise SettingError(
                f"speed is {self.speed}, paused {str(self.paused).lower()} and lockstep "
                f"{str(self.lockstep).lower()}, expected 1, false and false without keep_clock"
            )
        _ = self.noise(), self.joints(), self.vicon_room()  # these reject invalid values

    def description(self) -> Arm | Base:
        """Return the true arm, or the base if there is no arm."""
        arm = described(self.arm)
        if self.serials:
            if len(self.serials) != arm.n:
                raise ValueError(
                    f"serials has {len(self.serials)} numbers, expected {arm.n}, one for each link"
                )
            links = zip(arm.links, self.serials, strict=True)
            arm = replace(arm, links=tuple(replace(k, serial=serial) for k, serial in links))
        return arm.base if self.without_arm else arm

    def noise(self) -> Noise:
        """Return the errors of the preset, with the values that override it."""
        values = {f.name: getattr(self, f.name) for f in fields(Noise)}
        return replace(PRESETS[self.preset], **_overrides(values))

    def vicon(self, seed: int, kinds: Sequence[int]) -> Vicon | None:
        """Return the cameras for subjects of these kinds, if poses are computed from markers."""
        noise = self.noise()
        return Vicon(noise, self.vicon_room(), seed, kinds, self.table) if noise.markers else None

    def radio_channel(self, seed: str) -> RadioChannel | None:
        """Return the radio channel of links and boards, if they share one."""
        radio = self.radio()
        return RadioChannel(radio, seed) if radio else None

    def power(self) -> Power:
        """Return the parameters of the batteries and their loads."""
        return Power(self.battery_energy, self.battery_resistance)

    def script(self) -> str:
        """Return the text of the fault script."""
        return read_text(self.faults) if self.faults else ""

    def open_wires(self, n: int) -> list[Wire]:
        """Open the connection of each link."""
        default = "serial" if self.terminals else "udp"
        kinds = n * (self.transports or (default,)) if len(self.transports) < 2 else self.transports
        if len(kinds) != n:
            raise ValueError(f"transports is {list(kinds)}, expected 1 or {n}")
        if "serial" in kinds and len(self.terminals) != n:
            raise ValueError(f"terminals has {len(self.terminals)} paths, expected {n}")
        paths, ports, opened = self.terminals or n * ("",), self.link_ports(n), list[Wire]()
        try:
            for kind, port, path in zip(kinds, ports, paths, strict=True):
                opened.append(self._open_wire(kind, port, path))
        except OSError:
            for wire in opened:
                wire.close()
            raise
        return opened

    def open_board_wire(self) -> Wire | None:
        """Open the connection of the base's board, if there is one."""
        if not (self.board_port or self.board_terminal):
            return None
        kind = "serial" if self.board_terminal else self.board_transport
        return self._open_wire(kind, self.board_port, self.board_terminal)

    def _open_wire(self, kind: str, port: int, path: str) -> Wire:
        if kind == "serial":
            return LinkTerminal(path)
        return (LinkListener if kind == "tcp" else LinkSocket)(self.host, port)

    def link_ports(self, n: int) -> tuple[int, ...]:
        """Return one port for each link."""
        ports = self.ports or tuple(range(5001, 5001 + n))
        if len(ports) != n:
            raise ValueError(f"ports is {list(ports)}, expected {n}")
        return ports

    def initial_state(self, n: int) -> State:
        """Return the initial state: from the state file if it exists, else from the parameters."""
        if self.state_file and Path(self.state_file).exists():
            return State.load(Path(self.state_file), n).after_restart()
        return self.state_from_parameters(n)

    def state_from_parameters(self, n: int) -> State:
        """Return the initial state from the parameters."""
        q = self.q or n * (0.0,)
        if len(q) != n:
            raise ValueError(f"q has {len(q)} angles, expected {n}")
        target = (*self.target_pose, *self.target_twist)
        rates = (*self.twist, *n * (0.0,))
        return State(0, 1, 0, q=(*self.base, *q), qd=rates, target=target)
