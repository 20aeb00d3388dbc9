"""State of the live page: what it draws of a vehicle, as JSON."""

import json
from math import nan, radians

import numpy as np
import pytest

from fss_arm_model.description import paper_arm
from fss_arm_model.kinematics import tip_pose
from fss_arm_model.units import SECOND
from fss_arm_view.live import MAX_ROUTE_POINTS, to_json, vehicle_state
from fss_arm_view.strip import ALARM, Item
from fss_arm_view.vehicle_scene import MAX_PREDICTION_AGE, VehicleScene

POSE = (0.3, -0.2, 0.5)


@pytest.fixture
def scene():
    found = VehicleScene(paper_arm())
    found.pose, found.q = POSE, [0.1, 0.2, -0.3, 0.4]
    return found


def state(scene, t=SECOND):
    """Return a vehicle's state as the page receives it."""
    items = [Item("fault", "link 2", ALARM)]
    return json.loads(to_json(5.0, t, 0.25, [vehicle_state(scene, t, items, "fss1")]))


def test_the_arm_is_drawn_to_its_tip(scene):
    found = state(scene)
    assert (found["sent"], found["stamp"], found["silent"]) == (5.0, 1.0, 0.25)
    (vehicle,) = found["vehicles"]
    assert vehicle["name"] == "fss1"
    assert vehicle["items"] == [["fault", "link 2", "danger"]]
    assert vehicle["pose"] == list(POSE)
    assert len(vehicle["joints"]) == 5
    tip = tip_pose(scene.arm.vector(), np.array([*POSE, *scene.q]))
    assert vehicle["joints"][-1] == pytest.approx(tip[:2], abs=1e-5)


def test_before_the_first_pose_only_the_strip_is_known(scene):
    scene.pose = None
    (vehicle,) = state(scene, 0)["vehicles"]
    assert vehicle["pose"] is None
    assert vehicle["items"]
    assert "joints" not in vehicle


def test_the_prediction_is_relative_to_the_pose_until_it_is_old(scene):
    scene.store_prediction_error(SECOND, [0.1, 0.0, -0.1], radians(0.5))
    (vehicle,) = state(scene)["vehicles"]
    assert vehicle["predicted"] == pytest.approx([0.2, -0.2, 0.6])
    assert vehicle["sigma"] == 0.5
    assert state(scene, SECOND + MAX_PREDICTION_AGE)["vehicles"][0]["predicted"] is None
    scene.store_prediction_error(SECOND, [nan] * 3, nan)
    (vehicle,) = state(scene)["vehicles"]
    assert vehicle["predicted"] is vehicle["sigma"] is None


def test_thrusters_target_and_mission_are_drawn(scene):
    scene.fire(SECOND, [0.0, 0.0, 0.5, *[0.0] * 5])
    scene.target = (1.0, 1.0, 0.1)
    scene.mission.receive(SECOND, 0.6, [(0.01 * k, 0.0) for k in range(1000)])
    (vehicle,) = state(scene)["vehicles"]
    assert vehicle["fired"] == [2]
    assert vehicle["target"] == [1.0, 1.0, 0.1]
    assert vehicle["keep_out"] == 0.6
    assert MAX_ROUTE_POINTS / 2 < len(vehicle["route"]) <= MAX_ROUTE_POINTS
