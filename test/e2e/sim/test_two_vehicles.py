"""Two vehicles in one test bed, a graph each: told apart, recorded apart, stopped together."""

import re
import subprocess
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from rclpy.node import Node
from running import OWN
from std_msgs.msg import Empty
from std_srvs.srv import SetBool

from fss_arm_bags.reader import open_bags
from fss_arm_driver.protocol import State
from fss_arm_model.description import paper_arm
from fss_arm_model.description_file import save
from fss_arm_msgs.msg import LinkCommand, LinkTelemetry
from fss_arm_ros.convert import SECOND, stamp_ns
from fss_arm_ros.qos import SENSOR, command

SCRIPT = Path(__file__).resolve().parents[3] / "scripts/fss_arm.py"
VEHICLES, LINKS = ("fss1", "fss2"), (1, 2)
PERIOD = 0.2  # of commands [s]
STOPS = 5


class Person(Node):
    """Hears all links of both vehicles, and moves them."""

    def __init__(self):
        super().__init__("person")
        self.last, self.stopped, self.told = {}, {}, None
        self.commands = {}
        for vehicle in VEHICLES:
            self.create_subscription(Empty, f"/{vehicle}/arm/stop", self.on_stop, 10)
            for i in LINKS:
                key, topic = (vehicle, i), f"/{vehicle}/link_{i}"
                take = partial(self.on_telemetry, key)
                self.create_subscription(LinkTelemetry, f"{topic}/telemetry", take, SENSOR)
                qos = command(5.0)
                self.commands[key] = self.create_publisher(LinkCommand, f"{topic}/command", qos)
        self.arming = [self.create_client(SetBool, f"/{v}/arm/enable") for v in VEHICLES]
        self.create_timer(0.5, self.move)

    def move(self):
        for publisher in self.commands.values():
            publisher.publish(
                LinkCommand(mode=LinkCommand.VELOCITY, set_point=0.02, time_to_live=2.0)
            )

    def on_stop(self, _):
        if self.told is None:
            self.told = self.get_clock().now().nanoseconds

    def on_telemetry(self, key, message):
        self.last[key] = message
        if message.flags & State.STOPPED:
            self.stopped.setdefault(key, stamp_ns(message.header.stamp))

    def armed(self, vehicle):
        return [self.last[vehicle, i].armed for i in LINKS]

    def moving(self, vehicle):
        return all(self.last[vehicle, i].velocity for i in LINKS)


@pytest.mark.slow
def test_two_graphs_are_told_apart_and_stopped_together(start, spin, tmp_path, capsys):
    save(replace(paper_arm(), links=paper_arm().links[:2]), tmp_path / "arm.yaml")
    ports = OWN.ports(4)
    (tmp_path / "vehicles.yaml").write_text(
        f"vehicles:\n  fss1: {{ports: {ports[:2]}, base: [-1.0, 0.0, 1.57]}}\n"
        f"  fss2: {{ports: {ports[2:]}, base: [1.0, 0.0, 1.57]}}\n"
    )
    arm = "-p", f"arm:={tmp_path / 'arm.yaml'}"
    start(
        "fss_sim.testbed_node", "--ros-args", *arm, "-p", f"vehicles:={tmp_path / 'vehicles.yaml'}",
        "-p", "telemetry_rate:=20.0",
    )  # fmt: skip
    recorders = []
    for k, vehicle in enumerate(VEHICLES):
        here = "-r", f"__ns:=/{vehicle}"
        urls = [f"udp://127.0.0.1:{port}?bind=0" for port in ports[2 * k : 2 * k + 2]]
        long = "-p", "timeout:=5.0", "-p", "watchdog:=10.0", "-p", "time_to_live:=5.0"
        start("fss_arm_driver.driver_node", "--ros-args", *here, *arm, "-p", f"urls:={urls}", *long)
        output = "-p", f"output:={tmp_path / vehicle}"
        recorders.append(start("fss_arm_bags.record_node", "--ros-args", *here, *output))
    person = Person()

    def tell(*words):
        process = subprocess.Popen(
            [sys.executable, SCRIPT, *words],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        spin(person, lambda: process.poll() is not None, 60.0)
        return process.communicate()

    def stop(*words):
        # Within a second all links confirm, or not, if other work has the machine.
        return next(out for out, _ in (tell("stop", *words) for _ in range(3)) if out)

    def arm_all():
        # A link that a busy machine kept waiting for too long wants to be told again.
        def moving():
            if all(answer.done() for answer in answers):
                answers[:] = [c.call_async(SetBool.Request(data=True)) for c in person.arming]
            return all(person.armed(v) == [True, True] and person.moving(v) for v in VEHICLES)

        answers = []
        spin(person, moving, 60.0)
        spin(person, lambda: all(answer.done() for answer in answers))
        person.stopped, person.told = {}, None

    spin(person, lambda: len(person.last) == 4, 60.0)
    _, nobody = tell("arm", "--wait", "1")
    here = f"in ROS domain {OWN.number}"
    assert nobody == f"no node offers arm/enable {here}; --vehicle is one of /fss1, /fss2\n"
    tell("arm", "--vehicle", "fss1")
    assert (person.armed("fss1"), person.armed("fss2")) == ([True, True], [False, False])
    arm_all()
    out = stop("--vehicle", "fss1")
    assert re.fullmatch(r"fss1/link_1, fss1/link_2: stopped after \d\.\d\d s\n", out)
    assert {vehicle for vehicle, _ in person.stopped} == {"fss1"}
    assert person.moving("fss2")

    took, apart = [], []
    for _ in range(STOPS):
        arm_all()
        everyone = ", ".join(f"{v}/link_{i}" for v in VEHICLES for i in LINKS)
        assert stop().startswith(f"{everyone}: stopped after ")
        spin(person, lambda: len(person.stopped) == 4)
        stops = person.stopped.values()
        took.append((max(stops) - person.told) / SECOND)  # told when the person heard of it
        apart.append((max(stops) - min(stops)) / SECOND)
        assert not any(person.armed("fss1") + person.armed("fss2"))
    with capsys.disabled():
        for what, times in (("after", took), ("apart", apart)):
            print(f"\nall links stopped {what} {', '.join(f'{t:.3f}' for t in sorted(times))} s")
    assert np.median(took) < PERIOD  # each, on a machine with nothing else to do
    assert np.median(apart) < PERIOD

    for vehicle, other, recorder in zip(VEHICLES, VEHICLES[::-1], recorders, strict=True):
        assert recorder.stop() == 0
        with open_bags(tmp_path / vehicle) as bags:
            assert not [topic for topic in bags.topics if topic.startswith(f"/{other}/")]
            assert bags.topics[f"/{vehicle}/joint_states"].messages > 100
            assert bags.topics[f"/vicon/{other}/{other}"].messages > 100  # the laboratory's
