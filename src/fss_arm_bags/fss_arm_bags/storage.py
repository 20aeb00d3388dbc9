"""The MCAP file of a bag that is being written: with checksums, and of whole chunks only.

rosbags' writer leaves the checksums out that MCAP has for chunks, data and summary, and what a full
disk takes of a chunk stays in its file.
"""

from collections.abc import Mapping
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import Any
from zlib import crc32

from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.enums import CompressionMode
from rosbags.rosbag2.storage_mcap import McapWriter

from fss_arm_bags.chunks import CHUNK_CRC, CRC, RECORD

FOOTER = RECORD.size + 20 + 8  # bytes at the end, with the magic ones


class _Next(BytesIO):
    """What comes next in a file, at the place `begin`."""

    def __init__(self, begin: int) -> None:
        super().__init__()
        self.begin = begin

    def tell(self) -> int:
        return self.begin + super().tell()

    def close(self) -> None:
        """Stay, as it is not written yet."""


class Storage(McapWriter):
    """rosbags' writer, but for the checksums and what happens on a full disk.

    A chunk that cannot be written is kept in memory, and the file is as it was before.
    """

    bio: Any  # what comes next

    def __init__(self, path: Path, compression: CompressionMode) -> None:
        super().__init__(path, compression)
        self.file: Any = self.bio.detach()
        begun = self.path.read_bytes()
        self.crc = crc32(begun)  # of the data so far
        self.bio = _Next(len(begun))
        self.failure: OSError | None = None  # of the last chunk

    def close_chunk(self) -> None:
        """Write the pending chunk.

        Raises:
            OSError: the disk is full or gone.
        """
        chunk, before = self.chunk, len(self.chunks)
        crc = crc32(chunk.bio.getvalue())
        super().close_chunk()
        data = bytearray(self.bio.getvalue())
        CRC.pack_into(data, CHUNK_CRC, crc)
        try:
            self._put(data)
        except OSError as error:
            self.chunk, self.failure = chunk, error
            del self.chunks[before:]
            raise
        self.failure = None
        self.crc = crc32(data, self.crc)

    def write(self, connection: Any, timestamp: int, data: bytes | memoryview) -> None:
        """Keep a message; what befalls the chunk that it fills is in `failure`."""
        with suppress(OSError):
            super().write(connection, timestamp, data)

    def close(self, version: int, metadata: str) -> None:
        """End the file with its index.

        Raises:
            OSError: the disk is full or gone.
        """
        super().close(version, metadata)
        data = bytearray(self.bio.getvalue())  # metadata, the end of the data, summary, footer
        _, length = RECORD.unpack_from(data)
        end = RECORD.size + length
        summary = end + RECORD.size + CRC.size
        CRC.pack_into(data, end + RECORD.size, crc32(data[:end], self.crc))
        place = len(data) - FOOTER + RECORD.size + 16
        CRC.pack_into(data, place, crc32(data[summary:place]))
        self._put(data)
        self.file.close()

    def abort(self) -> None:
        """End the file as it is."""
        self.file.close()

    def _put(self, data: bytearray) -> None:
        """Write what comes next as a whole or not at all."""
        begin = self.bio.begin
        self.bio = _Next(begin)
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[self.file.write(rest) :]
        except OSError:
            with suppress(OSError):
                self.file.seek(begin)
                self.file.truncate()
            raise
        self.bio = _Next(begin + len(data))


class CheckedWriter(Writer):
    """Writes bags with checksums."""

    STORAGE_PLUGINS: Mapping[StoragePlugin, type[Any]] = {StoragePlugin.MCAP: Storage}

    def __init__(self, path: Path) -> None:
        super().__init__(path, version=9, storage_plugin=StoragePlugin.MCAP)
