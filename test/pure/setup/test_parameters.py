"""What `ros2 param describe` shows of each parameter: words that stand alone, unit, range."""

import re
from collections.abc import Iterator
from dataclasses import Field, fields, is_dataclass
from importlib import import_module
from inspect import getmembers, isclass
from pathlib import Path
from typing import Any, get_type_hints

import pytest

SOURCES = Path(__file__).parents[3] / "src"
PACKAGES = sorted(path.parent.name for path in SOURCES.glob("*/setup.py"))

#: Fields that are ratios, shares or factors, or have their kind's unit; with the class where others
#: have a unit.
DIMENSIONLESS = {
    *("FogCorrection.scale", "stuck_open", "stuck_closed"),
    *("clock_drift", "gear_ratio", "gyro_scale", "ReplaySettings.rate", "speed", "tolerance"),
    *("battery", "corruption", "dead", "dropout", "duplication", "frozen", "loss", "occlusion"),
    *("braking", "reordering", "swap", "vicon_occlusion", "vicon_merge_swap"),
    *("interference", "burst_loss", "wifi_loss", "wifi_burst_loss"),
    *("blocked", "command_input", "enable_open", "encoder", "flash", "internal", "logic"),
    *("negative_limit", "overcurrent", "phasing", "positive_limit", "reset", "short_circuit"),
    *("pad_friction", "voltage_limit", "wrapped"),
    *("restitution", "contact_friction", "Contact.friction", "cancelled", "friction_cancelled"),
    *("max_condition", "max_relative", "min_probability", "min_redundancy", "outlier"),
    "relative_inertia_deviation",
    *("LimitSettings.share", "MissionSettings.authority", "MissionSettings.torque_share"),
    *("thrust_error", "joint_rate_error"),
    *("DriftSettings.mass_deviation", "Event.value", "PoseGains.damping", "PoseGains.integral"),
    *("MassErrors.mass_error",),
}

# A description that begins with one of these leans on the parameter's name or on the one before it.
LEANING = {
    *("after", "also", "as", "at", "before", "by", "ditto", "for", "from", "in", "it", "likewise"),
    *("of", "same", "that", "to", "which", "while", "with", "within"),
}


def settings(package: str) -> Iterator[type]:
    """The dataclasses made of settings in a package."""
    for path in sorted((SOURCES / package / package).rglob("*.py")):
        if "setting(" in path.read_text():
            parts = path.relative_to(SOURCES / package).with_suffix("").parts
            module = import_module(".".join(parts).removesuffix(".__init__"))
            for _, kind in getmembers(module, isclass):
                if kind.__module__ == module.__name__ and is_dataclass(kind):
                    yield kind


def flaws(f: "Field[Any]", hint: Any, name: str) -> Iterator[str]:
    """What a setting lacks."""
    about, unit, check = (f.metadata[key] for key in ("about", "unit", "check"))
    kinds = getattr(hint, "__args__", (hint,))
    if float in kinds and not unit and not {name, f.name} & DIMENSIONLESS:
        yield "has no unit"
    if {int, float} & {*kinds} and check is None:
        yield "has no check"
    if re.search(r"\[[^]]*\]", about):
        yield "has a unit in its description"
    if (first := about.split()[0].strip(",;:").lower()) in LEANING:
        yield f"begins with {first!r}"
    if re.search(r"\b(likewise|ditto|as above|the same)\b", about):
        yield "leans on another description"


@pytest.mark.parametrize("package", PACKAGES)
def test_each_parameter_says_what_it_is(package: str) -> None:
    found = []
    for kind in settings(package):
        hints = get_type_hints(kind)
        for f in fields(kind):
            if f.name in kind.__annotations__ and "check" in f.metadata:
                name = f"{kind.__name__}.{f.name}"
                found += [f"{name} {flaw}" for flaw in flaws(f, hints[f.name], name)]
    assert not found, "\n".join(found)
