"""What is whole of a damaged MCAP bag, as a sound one.

A bag whose recorder was killed has no index and no metadata.yaml, but whole chunks.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from os import SEEK_END
from pathlib import Path
from typing import BinaryIO

from mcap.exceptions import InvalidMagic
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, ChunkIndex, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk, get_chunk_data_stream
from mcap.summary import Summary
from rosbags.interfaces import Connection
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.rosbag2.metadata import parse_qos
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore

from fss_arm_bags.chunks import CRC, RECORD, records


class BagError(ValueError):
    """A bag cannot be read; the message names the file and what is wrong with it."""


@dataclass(frozen=True)
class Recovered:
    """What could be saved of a damaged bag."""

    path: Path
    messages: int
    lost: int  # bytes that belong to no whole record, or to messages of an unknown type

    def __str__(self) -> str:
        return (
            f"{self.path}: {self.messages} messages recovered, "
            f"{self.lost} bytes at damaged places lost"
        )


def storage_files(path: Path) -> list[Path]:
    """The storage files of a bag, in the order in which they were written."""
    if path.is_file():
        return [path]
    files = [p for p in path.iterdir() if p.suffix in (".mcap", ".db3")]
    return sorted(files, key=lambda p: (len(p.name), p.name))


def is_sound(path: Path) -> bool:
    """Whether a bag has its index and metadata; its chunks are not looked at.

    Raises:
        BagError: it is of an unknown kind, or of which nothing can be recovered.
    """
    try:
        with Reader(path):
            return True
    except Exception as error:  # rosbags parses damaged bytes as they come
        files = storage_files(path)
        if not files or any(file.suffix != ".mcap" for file in files):
            raise BagError(f"{path}: {error}") from None
        return False


def recover(path: Path, copy: Path) -> Recovered:
    """Write the whole chunks of a damaged MCAP bag to `copy`, a sound bag.

    Raises:
        BagError: a file is not MCAP or has a definition that is not understood.
    """
    messages = lost = 0
    with Writer(copy, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections: dict[tuple[str, str], Connection] = {}
        for file in storage_files(path):
            found = _Records(file)
            schemas: dict[int, Schema] = {}
            channels: dict[int, Connection] = {}
            for record in found:
                if isinstance(record, Schema):
                    schemas[record.id] = record
                elif isinstance(record, Channel) and record.schema_id in schemas:
                    schema = schemas[record.schema_id]
                    key = (record.topic, schema.name)
                    if key not in connections:
                        connections[key] = _connect(writer, file, record, schema)
                    channels[record.id] = connections[key]
                elif isinstance(record, Message) and record.channel_id in channels:
                    writer.write(channels[record.channel_id], record.log_time, record.data)
                    messages += 1
                elif isinstance(record, Message):  # what defines its type was in a damaged chunk
                    lost += len(record.data)
            lost += found.lost
    return Recovered(path, messages, lost)


class _Records:
    """The schemas, channels and messages in the whole chunks of an MCAP file."""

    def __init__(self, file: Path) -> None:
        self.file = file
        self.lost = 0  # bytes met that belong to no whole record

    def __iter__(self) -> Iterator[McapRecord]:
        with self.file.open("rb") as stream:
            summary = _summary(stream)
            if summary:  # the chunk that has them may be damaged
                yield from summary.schemas.values()
                yield from summary.channels.values()
            if summary and summary.chunk_indexes:
                yield from self._indexed(stream, summary.chunk_indexes)
            else:
                yield from self._in_turn(stream)

    def _indexed(self, stream: BinaryIO, chunks: Iterable[ChunkIndex]) -> Iterator[McapRecord]:
        """Those in the chunks that the index knows, whatever lies between them."""
        for index in chunks:
            stream.seek(index.chunk_start_offset + RECORD.size + 24)
            crc = int.from_bytes(stream.read(CRC.size), "little")
            stream.seek(index.chunk_start_offset + index.chunk_length - index.compressed_size)
            chunk = Chunk(
                compression=index.compression,
                data=stream.read(index.compressed_size),
                message_start_time=index.message_start_time,
                message_end_time=index.message_end_time,
                uncompressed_crc=crc,
                uncompressed_size=index.uncompressed_size,
            )
            yield from self._within(chunk, index.chunk_length)

    def _in_turn(self, stream: BinaryIO) -> Iterator[McapRecord]:
        """One after the other, up to the first place from which nothing leads on."""
        size = stream.seek(0, SEEK_END)
        stream.seek(0)
        end = 0  # of the last whole record
        found = iter(StreamReader(stream, emit_chunks=True, record_size_limit=size).records)
        while True:
            try:
                record = next(found)
            except (StopIteration, InvalidMagic) as stop:
                if isinstance(stop, InvalidMagic) and end == 0:
                    raise BagError(f"{self.file}: is not an MCAP file") from None
                break
            except OSError:
                raise
            except Exception:  # the parser takes damaged bytes as they come
                break
            start, end = end, stream.tell()
            if isinstance(record, Chunk):
                yield from self._within(record, end - start)
            else:
                yield record
        self.lost += size - end

    def _within(self, chunk: Chunk, size: int) -> list[McapRecord]:
        """Those in a chunk of so many bytes; none if it is damaged."""
        try:
            unpacked, length = get_chunk_data_stream(chunk, validate_crc=True)
            for _ in records(unpacked.read(length)):  # of which breakup_chunk is not so sure
                pass
            return breakup_chunk(chunk)
        except Exception:  # the parsers take damaged bytes as they come
            self.lost += size
            return []


def _summary(stream: BinaryIO) -> Summary | None:
    """The summary at the end of an MCAP file, if it is whole."""
    try:
        return make_reader(stream).get_summary()
    except Exception:  # as above; an OSError, too, where it seeks to before a short file's begin
        return None


def _connect(writer: Writer, file: Path, channel: Channel, schema: Schema) -> Connection:
    """Begin a topic in `writer` as it was in `file`."""
    try:
        if schema.encoding != "ros2msg":
            raise TypesysError(f"definition in {schema.encoding!r} is not understood")
        text = schema.data.decode()
        store = get_typestore(Stores.EMPTY)
        store.register(get_types_from_msg(text, schema.name))
        digest = store.hash_rihs01(schema.name)
    except (TypesysError, UnicodeDecodeError) as error:
        raise BagError(f"{file}: {channel.topic} of type {schema.name}: {error}") from None
    return writer.add_connection(
        channel.topic,
        schema.name,
        msgdef=text,
        rihs01=digest,
        offered_qos_profiles=parse_qos(channel.metadata.get("offered_qos_profiles", "")),
    )
