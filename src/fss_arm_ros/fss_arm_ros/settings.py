"""A node's parameters, declared from a frozen dataclass.

The dataclass is the one place where a parameter's default, unit and description are written, and
its `__post_init__` the one place where values are checked.
"""

from dataclasses import field, fields
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node

Settings = TypeVar("Settings")

NAMES = {bool: "true or false", int: "an integer", float: "a number", str: "a string"}


class SettingError(ValueError):
    """A parameter has a value of the wrong type, or does not exist; the message names it."""


def setting(default: Any, about: str) -> Any:
    """A settings field: its default, and the sentence that `ros2 param describe` shows."""
    return field(default=default, metadata={"about": about})


def declare(node: Node, kind: type[Settings]) -> Settings:
    """Declare each field of `kind`, a dataclass, as a read-only parameter; return them read.

    Fields are bool, int, float, str or tuples of one of them (`tuple[str, ...]`). An integer is
    taken where a float is asked for.

    Raises:
        SettingError: a parameter was given a value of another type, or `kind` has no such field.
        ValueError: `kind` refuses a value.
    """
    hints = get_type_hints(kind)
    unknown = _given(node) - set(hints)
    if unknown:
        raise SettingError(
            f"no parameter {', '.join(sorted(unknown))}; there are {', '.join(hints)}"
        )
    values = {}
    for f in fields(kind):  # type: ignore[arg-type]
        # Dynamic: a static type would refuse 1 for 1.0, and take an empty list for bytes.
        about = ParameterDescriptor(
            description=f.metadata["about"], read_only=True, dynamic_typing=True
        )
        value = node.declare_parameter(f.name, f.default, about).value
        values[f.name] = _convert(f.name, value, hints[f.name])
    return kind(**values)


def _given(node: Node) -> set[str]:
    """Names of the parameters that the caller gave and that are not rclpy's own."""
    names = node._parameter_overrides  # the only place that tells a misspelt `-p` from none
    return {n for n in names if not node.has_parameter(n) and not n.startswith("qos_overrides.")}


def _convert(name: str, value: Any, hint: Any) -> Any:
    """The value as the field's type; lists come back as tuples."""
    if get_origin(hint) is tuple:
        kind = get_args(hint)[0]
        value = () if value is None else value  # how rcl reads `name:=[]`
        if isinstance(value, str | bytes) or not hasattr(value, "__iter__"):
            raise SettingError(f"{name} is {value!r}, expected a list, each {NAMES[kind]}")
        return tuple(_convert(name, item, kind) for item in value)
    if hint is float and type(value) is int:
        return float(value)
    if type(value) is not hint:
        raise SettingError(f"{name} is {value!r}, expected {NAMES[hint]}")
    return value
