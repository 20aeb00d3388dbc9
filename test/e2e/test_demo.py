"""The main job as a person runs it: simulator, drivers over UDP, calibration, bag and back."""

import os
import re
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path
from threading import Event

import numpy as np
import pytest
import rclpy
from calib_quantization import quantization_bound
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from running import wait_until
from std_srvs.srv import SetBool

from fss_arm_bags.reader import open_bags
from fss_arm_calib.kinematic.problem import KinematicProblem
from fss_arm_calib.kinematic.solve import solve
from fss_arm_model.description_file import load
from fss_arm_model.layout import kinematic_index
from fss_arm_msgs.msg import LinkTelemetry
from fss_arm_ros.qos import SENSOR
from fss_arm_ros.state_file import read

ROOT = Path(__file__).resolve().parents[2]
NODES = {  # name in the demo: a word of its process's command line
    "testbed": "fss_sim/testbed",
    "record": "fss_arm_bags/record",
    "link_2": "link:=2",
    "arm": "fss_arm_driver/arm",
    "kinematic": "fss_arm_calib/kinematic",
    "experiment": "fss_arm_calib/experiment",
}


class Demo:
    """The demo as a process."""

    def __init__(self, out, *options):
        self.out, self.log = out, out.with_suffix(".log")
        with self.log.open("wb") as log:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "fss_rehearsal", "demo", "--out", out, *options],
                stdout=log,
                stderr=log,
            )

    @property
    def text(self):
        return self.log.read_text()

    def ended(self):
        return self.process.poll() is not None

    def wait(self, timeout):
        try:
            return self.process.wait(timeout)
        except subprocess.TimeoutExpired:
            pytest.fail(f"still running after {timeout} s:\n{self.text}")

    def domain(self):
        """The ROS domain that it says it is in."""
        found = re.search(r"own\s+ROS\s+domain,\s+(\d+)", self.text)
        return found and int(found[1])

    def observed(self):
        """How many rests have been observed, by the node's own file."""
        path = self.out / "observations.json"
        return sum(o["used"] for o in read(path, {"data": []})["data"])

    def pid(self, word):
        """The demo's child whose command line holds the word."""
        for stat in Path("/proc").glob("[0-9]*/stat"):
            try:
                parent = int(stat.read_text().rsplit(")", 1)[1].split()[1])
                command = stat.with_name("cmdline").read_bytes().decode().split("\0")
            except (OSError, ValueError):
                continue  # it has just ended
            if parent == self.process.pid and any(part.endswith(word) for part in command):
                return int(stat.parent.name)
        return None


@pytest.fixture
def demo(tmp_path):
    started = []

    def start(*options):
        started.append(Demo(tmp_path / f"demo{len(started)}", *options))
        return started[-1]

    yield start
    for one in started:
        if one.process.poll() is None:
            one.process.send_signal(signal.SIGINT)
            one.process.wait(60)


@pytest.mark.parametrize(
    "killed", [(), pytest.param(tuple(NODES), marks=pytest.mark.slow)], ids=["whole", "killed"]
)
def test_the_truth_comes_back_live_and_from_the_bag_whatever_node_dies(demo, killed):
    # Without noise; at a speed that two cores keep up with.
    postures = 13 if killed else 7
    run = demo("--speed", "2", "--preset", "ideal", "--postures", str(postures))
    pause = partial(Event().wait, 0.1)
    for observed, (name, word) in enumerate(((k, NODES[k]) for k in killed), 2):
        wait_until(lambda k=observed: run.observed() >= k or run.ended(), 120, pause)
        pid = wait_until(lambda w=word: run.pid(w), 20, pause)
        os.kill(pid, signal.SIGKILL)
        wait_until(lambda n=name: f"node {n} was killed" in run.text, 20, pause)
    assert run.wait(300) == 0, run.text
    for name in killed:
        assert f"node {name} was killed (SIGKILL), restarting it" in run.text
    assert f"{postures}/{postures}" in run.text
    if not killed:
        assert "parameters differ by at most" in run.text  # live and from the bag
    assert len(list((run.out / "bag").iterdir())) == 1 + ("record" in killed)
    assert load(run.out / "arm.yaml").n == 4

    topics = "/calibration/kinematic", "/calibration/observations"
    with open_bags(run.out / "bag") as bags:
        last = {topic: message for topic, _, _, message in bags.messages({*topics})}
    live, observations = (last[topic] for topic in topics)
    live, used = live.calibration, [o for o in observations.observations if o.used]
    assert live.verdict == live.PASS
    cad = load(ROOT / "config/cad.yaml")
    problem = KinematicProblem([o.q for o in used], [o.tip for o in used], cad)
    assert len(problem.q) >= postures
    # A rest lets a joint creep by less than a count beside the half count of rounding.
    bound = quantization_bound(problem, 1.5 * 2 * np.pi / 240_000, live.values)
    truth = load(ROOT / "config/truth.yaml")
    true = truth.vector()[kinematic_index(4)][2:]  # a_1 = a_2 = a_3
    assert (np.abs(live.values - true) < bound).all()
    assert bound.max() < 1e-3
    # A live result follows from the observations that it carries. Where a link let its joint go by
    # some counts, the noise that is found weighs positions and headings otherwise than assumed.
    atol = 1e-5 if killed else 1e-9
    np.testing.assert_allclose(solve(problem).values, live.values, rtol=0, atol=atol)


def test_the_demo_keeps_away_from_links_in_the_exported_domain(ros, spin, demo, domain):
    """As when the real arm's drivers run, and its domain is exported: docs/start/hardware.md."""
    real, asked = Node("arm"), []
    real.create_service(
        SetBool, "arm/enable", lambda request, answer: asked.append(request) or answer
    )
    telemetry = real.create_publisher(LinkTelemetry, "link_1/telemetry", SENSOR)
    run, heard = demo("--preset", "ideal"), []
    spin(real, lambda: run.domain() or run.ended(), 60.0)
    assert run.domain() not in (None, domain), run.text

    context = Context()  # one who looks on in the demo's domain
    rclpy.init(context=context, domain_id=run.domain())
    look = Node("look", context=context)
    look.create_subscription(LinkTelemetry, "link_1/telemetry", heard.append, SENSOR)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(look)

    def armed():
        telemetry.publish(LinkTelemetry(link=1))
        executor.spin_once(timeout_sec=0.1)
        return heard and heard[-1].armed

    spin(real, armed, 60.0)
    executor.shutdown()
    look.destroy_node()
    context.shutdown()
    pids = [pid for pid in map(run.pid, NODES.values()) if pid]
    assert len(pids) == len(NODES)
    run.process.terminate()
    assert run.wait(60) == 128 + signal.SIGTERM, run.text
    assert run.text.endswith("demo: interrupted\n")
    assert not any(Path(f"/proc/{pid}").exists() for pid in pids)
    assert not asked
