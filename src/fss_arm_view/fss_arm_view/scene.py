"""Drawings of the view: the table from above, and time series, as rerun's archetypes.

Entities: `table/...` is drawn to scale [m], and its part `table/fss/...` moves with the base;
`plot/<what>/<series>` are numbers over time; `log` is text. A drawing is a pair of entity and
archetype. rerun's plane has its y axis downwards, so y is drawn negated.
"""

import re
from collections.abc import Sequence
from itertools import pairwise
from math import cos, degrees, pi, sin
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import rerun as rr
import rerun.blueprint as rrb

from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_model.kinematics import com_positions, joint_positions, tip_jacobian
from fss_arm_model.momentum import generalized_jacobian
from fss_arm_ros import palette
from fss_arm_ros.palette import rgb

Drawing = tuple[str, Any]  # an entity, and an archetype or several
Color = tuple[int, int, int]

TIMELINE = "time"

TABLE_EDGE = 4.0  # edge of the granite table [m]
BASE_EDGE = 0.27  # edge of the spacecraft simulator as drawn [m]
CORNERS = ((1, 1), (-1, 1), (-1, -1), (1, -1))  # corners of the base in the thrusters' order
PLUME_LENGTH = 0.15  # length of a thruster's plume as drawn [m]
MAX_TRAIL_POINTS = 600  # points kept of a path
MIN_TRAIL_STEP = 0.005  # minimum distance between points of a path [m]
PLOT_DURATION = 60  # duration that the plots display [s]

STATIC_COLOR, MEASURED_COLOR = rgb(palette.STATIC), rgb(palette.MEASURED)
PREDICTED_COLOR, BAND_COLOR = rgb(palette.PREDICTED), rgb(palette.BAND)
TIP_COLOR, TARGET_COLOR = rgb(palette.TIP), rgb(palette.TARGET)
THRUST_COLOR, DIFFERENCE_COLOR = rgb(palette.THRUST), rgb(palette.DIFFERENCE)
AXIS_COLORS, LINK_COLORS = tuple(map(rgb, palette.AXES)), tuple(map(rgb, palette.LINKS))

LEGEND = (
    ("base and arm, measured", MEASURED_COLOR),
    ("base as predicted", PREDICTED_COLOR),
    ("path of the base", MEASURED_COLOR),
    ("path of the center of mass", PREDICTED_COLOR),
    ("path of the end effector", TIP_COLOR),
    ("manipulability, floating base", TIP_COLOR),
    ("manipulability, base held", STATIC_COLOR),
)
LEGEND_ROWS = 6
ELLIPSE_SCALE = 0.4  # scale of the manipulability ellipse [s]


class Series(NamedTuple):
    """Time series that share a plot."""

    name: str
    title: str
    lines: tuple[str, ...]
    colors: tuple[Color, ...]


HEADING = Series(
    "heading",
    "heading of the base [deg]",
    ("band_above", "band_below", "predicted", "measured"),
    (BAND_COLOR, BAND_COLOR, PREDICTED_COLOR, MEASURED_COLOR),
)
HEADING_DIFFERENCE = Series(
    "turn",
    "heading, measured minus predicted [deg]",
    ("band_above", "band_below", "difference"),
    (BAND_COLOR, BAND_COLOR, DIFFERENCE_COLOR),
)
POSITION_DIFFERENCE = Series(
    "place", "position, measured minus predicted [mm]", ("x", "y"), AXIS_COLORS
)
LINEAR_MOMENTUM = Series("momentum", "momentum [N s]", ("x", "y"), AXIS_COLORS)
ANGULAR_MOMENTUM = Series("spin", "angular momentum [N m s]", ("measured",), (MEASURED_COLOR,))
TORQUE = Series(
    "torque", "torque, joint 1 [N m]", ("predicted", "measured"), (PREDICTED_COLOR, MEASURED_COLOR)
)
PLOTS = (
    HEADING,
    HEADING_DIFFERENCE,
    POSITION_DIFFERENCE,
    LINEAR_MOMENTUM,
    ANGULAR_MOMENTUM,
    TORQUE,
)
LINK_PLOTS = {
    "angle": "joint angles [deg]",
    "current": "motor currents [A]",
    "effort": "torque sensors [N m]",
    "loss": "telemetry lost [%]",
}


def flip_y(points: npt.ArrayLike) -> Floats:
    """Convert points (..., 2) to rerun's plane: y is negated."""
    return np.asarray(points, dtype=float) * (1.0, -1.0)


def static_scene() -> list[Drawing]:
    """Draw the static parts: the table's edge, its scale and the legend."""
    a = TABLE_EDGE / 2.0
    edge = flip_y([(-a, -a), (a, -a), (a, a), (-a, a), (-a, -a)])
    return [
        ("table/edge", rr.LineStrips2D([edge], colors=STATIC_COLOR, radii=0.01)),
        *_ticks(),
        *(legend_entry(k, text, color) for k, (text, color) in enumerate(LEGEND)),
    ]


def _ticks() -> list[Drawing]:
    """Draw ticks and labels in meters along the edges of the table."""
    a, meters = TABLE_EDGE / 2.0, range(1 - int(TABLE_EDGE / 2.0), int(TABLE_EDGE / 2.0) + 1)
    marks = [[(m, -a), (m, 0.06 - a)] for m in meters] + [[(-a, m), (0.06 - a, m)] for m in meters]
    label_positions = [(m, -a - 0.1) for m in meters] + [(-a - 0.15, m) for m in meters]
    names = [f"{m:d} m" if m == meters[-1] else f"{m:d}" for m in (*meters, *meters)]
    labels = rr.Points2D(
        flip_y(label_positions), colors=STATIC_COLOR, radii=0.001, labels=names, show_labels=True
    )
    lines = rr.LineStrips2D([flip_y(mark) for mark in marks], colors=STATIC_COLOR, radii=0.006)
    return [("table/ticks", lines), ("table/meters", labels)]


def legend_entry(k: int, text: str, color: Color) -> Drawing:
    """Draw the k-th entry of the legend, above the table: a text in its color."""
    column, row = divmod(k, LEGEND_ROWS)
    position = (2.3 * column - 1.3, TABLE_EDGE / 2.0 + 0.19 * (LEGEND_ROWS - row) + 0.05)
    label = rr.Points2D(
        flip_y([position]), colors=color, radii=0.001, labels=[text], show_labels=True
    )
    return f"table/legend/{k}", label


class Legend:
    """Names that the legend shows."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Keep only the names of the static scene."""
        self.names = [name for name, _ in LEGEND]

    def add(self, name: str, color: Color) -> Drawing | None:
        """Add a name and draw it; return None if the legend shows it already."""
        if name in self.names:
            return None
        self.names.append(name)
        return legend_entry(len(self.names) - 1, name, color)


class Lines(NamedTuple):
    """Lines of one kind, before they are drawn."""

    strips: list[Floats]  # (m, 2) each
    color: Color
    radius: float  # [m]


class Dots(NamedTuple):
    """Points of one kind, before they are drawn."""

    points: Floats  # (m, 2)
    color: Color
    radius: float  # [m]


def combine(what: str, parts: Sequence[Lines | Dots]) -> Drawing:
    """Combine simultaneous parts in one entity, so that a slow viewer draws all or none of them."""
    lines = [part for part in parts if isinstance(part, Lines)]
    dots = [part for part in parts if isinstance(part, Dots)]
    return f"table/{what}", [
        rr.LineStrips2D(
            [strip for part in lines for strip in part.strips],
            colors=[part.color for part in lines for _ in part.strips],
            radii=[part.radius for part in lines for _ in part.strips],
        ),
        rr.Points2D(
            [point for part in dots for point in part.points],
            colors=[part.color for part in dots for _ in part.points],
            radii=[part.radius for part in dots for _ in part.points],
        ),
    ]


def base(pose: npt.ArrayLike, color: Color) -> Lines:
    """Draw the spacecraft simulator as a square with a line along its heading."""
    x, y, heading = np.asarray(pose, dtype=float)
    a = BASE_EDGE / 2.0
    square = [(-a, -a), (a, -a), (a, a), (-a, a), (-a, -a)]
    nose = [(0.0, 0.0), (a, 0.0)]
    turn = np.array([[cos(heading), -sin(heading)], [sin(heading), cos(heading)]])
    strips = [flip_y(np.array(part) @ turn.T + (x, y)) for part in (square, nose)]
    return Lines(strips, color, 0.01)


def arm(description: Arm, pose: npt.ArrayLike, q: npt.ArrayLike) -> list[Lines | Dots]:
    """Draw links, joints, centers of mass, and manipulability ellipses of the end effector."""
    p = description.vector()
    state = np.concatenate([np.asarray(pose, dtype=float), np.asarray(q, dtype=float)])
    joints = joint_positions(p, state)  # joints, and the tip as last row
    return [
        Lines([flip_y(joints)], MEASURED_COLOR, 0.015),
        Dots(flip_y(joints), MEASURED_COLOR, 0.028),
        Dots(flip_y(com_positions(p, state)), PREDICTED_COLOR, 0.008),
        ellipse(tip_jacobian(p, state)[:2, 3:], joints[-1], STATIC_COLOR),
        ellipse(generalized_jacobian(p, state)[:2], joints[-1], TIP_COLOR),
    ]


def ellipse(J: Floats, center: Floats, color: Color, scale: float = ELLIPSE_SCALE) -> Lines:
    """Draw the manipulability ellipse {J qd : |qd| = 1} at a scale [s]."""
    U, s, _ = np.linalg.svd(J)
    s = np.append(s, 0.0)  # with a single link there is one singular value only
    angle = np.linspace(0.0, 2.0 * pi, 49)
    points = center + scale * (np.column_stack([s[0] * np.cos(angle), s[1] * np.sin(angle)]) @ U.T)
    return Lines([flip_y(points)], color, 0.008)


def trail(points: Sequence[tuple[float, float]], what: str, color: Color) -> Drawing:
    """Draw the past path of a point."""
    return f"table/{what}", rr.LineStrips2D([flip_y(points)], colors=color, radii=0.006)


def route(points: Sequence[tuple[float, float]]) -> Lines:
    """Draw a planned path as dashes: the first half of each segment between its points."""
    ends = np.asarray(points, dtype=float).reshape(-1, 2)
    dashes = [flip_y([a, 0.5 * (a + b)]) for a, b in pairwise(ends)]
    return Lines(dashes, PREDICTED_COLOR, 0.008)


def circle(center: tuple[float, float], radius: float, color: Color) -> Lines:
    """Draw a circle, as the boundary of a keep-out zone."""
    angle = np.linspace(0.0, 2.0 * pi, 65)
    around = np.column_stack([np.cos(angle), np.sin(angle)])
    return Lines([flip_y(np.array(center) + radius * around)], color, 0.006)


def phase_label(text: str) -> Drawing:
    """Draw the mission's phase as text below the table."""
    position = flip_y([(-TABLE_EDGE / 2.0, -TABLE_EDGE / 2.0 - 0.12)])
    label = rr.Points2D(
        position, colors=MEASURED_COLOR, radii=0.001, labels=[text], show_labels=True
    )
    return "table/phase", label


def base_transform(pose: npt.ArrayLike) -> Drawing:
    """Return the transform of the base, which moves all entities below `table/fss`."""
    x, y, heading = np.asarray(pose, dtype=float)
    turn = rr.RotationAxisAngle(axis=[0.0, 0.0, 1.0], radians=-heading)
    return "table/fss", rr.Transform3D(translation=[x, -y, 0.0], rotation_axis_angle=turn)


def outline(
    strips: Sequence[npt.ArrayLike],
    what: str,
    color: Color,
    in_base: bool,
) -> list[Drawing]:
    """Draw lines given in the base's or the world's frame, and clear those in the other frame."""
    path = re.sub(r"\W+", "_", what)
    lines = rr.LineStrips2D([flip_y(strip) for strip in strips], colors=color, radii=0.005)
    here, there = f"table/fss/{path}", f"table/outlines/{path}"
    return [(here if in_base else there, lines), (there if in_base else here, rr.LineStrips2D([]))]


def plumes(pose: npt.ArrayLike, valves: Sequence[bool]) -> Lines:
    """Draw the jets of open thrusters, pointing away from the base; ThrusterCommand's numbering."""
    x, y, heading = np.asarray(pose, dtype=float)
    turn = complex(cos(heading), sin(heading))
    strips = []
    for k in (k for k, is_open in enumerate(valves) if is_open):
        corner = complex(*CORNERS[k // 2])
        out = corner.imag * 1j if k % 2 else corner.real
        jet = [0.0, PLUME_LENGTH * (out + 0.2j * out), PLUME_LENGTH * (out - 0.2j * out), 0.0]
        points = complex(x, y) + turn * (0.5 * BASE_EDGE * corner + np.array(jet))
        strips.append(flip_y(np.column_stack([points.real, points.imag])))
    return Lines(strips, THRUST_COLOR, 0.012)


def plot_values(series: Series, values: Sequence[float]) -> list[Drawing]:
    """Plot the values of one time; NaN is left out."""
    return [
        (f"plot/{series.name}/{line}", rr.Scalars(value))
        for line, value in zip(series.lines, values, strict=True)
        if value == value
    ]


def reaction_drawings(message: Any) -> list[Drawing]:
    """Draw a BaseReaction message: the center of mass, and the plots."""
    heading, band = message.predicted[2], message.predicted_deviation[2]
    dx, dy, turn = message.difference
    return [
        (
            "table/center_of_mass",
            rr.Points2D(flip_y([message.com]), colors=PREDICTED_COLOR, radii=0.02),
        ),
        *plot_values(
            HEADING,
            [degrees(a) for a in (heading + band, heading - band, heading, message.measured[2])],
        ),
        *plot_values(HEADING_DIFFERENCE, (degrees(band), -degrees(band), degrees(turn))),
        *plot_values(POSITION_DIFFERENCE, (1e3 * dx, 1e3 * dy)),
        *plot_values(LINEAR_MOMENTUM, message.momentum[:2]),
        *plot_values(ANGULAR_MOMENTUM, message.momentum[2:]),
        *plot_values(TORQUE, (message.torque, message.torque_measured)),
    ]


def link_value(kind: str, i: int, value: float) -> Drawing:
    """Plot a link's value in the plot of all links."""
    return f"plot/{kind}/link_{i}", rr.Scalars(value)


def log_line(text: str, level: str = "INFO") -> Drawing:
    """Return a line of the log."""
    return "log", rr.TextLog(text, level=level)


def name_label(pose: Sequence[float], name: str) -> Drawing:
    """Draw a vehicle's name beside its base."""
    position = flip_y([pose[:2]])
    label = rr.Points2D(position, colors=STATIC_COLOR, radii=0.001, labels=[name], show_labels=True)
    return "table/name", label


def series_styles(n: int, vehicle: str = "") -> list[Drawing]:
    """Return names and colors of the series; the names include the vehicle's, if given."""
    prefix = f"{vehicle} " if vehicle else ""
    found: list[Drawing] = []
    for series in PLOTS:
        for line, color in zip(series.lines, series.colors, strict=True):
            is_band = line.startswith("band")
            name, width = ("band of 1 sigma", 1.0) if is_band else (line, 2.0)
            found.append((f"plot/{series.name}/{line}", _series(prefix + name, color, width)))
    for kind in LINK_PLOTS:
        for i in range(1, n + 1):
            color = LINK_COLORS[(i - 1) % len(LINK_COLORS)]
            found.append((f"plot/{kind}/link_{i}", _series(f"{prefix}link {i}", color, 1.5)))
    return found


def _series(name: str, color: Color, width: float) -> Any:
    return rr.SeriesLines(names=name, colors=color, widths=width)


def blueprint() -> Any:
    """Return the layout: table and events left, base reaction in the middle, links right.

    Plots are few and large, so that their axes have legible ticks; rarely used plots share tabs.
    """
    a, legend_height = TABLE_EDGE / 2.0 + 0.25, 0.2 * LEGEND_ROWS
    table = rrb.Spatial2DView(
        origin="table",
        name="table from above, 4 m x 4 m",
        visual_bounds=rrb.VisualBounds2D(x_range=[-a, a], y_range=[-a - legend_height, a + 0.2]),
    )
    last = rrb.VisibleTimeRange(
        TIMELINE,
        start=rrb.TimeRangeBoundary.cursor_relative(seconds=-PLOT_DURATION),
        end=rrb.TimeRangeBoundary.cursor_relative(),
    )
    options: dict[str, Any] = {"plot_legend": rrb.PlotLegend(rrb.Corner2D.LeftTop)}
    options["time_ranges"] = last
    heading, turn, position, *forces = (
        rrb.TimeSeriesView(origin=f"plot/{s.name}", name=s.title, **options) for s in PLOTS
    )
    angle, *more = (
        rrb.TimeSeriesView(origin=f"plot/{kind}", name=title, **options)
        for kind, title in LINK_PLOTS.items()
    )
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(table, rrb.TextLogView(origin="log", name="events"), row_shares=[4, 1]),
            rrb.Vertical(heading, turn, position),
            rrb.Vertical(angle, rrb.Tabs(*more), rrb.Tabs(*forces)),
            column_shares=[5, 4, 4],
        ),
        collapse_panels=True,
    )
