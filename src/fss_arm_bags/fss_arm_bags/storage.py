"""MCAP file of a bag that is being written, with checksums and of complete chunks only.

rosbags' writer omits the optional MCAP checksums of chunks, data and summary. On a full disk it
leaves a partial chunk in the file.
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


class _PendingData(BytesIO):
    """Buffer of the data to write next, which start at `offset` in the file."""

    def __init__(self, offset: int) -> None:
        super().__init__()
        self.offset = offset

    def tell(self) -> int:
        return self.offset + super().tell()

    def close(self) -> None:
        """Do nothing: the data are not written yet."""


class Storage(McapWriter):
    """rosbags' writer with checksums and with safe behaviour on a full disk.

    A chunk that cannot be written is kept in memory, and the file stays unchanged.
    """

    bio: Any  # data to write next

    def __init__(self, path: Path, compression: CompressionMode) -> None:
        super().__init__(path, compression)
        self.file: Any = self.bio.detach()
        header = self.path.read_bytes()
        self.crc = crc32(header)  # checksum of the data written
        self.bio = _PendingData(len(header))
        self.failure: OSError | None = None  # error of the last chunk

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
            self._append(data)
        except OSError as error:
            self.chunk, self.failure = chunk, error
            del self.chunks[before:]
            raise
        self.failure = None
        self.crc = crc32(data, self.crc)

    def write(self, connection: Any, timestamp: int, data: bytes | memoryview) -> None:
        """Add a message; if this fills a chunk that cannot be written, `failure` has the error."""
        with suppress(OSError):
            super().write(connection, timestamp, data)

    def close(self, version: int, metadata: str) -> None:
        """Close the file with its index.

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
        self._append(data)
        self.file.close()

    def abort(self) -> None:
        """Close the file without an index."""
        self.file.close()

    def _append(self, data: bytearray) -> None:
        """Write the next data completely or not at all."""
        offset = self.bio.offset
        self.bio = _PendingData(offset)
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[self.file.write(rest) :]
        except OSError:
            with suppress(OSError):
                self.file.seek(offset)
                self.file.truncate()
            raise
        self.bio = _PendingData(offset + len(data))


class CheckedWriter(Writer):
    """Writer of bags with checksums."""

    STORAGE_PLUGINS: Mapping[StoragePlugin, type[Any]] = {StoragePlugin.MCAP: Storage}

    def __init__(self, path: Path) -> None:
        super().__init__(path, version=9, storage_plugin=StoragePlugin.MCAP)
