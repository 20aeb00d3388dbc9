"""How much room the bodies take on the table; plain numbers, that need no compiler."""

from dataclasses import dataclass

from .settings import NOT_NEGATIVE, POSITIVE, Settings, setting


@dataclass(frozen=True)
class Extents(Settings):
    """Of the table, and of the bodies on it as discs and as lines with a radius."""

    table: tuple[float, ...] = setting(
        (4.0, 4.0), "sides of the table, along x and y, about the origin", unit="m",
        check=POSITIVE, size=2,
    )  # fmt: skip
    base_radius: float = setting(
        0.19, "radius within which the base lies about its origin", unit="m", check=NOT_NEGATIVE
    )
    link_radius: float = setting(
        0.06, "radius of the links about the lines from joint to joint", unit="m",
        check=NOT_NEGATIVE,
    )  # fmt: skip
