"""Rehearse a capture on a simulated test bed: approach, grip, stop the target; show what happened.

Stands for the spacecraft's computer: it listens to VICON and the links, and lets fss_sim.guidance
decide. It steps the test bed's time, so that the rehearsal is the same on a slow computer.
"""

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool

from fss_arm_bags.reader import open_bags
from fss_arm_model.description import Arm, load
from fss_arm_model.held import Target
from fss_arm_model.kinematics import joint_positions
from fss_arm_model.thrusters import layout
from fss_arm_msgs.msg import GripperState, LinkCommand, ThrusterCommand
from fss_arm_msgs.srv import StepTime
from fss_arm_ros.convert import SECOND, planar_pose, stamp_ns
from fss_arm_ros.qos import COMMAND, SENSOR
from fss_sim.guidance import PERIOD, Guidance
from fss_sim.plant.thrusters import Propulsion
from fss_sim.rehearsal.domain import CONFIG, Domain
from fss_sim.rehearsal.person import LINKS, Operator, own_domain
from fss_sim.rehearsal.processes import Nodes, RehearsalError, rehearse, results
from fss_sim.sensors import RATE

TARGET = Target(mass=10.0, inertia=0.25)
BEGIN = {
    "base": [-1.0, -0.75, 0.3],
    "q": [0.9, -1.4, 1.2, -0.6],
    "target_mass": TARGET.mass,
    "target_inertia": TARGET.inertia,
    "target_pose": [1.05, 0.75, -0.3],
    "target_twist": [-0.012, 0.008, 0.15],
}
MAX_DURATION = 300.0  # [s] of the mission
STRIDE = 5  # frames at once; a driver whose clock is farther behind refuses telemetry as untimely
AGREE = 1e-9  # momentum before and after the capture [N s, N m s]


class Pilot(Operator):
    """Hands what is seen to the guidance and its orders on; lets time pass between."""

    def __init__(self, arm: Arm, domain: Domain) -> None:
        super().__init__(domain, parameter_overrides=[Parameter("use_sim_time", value=True)])
        propulsion = Propulsion()
        self.guidance = Guidance(arm, TARGET, layout(propulsion.thrust, propulsion.lever))
        self.joints: dict[str, tuple[int, float, float]] = {}  # stamp, angle, rate
        self.holds, self.now = False, 0
        tracks = self.guidance.base, self.guidance.tip, self.guidance.body
        for subject, track in zip(("fss", "end_effector", "target"), tracks, strict=True):
            self.create_subscription(
                PoseStamped, f"vicon/{subject}/{subject}", self.on_pose(track.update), SENSOR
            )
        self.create_subscription(JointState, "joint_states", self.on_joints, SENSOR)
        self.create_subscription(GripperState, "gripper/state", self.on_gripper, SENSOR)
        self.thrust = self.create_publisher(ThrusterCommand, "thrusters/command", COMMAND)
        self.grip = self.create_publisher(Bool, "gripper/command", COMMAND)
        self.links = [
            self.create_publisher(LinkCommand, f"link_{i}/command", COMMAND) for i in self.armed
        ]
        self.stepping = self.create_client(StepTime, "sim/step")

    def on_pose(self, update: Callable[..., None]) -> Callable[[PoseStamped], None]:
        """Follow a subject."""

        def take(message: PoseStamped) -> None:
            self.now = stamp_ns(message.header.stamp)
            update(self.now / SECOND, planar_pose(message.pose))

        return take

    def on_joints(self, message: JointState) -> None:
        """One link's angle and rate."""
        at = stamp_ns(message.header.stamp)
        self.joints[message.name[0]] = at, message.position[0], message.velocity[0]

    def on_gripper(self, message: GripperState) -> None:
        """Whether it holds the target."""
        self.holds = message.holds

    def pass_time(self, seconds: float, fresh: bool = True) -> None:
        """Let time pass, and hear all that was seen meanwhile, joints at most a second ago.

        Raises:
            RehearsalError: it is not heard.
        """
        for _ in range(round(seconds * RATE) // STRIDE):
            stamp = self.step()
        if fresh:
            self.wait(
                lambda: (
                    len(self.joints) == LINKS
                    and min(at for at, _, _ in self.joints.values()) > stamp - SECOND
                ),
                "the links are not heard",
            )

    def step(self) -> int:
        """Let a stride pass, and hear VICON of its end; the time then [ns]."""
        answer = self.stepping.call_async(StepTime.Request(frames=STRIDE))
        self.wait(answer.done, "sim/step does not answer")
        stamp = stamp_ns(answer.result().stamp)
        self.wait(lambda: self.now >= stamp, "VICON is not heard")
        return stamp

    def wait(self, until: Callable[[], bool], complaint: str, timeout: float = 60.0) -> None:
        """Spin until something holds.

        Raises:
            RehearsalError: it does not within `timeout` [s].
        """
        deadline = time.monotonic() + timeout
        while not until():
            if time.monotonic() > deadline:
                raise RehearsalError(complaint)
            rclpy.spin_once(self, timeout_sec=0.05)

    def arm_links(self) -> None:
        """Arm all links, as a person does; time must pass meanwhile.

        Raises:
            RehearsalError: they do not get armed.
        """
        self.wait(self.stepping.service_is_ready, "there is no test bed")
        self.wait(self.arm.service_is_ready, "there is no node `arm`")
        deadline = time.monotonic() + 60.0
        while not all(self.armed.values()):
            if time.monotonic() > deadline:
                raise RehearsalError(f"links are not armed: {self.armed}")
            self.keep_armed()
            self.pass_time(0.1, fresh=False)

    def fly(self, progress: Callable[[str], None]) -> bool:
        """See the mission through; return whether it came to its end.

        Raises:
            RehearsalError: what is needed is not heard, or somebody else drives links here.
        """
        phase = ""
        while self.now < MAX_DURATION * SECOND:
            self.pass_time(PERIOD)
            self.drives_alone()
            seen = np.array([self.joints[f"joint_{i}"] for i in self.armed])
            qd = seen[:, 2]
            q = seen[:, 1] + qd * (self.now - seen[:, 0]) / SECOND
            orders = self.guidance.orders(q, qd, self.holds)
            if orders.phase != phase:
                phase = orders.phase
                progress(f"{self.now / SECOND:6.1f} s  {phase}")
            stamp = self.get_clock().now().to_msg()
            command = ThrusterCommand(on_time=orders.on_times)
            command.header.stamp = stamp
            self.thrust.publish(command)
            self.grip.publish(Bool(data=orders.close))
            for link, rate in zip(self.links, orders.rates, strict=True):
                link_command = LinkCommand(
                    mode=LinkCommand.VELOCITY, set_point=rate, time_to_live=1.0
                )
                link_command.header.stamp = stamp
                link.publish(link_command)
            if phase == "done":
                return True
        return False


def start_all(nodes: Nodes, arm: Path, out: Path, seed: int) -> None:
    """Start test bed, recorder, links and arm."""
    clock = {"use_sim_time": True}
    nodes.start("record", "fss_arm_bags", "record", output=out / "bag", **clock)
    nodes.start(
        "testbed", "fss_sim", "testbed", arm=arm, seed=seed, ports=nodes.domain.ports(LINKS),
        keep_clock=True, paused=True, truth_rate=50.0, **BEGIN,
    )  # fmt: skip
    nodes.start(
        "links", "fss_arm_driver", "link", arm=arm, urls=nodes.domain.urls(LINKS), rate=20.0,
        timeout=10.0, watchdog=10.0, **clock,
    )  # fmt: skip
    nodes.start("arm", "fss_arm_driver", "arm", arm=arm, time_to_live=10.0, **clock)


class Flight(NamedTuple):
    """What sim/truth shows of the mission, (k, ...)."""

    time: np.ndarray  # [s]
    q: np.ndarray
    qd: np.ndarray
    target: np.ndarray
    target_twist: np.ndarray
    holds: np.ndarray
    momentum: np.ndarray  # of all bodies
    impulse: np.ndarray  # of it, given from outside
    error: np.ndarray  # of the audit: momentum and energy
    propellant: np.ndarray


def read(bag: Path) -> Flight:
    """The mission from its bag.

    Raises:
        RehearsalError: the bag has no truth in it.
    """
    with open_bags(bag) as bags:
        truths = [message for _, _, _, message in bags.messages({"/sim/truth"})]
    if not truths:
        raise RehearsalError(f"there is no sim/truth in {bag}")

    def column(name: str) -> np.ndarray:
        return np.array([getattr(message, name) for message in truths])

    stamps = np.array([stamp_ns(message.header.stamp) for message in truths]) / SECOND
    error = np.column_stack([column("momentum_error"), column("energy_error")])
    return Flight(
        stamps, column("q"), column("qd"), column("target"), column("target_twist"),
        column("holds"), column("momentum"), column("impulse"), error, column("propellant"),
    )  # fmt: skip


def accept(flight: Flight, say: Callable[[str], None]) -> bool:
    """Say how it went; return whether all is as it should be."""
    if not flight.holds.any():
        say("the target was not captured")
        return False
    k = int(np.argmax(flight.holds))
    change = flight.momentum[k] - flight.momentum[k - 1]
    given = flight.impulse[k] - flight.impulse[k - 1]
    say(f"captured between {flight.time[k - 1]:.2f} and {flight.time[k]:.2f} s")
    for name, unit, i in (("x", "N s", 0), ("y", "N s", 1), ("about the origin", "N m s", 2)):
        before, after = flight.momentum[k - 1, i], flight.momentum[k, i]
        say(f"  momentum {name:>16}  before {before:+.12f}  after {after:+.12f} {unit}")
    worst, audit = float(np.abs(change - given).max()), float(np.abs(flight.error).max())
    say(f"  differ by {worst:.1e} at most; the audit of the whole mission by {audit:.1e}")
    spin = np.degrees(flight.target_twist[[0, -1], 2])
    say(f"target's spin {spin[0]:.2f} deg/s at the begin, {spin[1]:.3f} deg/s at the end")
    say(f"propellant used {1e3 * flight.propellant[-1]:.1f} g")
    return worst < AGREE and abs(spin[1]) < 0.1 * abs(spin[0])


def plot(arm: Arm, flight: Flight, path: Path) -> None:
    """Draw the mission from above, and how momentum and motion went."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure = plt.figure(figsize=(12.0, 7.0), layout="constrained")
    grid = figure.add_gridspec(3, 2, width_ratios=(1.5, 1.0))
    above = figure.add_subplot(grid[:, 0])
    above.set(xlim=(-2, 2), ylim=(-2, 2), aspect="equal", xlabel="x [m]", ylabel="y [m]")
    above.set_title("the table from above: begin, capture, end")
    k = int(np.argmax(flight.holds)) if flight.holds.any() else len(flight.time) - 1
    for i, shade in ((0, 0.35), (k, 0.65), (len(flight.time) - 1, 1.0)):
        draw(above, arm, flight.q[i], flight.target[i], shade)
    above.plot(*flight.q[:, :2].T, "C0:", lw=1, label="base")
    above.plot(*flight.target[:, :2].T, "C3:", lw=1, label="target")
    above.legend(loc="upper left")
    panels: tuple[tuple[str, list[tuple[str, Any]]], ...] = (
        (
            "turning [deg/s]",
            [
                ("base", np.degrees(flight.qd[:, 2])),
                ("target", np.degrees(flight.target_twist[:, 2])),
            ],
        ),
        (
            "joints [deg]",
            [(f"joint {j}", np.degrees(flight.q[:, 2 + j])) for j in range(1, arm.n + 1)],
        ),
        (
            "momentum of all, about the origin [N m s]",
            [("it is", flight.momentum[:, 2]), ("of it, by thrusters", flight.impulse[:, 2])],
        ),
    )
    for row, (title, lines) in enumerate(panels):
        panel = figure.add_subplot(grid[row, 1])
        for name, values in lines:
            panel.plot(flight.time, values, lw=1, label=name)
        panel.axvline(flight.time[k], color="0.5", lw=0.8, ls="--")
        panel.set_title(title, fontsize=10)
        panel.legend(fontsize=8)
    panel.set_xlabel("time [s]; dashed: capture")
    figure.savefig(path, dpi=120)
    plt.close(figure)


def draw(axes: Any, arm: Arm, q: np.ndarray, target: np.ndarray, shade: float) -> None:
    """Base, arm and target as they are at one time."""
    square = 0.135 * np.array([1 + 1j, -1 + 1j, -1 - 1j, 1 - 1j, 1 + 1j])
    for (x, y, heading), colour in ((q[:3], "C0"), (target, "C3")):
        corners = complex(x, y) + square * np.exp(1j * heading)
        axes.plot(corners.real, corners.imag, colour, alpha=shade)
    fixture = complex(*target[:2]) + complex(*TARGET.fixture[:2]) * np.exp(1j * target[2])
    axes.plot([target[0], fixture.real], [target[1], fixture.imag], "C3", lw=1, alpha=shade)
    joints = joint_positions(arm.vector(), q)
    axes.plot(*joints.T, "C1o-", ms=4, alpha=shade)
    axes.plot([q[0], joints[0, 0]], [q[1], joints[0, 1]], "C0", alpha=shade)


def main() -> int:
    """Run; the exit code is 0 if the target was captured and stopped, and momentum stayed."""
    parser = argparse.ArgumentParser("mission.sh", description=__doc__)
    parser.add_argument("--seed", type=int, default=1, help="of the simulated errors")
    parser.add_argument("--out", type=Path, help="folder for the results (out/mission-TIME)")
    options = parser.parse_args()
    out = results(options.out, "mission")
    arm = load(CONFIG / "arm.yaml")
    with own_domain() as domain, Nodes(out / "logs", print, domain) as nodes:
        print(f"starting simulator, drivers, recorder and arm, in ROS domain {domain.number}")
        start_all(nodes, CONFIG / "arm.yaml", out, options.seed)
        pilot = Pilot(arm, domain)
        pilot.arm_links()
        ended = pilot.fly(print)
        pilot.destroy_node()
    flight = read(out / "bag")
    good = accept(flight, print) and ended
    plot(arm, flight, out / "mission.png")
    for name, what in (("bag", "recording"), ("mission.png", "drawing"), ("logs", "of the nodes")):
        print(f"{what:>16}  {out / name}")
    return 0 if good else 2


if __name__ == "__main__":
    sys.exit(rehearse("mission", main))
