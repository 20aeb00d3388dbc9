"""The example that flies a trained policy: its flights, with messages of a batch of one arm."""

import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState

from fss_arm_model.description import paper_arm
from fss_arm_msgs.msg import SimTruth
from fss_sim.environments.batch import PERIOD, Batch

sys.path.append(str(Path(__file__).parents[3] / "docs/examples"))

import fly_reach


def measure(node, batch, k):
    """Give the node the messages at the end of period k."""
    (q,), (qd,), time = batch.q, batch.qd, Time(sec=k // 20, nanosec=k % 20 * 50_000_000)
    truth = SimTruth(q=q.tolist(), qd=qd.tolist(), torque=batch.torque[0].tolist())
    base, joints = Odometry(), JointState(position=q[3:].tolist())
    truth.header.stamp = base.header.stamp = joints.header.stamp = time
    joints.name = [f"joint_{i + 1}" for i in range(batch.n)]
    base.pose.pose.position.x, base.pose.pose.position.y = q[:2].tolist()
    base.pose.pose.orientation.z = float(np.sin(0.5 * q[2]))
    base.pose.pose.orientation.w = float(np.cos(0.5 * q[2]))
    node.on_truth(truth)
    node.on_base(base)
    node.on_joints(joints)


@pytest.mark.usefixtures("ros")
def test_each_law_flies_from_each_start():
    arm, commands = paper_arm(), []
    laws = {
        "Jacobian": fly_reach.jacobian_law(arm),
        "idle": lambda q, _: np.zeros_like(q),
    }
    node, batch, k = fly_reach.FlyReach(arm, laws, 2), Batch(arm, 1), 0
    node.commands = SimpleNamespace(publish=commands.append)
    while not node.done and k < 6000:
        measure(node, batch, k)
        batch.advance(np.zeros((1, 3)), [commands[-1].velocity])
        k += 1
    laws, starts, *columns = (list(column.cells) for column in node.table.columns)
    distances, arrivals, errors, *_ = (column[::2] for column in columns)
    assert laws == ["Jacobian", "idle"] * 2
    assert starts == ["1", "1", "2", "2"]
    assert PERIOD < max(map(float, arrivals)) < 15.0
    assert max(map(float, errors)) < 10.0 < max(map(float, distances))
    distances, arrivals, errors, *_ = (column[1::2] for column in columns)
    assert arrivals == ["none", "none"]
    assert distances == errors
    node.destroy_node()
