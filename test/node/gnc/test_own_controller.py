"""The example of a user's controller in the documentation."""

from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import WrenchStamped
from gnc_bench import FakeCraft
from sensor_msgs.msg import JointState

from fss_arm_ros.convert import SECOND, stamp_ns

EXAMPLE = Path(__file__).parents[3] / "docs/examples/own_controller.py"


def test_example_returns_the_base_swings_the_joint_and_stops_without_input(spin):
    spec = spec_from_file_location("own_controller", EXAMPLE)
    example = module_from_spec(spec)
    spec.loader.exec_module(example)
    craft, own = FakeCraft(), example.OwnController()
    wrenches, rates = [], []
    craft.create_subscription(WrenchStamped, "base/wrench", wrenches.append, 10)
    craft.create_subscription(JointState, "arm/joint_commands", rates.append, 10)
    nodes = [craft, own]
    craft.pose = np.array([0.5, 0.2, 3.0])
    spin(nodes, lambda: own.home and wrenches and rates)
    assert own.home == pytest.approx((0.5, 0.2, 3.0))
    away = np.array([0.1, 0.0, 0.2])  # 3.2 rad: beyond the half turn
    craft.pose, craft.twist = craft.pose + away, np.zeros(3)
    spin(nodes, lambda: abs(wrenches[-1].wrench.torque.z) > 0.01)
    w = wrenches[-1].wrench
    force = complex(w.force.x, w.force.y) * np.exp(1j * craft.pose[2])
    assert force == pytest.approx(-example.MASS * example.STIFFNESS * 0.1, rel=0.02)
    assert w.torque.z == pytest.approx(-example.INERTIA * example.STIFFNESS * 0.2, rel=0.02)
    assert wrenches[-1].header.frame_id == "fss"
    assert stamp_ns(wrenches[-1].header.stamp) > craft.now() - SECOND
    assert rates[-1].name == ["joint_1"]
    assert abs(rates[-1].velocity[0]) == pytest.approx(0.01)
    craft.silent |= {"base/state", "arm/joint_states"}
    count, start = len(wrenches), craft.now()
    spin(nodes, lambda: craft.now() > start + SECOND // 2)
    assert len(wrenches) - count < 5
