"""A node's parameters, declared from a frozen dataclass of settings (fss_arm_model.settings)."""

import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import Field, fields
from difflib import get_close_matches
from itertools import pairwise
from math import isfinite
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.exceptions import InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter

from fss_arm_model.files import read_yaml
from fss_arm_model.settings import SettingError, converted, default_in, meaning, refuse
from fss_arm_ros import duplicates
from fss_arm_ros.common_parameter import ABOUT, ALLOW
from fss_arm_ros.rclpy_compat import parameter_overrides

Settings = TypeVar("Settings")


def declare(node: Node, kind: type[Settings], live: bool = False) -> Settings:
    """Declare each field of the dataclass `kind` as a read-only parameter; return their values.

    Fields are bool, int, float, str or tuples of one of them (`tuple[str, ...]`). An integer is
    accepted for a float. With `live`, `declare_live` follows and checks for unknown parameters.
    Under `run`, this is where a duplicate node ends.

    Raises:
        SettingError: a value has another type, or `kind` has no such field.
        ValueError: `kind` rejects a value.
        DuplicateError: another node has its name.
    """
    hints = get_type_hints(kind)
    about = ParameterDescriptor(description=ABOUT, read_only=True, dynamic_typing=True)
    allowed = node.declare_parameter(ALLOW, False, about).value
    allowed = converted(ALLOW, allowed, bool)
    known = fields(kind)  # type: ignore[arg-type]  # a dataclass each
    names = [f.name for f in known]
    if not live:
        _refuse(_unknown_overrides(node) - set(names), names)
    values = {}
    for f in known:
        value = _declared(node, f.name, f, read_only=True)
        values[f.name] = converted(f.name, value, hints[f.name])
    settings = kind(**values)
    duplicates.check_name(node, allowed)
    return settings


def declare_live(
    node: Node, kinds: Mapping[str, type], take: Callable[[str, str, float], None]
) -> None:
    """Declare each field of each of `kinds`, dataclasses of floats, as a parameter PREFIX.FIELD.

    Args:
        node: owner of the parameters, which may be set at any time.
        kinds: dataclasses by prefix.
        take: called with prefix, field and value whenever one is set, and at the start if it is
            not the default; its ValueError rejects the value.

    Raises:
        SettingError: an unknown parameter was given, or a wrong type or range.
    """
    names = {f"{prefix}.{f.name}": (prefix, f) for prefix in kinds for f in fields(kinds[prefix])}

    def on_set(parameters: list[Parameter]) -> SetParametersResult:
        taken: list[tuple[str, str, float]] = []  # values to restore
        try:
            for parameter in parameters:
                if parameter.name in names:
                    prefix, f = names[parameter.name]
                    take(prefix, f.name, converted(parameter.name, parameter.value, float))
                    taken.append((prefix, f.name, node.get_parameter(parameter.name).value))
        except ValueError as error:
            for before in reversed(taken):  # set together or not at all
                take(*before)
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    for name, (_, f) in names.items():
        _declared(node, name, f)
    _refuse(_unknown_overrides(node), node.get_parameters_by_prefix(""))
    node.add_on_set_parameters_callback(on_set)
    overrides = parameter_overrides(node)
    given = [node.get_parameter(name) for name in names if name in overrides]
    if not (result := on_set(given)).successful:
        raise SettingError(result.reason)


def _declared(node: Node, name: str, f: "Field[Any]", read_only: bool = False) -> Any:
    """Declare a setting as a parameter; return its value."""
    default = default_in(f, node.get_namespace())
    try:
        return node.declare_parameter(name, default, descriptor(f, read_only)).value
    except InvalidParameterValueException:  # rclpy checks the range; our message names the unit
        if given := parameter_overrides(node).get(name):
            refuse(f, given.value, name)
        raise


def descriptor(f: "Field[Any]", read_only: bool = False) -> ParameterDescriptor:
    """Return the descriptor that `ros2 param describe` shows: meaning, unit, and range.

    A range needs two finite ends; the meaning names a single bound.
    """
    # Dynamic: a static type would reject 1 for 1.0, and treat an empty list as bytes.
    about = ParameterDescriptor(description=meaning(f), read_only=read_only, dynamic_typing=True)
    check = f.metadata["check"]
    if check is None or not (isfinite(check.low) and isfinite(check.high)):
        return about
    low, high = check.low, check.high
    if type(f.default) is int:
        about.integer_range = [IntegerRange(from_value=int(low), to_value=int(high), step=1)]
    elif type(f.default) is float:
        about.floating_point_range = [
            FloatingPointRange(from_value=float(low), to_value=float(high))
        ]
    return about


def _refuse(unknown: set[str], known: Iterable[str]) -> None:
    every = list(known)
    for name in sorted(unknown):
        near = get_close_matches(name, every, n=1)
        hint = f"is it {near[0]}?" if near else f"there are {', '.join(every)}"
        raise SettingError(f"no parameter {name}; {hint}")


def _unknown_overrides(node: Node) -> set[str]:
    """Return the names of parameters that the user gave and that are not rclpy's own."""
    names = parameter_overrides(node)
    given = {n for n in names if not node.has_parameter(n) and not n.startswith("qos_overrides.")}
    return given - _for_all(sys.argv) if given else given


def _for_all(arguments: Sequence[str]) -> set[str]:
    """Return the names that parameter files give to all nodes (`/**`)."""
    files = [file for option, file in pairwise(arguments) if option == "--params-file"]
    sections = [part for file in files for part in read_yaml(Path(file)).items()]
    return {
        name
        for nodes, given in sections
        if nodes.endswith("*")
        for name in _names(given.get("ros__parameters", {}))
    }


def _names(given: Mapping[str, Any]) -> Iterator[str]:
    """Yield parameter names, nested groups joined with dots."""
    for name, value in given.items():
        if isinstance(value, dict):
            yield from (f"{name}.{inner}" for inner in _names(value))
        else:
            yield name
