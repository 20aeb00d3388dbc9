"""Fields of messages, and changes of single ones."""

from copy import deepcopy
from importlib import import_module


def fields(message, path=()):
    """Yield the path of each field that is no message, with its value and type."""
    for field, kind in message.get_fields_and_field_types().items():
        value, here = getattr(message, field), (*path, field)
        if hasattr(value, "get_fields_and_field_types"):
            yield from fields(value, here)
        else:
            yield here, value, kind


def element(kind):
    """Return an element of a sequence of this type."""
    if "/" in kind:
        package, name = kind.split("/")
        return getattr(import_module(f"{package}.msg"), name)()
    return "x" if kind == "string" else 0.0


def changed(message, path, value):
    """A copy with another value at a path."""
    copy = deepcopy(message)
    *parts, last = path
    inner = copy
    for part in parts:
        inner = getattr(inner, part)
    setattr(inner, last, value)
    return copy
