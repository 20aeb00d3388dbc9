"""Two simulated vehicles, each with its own nodes, on crossing courses."""

from pathlib import Path
from time import monotonic

import pytest
import rclpy
import yaml
from ament_index_python.packages import get_package_prefix
from flight import Flyer
from running import OWN, free_port

from fss_rehearsal.processes import Nodes

pytestmark = pytest.mark.slow
NAMES = "fss1", "fss2"
STARTS = [-1.2, 0.0, 0.0], [0.0, -1.2, 1.57]
GOALS = [1.2, 0.0, 0.0], [0.0, 1.2, 1.57]
CURLED = [1.3, 1.15, 1.15, 1.1]


def start_vehicle(nodes, name, board, links):
    """Start the nodes of one vehicle, in its namespace."""
    clock = {"use_sim_time": True}
    urls = [f"udp://127.0.0.1:{port}?bind=0" for port in links]
    given = {
        "fss_arm_driver link": {"urls": urls},
        "fss_arm_driver arm": {},
        "fss_base_driver base": {"url": f"udp://127.0.0.1:{board}?bind=0"},
        "fss_gnc navigation": {},
        "fss_gnc control": {},
        "fss_gnc guidance": {"vehicles": list(NAMES)},
    }
    for what, parameters in given.items():
        package, executable = what.split()
        program = Path(get_package_prefix(package), "lib", package, executable)
        command = [str(program), "--ros-args", "-r", f"__ns:=/{name}"]
        nodes.run(f"{name}_{executable}", command, **clock, **parameters)


@pytest.fixture
def flyers(tmp_path_factory):
    folder = tmp_path_factory.mktemp("nodes")
    ports = {name: [free_port() for _ in range(5)] for name in NAMES}
    vehicles = {
        name: {"board_port": board, "ports": links, "base": start, "q": CURLED}
        for (name, (board, *links)), start in zip(ports.items(), STARTS, strict=True)
    }
    (folder / "vehicles.yaml").write_text(yaml.safe_dump({"vehicles": vehicles}))
    rclpy.init(args=[])
    with Nodes(folder, print, OWN) as nodes:
        parameters = {"vehicles": folder / "vehicles.yaml", "keep_clock": True, "lockstep": True}
        nodes.start("testbed", "fss_sim", "testbed", truth_rate=50.0, **parameters)
        for name, (board, *links) in ports.items():
            start_vehicle(nodes, name, board, links)
        found = [Flyer(nodes, namespace=name) for name in NAMES]
        for flyer in found:
            flyer.begin()
        yield found
        for flyer in found:
            flyer.close()
    rclpy.try_shutdown()


def least_gap(flyer):
    """Least gap of a vehicle to the other one so far [m]."""
    return min(
        gap
        for truth in flyer.truths
        for pair, gap in zip(truth.pairs, truth.gaps, strict=True)
        if all(name in pair for name in NAMES)
    )


def test_two_vehicles_on_crossing_courses_arrive_without_contact(flyers):
    for flyer, goal in zip(flyers, GOALS, strict=True):
        flyer.send("base/go_to", pose=goal, hold_duration=300.0)
    deadline = monotonic() + 900.0
    while any(flyer.states[-1].phase != "hold" for flyer in flyers):
        for flyer in flyers:
            flyer.executor_.spin_once(timeout_sec=0.01)
            assert flyer.states[-1].phase != "abort", flyer.states[-1].reason
        assert monotonic() < deadline, [flyer.states[-1].phase for flyer in flyers]
    first, second = flyers
    print(f"{second.t:.0f} s, least gap {least_gap(first):.3f} m")
    assert least_gap(first) > 0.04
    reasons = {state.reason for state in second.states}
    assert reasons & {"waits for fss1", "gives way to fss1"}
    for flyer, goal in zip(flyers, GOALS, strict=True):
        assert flyer.truths[-1].q[:2] == pytest.approx(goal[:2], abs=0.03)
