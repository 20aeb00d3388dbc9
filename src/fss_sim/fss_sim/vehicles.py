"""Reader of the vehicles file: for each vehicle, the settings that differ from the test bed's."""

import re
from collections.abc import Collection, Mapping
from dataclasses import fields, replace
from itertools import combinations
from math import dist
from pathlib import Path
from typing import Any, get_type_hints

from fss_arm_model.files import ContentError, read_yaml
from fss_arm_model.settings import SettingError, converted, default_in
from fss_sim.noise import Noise
from fss_sim.plant.surroundings import Surroundings
from fss_sim.settings import PlantSettings, TestbedSettings

NAME = re.compile("[A-Za-z][A-Za-z0-9_]*")  # name of a vehicle, which is also its namespace
PORT_STEP = 10  # from the ports of a vehicle to those of the next one
SHARED_SETTINGS = {
    *("vehicles", "keep_clock", "speed", "paused", "truth_rate", "state_file", "world_frame"),
    *("tilt", "table", "tolerance", "contact", "restitution", "contact_friction"),
    *(f.name for f in fields(PlantSettings) if f.name.startswith(("target_", "wifi"))),
    *(f.name for f in fields(Noise) if f.name.startswith("vicon_")),
    *("preset", "marker_noise", "vicon_cameras", "base_markers", "tip_markers"),
    *("heights", "marker_stalk"),
    "target_topic",
}  # settings of the whole test bed, which a vehicle cannot have of its own


def read_vehicles(bed: TestbedSettings) -> dict[str, TestbedSettings]:
    """Return the settings of each vehicle by name; without a file, those of the only vehicle.

    Raises:
        OSError: if the vehicles file cannot be read.
        ValueError: if its content is invalid.
    """
    file = bed.vehicles
    if not file:
        return {"": bed}
    values = read_yaml(Path(file))
    entries = values.get("vehicles") if isinstance(values, dict) and len(values) == 1 else None
    if not isinstance(entries, dict) or not entries:
        raise ContentError(f"{file}: vehicles", entries, "the settings of each, by name")
    settings = {
        str(name): _vehicle_settings(bed, str(name), k, entries[name])
        for k, name in enumerate(entries)
    }
    min_distance = 2.0 * Surroundings().base_radius
    for (one, a), (other, b) in combinations(settings.items(), 2):
        if dist(a.base[:2], b.base[:2]) < min_distance:
            raise SettingError(
                f"{file}: {one} and {other} start in the same place: change base of one of them"
            )
    return settings


def check_keys(keys: Mapping[str, Collection[bytes]]) -> None:
    """Raise SettingError if links of two vehicles, by name, would accept each other's commands."""
    for one, other in combinations(keys, 2):
        if set(keys[one]) & set(keys[other]):
            raise SettingError(
                f"{one} and {other} have a key in common: give each vehicle its own keys"
            )


def _vehicle_settings(bed: TestbedSettings, name: str, k: int, values: Any) -> TestbedSettings:
    """Return the settings of vehicle k: from the file, or from its name, or the test bed's."""
    where = f"{bed.vehicles}: {name}"
    if not NAME.fullmatch(name):
        raise ContentError(f"{bed.vehicles}: a vehicle's name", name, "letters, digits and _")
    allowed = {f.name: f for f in fields(bed) if f.name not in SHARED_SETTINGS}
    if not isinstance(values, dict) or not set(values) <= set(allowed):
        what = (
            ", ".join(map(str, set(values) - set(allowed))) if isinstance(values, dict) else values
        )
        raise ContentError(where, what, f"some of {', '.join(allowed)}")
    state, hints = Path(bed.state_file), get_type_hints(TestbedSettings)
    file = str(state.with_name(f"{state.stem}_{name}{state.suffix}")) if bed.state_file else ""
    changed: dict[str, Any] = {"vehicles": "", "seed": bed.seed + k, "state_file": file}
    changed |= {n: default_in(f, name) for n, f in allowed.items() if f.metadata.get("within")}
    changed |= {"target_mass": 0.0} if k else {}
    ports = [port and port + k * PORT_STEP for port in (bed.board_port, *bed.ports)]  # 0: any
    changed |= {"board_port": ports[0], "ports": tuple(ports[1:])}
    try:
        changed |= {n: converted(n, value, hints[n]) for n, value in values.items()}
        return replace(bed, **changed)
    except ValueError as error:
        raise SettingError(f"{where}: {error}") from None
