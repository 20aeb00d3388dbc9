"""Message definitions: the installed ones, and earlier versions of them in bags.

Installed definitions are searched as ament does it, but without ament: bags can be read without
ROS.
"""

import os
import re
from functools import cache, lru_cache
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

from numpy import ndarray
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

from fss_arm_model.files import short

#: Types of the messages that sensors publish.
MEASUREMENTS = frozenset(
    {
        "sensor_msgs/msg/JointState",
        "sensor_msgs/msg/Imu",
        "geometry_msgs/msg/PoseStamped",
        "fss_arm_msgs/msg/LinkTelemetry",
        "fss_arm_msgs/msg/BaseTelemetry",
        "fss_arm_msgs/msg/GripperState",
    }
)
#: Start of the types that rosbag2 publishes about itself, as on /events/write_split.
ROSBAG2_TYPES = "rosbag2_interfaces/"


class NotInstalledError(LookupError):
    """A message type is not installed here."""


class DefinitionError(ValueError):
    """A definition in a bag cannot be used to decode messages."""


class Definition(NamedTuple):
    """The definition of a message type, as a bag stores it."""

    text: str  # the .msg file, followed by those of all nested types
    hash: str  # RIHS01 of the complete type, as rclpy gives it for the topic


def message_class(msgtype: str) -> Any:
    """Return the Python class of a type such as `sensor_msgs/msg/Imu`.

    Raises:
        NotInstalledError: the type is not installed.
    """
    package, _, name = msgtype.split("/")
    try:
        return getattr(import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError):
        raise NotInstalledError(f"{msgtype} is not installed") from None


@lru_cache(1000)
def hash_of(msgtype: str, text: str, *, idl: bool = False) -> str:
    """Return the RIHS01 of a type by its definition in a bag, in .msg or in .idl.

    Raises:
        NotUnderstoodError: it is something else, such as the definition of a service.
    """
    store = get_typestore(Stores.EMPTY)
    try:
        if idl:
            for part in text.split("=" * 80 + "\n"):
                store.register(get_types_from_idl(re.sub(r"\AIDL: .*\n", "", part)))
        else:
            store.register(get_types_from_msg(text, msgtype))
        return store.hash_rihs01(msgtype)
    except Exception as error:  # rosbags parses without checks, so any exception is possible
        about = f"its definition of {short(msgtype)}"
        raise DefinitionError(f"{about} cannot be parsed: {short(str(error))}") from None


@cache
def definition(msgtype: str) -> Definition:
    """Return the definition of a type from the installed .msg files, with comments.

    Raises:
        NotInstalledError: a file is missing.
    """
    texts: dict[str, str] = {}
    _collect_texts(msgtype, texts)
    first, *others = texts
    parts = [texts[first]] + [f"MSG: {n.replace('/msg/', '/')}\n{texts[n]}" for n in others]
    text = ("=" * 80 + "\n").join(parts)
    return Definition(text, hash_of(msgtype, text))


def installed_definition(msgtype: str, digest: str) -> Definition:
    """Return the installed definition of a type that the bag does not define.

    The bag may give the hash of the type (`digest`; empty: unknown).

    Raises:
        NotInstalledError: the type is not installed, or in another version.
    """
    try:
        found = definition(msgtype)
    except NotInstalledError as error:
        raise NotInstalledError(f"the bag does not define its type, and {error}") from None
    if digest not in ("", found.hash):
        raise NotInstalledError(
            f"the bag does not define {msgtype}, which is installed in another version"
        )
    return found


def extends(msgtype: str, text: str) -> bool:
    """Return True if the installed version of a type has every field of another definition.

    Raises:
        NotInstalledError: it is not installed.
    """
    current: Any = get_types_from_msg(definition(msgtype).text, msgtype)
    earlier: Any = get_types_from_msg(text, msgtype)
    return all(
        name in current and all(field in current[name][1] for field in fields)
        for name, (_, fields) in earlier.items()
    )


def upgrade(earlier: Any, kind: Any) -> Any:
    """Convert a message of an earlier version to `kind`; new fields get their defaults."""
    message = kind()
    for name, field_type in kind.get_fields_and_field_types().items():
        if hasattr(earlier, name):
            setattr(message, name, _convert_value(getattr(earlier, name), field_type))
    return message


def _convert_value(value: Any, field_type: str) -> Any:
    """Convert a field's value for rclpy; `field_type` is as `sequence<std_msgs/Header>`."""
    if isinstance(value, list | ndarray):
        bare = field_type.removeprefix("sequence<").partition("[")[0]
        element = bare.partition(",")[0].rstrip(">")
        plain = value if isinstance(value, list) else value.tolist()
        return [_convert_value(v, element) for v in plain]
    if field_type == "octet":
        return bytes([value])
    if "/" in field_type:
        return upgrade(value, message_class(field_type.replace("/", "/msg/")))
    return value


def _collect_texts(msgtype: str, texts: dict[str, str]) -> None:
    """Add the text of a type, then those of the types of its fields."""
    prefixes = filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep))
    files = (Path(prefix, "share", f"{msgtype}.msg") for prefix in prefixes)
    try:
        text = next(file for file in files if file.is_file()).read_text(encoding="utf-8")
    except (StopIteration, OSError, ValueError):  # in a bag, names may contain anything
        raise NotInstalledError(f"{short(msgtype)} is not installed") from None
    texts[msgtype] = text.rstrip("\n") + "\n"
    fields: Any = get_types_from_msg(text, msgtype)[msgtype][1]
    for _, kind in fields:
        if kind[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            kind = kind[1][0]  # type of the elements; kind[1][1] is their number
        if kind[0] == Nodetype.NAME and kind[1] not in texts:
            _collect_texts(kind[1], texts)
