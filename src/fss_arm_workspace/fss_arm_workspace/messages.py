"""Conversion of workspaces, maps and ellipsoids to ROS messages, for RViz, Foxglove and bags."""

from array import array
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from hashlib import sha256
from typing import Any

import numpy as np
from geometry_msgs.msg import Point, Point32, PolygonStamped
from nav_msgs.msg import OccupancyGrid
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from fss_arm_model.arrays import Complexes, Floats
from fss_arm_model.description import Arm
from fss_arm_model.description_file import to_yaml
from fss_arm_model.kinematics import tip_in_base
from fss_arm_model.momentum import system_com
from fss_arm_msgs.msg import ManipulabilityMap, Provenance, StraightPaths, Workspace
from fss_arm_workspace import __version__
from fss_arm_workspace.analysis import Analysis, AnalysisSettings
from fss_arm_workspace.manipulability.map import Map
from fss_arm_workspace.manipulability.measure import FIXED, FLOATING, ellipsoid, jacobian
from fss_arm_workspace.regions.virtual import VirtualManipulator
from fss_arm_workspace.straight_path.paths import Paths
from fss_arm_workspace.straight_path.redundancy import BASES
from fss_arm_workspace.straight_path.trace import REASONS

_COLORS = {
    "fixed": (0.85, 0.15, 0.15),
    "floating": (0.1, 0.4, 0.8),
    "zero reaction": (0.5, 0.2, 0.7),
    "maximum": (0.15, 0.6, 0.2),
}
_LINE_WIDTH = 0.01  # width of lines [m]


def topics() -> dict[str, type]:
    """Return the type of each topic of a WorkspaceNode, by its name without `workspace/`."""
    kinds: dict[str, type] = {"result": Workspace, "boundary": PolygonStamped}
    kinds |= {"markers": MarkerArray, "straight_markers": MarkerArray, "ellipsoids": MarkerArray}
    for base in ("fixed", "floating"):
        kinds |= {f"map/{base}": OccupancyGrid, f"manipulability/{base}": ManipulabilityMap}
    for base in map(_topic_name, BASES):
        kinds |= {f"straight/{base}": PolygonStamped, f"straight_paths/{base}": StraightPaths}
    return kinds


def map_messages(
    found: Analysis, settings: AnalysisSettings, header: Header
) -> Iterator[tuple[str, Any]]:
    """Yield topic and message of each result that depends on the arm alone."""
    for base, one in found.maps.items():
        yield f"map/{base}", occupancy_grid(one, header)
        yield f"manipulability/{base}", map_message(one, base, header)
    yield "boundary", polygon(found.boundary[0][0], header)
    yield "markers", workspace_markers(found, header)
    yield "result", workspace_message(found, settings, header)


def path_messages(
    arm: Arm, found: Mapping[str, Paths], header: Header
) -> Iterator[tuple[str, Any]]:
    """Yield topic and message of the straight paths on each base."""
    for base, paths in found.items():
        yield f"straight/{_topic_name(base)}", polygon(paths.ends, header)
        yield f"straight_paths/{_topic_name(base)}", straight_message(paths, base, header)
    radius = VirtualManipulator(arm).radius
    yield "straight_markers", straight_markers(arm, found, radius, header)


def _topic_name(base: str) -> str:
    return base.replace(" ", "_")


def workspace_message(a: Analysis, settings: AnalysisSettings, header: Header) -> Workspace:
    """Return the workspace message, with description, limits and settings used."""
    points = np.concatenate([points for points, _ in a.boundary])
    description = to_yaml(a.arm)
    return Workspace(
        header=header,
        area=a.region.area,
        loops=array("I", [len(points) for points, _ in a.boundary]),
        x=_doubles(points.real),
        y=_doubles(points.imag),
        deviation=_doubles(np.concatenate([deviation for _, deviation in a.boundary])),
        radius=a.radius,
        radius_deviation=a.radius_deviation,
        nearest=a.reach[0],
        farthest=a.reach[1],
        limits=_doubles(a.limits),
        description=description,
        provenance=Provenance(
            software=f"fss_arm_workspace {__version__}",
            parameters=_yaml(settings),
            data_hash=sha256(description.encode()).hexdigest(),
            source="live",
        ),
    )


def map_message(found: Map, base: str, header: Header) -> ManipulabilityMap:
    """Return the message of a map, in full precision."""
    grid = found.grid
    return ManipulabilityMap(
        header=header,
        base=base,
        cell=grid.cell,
        x=grid.x,
        y=grid.y,
        width=grid.width,
        height=grid.height,
        w=_doubles(found.w),
    )


def occupancy_grid(found: Map, header: Header) -> OccupancyGrid:
    """Return a map for viewers: 0 to 100 % of its largest value, -1 in cells not reached."""
    grid, message = found.grid, OccupancyGrid(header=header)
    message.info.map_load_time = header.stamp
    message.info.resolution = grid.cell
    message.info.width, message.info.height = grid.width, grid.height
    message.info.origin.position.x, message.info.origin.position.y = grid.x, grid.y
    message.info.origin.orientation.w = 1.0
    share = np.nan_to_num(100.0 * found.w / np.nanmax(found.w), nan=-1.0)
    message.data = array("b", share.round().astype(np.int8).tobytes())
    return message


def straight_message(paths: Paths, base: str, header: Header) -> StraightPaths:
    """Return the message of a straight-path workspace."""
    return StraightPaths(
        header=header,
        base=base,
        redundancy=paths.redundancy,
        start=_doubles(paths.start),
        direction=_doubles(paths.direction),
        distance=_doubles(paths.distance),
        reasons=list(REASONS),
        reason=array("B", paths.reason.astype(np.uint8).tobytes()),
        grazes=paths.grazes.tolist(),
        last=_doubles(paths.last),
        area=paths.area,
    )


def polygon(points: Complexes, header: Header) -> PolygonStamped:
    """Return a closed line as a polygon."""
    message = PolygonStamped(header=header)
    message.polygon.points = [Point32(x=float(z.real), y=float(z.imag)) for z in points]
    return message


def workspace_markers(a: Analysis, header: Header) -> MarkerArray:
    """Return markers of the boundary of the fixed vehicle workspace, including holes."""
    lines = [points for points, _ in a.boundary]
    return MarkerArray(
        markers=[
            _line(z, header, "fixed vehicle workspace", "fixed", k) for k, z in enumerate(lines)
        ]
    )


def straight_markers(
    arm: Arm, straight: Mapping[str, Paths], radius: float, header: Header
) -> MarkerArray:
    """Return markers of straight-path workspaces, and of the circle of radius R [m].

    The circle is about the system's center of mass.
    """
    markers = [
        _line(paths.ends, header, f"straight paths, {base}", base, 0)
        for base, paths in straight.items()
    ]
    start = next(iter(straight.values())).start
    circle = complex(*system_com(arm.vector(), start)) + radius * np.exp(
        2j * np.pi * np.arange(128) / 128
    )
    markers.append(_line(circle, header, "maximum reachable workspace", "maximum", 0))
    return MarkerArray(markers=markers)


def ellipsoid_markers(arm: Arm, q: Floats, scale: float, header: Header) -> MarkerArray:
    """Return markers of the tip's velocity ellipsoids at joint readings q (n,), on both bases.

    Args:
        arm: the arm.
        q: joint readings [rad].
        scale: scale of the drawing [m per m/rad].
        header: header in the base's frame.
    """
    x, y, _ = tip_in_base(arm.vector(), q)
    markers = []
    for number, (kind, base) in enumerate(((FIXED, "fixed"), (FLOATING, "floating"))):
        radii, axes = ellipsoid(jacobian(arm, q, kind))
        radii = np.append(radii, 0.0)[:2]  # with a single link there is one radius only
        turn = 0.5 * np.arctan2(axes[0, 1], axes[0, 0])
        marker = _marker(header, f"manipulability, {base} base", base, 0, Marker.SPHERE)
        marker.pose.position.x, marker.pose.position.y = float(x), float(y)
        marker.pose.position.z = 0.01 * number  # seen from above, the smaller one is not hidden
        marker.pose.orientation.z, marker.pose.orientation.w = (
            float(np.sin(turn)),
            float(np.cos(turn)),
        )
        marker.scale.x, marker.scale.y = (float(2.0 * scale * r) for r in radii)
        marker.scale.z = 0.005
        marker.color.a = 0.5
        markers.append(marker)
    return MarkerArray(markers=markers)


def _line(points: Complexes, header: Header, name: str, color: str, number: int) -> Marker:
    marker = _marker(header, name, color, number, Marker.LINE_STRIP)
    closed = [*points, *points[:1]]
    marker.points = [Point(x=float(z.real), y=float(z.imag)) for z in closed]
    marker.scale.x = _LINE_WIDTH
    return marker


def _marker(header: Header, name: str, color: str, number: int, kind: int) -> Marker:
    r, g, b = _COLORS[color]
    marker = Marker(header=header, ns=name, id=number, type=kind, action=Marker.ADD)
    marker.color = ColorRGBA(r=r, g=g, b=b, a=1.0)
    marker.pose.orientation.w = 1.0
    return marker


def _doubles(values: Floats | Sequence[float]) -> "array[float]":
    """Return an array that a float64[] field accepts without copying element by element."""
    return array("d", np.ascontiguousarray(values, dtype=float).tobytes())


def _yaml(settings: AnalysisSettings) -> str:
    values = {f.name: getattr(settings, f.name) for f in fields(AnalysisSettings)}
    values["table_corners"] = list(settings.table_corners)
    return "".join(f"{name}: {value}\n" for name, value in values.items())
