"""State of the live page: what is drawn of each vehicle, as JSON."""

import json
from collections.abc import Iterable, Sequence
from math import degrees, isfinite
from typing import Any

import numpy as np

from fss_arm_model.kinematics import joint_positions

from .strip import Item
from .vehicle_scene import VehicleScene

MAX_ROUTE_POINTS = 100  # drawn of a planned path


def vehicle_state(scene: VehicleScene, t: int, items: Iterable[Item], name: str) -> dict[str, Any]:
    """Return what the page draws of a vehicle: world frame, m and rad; None: not known.

    Args:
        scene: the vehicle's scene.
        t: stamp of its newest measurement [ns].
        items: of its strip.
        name: empty if it is the only vehicle.
    """
    pose, target = scene.pose, scene.target
    state: dict[str, Any] = {
        "name": name,
        "items": list(items),
        "t": t * 1e-9,
        "phase": scene.mission.text,
        "pose": _rounded(pose),
        "tip": _rounded(scene.tip),
        "target": _rounded(target),
        "keep_out": scene.mission.keep_out(t),
    }
    if pose is None:
        return state
    joints = joint_positions(scene.arm.vector(), np.concatenate([pose, scene.q]))
    difference = scene.recent_difference(t)
    sigma = degrees(scene.sigma)
    route = scene.mission.path(t)
    return state | {
        "joints": [_rounded(joint) for joint in joints],  # and the tip
        "fired": [k for k, until in enumerate(scene.plumes_until) if t < until],
        "predicted": None if difference is None else _rounded(pose - difference),
        "sigma": round(sigma, 4) if isfinite(sigma) else None,  # of the heading [deg]
        "route": [_rounded(point) for point in route[:: 1 + len(route) // MAX_ROUTE_POINTS]],
    }


def _rounded(values: Sequence[float] | np.ndarray | None) -> list[float] | None:
    return None if values is None else [round(float(value), 5) for value in values]


def to_json(sent: float, stamp: int, silent: float, vehicles: Sequence[dict[str, Any]]) -> str:
    """Return the state of all vehicles as JSON.

    Args:
        sent: time of sending [s].
        stamp: of the newest measurement [ns]; 0: none yet.
        silent: time since it was received [s].
        vehicles: state of each vehicle.
    """
    return json.dumps(
        {
            "sent": round(sent, 3),
            "stamp": round(stamp * 1e-9, 3),
            "silent": round(silent, 2),
            "vehicles": vehicles,
        },
        separators=(",", ":"),
        allow_nan=False,
    )
