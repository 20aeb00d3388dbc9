"""Read bags with rosbags, but skip topics without a usable definition.

rosbags rejects a whole bag for one such topic. The standard recorder writes such topics: events of
services, whose definition is a .srv file, and topics whose definition it did not find, such as the
feedback of actions.
"""

from collections.abc import Collection, Generator, Mapping
from io import BytesIO
from typing import Any, cast

from backports import zstd
from rosbags.interfaces import (
    Connection,
    ConnectionExtRosbag2,
    MessageDefinition,
    MessageDefinitionFormat,
)
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.storage_mcap import Channel, McapReader, Schema, read_string
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

from fss_arm_bags.definitions import (
    DefinitionError,
    NotInstalledError,
    hash_of,
    installed_definition,
)
from fss_arm_model.files import short

DEFINITION_FORMATS = ("ros2msg", "ros2idl", "omgidl")  # of definitions that rosbags reads
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
NO_DEFINITION, MSG_FORMAT = MessageDefinitionFormat.NONE, MessageDefinitionFormat.MSG


class _Schemas(dict[int, Schema]):
    """The schemas of an MCAP file; one in an unknown format counts as missing."""

    def __setitem__(self, key: int, schema: Schema) -> None:
        known = schema.encoding in DEFINITION_FORMATS
        super().__setitem__(key, schema if known else schema._replace(encoding="", data=""))


class _McapReader(McapReader):
    def __init__(self, path: Any) -> None:
        super().__init__(path)
        self.schemas = _Schemas()

    def open(self) -> None:
        """Open the file; for missing definitions keep the type's hash, which rosbags drops."""
        super().open()
        self.connections = [
            c._replace(digest=_hash(self.channels[c.id])) if c.msgdef.format is NO_DEFINITION else c
            for c in self.connections
        ]


def _hash(channel: Channel) -> str:
    """Return the type's hash in a channel's metadata (lengths and texts by turns); empty: none."""
    file, texts = BytesIO(channel.metadata), list[str]()
    while file.tell() < len(channel.metadata):
        texts.append(read_string(file))
    return dict(zip(texts[::2], texts[1::2], strict=False)).get("topic_type_hash", "")


class _Sqlite3Reader(Sqlite3Reader):
    def messages(
        self,
        connections: Collection[Connection],
        start: int | None = None,
        stop: int | None = None,
    ) -> Generator[tuple[Connection, int, bytes], None, None]:
        """Yield the messages, those of `--compression-mode message` decompressed."""
        for connection, receipt, data in super().messages(connections, start, stop):
            yield connection, receipt, zstd.decompress(data) if data[:4] == ZSTD_MAGIC else data


class TopicReader(Reader):
    """Reader of the topics that have a usable definition, in the bag or installed."""

    STORAGE_PLUGINS: Mapping[str, type[Any]] = {".mcap": _McapReader, ".db3": _Sqlite3Reader}

    def open(self) -> None:
        """Open the bag."""
        super().open()
        self.left_out: dict[str, str] = {}  # reason, by topic
        self._readable = []
        for c in self.storage.connections:
            try:
                self._readable.append(_with_definition(c))
            except (NotInstalledError, DefinitionError) as error:
                self.left_out[c.topic] = str(error)

    @property
    def connections(self) -> list[Connection]:
        """Connections that can be read."""
        return self._readable


def _with_definition(c: Connection) -> Connection:
    """Return a topic with a definition that can decode its messages.

    Raises:
        NotInstalledError: the bag has no definition, and the same type is not installed.
        NotUnderstoodError: the definition in the bag cannot be used.
    """
    if (serialized := cast(ConnectionExtRosbag2, c.ext).serialization_format) != "cdr":
        raise DefinitionError(f"its serialization format is {short(repr(serialized))}, not 'cdr'")
    if c.msgdef.format is not NO_DEFINITION:
        idl = c.msgdef.format is not MSG_FORMAT
        if c.digest not in ("", hash_of(c.msgtype, c.msgdef.data, idl=idl)):
            raise DefinitionError(
                f"its definition of {short(c.msgtype)} does not have the hash "
                f"{short(c.digest)} that the bag states"
            )
        return c
    text, digest = installed_definition(c.msgtype, c.digest)
    return c._replace(msgdef=MessageDefinition(MSG_FORMAT, text), digest=digest)
