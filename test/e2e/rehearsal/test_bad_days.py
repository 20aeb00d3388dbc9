"""First day, every fault, power failure, empty tank: rehearsed by the documents' commands."""

import os
import re
import subprocess
import sys
import threading
from dataclasses import dataclass
from pathlib import Path

import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from fss_arm_driver.faults import FAULTS, Word, blocking_faults
from fss_arm_driver.protocol import State
from fss_arm_model.files import read_yaml
from fss_arm_msgs.msg import LinkCommand, LinkTelemetry
from fss_arm_ros.qos import COMMAND, SENSOR
from fss_sim.testbed_node import TestbedNode

SCRIPT = Path(__file__).resolve().parents[3] / "scripts/fss_arm.py"
LINKS = range(1, 5)


def make_bed(**settings):
    settings = {"ports": [0, 0, 0, 0], "preset": "ideal", "table": [20.0, 20.0], **settings}
    return TestbedNode(parameter_overrides=[Parameter(k, value=v) for k, v in settings.items()])


def put(bed, **faults):
    """Set faults, as `ros2 param set` does: link_2__dead=1.0."""
    given = [Parameter(name.replace("__", "."), value=v) for name, v in faults.items()]
    assert all(result.successful for result in bed.set_parameters(given))


class Laboratory(Node):
    """A test bed, the drivers of its links, and a person with a shell."""

    def __init__(self, spin, start, **settings):
        super().__init__("laboratory")
        self.bed, self.run_nodes = make_bed(q=[0.1, -0.1, 0.1, -0.1], **settings), spin
        urls = [f"udp://127.0.0.1:{wire.port}?bind=0" for wire in self.bed.wires]
        start("fss_arm_driver.link_node", "--ros-args", "-p", f"urls:={urls}")
        start("fss_arm_driver.arm_node")
        self.heard, self.goal = {}, {}
        for i in LINKS:
            self.create_subscription(LinkTelemetry, f"link_{i}/telemetry", self.hear, SENSOR)
        self.orders = {
            i: self.create_publisher(LinkCommand, f"link_{i}/command", COMMAND) for i in LINKS
        }
        self.create_timer(0.2, self.order)
        self.until(lambda: len(self.heard) == 4, 60.0)

    def hear(self, message):
        self.heard[message.link] = message

    def order(self):
        for i, angle in self.goal.items():
            command = LinkCommand(
                mode=LinkCommand.POSITION, set_point=angle, max_velocity=0.5, time_to_live=1.0
            )
            self.orders[i].publish(command)

    def until(self, condition, timeout=20.0):
        return self.run_nodes([self.bed, self], condition, timeout)

    def tell(self, what):
        """`scripts/fss_arm.sh WHAT`: its exit code and words."""
        with subprocess.Popen(
            [sys.executable, SCRIPT, what], stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            text=True, env=os.environ,
        ) as process:  # fmt: skip
            self.until(lambda: process.poll() is not None, 120.0)
            return process.returncode, process.stdout.read()

    def succeed(self, what):
        """The same, again while a busy machine keeps a link waiting for too long."""
        for _ in range(4):
            code, said = self.tell(what)
            if code == 0:
                return said
        pytest.fail(f"{what}: {said}")

    def referenced(self):
        return {i for i, m in self.heard.items() if m.flags & State.REFERENCED}

    def move(self, **way):
        """Have all joints go somewhere; whether they do."""
        self.succeed("arm")
        self.goal = dict.fromkeys(LINKS, way["to"])
        self.until(lambda: all(abs(q - way["to"]) < 0.01 for q in self.bed.testbed.plant.q[3:]))
        self.goal = {}


# --- every fault ---------------------------------------------------------------------------------

LATCHED = {f.name: f for f in FAULTS if f.word is Word.FAULTS}
STUCK = "tracking error"
ENDED_BY_POWER = {"flash memory damaged", "internal error", "logic failure"}
UNREFERENCED = {*ENDED_BY_POWER, "feedback error"}


def injected(name):
    """Fault of the drive and its value, as the page has them."""
    fault, value = re.match(r"`(\w+)`(?: (-?\d+))?", LATCHED[name].rehearsal).groups()
    return fault, float(value or 1)


def happen(lab, chosen):
    """Have a fault of each link's drive; each is latched, and lets go of its joint."""
    lab.succeed("arm")
    lab.goal = {i: 1.0 for i, name in chosen.items() if name == STUCK}
    faults = {i: injected(name) for i, name in chosen.items()}
    put(lab.bed, **{f"drive_{i}__{fault}": value for i, (fault, value) in faults.items()})
    bits = {i: 1 << LATCHED[name].bit for i, name in chosen.items()}
    lab.until(lambda: all(lab.heard[i].faults & bit for i, bit in bits.items()))
    lab.goal = {}
    lab.until(lambda: not any(lab.heard[i].mode or lab.heard[i].armed for i in chosen))
    for i, name in chosen.items():
        assert name in blocking_faults(lab.heard[i].status, lab.heard[i].faults)


def mend(lab, chosen):
    """Take the causes away, clear what is latched, and cycle the power where that does not help."""
    lab.succeed("clear")  # which helps only where the cause has gone with the torque
    lab.until(lambda: not any(lab.heard[i].faults for i, n in chosen.items() if n == STUCK))
    for i, name in chosen.items():
        assert bool(lab.heard[i].faults) == (name != STUCK)
    put(lab.bed, **{f"drive_{i}__{injected(name)[0]}": 0.0 for i, name in chosen.items()})
    lab.succeed("clear")
    left = {i for i, name in chosen.items() if name in ENDED_BY_POWER}
    lab.until(lambda: {i for i in LINKS if lab.heard[i].faults} == left)
    boots = {i: lab.heard[i].boot for i in left}
    put(lab.bed, **{f"link_{i}__dead": 1.0 for i in left})
    lab.until(lambda: not any(lab.bed.testbed.links[i - 1].running for i in left))
    put(lab.bed, **{f"link_{i}__dead": 0.0 for i in left})
    lab.until(lambda: all(lab.heard[i].boot != boot for i, boot in boots.items()))
    lab.until(lambda: not any(m.faults for m in lab.heard.values()))


@pytest.mark.slow
def test_every_fault_is_seen_cleared_and_left_behind(spin, start):
    lab, names = Laboratory(spin, start), sorted(LATCHED)
    for begin in range(0, len(names), 4):
        chosen = dict(zip(LINKS, names[begin : begin + 4], strict=False))
        happen(lab, chosen)
        code, said = lab.tell("arm")
        assert code == 1
        assert all(name in said for name in chosen.values()), said
        mend(lab, chosen)
        lost = {i for i, name in chosen.items() if name in UNREFERENCED}
        assert lab.referenced() == set(LINKS) - lost
        lab.succeed("arm")
        lab.succeed("home")
        assert lab.referenced() == set(LINKS)
        lab.move(to=0.1)
        lab.succeed("disarm")


# --- power ---------------------------------------------------------------------------------------


def test_after_a_power_failure_links_are_homed_and_move_again(spin, start):
    lab = Laboratory(spin, start)
    lab.succeed("arm")
    lab.goal = dict.fromkeys(LINKS, 1.0)
    lab.until(lambda: all(qd > 0.1 for qd in lab.bed.testbed.plant.qd[3:]))
    put(lab.bed, **{f"link_{i}__dead": 1.0 for i in LINKS})
    lab.until(lambda: not any(link.running for link in lab.bed.testbed.links))
    lab.goal = {}
    boots = {i: m.boot for i, m in lab.heard.items()}
    put(lab.bed, **{f"link_{i}__dead": 0.0 for i in LINKS})
    lab.until(lambda: all(lab.heard[i].boot != boot for i, boot in boots.items()))
    assert not any(m.armed for m in lab.heard.values())
    assert not lab.referenced()
    assert all(m.status >> 20 & 1 for m in lab.heard.values())  # "was reset"
    code, said = lab.tell("home")
    assert code == 1
    assert "it is not armed" in said
    lab.succeed("arm")
    assert lab.succeed("home").endswith("all 4 links are referenced\n")
    lab.move(to=0.2)


def test_empty_batteries_are_charged_and_links_homed(spin, start):
    lab = Laboratory(spin, start, battery=0.03)
    volts, boots = lab.heard[1].battery, {i: m.boot for i, m in lab.heard.items()}
    for link in lab.bed.testbed.links:
        link.supply.battery.charge = 1e-6
    lab.until(lambda: not any(link.running for link in lab.bed.testbed.links))
    assert volts == 0 or volts < 135
    charger = lab.create_client(Trigger, "sim/charge")
    lab.until(charger.service_is_ready)
    lab.until(charger.call_async(Trigger.Request()).done)
    lab.until(lambda: all(m.battery > 160 and m.boot != boots[i] for i, m in lab.heard.items()))
    lab.succeed("arm")
    lab.succeed("home")
    assert lab.referenced() == set(LINKS)


# --- air -----------------------------------------------------------------------------------------


def test_an_empty_tank_lays_the_vehicle_on_the_table_and_diagnostics_say_so(spin):
    bed = make_bed(
        bearing_flow=2e-3, tank_volume=0.43e-5, twist=[0.1, 0.0, 0.05], keep_clock=True, speed=5.0
    )
    spin(bed, lambda: bed.testbed.frame > 20)
    assert bed.testbed.plant.qd[0] == pytest.approx(0.1, abs=0.01)
    assert "air" not in bed.health().message
    spin(bed, lambda: not bed.testbed.plant.thrusters.floats)
    spin(bed, lambda: abs(bed.testbed.plant.qd[:3]).max() < 1e-4)
    assert "no air in the bearings: the vehicle rubs on the table" in bed.health().message


# --- the first day -------------------------------------------------------------------------------


@dataclass
class Person:
    """Answers `check`: turns the joint by hand, loads it, and agrees."""

    bed: TestbedNode
    process: subprocess.Popen
    link: int
    said: str = ""
    asked: str = ""
    hand: float = 0.0

    def __post_init__(self):
        threading.Thread(target=self.listen, daemon=True).start()

    def listen(self):
        while text := self.process.stdout.read(1):
            self.said += text
            self.asked += text

    def push(self, torque):
        put(self.bed, **{f"drive_{self.link}__hand": torque})

    def answer(self, words):
        self.asked = ""
        self.process.stdin.write(f"{words}\n")
        self.process.stdin.flush()

    def act(self, spin):
        """Do what is asked for, if something is."""
        joint = self.bed.testbed.plant.q[2 + self.link : 3 + self.link]
        if "to skip this test: " in self.asked and "by an angle" in self.asked:
            before = joint[0]
            self.push(0.4)
            spin(self.bed, lambda: joint_of(self.bed, self.link) > before + 0.6)
            self.push(-0.4)
            spin(self.bed, lambda: self.bed.testbed.plant.qd[2 + self.link] < 0.05)
            self.push(0.0)
            spin(self.bed, lambda: abs(self.bed.testbed.plant.qd[2 + self.link]) < 1e-4, 20.0)
            turned = joint_of(self.bed, self.link) - before
            self.answer(f"{turned * 57.29577951308232:.3f}")
        elif "free of any torque, and press Enter: " in self.asked:
            frame = self.bed.testbed.frame  # a busy machine may still read of the hand's torque
            spin(self.bed, lambda: self.bed.testbed.frame > frame + 300, 30.0)
            self.answer("")
        elif "N m, or nothing to skip this test: " in self.asked:
            self.push(0.5)
            frame = self.bed.testbed.frame
            spin(self.bed, lambda: self.bed.testbed.frame > frame + 1000, 30.0)  # to the stop
            self.answer("0.5")
        elif "type yes: " in self.asked:
            self.push(0.0)
            self.answer("yes")


def joint_of(bed, link):
    return bed.testbed.plant.q[2 + link]


def test_the_first_day_passes_link_by_link(spin, ros, tmp_path):
    bed = make_bed(q=[0.0, -0.9, 0.0, 0.0], tether_drag=1e3, tether_twist=50.0)  # the base is held
    output = tmp_path / "check.yaml"
    command = "import sys; from fss_arm_driver.check import main; sys.exit(main())"
    url = f"udp://127.0.0.1:{bed.wires[1].port}?bind=0"
    with subprocess.Popen(
        [sys.executable, "-u", "-c", command, url, "--output", output],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    ) as process:  # fmt: skip
        person = Person(bed, process, 2)

        def ended():
            person.act(spin)
            return process.poll() is not None

        try:
            spin(bed, ended, 120.0)
        finally:
            process.kill()
            print(person.said)
    assert process.returncode == 0, person.said
    (link,) = read_yaml(output.read_text())["links"]
    found = {f["name"]: f["verdict"] for f in link["findings"]}
    assert len(found) == 9, found
    assert set(found.values()) == {"pass"}
