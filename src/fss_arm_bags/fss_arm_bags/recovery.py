"""What is whole of a damaged MCAP bag, as a sound one.

A bag whose recorder was killed has no index and no metadata.yaml, but whole chunks.
"""

import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import chain
from mmap import ACCESS_READ, mmap
from os import SEEK_END
from pathlib import Path
from typing import cast

from mcap.records import Channel, McapRecord, Message, Schema
from rosbags.interfaces import Connection

from fss_arm_bags.chunks import CHANNEL, CHUNK, HEAD, MESSAGE, RECORD, SCHEMA, records
from fss_arm_bags.definitions import (
    NotInstalledError,
    NotUnderstoodError,
    hash_of,
    installed,
)
from fss_arm_bags.integrity import (
    DATA_END,
    LAST,
    MAGIC,
    Chunk,
    Contents,
    DamageError,
    qos,
    read_end,
)
from fss_arm_bags.layout import storage_files
from fss_arm_bags.storage import CheckedWriter, Storage
from fss_arm_model.files import short

SHOWN = 3  # damaged places named
#: What may be a chunk: its kind, its length, times, sizes, checksum, compression.
CHUNK_HEAD = re.compile(
    rb"\x06.{5}\0{3}.{28}(?:\0{4}|\x03\0{3}lz4|\x04\0{3}zstd).{5}\0{3}", re.DOTALL
)


class BagError(ValueError):
    """A bag cannot be read; the message names the file and what is wrong with it."""


@dataclass(frozen=True)
class Recovered:
    """What could be saved of a damaged bag."""

    path: Path
    messages: int
    lost: int  # bytes that belong to no whole record, or to messages of an unknown type
    damage: str = ""  # what is wrong, and where

    def __str__(self) -> str:
        return (
            f"{self.path}: {self.messages} messages recovered, "
            f"{self.lost} bytes at damaged places lost ({self.damage})"
        )


def recover(path: Path, copy: Path, damage: str) -> Recovered:
    """Write what is whole of a damaged MCAP bag to `copy`, a sound bag.

    Args:
        path: the bag.
        copy: where to; there is nothing yet.
        damage: what is known to be wrong.

    Raises:
        BagError: a file is not MCAP.
        OSError: the copy cannot be written.
    """
    salvage = _Salvage()
    with CheckedWriter(copy) as writer:
        for file in storage_files(path):
            salvage.file(file, writer)
    damages = [damage]
    if salvage.expected > salvage.messages:
        damages.append(f"{salvage.expected - salvage.messages} messages are missing")
    damages += salvage.places[:SHOWN]
    if len(salvage.places) > SHOWN:
        damages.append(f"and {len(salvage.places) - SHOWN} more")
    damages += salvage.untold.values()
    return Recovered(path, salvage.messages, salvage.lost, ", ".join(damages))


class _Salvage:
    """What was written of a bag's files, and what was not."""

    def __init__(self) -> None:
        self.messages = 0
        self.expected = 0  # messages by the indexes that are whole
        self.lost = 0  # bytes
        self.places: list[str] = []  # that are damaged
        self.connections: dict[tuple[str, str], Connection] = {}
        self.untold: dict[tuple[str, str], str] = {}  # why topics are left out
        self.met: set[tuple[int, int]] = set()  # chunks: how many messages, which

    def file(self, file: Path, writer: CheckedWriter) -> None:
        """Write what is whole in a file."""
        schemas: dict[int, Schema] = {}
        channels: dict[int, Connection] = {}
        for record in self._records(file):
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel) and record.schema_id in schemas:
                schema = schemas[record.schema_id]
                key = record.topic, schema.name
                try:
                    if key not in self.connections:
                        self.connections[key] = _connect(writer, record, schema)
                    channels[record.id] = self.connections[key]
                except (NotInstalledError, NotUnderstoodError) as error:
                    self.untold[key] = f"{short(record.topic)} is left out: {error}"
            elif isinstance(record, Message) and record.channel_id in channels:
                writer.write(channels[record.channel_id], record.log_time, record.data)
                self.messages += 1
                if failure := cast(Storage, writer.storage).failure:
                    raise failure
            elif isinstance(record, Message):  # nothing tells its type, perhaps a damaged chunk did
                self.lost += len(record.data)

    def _records(self, file: Path) -> Iterator[McapRecord]:
        """The schemas, channels and messages in a file."""
        with file.open("rb") as stream:
            with suppress(Exception):  # the end may be damaged
                known = read_end(stream).known
                self.expected += known.statistics.message_count if known.statistics else 0
                # As the chunk that has them may be damaged.
                yield from [*known.schemas.values(), *known.channels.values()]
            if stream.seek(0, SEEK_END):
                with mmap(stream.fileno(), 0, access=ACCESS_READ) as data:
                    yield from self._in_turn(file, data)

    def _in_turn(self, file: Path, data: mmap) -> Iterator[McapRecord]:
        """One after the other; where none leads on, from the next whole chunk on."""
        at, sure = len(MAGIC), 0  # up to there it is known to be whole
        if data[: len(MAGIC)] != MAGIC[: len(data)]:
            at = next_chunk(data, 0)
            if at == len(data):
                raise BagError(f"{file}: is not an MCAP file")
            self.lost += at
        while at < len(data) and data[at:] != MAGIC:
            kind, end = record_at(data, at)
            if kind == DATA_END:
                return
            if not kind:
                found = next_chunk(data, sure)  # a damaged record may have led too far
                self.lost += max(0, found - at)
                self.places.append(f"no record at byte {at}")
                at = found
            elif kind == CHUNK:
                try:
                    inside = in_chunk(data[at + RECORD.size : end])
                except Exception:  # the parsers take damaged bytes as they come
                    self.lost += end - at
                    self.places.append(f"damaged chunk at byte {at}")
                else:
                    yield from self._new(inside, at)
                    sure = end
                at = end
            else:
                with suppress(Exception):  # as above
                    yield from parsed(kind, data[at + RECORD.size : end])
                at = end

    def _new(self, inside: list[McapRecord], at: int) -> list[McapRecord]:
        """What a chunk holds, unless another one did."""
        messages = [
            hash((r.channel_id, r.log_time, r.data)) for r in inside if isinstance(r, Message)
        ]
        key = len(messages), hash(tuple(messages))
        if messages and key in self.met:
            self.places.append(f"a second copy of a chunk at byte {at}")
            return []
        self.met.add(key)
        return inside


def record_at(data: mmap, at: int) -> tuple[int, int]:
    """Kind and end of the record there; kind 0: there is none."""
    if at + RECORD.size > len(data):
        return 0, at
    kind, length = RECORD.unpack_from(data, at)
    end = at + RECORD.size + length
    return (kind if kind <= DATA_END and end <= len(data) else 0), end


def next_chunk(data: mmap, at: int) -> int:
    """Where the next whole chunk is, from `at` on; the end of the data: nowhere."""
    for match in CHUNK_HEAD.finditer(data, at):
        begin = match.start()
        kind, end = record_at(data, begin)
        if kind == CHUNK:
            with suppress(Exception):  # the parsers take damaged bytes as they come
                in_chunk(data[begin + RECORD.size : end])
                return begin
    return len(data)


def in_chunk(record: bytes) -> list[McapRecord]:
    """The schemas, channels and messages in a chunk.

    Raises:
        Exception: it is damaged.
    """
    chunk = Chunk.read(record)
    data = chunk.unpacked()
    found = list(chain.from_iterable(parsed(kind, data[at:to]) for kind, at, to in records(data)))
    if not chunk.crc and not all(
        chunk.begin <= r.log_time <= chunk.end for r in found if isinstance(r, Message)
    ):
        raise DamageError("a message is out of its chunk's times")
    return found


def parsed(kind: int, data: bytes) -> Iterator[McapRecord]:
    """What a record is, if it is a schema, a channel or a message.

    Raises:
        Exception: it is damaged.
    """
    if kind == MESSAGE:
        channel, sequence, receipt, published = HEAD.unpack_from(data)
        if receipt > LAST:
            raise DamageError(f"a message is of {receipt} ns")
        yield Message(channel, receipt, data[HEAD.size :], published, sequence)
    elif kind in (SCHEMA, CHANNEL):
        contents = Contents()
        contents.add(kind, data)
        yield from [*contents.schemas.values(), *contents.channels.values()]


def _connect(writer: CheckedWriter, channel: Channel, schema: Schema) -> Connection:
    """Begin a topic in `writer` as it was.

    Raises:
        NotInstalledError: it has no definition, nor the same is here.
        NotUnderstoodError: its definition is nothing that messages can be read by.
    """
    if schema.encoding == "ros2msg":
        text = schema.data.decode(errors="replace")
        digest = hash_of(schema.name, text)
    else:
        text, digest = installed(schema.name, channel.metadata.get("topic_type_hash", ""))
    return writer.add_connection(
        channel.topic,
        schema.name,
        msgdef=text,
        rihs01=digest,
        offered_qos_profiles=qos(channel),
    )
