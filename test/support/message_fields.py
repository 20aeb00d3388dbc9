"""Changes of single fields of messages."""

from copy import deepcopy


def changed(message, path, value):
    """A copy with another value at a path."""
    copy = deepcopy(message)
    *parts, last = path
    inner = copy
    for part in parts:
        inner = getattr(inner, part)
    setattr(inner, last, value)
    return copy
