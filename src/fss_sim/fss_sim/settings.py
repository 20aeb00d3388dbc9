"""The parameters of the test-bed node, and what they amount to."""

from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from fss_arm_model.description import Arm, described
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
from fss_sim.link.pty import LinkTerminal
from fss_sim.link.radio import Radio
from fss_sim.link.tcp import LinkListener
from fss_sim.link.udp import LinkSocket
from fss_sim.noise import PRESETS, Noise
from fss_sim.plant.plant import Joints, World
from fss_sim.plant.surroundings import Surroundings
from fss_sim.plant.target import Gripper
from fss_sim.plant.thrusters import Propulsion
from fss_sim.sensors import RATE
from fss_sim.testbed import State
from fss_sim.vicon import Room

Wire = LinkSocket | LinkListener | LinkTerminal


@dataclass(frozen=True)
class PlantSettings(Settings):
    """What base and arm are made of, what acts on them, and the target."""

    rotor_inertia: float = like(Joints, "rotor_inertia")
    gear_ratio: float = like(Joints, "gear_ratio")
    viscous_friction: float = like(Joints, "viscous")
    coulomb_friction: float = like(Joints, "coulomb")
    end_stops: bool = setting(True, "stops at the ends of the joints' ranges")
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
    tolerance: float = setting(
        0.0, "error that error control allows a step, in each coordinate, SI units; 0: fixed "
        "steps of 1 ms", check=NOT_NEGATIVE,
    )  # fmt: skip
    target_mass: float = setting(
        0.0, "mass of a second spacecraft simulator, the target; 0: there is none", unit="kg",
        check=NOT_NEGATIVE,
    )  # fmt: skip
    target_inertia: float = like(Target, "inertia")
    target_pose: tuple[float, ...] = setting(
        (1.0, 1.0, 0.0), "pose of the target at the begin", unit="m, m, rad", check=FINITE, size=3
    )
    target_twist: tuple[float, ...] = setting(
        (0.0, 0.0, 0.0), "velocity of the target at the begin", unit="m/s, m/s, rad/s",
        check=FINITE, size=3,
    )  # fmt: skip
    target_fixture: tuple[float, ...] = like(Target, "fixture")
    grip_reach: float = like(Gripper, "reach")
    grip_angle: float = like(Gripper, "angle")
    grip_speed: float = like(Gripper, "speed")
    vicon_cameras: tuple[float, ...] = like(Room, "cameras")
    base_markers: tuple[float, ...] = like(Room, "base_markers")
    tip_markers: tuple[float, ...] = like(Room, "tip_markers")
    target_markers: tuple[float, ...] = like(Room, "target_markers")
    heights: tuple[float, ...] = like(Room, "heights")
    marker_stalk: float = like(Room, "stalk")
    wifi: bool = setting(
        False, "links and base share a radio channel; else what they send is there at once"
    )
    wifi_rate: float = like(Radio, "rate")
    wifi_overhead: float = like(Radio, "overhead")
    wifi_loss: float = like(Radio, "loss")
    wifi_burst_interval: float = like(Radio, "burst_interval")
    wifi_burst_length: float = like(Radio, "burst_length")
    wifi_burst_loss: float = like(Radio, "burst_loss")
    wifi_retries: int = like(Radio, "retries")
    wifi_patience: float = like(Radio, "patience")

    def world(self) -> World:
        """What the plant is made of beside the arm."""
        stops = {} if self.end_stops else {"stop_stiffness": 0.0, "stop_damping": 0.0}
        frictions = self.viscous_friction, self.coulomb_friction
        tether = self.tether_drag, self.tether_twist
        return World(
            Joints(self.rotor_inertia, self.gear_ratio, *frictions, **stops),
            Surroundings(self.tilt, self.film_damping, *tether, self.table),
            Propulsion(
                self.thrust,
                self.thruster_lever,
                self.specific_impulse,
                self.minimum_on_time,
                self.valve_delay,
                self.tank_volume,
                self.tank_pressure,
            ),
            Gripper(self.grip_reach, self.grip_angle, self.grip_speed),
            Target(self.target_mass, self.target_inertia, self.target_fixture)
            if self.target_mass
            else None,
            self.tolerance,
        )

    def room(self) -> Room:
        """Where VICON's cameras and markers are."""
        places = self.base_markers, self.tip_markers, self.target_markers
        return Room(self.vicon_cameras, *places, self.heights, self.marker_stalk)

    def radio(self) -> Radio | None:
        """The channel that links and base share, if they do."""
        if not self.wifi:
            return None
        given = (getattr(self, f"wifi_{f.name}") for f in fields(Radio))
        return Radio(*given)


def _error(name: str) -> Any:
    """A field for one of the errors of Noise; below 0: what the preset says."""
    about = Noise.__dataclass_fields__[name].metadata
    return field(
        default=-1.0,
        metadata={**about, "about": f"{about['about']}; below 0: the preset's", "check": FINITE},
    )


@dataclass(frozen=True)
class TestbedSettings(PlantSettings):
    """The parameters of a TestbedNode."""

    arm: str = setting("", "file of the true arm's description; empty: the paper's arm")
    host: str = setting("127.0.0.1", "address that the links' ports are opened on")
    transports: tuple[str, ...] = setting(
        (), "what reaches each link: udp, tcp, or serial, a pseudo-terminal as RS-232; one for "
        "all or one each; empty: serial if there are terminals, else udp",
        check=one_of("udp", "tcp", "serial"),
    )  # fmt: skip
    ports: tuple[int, ...] = setting(
        (), "the links' UDP or TCP ports, 0: any; empty: 5001, 5002, ...", check=between(0, 65535)
    )
    terminals: tuple[str, ...] = setting(
        (), "paths of the links' pseudo-terminals, one each; the others' count for nothing"
    )
    board_port: int = setting(
        0,
        "UDP port of the base's board, for the node base; 0: none, the test bed takes "
        "thrusters/command and gripper/command itself, and publishes fog/imu and gripper/state",
        check=between(0, 65535),
    )
    board_rate: float = setting(
        20.0, "rate of the board's telemetry frames", unit="1/s", check=above(0.0, RATE)
    )
    telemetry_rate: float = setting(
        5.0, "rate of each link's telemetry frames", unit="1/s", check=above(0.0, RATE)
    )
    keys: str = setting("", "file of the links' keys; empty: frames are not signed")
    seed: int = setting(1, "seed of all the sensors' errors", check=at_least(0))
    preset: str = setting("default", "preset of the sensors' errors", check=one_of(*PRESETS))
    position_noise: float = _error("position_noise")
    heading_noise: float = _error("heading_noise")
    vicon_hold: float = _error("vicon_hold")
    rest_position_error: float = _error("rest_position_error")
    rest_heading_error: float = _error("rest_heading_error")
    gyro_noise: float = _error("gyro_noise")
    vicon_latency: float = _error("vicon_latency")
    vicon_jitter: float = _error("vicon_jitter")
    marker_noise: float = _error("marker_noise")
    vicon_edge_error: float = _error("vicon_edge_error")
    vicon_occlusion: float = _error("vicon_occlusion")
    vicon_merge_distance: float = _error("vicon_merge_distance")
    vicon_merge_swap: float = _error("vicon_merge_swap")
    gyro_bias: float = _error("gyro_bias")
    gyro_walk: float = _error("gyro_walk")
    gyro_scale: float = _error("gyro_scale")
    encoder_error: float = _error("encoder_error")
    torque_noise: float = _error("torque_noise")
    torque_zero: float = _error("torque_zero")
    torque_rate: int = setting(
        80, "samples of a torque converter", unit="1/s",
        check=Check("10 or 80", lambda rate: rate in (10, 80), 10, 80),
    )  # fmt: skip
    clock_drift: float = _error("clock_drift")
    battery: float = setting(
        1.0, "charge of the links' batteries at the begin, as a share", check=above(0.0, 1.0)
    )
    faults: str = setting("", "file of a fault script (docs/explanation/simulator.md); empty: none")
    base: tuple[float, ...] = setting(
        (0.0, 0.0, 0.0), "pose of the base at the begin", unit="m, m, rad", check=FINITE, size=3
    )
    twist: tuple[float, ...] = setting(
        (0.0, 0.0, 0.0), "velocity of base and arm at the begin, about the base's origin",
        unit="m/s, m/s, rad/s", check=FINITE, size=3,
    )  # fmt: skip
    q: tuple[float, ...] = setting(
        (), "joint angles at the begin; empty: all 0", unit="rad", check=FINITE
    )
    keep_clock: bool = setting(False, "publish /clock; else the stamps are ROS time as it is")
    speed: float = setting(
        1.0, "speed of the clock kept, in multiples of real time; 0: as the links' drivers follow",
        check=Check("0, or 0.01 to 100", lambda x: x == 0.0 or 0.01 <= x <= 100.0, 0.0, 100.0),
    )  # fmt: skip
    paused: bool = setting(False, "begin with the clock kept standing still, to be stepped")
    truth_rate: float = setting(
        10.0, "rate of sim/truth and gripper/state", unit="1/s", check=above(0.0, RATE)
    )
    state_file: str = setting("", "file that the state is kept in to resume from; empty: none")
    world_frame: str = setting("world", "frame_id of the VICON poses")
    base_frame: str = setting("fss", "frame_id of the FOG")

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.speed != 1.0 or self.paused) and not self.keep_clock:
            raise SettingError(
                f"speed is {self.speed} and paused {str(self.paused).lower()}, "
                "expected 1 and false without keep_clock"
            )
        _ = self.noise(), self.room()  # which refuse what they must

    def description(self) -> Arm:
        """The true arm."""
        return described(self.arm)

    def noise(self) -> Noise:
        """The preset's deviations, with those given in their places."""
        given = {f.name: getattr(self, f.name) for f in fields(Noise)}
        return replace(PRESETS[self.preset], **{k: v for k, v in given.items() if not v < 0.0})

    def script(self) -> str:
        """The fault script's text."""
        return read_text(self.faults) if self.faults else ""

    def wires(self, n: int) -> list[Wire]:
        """Open what each link is reached by."""
        usual = "serial" if self.terminals else "udp"
        kinds = n * (self.transports or (usual,)) if len(self.transports) < 2 else self.transports
        if len(kinds) != n:
            raise ValueError(f"transports is {list(kinds)}, expected 1 or {n}")
        if "serial" in kinds and len(self.terminals) != n:
            raise ValueError(f"terminals has {len(self.terminals)} paths, expected {n}")
        paths, ports, opened = self.terminals or n * ("",), self.link_ports(n), list[Wire]()
        try:
            for kind, port, path in zip(kinds, ports, paths, strict=True):
                if kind == "serial":
                    opened.append(LinkTerminal(path))
                else:
                    opened.append((LinkListener if kind == "tcp" else LinkSocket)(self.host, port))
        except OSError:
            for wire in opened:
                wire.close()
            raise
        return opened

    def board_wire(self) -> LinkSocket | None:
        """Open what the base's board is reached by, if there is one."""
        return LinkSocket(self.host, self.board_port) if self.board_port else None

    def link_ports(self, n: int) -> tuple[int, ...]:
        """One port for each link."""
        ports = self.ports or tuple(range(5001, 5001 + n))
        if len(ports) != n:
            raise ValueError(f"ports is {list(ports)}, expected {n}")
        return ports

    def begin(self, n: int) -> State:
        """The state to begin with: the file's, else the one given."""
        if self.state_file and Path(self.state_file).exists():
            return State.load(Path(self.state_file), n).resumed()
        return self.fresh(n)

    def fresh(self, n: int) -> State:
        """The state given."""
        q = self.q or n * (0.0,)
        if len(q) != n:
            raise ValueError(f"q has {len(q)} angles, expected {n}")
        target = (*self.target_pose, *self.target_twist)
        rates = (*self.twist, *n * (0.0,))
        return State(0, 1, 0, q=(*self.base, *q), qd=rates, target=target)
