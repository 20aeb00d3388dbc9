"""Rules for the content of messages; this module imports no ROS, so that commands start quickly."""

from collections.abc import Callable
from typing import Any, NamedTuple

ANY_FIELD = frozenset({"*"})

Check = Callable[[Any], str]  # returns why a message is invalid; empty: it is valid


class Rule(NamedTuple):
    """Rule for a type of message."""

    unknown: frozenset[str] = frozenset()  # fields that may be NaN or infinite
    alike: tuple[tuple[str, ...], ...] = ()  # arrays with the length of the first, or empty
    square: tuple[tuple[str, str], ...] = ()  # matrices row by row; size of the second
    size: int = 65_536  # largest serialized size [bytes]
    also: tuple[Check, ...] = ()


RESULT = Rule(ANY_FIELD, size=1_000_000)  # of a calibration
