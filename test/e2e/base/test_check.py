"""The base's first day: the command `check` beside the node `base` and a board with a bad valve."""

from io import StringIO

import pytest
from rclpy.parameter import Parameter
from running import free_port

from fss_arm_model.files import read_yaml
from fss_base_driver import check_command, check_node
from fss_sim.testbed_node import TestbedNode

ALONE = ("--q", "0", "0", "0", "0", "--yes")


def test_a_valve_that_does_not_open_is_found_and_the_others_fit(spin, start, tmp_path):
    port = free_port()
    settings = {
        "ports": [0, 0, 0, 0], "board_port": port, "table": [8.0, 8.0], "coulomb_friction": 5.0,
        "valve_3.stuck_closed": 1.0,
    }  # fmt: skip
    bed = TestbedNode(parameter_overrides=[Parameter(k, value=v) for k, v in settings.items()])
    output = tmp_path / "found.yaml"
    start("fss_base_driver.base_node", "--ros-args", "-p", f"url:=udp://127.0.0.1:{port}?bind=0")
    options = "--valves", 1, 3, "--before", 2, "--after", 3, "--output", output
    check = start("fss_base_driver.check_node", *ALONE, *options)
    spin(bed, lambda: check.process.poll() is not None, 90.0)
    assert check.process.returncode == 2, check.output
    first, third = read_yaml(output.read_text())["valves"]
    assert (first["valve"], first["verdict"]) == (1, "pass")
    assert first["force"] == pytest.approx([-0.16, 0.0], abs=0.02)
    assert (third["valve"], third["verdict"]) == (3, "fail")
    assert "no thrust" in third["words"]
    assert not bed.testbed.board.state.armed  # it leaves the board as it found it


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (("--on-time", "0"), "--on-time is 0.0, expected above 0 and below 60\n"),
        (("--after", "60"), "--after is 60.0, expected above 0 and below 60\n"),
        (("--q", "nan"), "--q is [nan], expected finite numbers"),
        (("--layout", *(24 * ["inf"])), "expected finite numbers"),
        (("--valves", "9"), "--valves is [9], expected 1 to 8"),
        (("--q", "0"), "--q has 1 angles, expected 4"),
        ((), "end of input"),
    ],
)
def test_what_cannot_be_done_is_said(monkeypatch, capsys, args, words):
    monkeypatch.setattr(check_command, "interrupt_at_end", lambda: None)
    monkeypatch.setattr("sys.stdin", StringIO())
    try:
        code = check_node.main(args)
    except SystemExit as end:
        code = end.code
    assert code == 1
    assert words in capsys.readouterr().err
