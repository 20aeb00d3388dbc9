"""`from_bag --joint` from bags of other arms that other tools made, by a new user's files."""

import numpy as np
import pytest
from foreign_bags import arm, flight, heard, write

from fss_arm_calib.from_bag import main as from_bag
from fss_arm_calib.result import read_passed
from fss_arm_model.description_file import load
from fss_arm_model.parameters import parameter_names, values
from fss_arm_model.planar import wrap
from fss_arm_ros.command_line import USER_ERROR


def main(args):
    return from_bag(["--joint", *args])


def drawn(truth):
    """What drawings and a scale tell, as a user writes it: what is required, and nothing else."""
    x, y, turn = np.round(truth.base.mount, 1)
    lines = ["name: drawn", f"base: {{mass: {truth.base.mass:.2f}, inertia: 0.3, ", "links:"]
    lines[1] += f"mount: [{x}, {y}, {turn}]}}"
    for link in truth.links:
        a, mass = round(link.a, 2), round(link.mass, 2)
        row = f"a: {a}, theta_0: 0, mass: {mass}, inertia: {0.1 * mass * a**2:.3f}, b: {a / 2:.3f}"
        lines.append(f"  - {{{row}}}")
    return "\n".join(lines) + "\n"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Bags and descriptions by the number of links."""

    def bag(n, count=0):
        folder = tmp_path_factory.mktemp(f"arm_{n}")
        (folder / "arm.yaml").write_text(drawn(arm(n, 1)))
        write(folder / "bag", heard(flight(n, 1, True, count=count), 1, True))
        return folder

    return bag


@pytest.mark.slow
@pytest.mark.parametrize("n", [3, 6])
def test_the_arm_is_found_within_what_is_claimed(made, n, capsys):
    folder, truth = made(n), arm(n, 1)
    files = ["--output", str(folder / "out.yaml"), "--result", str(folder / "out.json")]
    assert main([str(folder / "bag"), "--arm", str(folder / "arm.yaml"), *files]) == 0
    found = read_passed(folder / "out.json", "joint")
    assert tuple(found["names"]) == parameter_names(n)
    off = np.array(found["values"]) - values(truth)
    angles = np.array(found["units"]) == "rad"
    off[angles] = wrap(off[angles])
    assert np.abs(off / found["deviations"]).max() < 4.0
    nees = off @ np.linalg.solve(found["covariance"], off) / len(off)
    assert nees < 2.0
    b = slice(3 * n + 6, 4 * n + 6)
    assert max(found["deviations"][b]) < 0.006
    assert load(folder / "out.yaml").links[n - 1].b == pytest.approx(found["values"][b][-1])


def test_what_a_new_user_forgets_is_named(made, tmp_path, capsys):
    folder = made(3, 3)
    assert main([str(folder / "bag")]) == 3  # by the paper's arm
    assert "nothing received from joint_4" in " ".join(capsys.readouterr().out.split())
    two = drawn(arm(3, 1)).splitlines()[:-1]
    (tmp_path / "two.yaml").write_text("\n".join(two))
    assert main([str(folder / "bag"), "--arm", str(tmp_path / "two.yaml")]) == 3
    assert "received joint_3, but 'drawn' has 2 joints" in " ".join(capsys.readouterr().out.split())
    (tmp_path / "p.yaml").write_text(
        "".join(
            f"{kind}: {{base_topic: vicon/b/b}}\n" for kind in ("kinematic", "dynamic", "drift")
        )
    )
    given = [str(folder / "bag"), "--arm", str(folder / "arm.yaml")]
    assert main([*given, "--params", str(tmp_path / "p.yaml")]) == USER_ERROR
    assert "no /vicon/b/b in" in capsys.readouterr().err
