"""Paths in time that a link keeps and follows by itself (docs/reference/protocol.md)."""


def hermite(
    t: float, duration: float, p0: float, v0: float, p1: float, v1: float
) -> tuple[float, float]:
    """Position and velocity, `t` after its beginning, of the cubic with these at its ends.

        p(s) = p0 + s (T v0 + s (3 D - T (2 v0 + v1) + s (T (v0 + v1) - 2 D)))

    with s = t / T from 0 to 1, T = `duration` and D = p1 - p0 (Hermite's interpolation).
    """
    s, rise = t / duration, p1 - p0
    a, b = duration * v0, duration * v1
    square, cube = 3.0 * rise - 2.0 * a - b, a + b - 2.0 * rise
    position = p0 + s * (a + s * (square + s * cube))
    return position, (a + s * (2.0 * square + s * 3.0 * cube)) / duration
