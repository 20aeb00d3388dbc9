"""Colors: each has one meaning, for color-blind users, too."""

from itertools import combinations

import numpy as np
import pytest

from fss_arm_ros import palette

#: Colors as seen without one kind of cone, for linear RGB: Machado, Oliveira and Fernandes (2009).
VISION = {
    "normal": np.eye(3),
    "protanopia": [
        [0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "deuteranopia": [
        [0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
    "tritanopia": [
        [1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602],
        [0.004733, 0.691367, 0.303900],
    ],
}  # fmt: skip
TO_XYZ = [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
MIN_DISTANCE = 15.0  # in CIE L*a*b*; 2.3 are just noticeable
DRAWN = ("MEASURED", "PREDICTED", "TIP", "TARGET", "THRUST", "STATIC", "DIFFERENCE")


def linear(color):
    c = np.array(palette.rgb(color)) / 255.0
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def lab(color, vision):
    seen = np.clip(np.array(VISION[vision]) @ linear(color), 0.0, 1.0)
    x = np.array(TO_XYZ) @ seen / [0.9505, 1.0, 1.0888]
    f = np.where(x > 0.008856, np.cbrt(x), 7.787 * x + 16.0 / 116.0)
    return np.array([116.0 * f[1] - 16.0, 500.0 * (f[0] - f[1]), 200.0 * (f[1] - f[2])])


@pytest.mark.parametrize("vision", VISION)
def test_drawings_are_told_apart(vision):
    seen = [lab(getattr(palette, name), vision) for name in DRAWN]
    assert min(np.linalg.norm(a - b) for a, b in combinations(seen, 2)) > MIN_DISTANCE


def test_no_two_drawings_have_one_color_and_none_is_red():
    colors = [getattr(palette, name) for name in (*DRAWN, "BAND")]
    shown = np.array([palette.rgb(c) for c in (*colors, *palette.AXES, *palette.LINKS)], float)
    assert min(np.linalg.norm(a - b) for a, b in combinations(shown, 2)) > 25.0
    red, green, blue = shown.T
    assert not ((red > 180) & (green < 70) & (blue < 70)).any()  # red is for alarms


@pytest.mark.parametrize(
    ("text", "fill"),
    [
        ("#ffffff", palette.DANGER),
        (palette.POSITIVE, palette.POSITIVE_FILL),
        (palette.TEXT, "#ffffff"),
        (palette.TEXT, palette.ATTENTION_FILL),
        (palette.MUTED, "#ffffff"),
    ],
)
def test_texts_are_legible(text, fill):
    """The contrast is at least 4.5, as the Web Content Accessibility Guidelines require (AA)."""
    light, dark = sorted((linear(c) @ TO_XYZ[1] + 0.05 for c in (text, fill)), reverse=True)
    assert light / dark >= 4.5


def test_css_has_each_color():
    assert "--measured: #0068a8;" in palette.css()
    assert palette.css().count("#") == len(palette.VARIABLES)
