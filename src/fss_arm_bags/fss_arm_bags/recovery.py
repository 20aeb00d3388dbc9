"""Recover the undamaged part of a damaged MCAP bag as a sound bag.

A bag whose recorder was killed has no index and no metadata.yaml, but complete chunks.
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

from fss_arm_bags.chunks import CHANNEL, CHUNK, MESSAGE, MESSAGE_HEADER, RECORD, SCHEMA, records
from fss_arm_bags.definitions import (
    DefinitionError,
    NotInstalledError,
    hash_of,
    installed_definition,
)
from fss_arm_bags.integrity import (
    DATA_END,
    MAGIC,
    MAX_TIME,
    Chunk,
    Contents,
    DamageError,
    qos,
    read_end,
)
from fss_arm_bags.layout import storage_files
from fss_arm_bags.storage import CheckedWriter, Storage
from fss_arm_model.files import short

MAX_PLACES = 3  # damaged places that the report names
#: Pattern of a possible chunk: its kind, length, times, sizes, checksum and compression.
CHUNK_HEAD = re.compile(
    rb"\x06.{5}\0{3}.{28}(?:\0{4}|\x03\0{3}lz4|\x04\0{3}zstd).{5}\0{3}", re.DOTALL
)


class BagError(ValueError):
    """A bag cannot be read; the message names the file and the problem."""


@dataclass(frozen=True)
class Recovered:
    """Result of the recovery of a damaged bag."""

    path: Path
    messages: int
    lost: int  # bytes outside of complete records, or of messages of an unknown type
    damage: str = ""  # the damage, and where it is

    def __str__(self) -> str:
        return (
            f"{self.path}: {self.messages} messages recovered, "
            f"{self.lost} bytes at damaged places lost ({self.damage})"
        )


def recover(path: Path, copy: Path, damage: str) -> Recovered:
    """Write the undamaged part of an MCAP bag to `copy`, a sound bag.

    Args:
        path: the bag.
        copy: path of the result, which does not exist yet.
        damage: the known damage.

    Raises:
        BagError: a file is not MCAP.
        OSError: the copy cannot be written.
    """
    salvage = _Salvage()
    with CheckedWriter(copy) as writer:
        for file in storage_files(path):
            salvage.recover_file(file, writer)
    damages = [damage]
    if salvage.expected > salvage.messages:
        damages.append(f"{salvage.expected - salvage.messages} messages are missing")
    damages += salvage.places[:MAX_PLACES]
    if len(salvage.places) > MAX_PLACES:
        damages.append(f"and {len(salvage.places) - MAX_PLACES} more")
    damages += salvage.left_out.values()
    return Recovered(path, salvage.messages, salvage.lost, ", ".join(damages))


class _Salvage:
    """Recovery of one bag: writes the messages and counts the losses."""

    def __init__(self) -> None:
        self.messages = 0
        self.expected = 0  # messages counted by undamaged indexes
        self.lost = 0  # bytes
        self.places: list[str] = []  # damaged places
        self.connections: dict[tuple[str, str], Connection] = {}
        self.left_out: dict[tuple[str, str], str] = {}  # reasons why topics are left out
        self.copied: set[tuple[int, int]] = set()  # number and hash of the messages of each chunk

    def recover_file(self, file: Path, writer: CheckedWriter) -> None:
        """Write the undamaged part of a file."""
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
                except (NotInstalledError, DefinitionError) as error:
                    self.left_out[key] = f"{short(record.topic)} is left out: {error}"
            elif isinstance(record, Message) and record.channel_id in channels:
                writer.write(channels[record.channel_id], record.log_time, record.data)
                self.messages += 1
                if failure := cast(Storage, writer.storage).failure:
                    raise failure
            elif isinstance(record, Message):  # type unknown; a damaged chunk may define it
                self.lost += len(record.data)

    def _records(self, file: Path) -> Iterator[McapRecord]:
        """Yield the schemas, channels and messages in a file."""
        with file.open("rb") as stream:
            with suppress(Exception):  # the end may be damaged
                summary = read_end(stream).summary
                self.expected += summary.statistics.message_count if summary.statistics else 0
                # First those of the summary: the chunk that defines them may be damaged.
                yield from [*summary.schemas.values(), *summary.channels.values()]
            if stream.seek(0, SEEK_END):
                with mmap(stream.fileno(), 0, access=ACCESS_READ) as data:
                    yield from self._scan(file, data)

    def _scan(self, file: Path, data: mmap) -> Iterator[McapRecord]:
        """Yield the records in order; where no record follows, continue at the next good chunk."""
        at, intact = len(MAGIC), 0  # the file is undamaged up to `intact`
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
                found = next_chunk(
                    data, intact
                )  # a damaged record's length may have been too large
                self.lost += max(0, found - at)
                self.places.append(f"no record at byte {at}")
                at = found
            elif kind == CHUNK:
                try:
                    chunk = chunk_records(data[at + RECORD.size : end])
                except Exception:  # the parsers do not check for damaged bytes
                    self.lost += end - at
                    self.places.append(f"damaged chunk at byte {at}")
                else:
                    yield from self._skip_copy(chunk, at)
                    intact = end
                at = end
            else:
                with suppress(Exception):  # as above
                    yield from parse_record(kind, data[at + RECORD.size : end])
                at = end

    def _skip_copy(self, chunk: list[McapRecord], at: int) -> list[McapRecord]:
        """Return the records of a chunk; empty if it is a copy of an earlier chunk."""
        messages = [
            hash((r.channel_id, r.log_time, r.data)) for r in chunk if isinstance(r, Message)
        ]
        key = len(messages), hash(tuple(messages))
        if messages and key in self.copied:
            self.places.append(f"a second copy of a chunk at byte {at}")
            return []
        self.copied.add(key)
        return chunk


def record_at(data: mmap, at: int) -> tuple[int, int]:
    """Return kind and end of the record at this offset; kind 0: there is none."""
    if at + RECORD.size > len(data):
        return 0, at
    kind, length = RECORD.unpack_from(data, at)
    end = at + RECORD.size + length
    return (kind if kind <= DATA_END and end <= len(data) else 0), end


def next_chunk(data: mmap, at: int) -> int:
    """Return the offset of the next undamaged chunk from `at` on; the end of the data: none."""
    for match in CHUNK_HEAD.finditer(data, at):
        start = match.start()
        kind, end = record_at(data, start)
        if kind == CHUNK:
            with suppress(Exception):  # the parsers do not check for damaged bytes
                chunk_records(data[start + RECORD.size : end])
                return start
    return len(data)


def chunk_records(record: bytes) -> list[McapRecord]:
    """Return the schemas, channels and messages in a chunk.

    Raises:
        Exception: it is damaged.
    """
    chunk = Chunk.read(record)
    data = chunk.unpacked()
    found = list(
        chain.from_iterable(parse_record(kind, data[at:to]) for kind, at, to in records(data))
    )
    if not chunk.crc and not all(
        chunk.start <= r.log_time <= chunk.end for r in found if isinstance(r, Message)
    ):
        raise DamageError("a message is outside the time range of its chunk")
    return found


def parse_record(kind: int, data: bytes) -> Iterator[McapRecord]:
    """Yield the content of a record if it is a schema, a channel or a message.

    Raises:
        Exception: it is damaged.
    """
    if kind == MESSAGE:
        channel, sequence, receipt, published = MESSAGE_HEADER.unpack_from(data)
        if receipt > MAX_TIME:
            raise DamageError(f"a message has the time {receipt} ns, which is not possible")
        yield Message(channel, receipt, data[MESSAGE_HEADER.size :], published, sequence)
    elif kind in (SCHEMA, CHANNEL):
        contents = Contents()
        contents.add(kind, data)
        yield from [*contents.schemas.values(), *contents.channels.values()]


def _connect(writer: CheckedWriter, channel: Channel, schema: Schema) -> Connection:
    """Add a topic to `writer` with its recorded definition and QoS.

    Raises:
        NotInstalledError: the bag has no definition, and the same type is not installed.
        NotUnderstoodError: its definition cannot be used to decode messages.
    """
    if schema.encoding == "ros2msg":
        text = schema.data.decode(errors="replace")
        digest = hash_of(schema.name, text)
    else:
        text, digest = installed_definition(
            schema.name, channel.metadata.get("topic_type_hash", "")
        )
    return writer.add_connection(
        channel.topic,
        schema.name,
        msgdef=text,
        rihs01=digest,
        offered_qos_profiles=qos(channel),
    )
