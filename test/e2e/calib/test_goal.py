"""An experiment with a goal, as a person makes it: design, the whole graph, and when it stops."""

import re
import time
from dataclasses import replace
from threading import Event

import pytest
from rclpy.node import Node
from running import wait_until
from std_srvs.srv import SetBool

from fss_arm_calib.experiment.design_command import main as design
from fss_arm_model.description import paper_arm
from fss_arm_model.description_file import save
from fss_arm_msgs.msg import DynamicCalibration, LinkTelemetry
from fss_arm_ros.qos import LATCHED, SENSOR

GOAL = {"b": 0.002, "I": 0.1}  # of each link [m], and of its description's value
#: A base that is seen well, and weighed, on a level table.
SEEN = {
    "position_deviation": 0.0001, "heading_deviation": 0.0002, "base_mass_deviation": 0.005,
    "mass_deviation": 0.001, "length_deviation": 0.0001, "offset_deviation": 0.0001,
    "mount_deviation": 0.0001, "mount_angle_deviation": 0.0001,
}  # fmt: skip
BED = {
    "preset": "ideal",
    "position_noise": 0.0001,
    "heading_noise": 0.0002,
    "vicon_hold": 0.1,
    "telemetry_rate": 20.0,
    "keep_clock": True,
    "speed": 0.0,
}


class Operator(Node):
    """Hears the calibration, and has the links armed."""

    def __init__(self):
        super().__init__("operator")
        self.armed, self.results, self.asked, self.due = {}, [], None, 0.0
        for i in range(1, 5):
            self.create_subscription(
                LinkTelemetry,
                f"link_{i}/telemetry",
                lambda m, i=i: self.armed.update({i: m.armed}),
                SENSOR,
            )
        heard = self.results.append
        self.create_subscription(DynamicCalibration, "calibration/dynamic", heard, LATCHED)
        self.enable = self.create_client(SetBool, "arm/enable")

    def keep_armed(self):
        """Ask for it where a link is not, again if no answer came."""
        armed = len(self.armed) == 4 and all(self.armed.values())
        answered = self.asked is None or self.asked.done() or time.monotonic() > self.due
        if not armed and answered and self.enable.service_is_ready():
            self.asked = self.enable.call_async(SetBool.Request(data=True))
            self.due = time.monotonic() + 5.0


def parameters(**values):
    given = []
    for name, value in values.items():
        given += ["-p", f"{name}:={str(value).lower() if isinstance(value, bool) else value}"]
    return "--ros-args", *given


def planned(folder, count):
    """So many maneuvers by `design`."""
    given = [f"--{key.replace('_', '-')}={value}" for key, value in SEEN.items()]
    plan = folder / f"plan_{count}.yaml"
    asked = ["--arm", str(folder / "guess.yaml"), "--count", str(count), "--output", str(plan)]
    assert design([*asked, *given]) == 0
    return plan


@pytest.mark.slow
def test_an_experiment_stops_when_its_goal_is_met(start, spin, tmp_path):
    truth = paper_arm()
    links = tuple(replace(k, b=k.b - 0.01, inertia=1.1 * k.inertia) for k in truth.links)
    guess = replace(truth, links=links)
    save(guess, tmp_path / "guess.yaml")
    save(truth, tmp_path / "truth.yaml")
    goal = {f"b_{i}": GOAL["b"] for i in range(1, 5)}
    goal |= {f"I_{i}": GOAL["I"] * k.inertia for i, k in enumerate(links, 1)}

    arm, clock = {"arm": tmp_path / "guess.yaml"}, {"use_sim_time": True}
    terminals = [str(tmp_path / f"tty_{i}") for i in range(1, 5)]
    bed = parameters(arm=tmp_path / "truth.yaml", terminals=terminals, **BED)
    start("fss_sim.testbed_node", *bed)
    wait_until(lambda: (tmp_path / "tty_4").exists(), 30.0, lambda: Event().wait(0.05))
    urls = [f"serial://{path}?baud=115200" for path in terminals]
    patience = {"timeout": 4.0, "watchdog": 4.0}  # with a busy machine
    start("fss_arm_driver.link_node", *parameters(urls=urls, **patience, **clock))
    start("fss_arm_driver.arm_node", *parameters(time_to_live=2.0, **arm, **clock))
    start("fss_arm_calib.programs:dynamic", *parameters(**SEEN, **arm, **clock))
    operator = Operator()

    plan = planned(tmp_path, 14)
    words = " ".join(f"{name} {deviation:.7f}" for name, deviation in goal.items())
    given = parameters(maneuvers=plan, goal=words, state_file=f"{plan}.json", **arm, **clock)
    said = "was stalled"
    while "was stalled" in said:  # by a busy machine: it is started again
        program = start("fss_arm_calib.experiment.experiment_node", *given)

        def ended(process=program.process):
            operator.keep_armed()
            return process.poll() is not None

        spin(operator, ended, 400.0)
        said = program.output.splitlines()[-1]
    assert program.process.returncode == 0, said
    made, of = map(int, re.search(r"goal met after (\d+) of (\d+) postures: pass", said).groups())
    assert made < of - 2
    found = operator.results[-1].calibration
    assert found.verdict == "pass"
    known = dict(zip(found.names, found.deviations, strict=False))
    assert all(known[name] <= asked for name, asked in goal.items())
    values = dict(zip(found.names, found.values, strict=False))
    for i, link in enumerate(truth.links, 1):
        assert abs(values[f"b_{i}"] - link.b) < 4.0 * known[f"b_{i}"]
        assert abs(values[f"I_{i}"] - link.inertia) < 4.0 * known[f"I_{i}"]
