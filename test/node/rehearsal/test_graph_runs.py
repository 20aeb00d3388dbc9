"""Runs of a campaign with all nodes: their parameters, faults and figures."""

import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_prefix

from fss_arm_bags.reader import open_bags
from fss_arm_model.settings import SettingError
from fss_arm_msgs.msg import SimTruth
from fss_gnc.guidance.mission_settings import MissionSettings
from fss_rehearsal.campaign.plan import GRAPH_RUNS, read_campaign
from fss_rehearsal.domain import CONFIG
from fss_rehearsal.loops.graph import GraphFaultSettings, capture, changes, figures
from fss_sim.faults import LinkFaults
from fss_sim.settings import TestbedSettings

FILES = "captures_by_nodes", "faults_by_nodes"


@pytest.mark.parametrize("name", FILES)
def test_campaigns_by_nodes_can_be_read(name):
    campaign = read_campaign(CONFIG / "campaigns" / f"{name}.yaml")
    assert campaign.function == GRAPH_RUNS["capture"]
    assert not campaign.is_repeatable


def test_runs_by_nodes_are_those_without_ros():
    """Runs with the same number can be compared."""
    with_nodes, without = (
        read_campaign(CONFIG / "campaigns" / f"{name}.yaml").runs for name in (FILES[0], "captures")
    )
    for one, other in zip(with_nodes, without, strict=True):
        assert one.values.items() >= other.values.items()


def test_nodes_get_the_settings_that_are_not_defaults():
    settings = replace(TestbedSettings(), seed=5, q=(0.1, 0.2, 0.3, 0.4), target_mass=10.0)
    assert changes(settings) == {"seed": 5, "q": [0.1, 0.2, 0.3, 0.4], "target_mass": 10.0}
    assert not changes(MissionSettings())


def test_a_fault_is_a_parameter_of_the_test_bed():
    assert GraphFaultSettings("open", valve=7).parameters() == {"valve_7.stuck_open": 1.0}
    (name,) = GraphFaultSettings("link").parameters()
    assert hasattr(LinkFaults(), name.removeprefix("link_2."))
    with pytest.raises(SettingError, match="kind is 'gripper'"):
        GraphFaultSettings("gripper")


@pytest.mark.parametrize(
    ("fault", "missing"),
    [(GraphFaultSettings("gyro"), "phase"), (GraphFaultSettings("kill", "reach"), "node")],
)
def test_an_incomplete_fault_is_rejected_before_anything_starts(fault, missing):
    with pytest.raises(SettingError, match=f"fault.{missing} is ''"):
        capture(1, fault=fault)


def truth(second, gap=0.5, holds=False, rate=0.0, valve=False):
    message = SimTruth(
        pairs=["link 2, target", "gripper, target"], gaps=[gap, -0.01], holds=holds,
        edge_clearance=0.3, torque=[0.1, -0.4], qd=[0.0, 0.0, 0.0, rate, 0.0],
        valves=[valve] * 8, propellant=0.01 * second,
    )  # fmt: skip
    message.header.stamp.sec = second
    return message


def test_figures_are_those_of_the_true_states():
    states = [
        truth(10, valve=True),
        truth(11, gap=0.2, rate=0.1),
        truth(12, valve=True, rate=0.1),
        truth(13, holds=True),
    ]
    found = figures(states, started=10.0, fault_time=11.0)
    assert found["gap"] == 0.2
    assert found["contact"] == ""
    assert found["torque"] == 0.4
    assert found["grip"] == 3.0
    assert (found["valves_open"], found["joints_moving"]) == (1.0, 1.0)
    touching = figures([*states, truth(14, gap=-0.001)], 10.0, 11.0)
    assert touching["contact"] == "bodies at 4.0 s"


def repeat(name, number, out):
    """Repeat a run of a campaign, and return what it prints."""
    program = Path(get_package_prefix("fss_rehearsal"), "lib/fss_rehearsal/campaign")
    file = CONFIG / "campaigns" / f"{name}.yaml"
    command = [program, file, "--out", out, "--replay", str(number)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=900, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.slow
def test_a_capture_by_nodes_is_repeated_with_a_bag(tmp_path):
    assert "outcome  success" in repeat(FILES[0], 3, tmp_path)
    with open_bags(tmp_path / "run_3" / "bag") as bags:
        holds = [m.holds for _, _, _, m in bags.messages({"/sim/truth"})]
    assert holds[-1]
    assert not holds[0]


@pytest.mark.slow
def test_valves_close_after_the_control_was_killed(tmp_path):
    campaign = read_campaign(CONFIG / "campaigns" / f"{FILES[1]}.yaml")
    cells = [list(run.cell.values()) for run in campaign.runs]
    text = repeat(FILES[1], cells.index(["control killed", "approach"]), tmp_path)
    values = dict(line.split(maxsplit=1) for line in text.splitlines() if "  " in line)
    assert float(values["valves_open"]) < 1.5
    assert float(values["gap"]) > 0.0
