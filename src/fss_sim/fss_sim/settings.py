"""The parameters of the test-bed node, and what they amount to."""

from dataclasses import dataclass, fields, replace
from pathlib import Path

from fss_arm_model.description import Arm, described
from fss_arm_model.settings import setting
from fss_sim.link.pty import LinkTerminal
from fss_sim.link.udp import LinkSocket
from fss_sim.noise import PRESETS, Noise
from fss_sim.plant.plant import Joints, World
from fss_sim.plant.surroundings import Surroundings
from fss_sim.plant.target import Gripper, Target
from fss_sim.plant.thrusters import Propulsion
from fss_sim.sensors import RATE
from fss_sim.testbed import State


@dataclass(frozen=True)
class PlantSettings:
    """What base and arm are made of, what acts on them, and the target."""

    rotor_inertia: float = setting(
        0.0, "of each motor, felt at its joint [kg m^2]; 0.0026 in the FHA-8C-30, 0: none"
    )
    gear_ratio: float = setting(30.0, "of the harmonic drives")
    viscous_friction: float = setting(0.5, "of each joint [N m s/rad]")
    coulomb_friction: float = setting(0.3, "of each joint [N m]")
    end_stops: bool = setting(True, "stops at the ends of the joints' ranges")
    tilt: tuple[float, ...] = setting((0.0, 0.0), "of the table along x and y, downhill [rad]")
    film_damping: float = setting(0.0, "of the air films, by mass and velocity [1/s]")
    tether_drag: float = setting(0.0, "on the base's origin [N s/m]")
    tether_twist: float = setting(0.0, "against the base's turning [N m s]")
    table: tuple[float, ...] = setting((4.0, 4.0), "sides of the table about the origin [m]")
    thrust: float = setting(0.16, "of one of the eight thrusters [N]")
    thruster_lever: float = setting(0.11, "from the base's origin to the line of thrust [m]")
    specific_impulse: float = setting(34.0, "of the thrusters [s]")
    minimum_on_time: float = setting(0.01, "of a thruster's valve [s]")
    valve_delay: float = setting(0.005, "from a command to the valve's answer [s]")
    tank_volume: float = setting(0.43e-3, "[m^3]")
    tank_pressure: float = setting(20e6, "at the begin [Pa]")
    tolerance: float = setting(
        0.0, "of error control, by step and coordinate, SI units; 0: fixed steps of 1 ms"
    )
    target_mass: float = setting(0.0, "of a second spacecraft simulator [kg]; 0: there is none")
    target_inertia: float = setting(0.25, "of the target about its centre of mass [kg m^2]")
    target_pose: tuple[float, ...] = setting(
        (1.0, 1.0, 0.0), "of the target at the begin: x, y [m], heading [rad]"
    )
    target_twist: tuple[float, ...] = setting((0.0, 0.0, 0.0), "likewise [m/s, m/s, rad/s]")
    target_fixture: tuple[float, ...] = setting(
        (0.19, 0.0, 0.0), "where to grip the target, in its frame: x, y [m], outward [rad]"
    )
    grip_reach: float = setting(0.03, "of the gripper [m]")
    grip_angle: float = setting(0.5, "most that the fixture may be askew to be gripped [rad]")
    grip_speed: float = setting(0.1, "most that it may move past the gripper [m/s]")

    def __post_init__(self) -> None:
        sizes = {"tilt": 2, "table": 2, "target_pose": 3, "target_twist": 3, "target_fixture": 3}
        for name, size in sizes.items():
            if len(getattr(self, name)) != size:
                raise ValueError(f"{name} has {len(getattr(self, name))} numbers, expected {size}")
        for name in (
            "rotor_inertia", "viscous_friction", "coulomb_friction", "film_damping", "tether_drag",
            "tether_twist", "tolerance", "target_mass",
        ):  # fmt: skip
            if not getattr(self, name) >= 0.0:
                raise ValueError(f"{name} is {getattr(self, name)}, expected 0 or more")
        if not self.gear_ratio > 0.0 or not min(self.table) > 0.0:
            raise ValueError(
                f"gear_ratio is {self.gear_ratio} and table {list(self.table)}, expected above 0"
            )
        self.world()

    def world(self) -> World:
        """What the plant is made of beside the arm."""
        stops = {} if self.end_stops else {"stop_stiffness": 0.0, "stop_damping": 0.0}
        frictions = self.viscous_friction, self.coulomb_friction
        fixture = self.target_fixture
        return World(
            Joints(self.rotor_inertia, self.gear_ratio, *frictions, **stops),
            Surroundings(
                (self.tilt[0], self.tilt[1]),
                self.film_damping,
                self.tether_drag,
                self.tether_twist,
                (self.table[0], self.table[1]),
            ),
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
            Target(self.target_mass, self.target_inertia, (fixture[0], fixture[1], fixture[2]))
            if self.target_mass
            else None,
            self.tolerance,
        )


@dataclass(frozen=True)
class TestbedSettings(PlantSettings):
    """The parameters of a TestbedNode."""

    arm: str = setting("", "file of the true arm's description; empty: the paper's arm")
    host: str = setting("127.0.0.1", "address that the links' UDP ports are opened on")
    ports: tuple[int, ...] = setting((), "the links' UDP ports, 0: any; empty: 5001, 5002, ...")
    terminals: tuple[str, ...] = setting(
        (), "paths of pseudo-terminals to reach the links by, as by RS-232; empty: UDP"
    )
    telemetry_rate: float = setting(5.0, "telemetry frames of each link [1/s]")
    keys: str = setting("", "file of the links' keys; empty: frames are not signed")
    seed: int = setting(1, "of all the sensors' errors")
    preset: str = setting("default", f"of the sensors' errors: {', '.join(PRESETS)}")
    position_noise: float = setting(-1.0, "of a VICON frame, 1 sigma [m]; < 0: the preset's")
    heading_noise: float = setting(-1.0, "of a VICON frame, 1 sigma [rad]; < 0: the preset's")
    vicon_hold: float = setting(
        -1.0, "how long such an error stays before it is another one [s]; < 0: the preset's"
    )
    rest_position_error: float = setting(
        -1.0, "of the end effector seen from the base, each rest, 1 sigma [m]; < 0: the preset's"
    )
    rest_heading_error: float = setting(-1.0, "likewise [rad]; < 0: the preset's")
    gyro_noise: float = setting(-1.0, "of a FOG sample, 1 sigma [rad/s]; < 0: the preset's")
    vicon_latency: float = setting(-1.0, "of VICON's poses [s]; < 0: the preset's")
    gyro_bias: float = setting(-1.0, "of the FOG, each run, 1 sigma [rad/s]; < 0: the preset's")
    gyro_walk: float = setting(-1.0, "of that bias in 1 s, 1 sigma [rad/s]; < 0: the preset's")
    gyro_scale: float = setting(-1.0, "scale error of the FOG, 1 sigma; < 0: the preset's")
    encoder_error: float = setting(-1.0, "of an encoder, largest [rad]; < 0: the preset's")
    torque_noise: float = setting(-1.0, "of a torque sample, 1 sigma [N m]; < 0: the preset's")
    torque_zero: float = setting(-1.0, "of a torque sensor, 1 sigma [N m]; < 0: the preset's")
    torque_rate: int = setting(80, "samples of a torque converter [1/s], 10 or 80")
    clock_drift: float = setting(-1.0, "of a link's clock, relative, 1 sigma; < 0: the preset's")
    battery: float = setting(1.0, "charge of the links' batteries at the begin, 0 to 1")
    faults: str = setting("", "file of a fault script (docs/simulator.md); empty: none")
    base: tuple[float, ...] = setting((0.0, 0.0, 0.0), "pose at the begin: x, y [m], heading [rad]")
    twist: tuple[float, ...] = setting(
        (0.0, 0.0, 0.0), "of base and arm at the begin, about the base's origin [m/s, m/s, rad/s]"
    )
    q: tuple[float, ...] = setting((), "joint angles at the begin [rad]; empty: all 0")
    keep_clock: bool = setting(False, "publish /clock; else the stamps are ROS time as it is")
    speed: float = setting(
        1.0, "of the clock kept, in multiples of real time; 0: as the links' drivers can follow"
    )
    paused: bool = setting(False, "begin with the clock kept standing still, to be stepped")
    truth_rate: float = setting(10.0, "of sim/truth and gripper/state [1/s]")
    state_file: str = setting("", "where the state is kept to resume from; empty: nowhere")
    world_frame: str = setting("world", "frame_id of the VICON poses")
    base_frame: str = setting("fss", "frame_id of the FOG")

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0.0 < self.truth_rate <= RATE:
            raise ValueError(f"truth_rate is {self.truth_rate}, expected above 0 to {RATE}")
        if self.preset not in PRESETS:
            raise ValueError(f"preset is {self.preset!r}, expected one of {', '.join(PRESETS)}")
        if self.seed < 0:
            raise ValueError(f"seed is {self.seed}, expected 0 or more")
        if not 0.0 < self.telemetry_rate <= RATE:
            raise ValueError(f"telemetry_rate is {self.telemetry_rate}, expected above 0 to {RATE}")
        if not (self.speed == 0.0 or 0.01 <= self.speed <= 100.0):
            raise ValueError(f"speed is {self.speed}, expected 0.01 to 100, or 0")
        if (self.speed != 1.0 or self.paused) and not self.keep_clock:
            raise ValueError(
                f"speed is {self.speed} and paused {str(self.paused).lower()}, "
                "expected 1 and false without keep_clock"
            )
        if self.torque_rate not in (10, 80):
            raise ValueError(f"torque_rate is {self.torque_rate}, expected 10 or 80")
        if not 0.0 < self.battery <= 1.0:
            raise ValueError(f"battery is {self.battery}, expected above 0 to 1")
        if not self.encoder_error <= 0.01:
            raise ValueError(f"encoder_error is {self.encoder_error} rad, expected at most 0.01")
        if not self.vicon_latency <= 1.0:
            raise ValueError(f"vicon_latency is {self.vicon_latency} s, expected at most 1")
        for name in ("base", "twist"):
            if len(getattr(self, name)) != 3:
                raise ValueError(f"{name} has {len(getattr(self, name))} numbers, expected 3")

    def description(self) -> Arm:
        """The true arm."""
        return described(self.arm)

    def noise(self) -> Noise:
        """The preset's deviations, with those given in their places."""
        given = {f.name: getattr(self, f.name) for f in fields(Noise)}
        return replace(PRESETS[self.preset], **{k: v for k, v in given.items() if v >= 0.0})

    def script(self) -> str:
        """The fault script's text."""
        return Path(self.faults).read_text(encoding="utf-8") if self.faults else ""

    def wires(self, n: int) -> list[LinkSocket | LinkTerminal]:
        """Open what each link is reached by."""
        if not self.terminals:
            return [LinkSocket(self.host, port) for port in self.link_ports(n)]
        if len(self.terminals) != n:
            raise ValueError(f"terminals has {len(self.terminals)} paths, expected {n}")
        return [LinkTerminal(path) for path in self.terminals]

    def link_ports(self, n: int) -> tuple[int, ...]:
        """One port for each link."""
        ports = self.ports or tuple(range(5001, 5001 + n))
        if len(ports) != n or not all(0 <= port <= 65535 for port in ports):
            raise ValueError(f"ports is {list(ports)}, expected {n} of 0 to 65535")
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
