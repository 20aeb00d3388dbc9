"""Sizes of the bodies on the table: plain numbers, without compiled code."""

from dataclasses import dataclass

from .settings import NOT_NEGATIVE, POSITIVE, Settings, setting


@dataclass(frozen=True)
class Extents(Settings):
    """Sizes of the table, and of the bodies on it as discs and as lines with a radius."""

    table: tuple[float, ...] = setting(
        (4.0, 4.0),
        "sides of the table, along x and y, about the origin",
        unit="m",
        check=POSITIVE,
        size=2,
    )
    base_radius: float = setting(
        0.19,
        "radius of a circle about the base's origin around the base",
        unit="m",
        check=NOT_NEGATIVE,
    )
    link_radius: float = setting(
        0.06,
        "radius of the links about the lines from joint to joint",
        unit="m",
        check=NOT_NEGATIVE,
    )
