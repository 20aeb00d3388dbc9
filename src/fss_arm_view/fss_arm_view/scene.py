"""What the view shows: drawings of the table from above, and series, as rerun's archetypes.

Entities: `table/...` is drawn to scale [m], `plot/<what>/<series>` are numbers over time, `log` is
text. A drawing is a pair of entity and archetype. rerun's plane has its y axis downwards, so y is
drawn negated.
"""

from collections.abc import Sequence
from math import cos, degrees, pi, sin
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import rerun as rr
import rerun.blueprint as rrb

from fss_arm_model.description import Arm
from fss_arm_model.kinematics import com_positions, joint_positions
from fss_arm_model.momentum import generalized_jacobian

Floats = npt.NDArray[np.float64]
Drawing = tuple[str, Any]

TABLE = 4.0  # edge of the granite table [m]
BASE = 0.27  # edge of the spacecraft simulator as drawn [m]
TRAIL = 600  # points kept

STONE, STEEL, GHOST = (110, 110, 110), (90, 160, 230), (250, 160, 60)
MARK, TIP, GREEN = (230, 230, 230), (120, 220, 120), (80, 200, 120)


class Series(NamedTuple):
    """Numbers that share a plot."""

    name: str
    title: str
    lines: tuple[str, ...]


HEADING = Series("heading", "base heading [deg]", ("measured", "predicted", "lowest", "highest"))
DIFFERENCE = Series("difference", "measured - predicted [mm, deg]", ("x", "y", "heading"))
MOMENTUM = Series("momentum", "momentum [N s, N m s]", ("x", "y", "angular"))
TORQUE = Series("torque", "torque about joint 1 [N m]", ("predicted", "sensor"))
PLOTS = (HEADING, DIFFERENCE, MOMENTUM, TORQUE)
OF_LINKS = {
    "angle": "joint angles [deg]",
    "current": "currents [A]",
    "effort": "torque sensors [N m]",
    "loss": "datagrams lost [%]",
}


def flat(points: npt.ArrayLike) -> Floats:
    """Points (..., 2) as rerun draws them."""
    return np.asarray(points, dtype=float) * (1.0, -1.0)


def ground() -> list[Drawing]:
    """What does not change: the table's edge."""
    a = TABLE / 2.0
    edge = flat([(-a, -a), (a, -a), (a, a), (-a, a), (-a, -a)])
    return [("table/edge", rr.LineStrips2D([edge], colors=STONE, radii=0.01))]


def base(pose: npt.ArrayLike, what: str, colour: tuple[int, int, int]) -> Drawing:
    """The spacecraft simulator as a square that shows its heading."""
    x, y, heading = np.asarray(pose, dtype=float)
    a = BASE / 2.0
    square = [(-a, -a), (a, -a), (a, a), (-a, a), (-a, -a)]
    nose = [(0.0, 0.0), (a, 0.0)]
    turn = np.array([[cos(heading), -sin(heading)], [sin(heading), cos(heading)]])
    strips = [flat(np.array(part) @ turn.T + (x, y)) for part in (square, nose)]
    return f"table/{what}", rr.LineStrips2D(strips, colors=colour, radii=0.006)


def arm(description: Arm, pose: npt.ArrayLike, q: npt.ArrayLike) -> list[Drawing]:
    """Links, joints and centres of mass, and how easily the end effector moves which way."""
    p = description.vector()
    state = np.concatenate([np.asarray(pose, dtype=float), np.asarray(q, dtype=float)])
    joints = joint_positions(p, state)  # and the tip
    return [
        ("table/arm/links", rr.LineStrips2D([flat(joints)], colors=STEEL, radii=0.015)),
        ("table/arm/joints", rr.Points2D(flat(joints), colors=MARK, radii=0.02)),
        (
            "table/arm/centres",
            rr.Points2D(flat(com_positions(p, state)), colors=GHOST, radii=0.008),
        ),
        ellipse(generalized_jacobian(p, state)[:2], joints[-1]),
    ]


def ellipse(J: Floats, centre: Floats, scale: float = 0.15) -> Drawing:
    """The floating-base manipulability ellipse {J qd : |qd| = 1}, drawn at a scale [s]."""
    U, s, _ = np.linalg.svd(J)
    angle = np.linspace(0.0, 2.0 * pi, 49)
    points = centre + scale * (np.column_stack([s[0] * np.cos(angle), s[1] * np.sin(angle)]) @ U.T)
    return "table/arm/ellipse", rr.LineStrips2D([flat(points)], colors=TIP, radii=0.003)


def trail(
    points: Sequence[tuple[float, float]], what: str, colour: tuple[int, int, int]
) -> Drawing:
    """Where a point has been."""
    return f"table/{what}", rr.LineStrips2D([flat(points)], colors=colour, radii=0.004)


def boundary(points: npt.ArrayLike, what: str) -> Drawing:
    """A closed boundary in the world."""
    ring = flat(points)
    return (
        f"table/{what}",
        rr.LineStrips2D([np.vstack([ring, ring[:1]])], colors=GREEN, radii=0.005),
    )


def numbers(series: Series, values: Sequence[float]) -> list[Drawing]:
    """One moment of a plot; what is not known leaves a gap."""
    return [
        (f"plot/{series.name}/{line}", rr.Scalars(value))
        for line, value in zip(series.lines, values, strict=True)
        if value == value
    ]


def reaction(message: Any) -> list[Drawing]:
    """A BaseReaction message: the ghost of the predicted base, and the plots."""
    heading, band = message.predicted[2], message.predicted_deviation[2]
    dx, dy, turn = message.difference
    return [
        base(message.predicted, "predicted", GHOST),
        ("table/centre_of_mass", rr.Points2D(flat([message.com]), colors=GHOST, radii=0.02)),
        *numbers(
            HEADING,
            [degrees(a) for a in (message.measured[2], heading, heading - band, heading + band)],
        ),
        *numbers(DIFFERENCE, (1e3 * dx, 1e3 * dy, degrees(turn))),
        *numbers(MOMENTUM, message.momentum),
        *numbers(TORQUE, (message.torque, message.torque_measured)),
    ]


def link(kind: str, i: int, value: float) -> Drawing:
    """One link's number in the plot of all links."""
    return f"plot/{kind}/link_{i}", rr.Scalars(value)


def words(text: str, level: str = "INFO") -> Drawing:
    """A line of the log."""
    return "log", rr.TextLog(text, level=level)


def styles(n: int) -> list[Drawing]:
    """Names of the series, and the colours of those that belong together."""
    colours = {"measured": STEEL, "predicted": GHOST, "lowest": (150, 110, 60)}
    colours |= {"highest": colours["lowest"], "sensor": STEEL}
    found: list[Drawing] = []
    for series in PLOTS:
        for line in series.lines:
            colour = colours.get(line)
            found.append((f"plot/{series.name}/{line}", _named(line, colour)))
    for kind in OF_LINKS:
        found += [(f"plot/{kind}/link_{i}", _named(f"link {i}", None)) for i in range(1, n + 1)]
    return found


def _named(name: str, colour: tuple[int, int, int] | None) -> Any:
    return rr.SeriesLines(names=name, colors=colour) if colour else rr.SeriesLines(names=name)


def blueprint() -> Any:
    """The table at the left, base reaction beside it, the links and the log below."""
    a = TABLE / 2.0 + 0.1
    table = rrb.Spatial2DView(
        origin="table",
        name="table from above",
        visual_bounds=rrb.VisualBounds2D(x_range=[-a, a], y_range=[-a, a]),
    )
    plots = [rrb.TimeSeriesView(origin=f"plot/{s.name}", name=s.title) for s in PLOTS]
    links = [rrb.TimeSeriesView(origin=f"plot/{k}", name=title) for k, title in OF_LINKS.items()]
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(table, rrb.TextLogView(origin="log", name="events"), row_shares=[4, 1]),
            rrb.Vertical(*plots),
            rrb.Vertical(*links),
            column_shares=[5, 3, 3],
        ),
        collapse_panels=True,
    )
