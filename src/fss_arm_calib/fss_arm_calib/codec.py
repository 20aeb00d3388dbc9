"""Conversion between dataclasses and the messages that have fields of the same names.

Messages are read by attribute, so that those of rclpy and of rosbags both work. In a message,
nested tuples follow each other in one array: poses row by row, and the samples of the joints with
their number for each joint in the field `samples`.
"""

from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass
from itertools import accumulate, chain, pairwise
from math import isfinite
from typing import Any, TypeVar, get_args, get_type_hints

import numpy as np

from fss_arm_calib.calibration import Data
from fss_arm_calib.segments.streams import Datum
from fss_arm_msgs import msg
from fss_arm_ros.convert import stamp_ns, to_time
from fss_arm_ros.rules import ANY_FIELD, Rule

MAX_DATA_SIZE = 10_000_000  # of a message [bytes]: hundreds of maneuvers of many links
POSE_WIDTHS = {"frames": 1, "seconds": 1, "poses": 3}  # elements for each averaged pose

D = TypeVar("D", bound=Datum)
T = TypeVar("T")
M = TypeVar("M", bound=Any)


def fieldwise_data(
    noun: str,
    kind: type[D],
    topic: str,
    message: type[Any],
    summary: Callable[[D], str],
    pose_times: str = "",
    needed: Sequence[str] = (),
    **constants: Any,
) -> Data[D]:
    """Return the data of a kind of calibration, converted to and from their messages by field.

    Args:
        noun: name of a datum; its plural is the field of `message` with all data.
        kind: dataclass of a datum.
        topic: topic of the data.
        message: class of the message with all data.
        summary: log text of a datum that is used.
        pose_times: field with the times of the averaged poses; empty: a datum has none.
        needed: fields that must be finite in a datum that is used.
        constants: other fields of the message, with their values.
    """
    part = f"{noun}s"
    element = _element_class(message.get_fields_and_field_types()[part])

    def to_message(data: Sequence[D], frame_id: str) -> Any:
        whole = message(**{part: [encode(one, element) for one in data]}, **constants)
        whole.header.frame_id = frame_id
        whole.header.stamp = to_time(data[-1].end if data else 0)
        return whole

    def from_message(whole: Any) -> list[D]:
        return [decode(one, kind) for one in getattr(whole, part)]

    def problem(whole: Any) -> str:
        problems = (datum_problem(one, kind, pose_times, needed) for one in getattr(whole, part))
        return next(filter(None, problems), "")

    rule = Rule(ANY_FIELD, size=MAX_DATA_SIZE, also=(problem,))
    return Data(noun, topic, message, kind, to_message, from_message, summary, rule)


def encode(values: Any, kind: type[M]) -> M:
    """Return a message of `kind` with those fields of a dataclass that it has."""
    types = kind.get_fields_and_field_types()
    known = [f.name for f in fields(values) if f.name in types]
    message = kind(**{name: _encode_field(getattr(values, name), types[name]) for name in known})
    if "samples" in types:
        message.samples = [len(row) for row in values.times]
    return message


def _encode_field(value: Any, field_type: str) -> Any:
    if field_type == "builtin_interfaces/Time":
        return to_time(value)
    if not isinstance(value, tuple | np.ndarray):
        return float(value) if field_type == "double" else value
    if "/" in field_type:
        return [encode(one, _element_class(field_type)) for one in value]
    flat = flatten(value)
    return [int(x) for x in flat] if "int" in field_type else flat


def _element_class(field_type: str) -> Any:
    """Return the class of the messages in an array of type `sequence<fss_arm_msgs/NAME>`."""
    return getattr(msg, field_type.rpartition("/")[2].rstrip(">"))


def decode(message: Any, kind: type[T]) -> T:
    """Return a message as a dataclass, whose fields it has; ValueError: an array does not fit."""
    hints = get_type_hints(kind)
    return kind(**{name: _decode_field(message, name, hint) for name, hint in hints.items()})


def _decode_field(message: Any, name: str, hint: Any) -> Any:
    value, inner = getattr(message, name), next(iter(get_args(hint)), None)
    if inner is None:
        return stamp_ns(value) if hasattr(value, "sec") else hint(value)
    if isinstance(inner, type) and is_dataclass(inner):
        return tuple(decode(one, inner) for one in value)
    if not get_args(inner):
        return tuple(map(inner, value))
    if name in POSE_WIDTHS:
        rows = np.reshape(value, (-1, POSE_WIDTHS[name])).astype(float).tolist()
        return tuple(map(tuple, rows))
    edges = pairwise(accumulate(map(int, message.samples), initial=0))
    return tuple(tuple(map(float, value[a:b])) for a, b in edges)


def datum_problem(message: Any, kind: type[Any], pose_times: str, needed: Sequence[str]) -> str:
    """Return why a datum in a message cannot be used; empty if it can. See `fieldwise_data`."""
    lengths = {
        name: sum(message.samples)
        for name, hint in get_type_hints(kind).items()
        if name not in POSE_WIDTHS and any(map(get_args, get_args(hint)))
    }
    if pose_times:
        poses = len(getattr(message, pose_times))
        lengths |= {name: width * poses for name, width in POSE_WIDTHS.items()}
    for name, expected in lengths.items():
        if (count := len(getattr(message, name))) != expected:
            return f"{name} has {count} elements, expected {expected}"
    for name in needed if message.used else ():
        if not all(map(isfinite, getattr(message, name))):
            return f"{name} is not finite, but is to be used"
    return ""


def flatten(values: Any) -> list[Any]:
    """Convert an array, or a tuple that may contain tuples, to a flat list for a message."""
    if isinstance(values, np.ndarray):
        return list(values.ravel().tolist())
    nested = len(values) > 0 and isinstance(values[0], tuple)
    return list(chain.from_iterable(values)) if nested else list(values)
