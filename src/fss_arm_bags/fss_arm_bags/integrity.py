"""Check whether an MCAP file is complete and undamaged.

A file with checksums of its data and of its summary is checked by them; ours have both. Otherwise
the file is checked record by record: lengths, the index and the statistics against the data, and
chunks by their checksums or by the data that a message has twice, its time and place. Without any
checksum, damage to data that is written only once (the messages themselves) cannot be detected.
"""

import struct
from collections import Counter
from dataclasses import dataclass, field
from functools import lru_cache
from io import BytesIO
from os import SEEK_END
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple
from zlib import crc32

from mcap.data_stream import ReadDataStream
from mcap.records import Channel, ChunkIndex, Schema, Statistics
from rosbags.interfaces import Qos
from rosbags.rosbag2.metadata import parse_qos
from rosbags.rosbag2.storage_mcap import decompress

from fss_arm_bags.chunks import (
    CHANNEL,
    CHUNK,
    CHUNK_DATA,
    CRC,
    MESSAGE,
    MESSAGE_HEADER,
    RECORD,
    SCHEMA,
    records,
)
from fss_arm_bags.storage import FOOTER
from fss_arm_model.files import read_yaml, short

MAGIC = b"\x89MCAP0\r\n"
HEADER, MESSAGE_INDEX, CHUNK_INDEX, STATISTICS, DATA_END = 1, 7, 8, 11, 15
MAX_TIME = 2**63 - 1  # latest possible time [ns]
MAX_QOS_LENGTH = 2**16  # of the QoS profiles of a channel [characters]
BLOCK_SIZE = 2**20  # read at once [bytes]


class DamageError(ValueError):
    """Damage of a file; the message describes it in one line."""


@dataclass
class Contents:
    """The contents of a file, by its summary or as found in its data."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: dict[int, ChunkIndex] = field(default_factory=dict)  # by their offsets
    counts: Counter[int] = field(default_factory=Counter)  # messages by channel
    statistics: Statistics | None = None
    checked: bool = False  # checksums cover all of it

    def add(self, kind: int, data: bytes) -> None:
        """Add the content of a record.

        Raises:
            DamageError: it contradicts an earlier one.
        """
        stream = ReadDataStream(BytesIO(data))
        if kind == SCHEMA:
            schema = Schema.read(stream)
            _add_unique(self.schemas, schema.id, schema)
        elif kind == CHANNEL:
            channel = Channel.read(stream)
            qos(channel)
            _add_unique(self.channels, channel.id, channel)
        elif kind == CHUNK_INDEX:
            chunk = ChunkIndex.read(stream)
            _add_unique(self.chunks, chunk.chunk_start_offset, chunk)
        elif kind == STATISTICS:
            self.statistics = Statistics.read(stream)


def _add_unique(known: dict[int, Any], key: int, value: Any) -> None:
    if known.setdefault(key, value) != value:
        raise DamageError(f"there are two versions of {type(value).__name__} {key}")


def qos(channel: Channel) -> list[Qos]:
    """Return the QoS profiles of a channel as rosbags reads them.

    Raises:
        DamageError: they are not valid.
    """
    try:
        return profiles(channel.metadata.get("offered_qos_profiles", ""))
    except Exception as error:  # rosbags parses without checks, so any exception is possible
        raise DamageError(f"QoS profiles of {short(channel.topic)}: {short(str(error))}") from None


@lru_cache
def profiles(text: str) -> list[Qos]:
    """Return the QoS profiles in a text.

    Raises:
        Exception: the text is something else.
    """
    if len(text) > MAX_QOS_LENGTH:  # rosbags needs long for it
        raise DamageError(f"{len(text)} characters, at most {MAX_QOS_LENGTH} are possible")
    return parse_qos(read_yaml(text) or [])


class Chunk(NamedTuple):
    """A chunk record."""

    start: int  # time of its first message [ns]
    end: int  # time of its last message [ns]
    size: int  # unpacked [bytes]
    crc: int  # checksum of the unpacked data; 0: none
    compression: str
    data: bytes

    @classmethod
    def read(cls, data: bytes) -> "Chunk":
        """Return the chunk that a record contains.

        Raises:
            DamageError: it is not a chunk.
        """
        if len(data) < 40:
            raise DamageError("a chunk is too short")
        start, end, size, crc, length = struct.unpack_from("<QQQII", data)
        name, at = data[32 : 32 + length], 40 + length
        packed = int.from_bytes(data[at - 8 : at], "little")
        if name not in (b"", b"lz4", b"zstd") or packed != len(data) - at:
            raise DamageError("a chunk's header does not match its data")
        return cls(start, end, size, crc, name.decode(), data[at:])

    def unpacked(self) -> bytes:
        """Return the unpacked data.

        Raises:
            Exception: it is damaged.
        """
        return decompress(self.data, self.compression, self.size, self.crc)


def examine(path: Path, *, thorough: bool = False) -> Contents:
    """Return the contents of an MCAP file that is complete and undamaged.

    Args:
        path: the file.
        thorough: check also data that readers do not use, as the times in the message index.

    Raises:
        DamageError: it is damaged.
        OSError: it cannot be read.
    """
    with path.open("rb") as file:
        try:
            return _examine(file, thorough)
        except (DamageError, OSError):
            raise
        except Exception as error:  # the parsers do not check for damaged bytes
            raise DamageError(short(str(error)) or type(error).__name__) from None


class End(NamedTuple):
    """The summary and the checksums at the end of a file."""

    summary: Contents
    data_end: int  # offset of the end of the data [bytes]
    data_crc: int  # 0: none, as for summary_crc
    summary_crc: int


def read_end(file: BinaryIO) -> End:
    """Read the summary and the checksums at the end of an MCAP file.

    Raises:
        Exception: it is damaged.
    """
    size = file.seek(0, SEEK_END)
    file.seek(max(0, size - FOOTER))
    footer = file.read()
    if size < FOOTER or RECORD.unpack_from(footer) != (2, 20) or not footer.endswith(MAGIC):
        raise DamageError("it ends without an index")
    start, _, crc = struct.unpack_from("<QQI", footer, RECORD.size)
    end = start - RECORD.size - CRC.size  # end of the data
    if not len(MAGIC) < end < size - FOOTER:
        raise DamageError(
            "it has no index" if start == 0 else "its index is not where its footer says"
        )
    file.seek(end)
    closing = file.read(RECORD.size + CRC.size)
    summary = file.read(size - FOOTER - start)
    if crc and crc32(footer[: RECORD.size + 16], crc32(summary)) != crc:
        raise DamageError("its index is damaged")
    if RECORD.unpack_from(closing) != (DATA_END, CRC.size):
        raise DamageError("the end of the data is not marked before its index")
    contents = Contents()
    for kind, at, to in records(summary):
        contents.add(kind, summary[at:to])
    times = [c.message_end_time for c in contents.chunks.values()]
    times += [contents.statistics.message_end_time] if contents.statistics else []
    if max(times, default=0) > MAX_TIME:
        raise DamageError(f"its index has a message time of {max(times)} ns, which is not possible")
    return End(contents, end, CRC.unpack_from(closing, RECORD.size)[0], crc)


def _examine(file: BinaryIO, thorough: bool) -> Contents:
    if file.read(len(MAGIC)) != MAGIC:
        raise DamageError("it does not start as an MCAP file")
    end = read_end(file)
    if end.data_crc and _checksum(file, end.data_end) != end.data_crc:
        raise DamageError("its data are damaged")
    if end.data_crc and end.summary_crc:
        end.summary.checked = True
        return end.summary
    return _RecordCheck(file, end, thorough).run()


def _checksum(file: BinaryIO, end: int) -> int:
    """Return the checksum of the file up to `end`."""
    file.seek(0)
    crc = 0
    for at in range(0, end, BLOCK_SIZE):
        crc = crc32(file.read(min(BLOCK_SIZE, end - at)), crc)
    return crc


class _RecordCheck:
    """Reader that compares the data of a file with its index, record by record."""

    def __init__(self, file: BinaryIO, end: End, thorough: bool) -> None:
        self.file, self.end, self.summary = file, end.data_end, end.summary
        self.read_all = thorough or not end.summary_crc  # also read chunks that have a checksum
        self.found = Contents(checked=end.summary_crc != 0)
        self.first, self.last = MAX_TIME, 0  # times of messages [ns]
        self.index: dict[int, list[tuple[int, int]]] | None = None  # expected after the last chunk

    def run(self) -> Contents:
        """Return the contents of the file.

        Raises:
            DamageError: it is damaged.
        """
        at = len(MAGIC)
        while at < self.end:
            self.file.seek(at)
            kind, length = RECORD.unpack(self.file.read(RECORD.size))
            to = at + RECORD.size + length
            if to > self.end or not (0 < kind < DATA_END or kind >= 0x80):
                raise DamageError(f"no complete record at byte {at}")
            if (kind == HEADER) != (at == len(MAGIC)):
                raise DamageError(f"a header is missing or misplaced at byte {at}")
            if kind in (HEADER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX):
                self._check_record(kind, at, self.file.read(length))
            at = to
        self._compare_with_summary()
        return self.summary

    def _check_record(self, kind: int, at: int, data: bytes) -> None:
        if kind == CHUNK:
            self._check_chunk(at, Chunk.read(data))
        elif kind == MESSAGE_INDEX:
            channel, size = struct.unpack_from("<HI", data)
            entries = sorted(struct.iter_unpack("<QQ", data[6 : 6 + size]))
            fits = size <= len(data) - 6
            if self.index is not None and (not fits or entries != self.index.pop(channel, None)):
                raise DamageError(f"the message index at byte {at} does not match its chunk")
        elif kind == HEADER:
            profile = int.from_bytes(data[:4], "little")
            library = int.from_bytes(data[4 + profile : 8 + profile], "little")
            if 8 + profile + library > len(data):
                raise DamageError(f"the header at byte {at} is shorter than it states")
        elif kind == MESSAGE:
            self.found.checked = False
            channel, _, receipt, _ = MESSAGE_HEADER.unpack_from(data)
            self._count_messages(channel, [(receipt, 0)], 0, MAX_TIME)
        else:
            self.found.checked = False
            self.found.add(kind, data)

    def _check_chunk(self, at: int, chunk: Chunk) -> None:
        self._check_message_index()
        index = self.summary.chunks.get(at)
        size = len(chunk.data) + CHUNK_DATA + len(chunk.compression)
        if index is None or (*chunk[:3], chunk.compression, len(chunk.data), size) != (
            index.message_start_time,
            index.message_end_time,
            index.uncompressed_size,
            index.compression,
            index.compressed_size,
            index.chunk_length,
        ):
            raise DamageError(f"the chunk at byte {at} does not match the index")
        data = chunk.unpacked()
        self.found.chunks[at] = index
        self.found.checked &= chunk.crc != 0
        self.index = None
        if chunk.crc and not self.read_all:
            return
        by_channel: dict[int, list[tuple[int, int]]] = {}
        for kind, start, end in records(data):
            if kind == MESSAGE:
                if end - start < MESSAGE_HEADER.size:
                    raise DamageError(f"a message in the chunk at byte {at} is too short")
                channel, _, receipt, _ = MESSAGE_HEADER.unpack_from(data, start)
                by_channel.setdefault(channel, []).append((receipt, start - RECORD.size))
            else:
                self.found.add(kind, data[start:end])
        for channel, entries in by_channel.items():
            entries.sort()
            self._count_messages(channel, entries, chunk.start, min(chunk.end, MAX_TIME))
        if index.message_index_offsets:  # the message index is optional
            self.index = by_channel

    def _count_messages(
        self, channel: int, entries: list[tuple[int, int]], start: int, end: int
    ) -> None:
        """Count the messages of a channel by their times [ns] and places, in order."""
        if channel not in self.summary.channels:
            raise DamageError(f"a message has channel {channel}, which is not defined")
        first, last = entries[0][0], entries[-1][0]
        if not start <= first <= last <= end:
            raise DamageError(
                f"messages from {first} to {last} ns are outside the time range of their chunk"
            )
        self.found.counts[channel] += len(entries)
        self.first, self.last = min(self.first, first), max(self.last, last)

    def _check_message_index(self) -> None:
        """Raise DamageError if the last chunk's message index is not complete."""
        if self.index:
            raise DamageError("a chunk lacks its message index")

    def _compare_with_summary(self) -> None:
        self._check_message_index()
        summary, found = self.summary, self.found
        if found.chunks.keys() != summary.chunks.keys():
            raise DamageError("its chunks do not match its index")
        for name in ("schemas", "channels"):
            listed = getattr(summary, name)
            if any(listed.get(k, v) != v for k, v in getattr(found, name).items()):
                raise DamageError(f"its {name} do not match its index")
        statistics = summary.statistics
        if self.read_all and statistics:
            counts = (statistics.message_count, +Counter(statistics.channel_message_counts))
            if counts != (found.counts.total(), found.counts) or (
                found.counts
                and (statistics.message_start_time, statistics.message_end_time)
                != (self.first, self.last)
            ):
                raise DamageError("its messages do not match the counts in its index")
        summary.checked = found.checked
