"""Parameters of a run by name: the keyword arguments of the function that a campaign runs.

An argument whose default is a settings dataclass is a group, usually named after a node. Its fields
are parameters by the names that `ros2 param` shows: `guidance.stand_off`. An element of a list has
an index: `testbed.target_pose[2]`.
"""

import re
from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass, replace
from difflib import get_close_matches
from inspect import Parameter, signature
from typing import Any, get_type_hints

from fss_arm_model.files import ContentError
from fss_arm_model.settings import NAMES, SettingError, converted
from fss_rehearsal.loops.parameters import ArmValues

KEY = re.compile(r"([\w.]+?)(?:\[(\d+)\])?")
SEED, BAG = "seed", "bag"  # arguments that a campaign sets itself


class Arguments:
    """The parameters of a function, checked and converted."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self.takes_seed = self.takes_bag = False
        self.hints: dict[str, Any] = {}  # type of each parameter, by full name
        self.defaults: dict[str, Any] = {}  # default of each argument
        self.unused: set[str] = set()  # full names of settings without effect
        hints = get_type_hints(function)
        annotations = get_type_hints(function, include_extras=True)
        for name, argument in signature(function).parameters.items():
            if name in (SEED, BAG):
                self.takes_seed |= name == SEED
                self.takes_bag |= name == BAG
                continue
            default = self.defaults[name] = argument.default
            if isinstance(default, ArmValues):
                self.hints |= {f"{name}.{value}": float for value in default.names()}
            elif is_dataclass(default):
                kinds = get_type_hints(type(default))
                self.hints |= {f"{name}.{f.name}": kinds[f.name] for f in fields(default)}
                for without in getattr(annotations[name], "__metadata__", ()):
                    self.unused |= {
                        f"{name}.{f.name}" for f in fields(default) if without.includes(f.name)
                    }
            else:
                self.hints[name] = hints.get(name, Any)

    @property
    def names(self) -> list[str]:
        """Full names of the parameters that have an effect."""
        return [name for name in self.hints if name not in self.unused]

    def build(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Return the keyword arguments for parameters by full name; others keep their defaults.

        Raises:
            ContentError: a name is unknown, or its parameter has no effect.
            SettingError: a value is invalid.
        """
        changes: dict[str, dict[str, Any]] = defaultdict(dict)
        built: dict[str, Any] = {}
        for key in sorted(values, key=lambda key: "[" in key):  # elements after whole lists
            name, index = self.parse(key, values[key])
            group, _, field = name.partition(".")
            value, default = values[key], self.defaults[group]
            if index is not None:
                whole = getattr(default, field, ()) if field else built.get(group, default)
                value = self._with_element(key, changes[group].get(field, whole), index, value)
            value = self._convert(name, value)
            if field:
                changes[group][field] = value
            else:
                built[group] = value
        for group, change in changes.items():
            if change:
                built[group] = self._changed(group, change)
        return built

    def missing(self, values: Mapping[str, Any]) -> list[str]:
        """Return the names of arguments that have neither a value nor a default."""
        required = [name for name, value in self.defaults.items() if value is Parameter.empty]
        return [name for name in required if name not in values]

    def parse(self, key: str, value: Any) -> tuple[str, int | None]:
        """Return a key's parameter and index.

        Raises:
            ContentError: there is no such parameter, or it has no effect.
        """
        found = KEY.fullmatch(key)
        name = found[1] if found else key
        if name in self.unused:
            raise ContentError(key, value, "no value: it has no effect on this run")
        if name == SEED or name.endswith(f".{SEED}"):
            raise ContentError(key, value, "the seeds under `seeds`")
        if name not in self.hints or not found:
            near = get_close_matches(name, self.names, n=1, cutoff=0.5)
            raise ContentError(
                key,
                value,
                f"a parameter of the run; the nearest name is {near[0]}"
                if near
                else f"a parameter of the run: {', '.join(self._groups())}",
            )
        return name, None if found[2] is None else int(found[2])

    def _groups(self) -> list[str]:
        return [name if name in self.hints else f"{name}.*" for name in self.defaults]

    def _with_element(self, key: str, known: Any, index: int, value: Any) -> tuple[Any, ...]:
        if not isinstance(known, tuple) or index >= len(known):
            size = len(known) if isinstance(known, tuple) else 0
            raise ContentError(key, value, f"an index below {size}, the size of this list")
        return (*known[:index], value, *known[index + 1 :])

    def _convert(self, name: str, value: Any) -> Any:
        hint = self.hints[name]
        is_checked = hint in NAMES or hasattr(hint, "__args__")
        return converted(name, value, hint) if is_checked else value

    def _changed(self, group: str, change: dict[str, Any]) -> Any:
        default = self.defaults[group]
        if isinstance(default, ArmValues):
            return ArmValues(default | change)
        try:
            return replace(default, **change)
        except SettingError as error:
            raise SettingError(f"{group}.{error}") from None
