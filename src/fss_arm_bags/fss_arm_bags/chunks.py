"""Read messages from the chunks of indexed MCAP files, several times as fast as rosbags does.

rosbags opens the files and reads their index; this module decodes each chunk in one pass. Chunks
may overlap in time, also between files: messages wait until no later chunk can have earlier ones.
The layouts of the records are those of the MCAP specification, https://mcap.dev/spec.
"""

from bisect import bisect_left
from collections.abc import Container, Iterable, Iterator, Sequence
from itertools import chain
from math import inf
from operator import itemgetter
from struct import Struct
from typing import NamedTuple

from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.storage_mcap import ChunkInfo, McapReader, decompress

RECORD = Struct("<BQ")  # kind of the record, length of its content
MESSAGE_HEADER = Struct("<HIQQ")  # channel, sequence, time of receipt, time of publication
CRC = Struct("<I")
CHUNK_CRC = RECORD.size + 24  # offset of the checksum in a chunk record
CHUNK_DATA = RECORD.size + 40  # offset of its data, without the name of the compression

SCHEMA, CHANNEL, MESSAGE, CHUNK = 3, 4, 5, 6  # kinds of records

RECEIPT = itemgetter(0)

Received = tuple[int, Connection, bytes]  # receipt [ns], topic, serialized message


class ChunkError(ValueError):
    """A chunk is damaged."""


class _Chunk(NamedTuple):
    """A chunk of an indexed MCAP file."""

    storage: McapReader
    connections: Sequence[Connection]  # those of the file that can be read
    info: ChunkInfo

    def messages(self, topics: Container[str]) -> list[Received]:
        """Return all messages on these topics, in the order of the chunk."""
        i, file = self.info, self.storage.bio
        assert file
        file.seek(i.chunk_start_offset + CHUNK_CRC)
        (crc,) = CRC.unpack(file.read(CRC.size))
        file.seek(i.chunk_start_offset + CHUNK_DATA + len(i.compression))
        packed = file.read(i.compressed_size)
        data = decompress(packed, i.compression, i.uncompressed_size, crc)
        wanted = {c.id: c for c in self.connections if c.topic in topics}
        found = []
        for kind, at, end in records(data):
            if kind == MESSAGE:
                channel, _, receipt, _ = MESSAGE_HEADER.unpack_from(data, at)
                if channel in wanted:
                    found.append((receipt, wanted[channel], data[at + MESSAGE_HEADER.size : end]))
        return found


def records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield kind, start and end of the content of each record in an unpacked chunk.

    Raises:
        ChunkError: the chunk is damaged.
    """
    at = 0
    while at < len(data):
        if len(data) - at < RECORD.size:
            raise ChunkError(f"the record at byte {at} of a chunk is cut off")
        kind, length = RECORD.unpack_from(data, at)
        if kind == 0:
            raise ChunkError(f"no record at byte {at} of a chunk")
        at += RECORD.size + length
        if at > len(data):
            raise ChunkError(f"a record is {at - len(data)} bytes longer than its chunk")
        yield kind, at - length, at


def indexed_chunks(readers: Iterable[AnyReader]) -> list[_Chunk] | None:
    """Return the chunks of all files, sorted by start time.

    Returns:
        The chunks; None if a file is not MCAP, or has messages but no index of chunks.
    """
    found = []
    for bag in chain.from_iterable(reader.readers for reader in readers):
        if not isinstance(bag, Reader) or not isinstance(bag.storage, McapReader):
            return None
        storage = bag.storage
        if storage.metadata.message_count and not storage.chunks:
            return None
        found += [_Chunk(storage, bag.connections, info) for info in storage.chunks]
    return sorted(found, key=lambda chunk: chunk.info.message_start_time)


def read_in_order(
    chunks: Iterable[_Chunk],
    topics: Container[str],
    start: int | None = None,
    stop: int | None = None,
) -> Iterator[Received]:
    """Yield the messages on these topics, received from `start` to before `stop` [ns], in order.

    The chunks must be sorted by start time, as those of `indexed_chunks`.

    Raises:
        ChunkError: the records of a chunk are damaged.
        Exception: another damage, as rosbags or the decompression reports it.
    """
    first, end = start if start is not None else -inf, stop if stop is not None else inf
    waiting: list[Received] = []
    for chunk in chunks:
        if chunk.info.message_end_time < first or chunk.info.message_start_time >= end:
            continue
        ready = bisect_left(waiting, chunk.info.message_start_time, key=RECEIPT)
        yield from waiting[:ready]
        new = [m for m in chunk.messages(topics) if first <= m[0] < end]
        waiting = sorted(waiting[ready:] + new, key=RECEIPT)
    yield from waiting
