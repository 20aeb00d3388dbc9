"""Message definitions as installed: what a bag must hold to be read where they are not."""

from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore


class NotInstalledError(LookupError):
    """A message type is not installed here."""


class Definition(NamedTuple):
    """A message type as a bag holds it."""

    text: str  # the .msg file, followed by those of all types within it
    hash: str  # RIHS01 over the whole, as rclpy gives it for the topic


def message_class(msgtype: str) -> Any:
    """The Python class of a type such as `sensor_msgs/msg/Imu`.

    Raises:
        NotInstalledError: there is none.
    """
    package, _, name = msgtype.split("/")
    try:
        return getattr(import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError):
        raise NotInstalledError(f"{msgtype} is not installed") from None


@cache
def definition(msgtype: str) -> Definition:
    """The definition of a type from the installed .msg files, comments and all.

    Raises:
        NotInstalledError: a file is missing.
    """
    texts: dict[str, str] = {}
    _collect(msgtype, texts)
    store = get_typestore(Stores.EMPTY)
    for name, text in texts.items():
        store.register(get_types_from_msg(text, name))
    first, *others = texts
    parts = [texts[first]] + [f"MSG: {n.replace('/msg/', '/')}\n{texts[n]}" for n in others]
    return Definition(("=" * 80 + "\n").join(parts), store.hash_rihs01(msgtype))


def _collect(msgtype: str, texts: dict[str, str]) -> None:
    """Add the text of a type, then those of the types of its fields."""
    package, _, name = msgtype.split("/")
    try:
        file = Path(get_package_share_directory(package), "msg", f"{name}.msg")
        text = file.read_text(encoding="utf-8")
    except (PackageNotFoundError, FileNotFoundError):
        raise NotInstalledError(f"{msgtype} is not installed") from None
    texts[msgtype] = text.rstrip("\n") + "\n"
    fields: Any = get_types_from_msg(text, msgtype)[msgtype][1]
    for _, kind in fields:
        if kind[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            kind = kind[1][0]  # of what; kind[1][1] is how many
        if kind[0] == Nodetype.NAME and kind[1] not in texts:
            _collect(kind[1], texts)
