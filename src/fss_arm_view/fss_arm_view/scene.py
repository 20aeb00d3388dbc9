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

from fss_arm_model.description import Arm
from fss_arm_model.kinematics import com_positions, joint_positions, tip_jacobian
from fss_arm_model.momentum import generalized_jacobian

Floats = npt.NDArray[np.float64]
Drawing = tuple[str, Any]  # an entity, and an archetype or several
Colour = tuple[int, int, int]

TIMELINE = "time"

TABLE = 4.0  # edge of the granite table [m]
BASE = 0.27  # edge of the spacecraft simulator as drawn [m]
CORNERS = ((1, 1), (-1, 1), (-1, -1), (1, -1))  # corners of the base in the thrusters' order
PLUME = 0.15  # length of a thruster's plume as drawn [m]
TRAIL = 600  # points kept of a path
TRAIL_STEP = 0.005  # minimum distance between points of a path [m]
SHOWN = 60  # duration that the plots display [s]

# Distinguishable on white and on black; each has one meaning, and red is reserved for alarms.
STONE = (130, 130, 130)  # what does not move: the table; the arm on a fixed base
STEEL = (40, 110, 200)  # measured
GHOST, BAND = (240, 130, 20), (250, 190, 120)  # predicted, and its band of one sigma
TIP = (30, 150, 70)  # end effector
PURPLE = (150, 80, 190)  # the target, and the circle around it to keep out of
JET = (0, 175, 190)  # thrusters that fire
DIFFERENCE = (200, 40, 140)  # measured minus predicted
AXES = (90, 90, 90), (165, 120, 10)  # x, y
#: Colours of the links.
PALETTE = (
    *((130, 85, 45), (235, 150, 190), (125, 135, 25), (95, 60, 150)),
    *((70, 160, 140), (200, 110, 90), (150, 150, 200), (60, 90, 60)),
    *((190, 180, 110), (110, 130, 150), (170, 60, 110), (205, 205, 50)),
)

LEGEND = (
    ("base and arm, measured", STEEL),
    ("base as predicted", GHOST),
    ("path of the base", STEEL),
    ("path of the centre of mass", GHOST),
    ("path of the end effector", TIP),
    ("manipulability, floating base", TIP),
    ("manipulability, base held", STONE),
)
LEGEND_ROWS = 6
ELLIPSE = 0.4  # scale of the manipulability ellipse [s]


class Series(NamedTuple):
    """Time series that share a plot."""

    name: str
    title: str
    lines: tuple[str, ...]
    colours: tuple[Colour, ...]


HEADING = Series(
    "heading",
    "heading of the base [deg]",
    ("band_above", "band_below", "predicted", "measured"),
    (BAND, BAND, GHOST, STEEL),
)
TURN = Series(
    "turn",
    "heading, measured less predicted [deg]",
    ("band_above", "band_below", "difference"),
    (BAND, BAND, DIFFERENCE),
)
PLACE = Series("place", "place, measured less predicted [mm]", ("x", "y"), AXES)
LINEAR = Series("momentum", "momentum [N s]", ("x", "y"), AXES)
ANGULAR = Series("spin", "angular momentum [N m s]", ("measured",), (STEEL,))
TORQUE = Series("torque", "torque, joint 1 [N m]", ("predicted", "measured"), (GHOST, STEEL))
PLOTS = (HEADING, TURN, PLACE, LINEAR, ANGULAR, TORQUE)
OF_LINKS = {
    "angle": "joint angles [deg]",
    "current": "motor currents [A]",
    "effort": "torque sensors [N m]",
    "loss": "telemetry lost [%]",
}


def flat(points: npt.ArrayLike) -> Floats:
    """Convert points (..., 2) to rerun's plane: y is negated."""
    return np.asarray(points, dtype=float) * (1.0, -1.0)


def ground() -> list[Drawing]:
    """Draw what does not change: the table's edge, its scale and the legend."""
    a = TABLE / 2.0
    edge = flat([(-a, -a), (a, -a), (a, a), (-a, a), (-a, -a)])
    return [
        ("table/edge", rr.LineStrips2D([edge], colors=STONE, radii=0.01)),
        *_ticks(),
        *(legend(k, text, colour) for k, (text, colour) in enumerate(LEGEND)),
    ]


def _ticks() -> list[Drawing]:
    """Draw ticks and metres along the edges of the table."""
    a, metres = TABLE / 2.0, range(1 - int(TABLE / 2.0), int(TABLE / 2.0) + 1)
    marks = [[(m, -a), (m, 0.06 - a)] for m in metres] + [[(-a, m), (0.06 - a, m)] for m in metres]
    beside = [(m, -a - 0.1) for m in metres] + [(-a - 0.15, m) for m in metres]
    names = [f"{m:d} m" if m == metres[-1] else f"{m:d}" for m in (*metres, *metres)]
    places = rr.Points2D(flat(beside), colors=STONE, radii=0.001, labels=names, show_labels=True)
    lines = rr.LineStrips2D([flat(mark) for mark in marks], colors=STONE, radii=0.006)
    return [("table/ticks", lines), ("table/metres", places)]


def legend(k: int, text: str, colour: Colour) -> Drawing:
    """Draw the k-th entry of the legend, above the table: a text in its colour."""
    column, row = divmod(k, LEGEND_ROWS)
    place = (2.3 * column - 1.3, TABLE / 2.0 + 0.19 * (LEGEND_ROWS - row) + 0.05)
    word = rr.Points2D(flat([place]), colors=colour, radii=0.001, labels=[text], show_labels=True)
    return f"table/legend/{k}", word


class Lines(NamedTuple):
    """Lines of one kind, before they are drawn."""

    strips: list[Floats]  # (m, 2) each
    colour: Colour
    radius: float  # [m]


class Dots(NamedTuple):
    """Points of one kind, before they are drawn."""

    points: Floats  # (m, 2)
    colour: Colour
    radius: float  # [m]


def together(what: str, parts: Sequence[Lines | Dots]) -> Drawing:
    """Combine simultaneous parts in one entity, so that a slow viewer draws all or none of them."""
    lines = [part for part in parts if isinstance(part, Lines)]
    dots = [part for part in parts if isinstance(part, Dots)]
    return f"table/{what}", [
        rr.LineStrips2D(
            [strip for part in lines for strip in part.strips],
            colors=[part.colour for part in lines for _ in part.strips],
            radii=[part.radius for part in lines for _ in part.strips],
        ),
        rr.Points2D(
            [point for part in dots for point in part.points],
            colors=[part.colour for part in dots for _ in part.points],
            radii=[part.radius for part in dots for _ in part.points],
        ),
    ]


def base(pose: npt.ArrayLike, colour: Colour) -> Lines:
    """Draw the spacecraft simulator as a square with a line along its heading."""
    x, y, heading = np.asarray(pose, dtype=float)
    a = BASE / 2.0
    square = [(-a, -a), (a, -a), (a, a), (-a, a), (-a, -a)]
    nose = [(0.0, 0.0), (a, 0.0)]
    turn = np.array([[cos(heading), -sin(heading)], [sin(heading), cos(heading)]])
    strips = [flat(np.array(part) @ turn.T + (x, y)) for part in (square, nose)]
    return Lines(strips, colour, 0.01)


def arm(description: Arm, pose: npt.ArrayLike, q: npt.ArrayLike) -> list[Lines | Dots]:
    """Draw links, joints, centres of mass, and manipulability ellipses of the end effector."""
    p = description.vector()
    state = np.concatenate([np.asarray(pose, dtype=float), np.asarray(q, dtype=float)])
    joints = joint_positions(p, state)  # joints, and the tip as last row
    return [
        Lines([flat(joints)], STEEL, 0.015),
        Dots(flat(joints), STEEL, 0.028),
        Dots(flat(com_positions(p, state)), GHOST, 0.008),
        ellipse(tip_jacobian(p, state)[:2, 3:], joints[-1], STONE),
        ellipse(generalized_jacobian(p, state)[:2], joints[-1], TIP),
    ]


def ellipse(J: Floats, centre: Floats, colour: Colour, scale: float = ELLIPSE) -> Lines:
    """Draw the manipulability ellipse {J qd : |qd| = 1} at a scale [s]."""
    U, s, _ = np.linalg.svd(J)
    s = np.append(s, 0.0)  # with a single link there is one singular value only
    angle = np.linspace(0.0, 2.0 * pi, 49)
    points = centre + scale * (np.column_stack([s[0] * np.cos(angle), s[1] * np.sin(angle)]) @ U.T)
    return Lines([flat(points)], colour, 0.008)


def trail(points: Sequence[tuple[float, float]], what: str, colour: Colour) -> Drawing:
    """Draw the past path of a point."""
    return f"table/{what}", rr.LineStrips2D([flat(points)], colors=colour, radii=0.006)


def route(points: Sequence[tuple[float, float]]) -> Lines:
    """Draw a planned path as dashes: the first half of each segment between its points."""
    ends = np.asarray(points, dtype=float).reshape(-1, 2)
    dashes = [flat([a, 0.5 * (a + b)]) for a, b in pairwise(ends)]
    return Lines(dashes, GHOST, 0.008)


def circle(centre: tuple[float, float], radius: float, colour: Colour) -> Lines:
    """Draw a circle, as the boundary of a keep-out zone."""
    angle = np.linspace(0.0, 2.0 * pi, 65)
    around = np.column_stack([np.cos(angle), np.sin(angle)])
    return Lines([flat(np.array(centre) + radius * around)], colour, 0.006)


def phase(text: str) -> Drawing:
    """Draw the mission's phase as text below the table."""
    place = flat([(-TABLE / 2.0, -TABLE / 2.0 - 0.12)])
    word = rr.Points2D(place, colors=STEEL, radii=0.001, labels=[text], show_labels=True)
    return "table/phase", word


def place(pose: npt.ArrayLike) -> Drawing:
    """Return the transform of the base, which moves all entities below `table/fss`."""
    x, y, heading = np.asarray(pose, dtype=float)
    turn = rr.RotationAxisAngle(axis=[0.0, 0.0, 1.0], radians=-heading)
    return "table/fss", rr.Transform3D(translation=[x, -y, 0.0], rotation_axis_angle=turn)


def outline(
    strips: Sequence[npt.ArrayLike],
    what: str,
    colour: Colour,
    in_base: bool,
) -> list[Drawing]:
    """Draw lines given in the base's or the world's frame, and clear those in the other frame."""
    path = re.sub(r"\W+", "_", what)
    lines = rr.LineStrips2D([flat(strip) for strip in strips], colors=colour, radii=0.005)
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
        jet = [0.0, PLUME * (out + 0.2j * out), PLUME * (out - 0.2j * out), 0.0]
        points = complex(x, y) + turn * (0.5 * BASE * corner + np.array(jet))
        strips.append(flat(np.column_stack([points.real, points.imag])))
    return Lines(strips, JET, 0.012)


def numbers(series: Series, values: Sequence[float]) -> list[Drawing]:
    """Plot the values of one time; NaN is left out."""
    return [
        (f"plot/{series.name}/{line}", rr.Scalars(value))
        for line, value in zip(series.lines, values, strict=True)
        if value == value
    ]


def reaction(message: Any) -> list[Drawing]:
    """Draw a BaseReaction message: the centre of mass, and the plots."""
    heading, band = message.predicted[2], message.predicted_deviation[2]
    dx, dy, turn = message.difference
    return [
        ("table/centre_of_mass", rr.Points2D(flat([message.com]), colors=GHOST, radii=0.02)),
        *numbers(
            HEADING,
            [degrees(a) for a in (heading + band, heading - band, heading, message.measured[2])],
        ),
        *numbers(TURN, (degrees(band), -degrees(band), degrees(turn))),
        *numbers(PLACE, (1e3 * dx, 1e3 * dy)),
        *numbers(LINEAR, message.momentum[:2]),
        *numbers(ANGULAR, message.momentum[2:]),
        *numbers(TORQUE, (message.torque, message.torque_measured)),
    ]


def link(kind: str, i: int, value: float) -> Drawing:
    """Plot a link's value in the plot of all links."""
    return f"plot/{kind}/link_{i}", rr.Scalars(value)


def words(text: str, level: str = "INFO") -> Drawing:
    """Return a line of the log."""
    return "log", rr.TextLog(text, level=level)


def called(pose: Sequence[float], name: str) -> Drawing:
    """Draw a vehicle's name beside its base."""
    place = flat([pose[:2]])
    word = rr.Points2D(place, colors=STONE, radii=0.001, labels=[name], show_labels=True)
    return "table/name", word


def styles(n: int, vehicle: str = "") -> list[Drawing]:
    """Return names and colours of the series; the names include the vehicle's, if given."""
    of = f"{vehicle} " if vehicle else ""
    found: list[Drawing] = []
    for series in PLOTS:
        for line, colour in zip(series.lines, series.colours, strict=True):
            is_band = line.startswith("band")
            name, width = ("band of 1 sigma", 1.0) if is_band else (line, 2.0)
            found.append((f"plot/{series.name}/{line}", _series(of + name, colour, width)))
    for kind in OF_LINKS:
        for i in range(1, n + 1):
            colour = PALETTE[(i - 1) % len(PALETTE)]
            found.append((f"plot/{kind}/link_{i}", _series(f"{of}link {i}", colour, 1.5)))
    return found


def _series(name: str, colour: Colour, width: float) -> Any:
    return rr.SeriesLines(names=name, colors=colour, widths=width)


def blueprint() -> Any:
    """Return the layout: table and events left, base reaction in the middle, links right.

    Plots are few and large, so that their axes have legible ticks; rarely used plots share tabs.
    """
    a, legend_height = TABLE / 2.0 + 0.25, 0.2 * LEGEND_ROWS
    table = rrb.Spatial2DView(
        origin="table",
        name="table from above, 4 m x 4 m",
        visual_bounds=rrb.VisualBounds2D(x_range=[-a, a], y_range=[-a - legend_height, a + 0.2]),
    )
    last = rrb.VisibleTimeRange(
        TIMELINE,
        start=rrb.TimeRangeBoundary.cursor_relative(seconds=-SHOWN),
        end=rrb.TimeRangeBoundary.cursor_relative(),
    )
    look: dict[str, Any] = {"plot_legend": rrb.PlotLegend(rrb.Corner2D.LeftTop)}
    look["time_ranges"] = last
    heading, turn, at, *forces = (
        rrb.TimeSeriesView(origin=f"plot/{s.name}", name=s.title, **look) for s in PLOTS
    )
    angle, *more = (
        rrb.TimeSeriesView(origin=f"plot/{kind}", name=title, **look)
        for kind, title in OF_LINKS.items()
    )
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(table, rrb.TextLogView(origin="log", name="events"), row_shares=[4, 1]),
            rrb.Vertical(heading, turn, at),
            rrb.Vertical(angle, rrb.Tabs(*more), rrb.Tabs(*forces)),
            column_shares=[5, 4, 4],
        ),
        collapse_panels=True,
    )
