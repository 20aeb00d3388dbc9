"""Reading bags as one stream in order of receipt, whatever became of their recorder.

A bag is a folder with metadata.yaml or a single file. A folder of bags, as `record` fills it
(bag_0, bag_1, ...), counts as one. A bag whose recorder was killed has no index and no
metadata.yaml: its whole chunks are first copied into a sound bag in a temporary folder. A damaged
chunk of a bag that has both is met only when it is read; `repair` leaves it out.
"""

from collections.abc import Collection, Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from fcntl import LOCK_NB, LOCK_SH, flock
from hashlib import sha256
from heapq import merge
from itertools import chain
from operator import itemgetter
from os import SEEK_END, PathLike, link
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO, NamedTuple, cast

from mcap.exceptions import InvalidMagic
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, ChunkIndex, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk, get_chunk_data_stream
from mcap.summary import Summary
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinitionFormat, Qos
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.rosbag2.metadata import parse_qos
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore

from .chunks import CRC, RECORD, Received, in_order, indexed, records

AnyPath = str | PathLike[str]


class BagError(ValueError):
    """A bag cannot be read; the message names the file and what is wrong with it."""


class Topic(NamedTuple):
    """What the bags hold of one topic."""

    msgtype: str
    messages: int
    qos: list[Qos]  # as offered by its publishers
    hash: str  # RIHS01 of the type; empty: not known
    definition: str  # of the type, as in the bag
    mixed: bool = False  # the bags hold the type in two versions


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


class Bags:
    """Several bags read as one; made by `open_bags`, a context manager."""

    def __init__(self, paths: Iterable[Path]) -> None:
        self.paths = [bag for path in paths for bag in find(path)]
        if not self.paths:
            raise BagError("no bag is given")
        self.recovered: list[Recovered] = []
        self._stack = ExitStack()
        try:
            # One for each: together they would read all by the definitions of the last one.
            self._readers = [self._open(path) for path in self.paths]
        except BaseException:
            self._stack.close()
            raise
        self._connections = list(chain.from_iterable(r.connections for r in self._readers))
        self._of_type = {c.msgtype: r for r in self._readers for c in r.connections}
        self._mixed = _mixed(self._readers)

    def _open(self, path: Path) -> AnyReader:
        try:
            return self._stack.enter_context(AnyReader([self._sound(path)]))
        except (AnyReaderError, OSError) as error:
            raise BagError(f"{path}: {error}") from None

    def _sound(self, path: Path) -> Path:
        """The bag itself, or its copy without damage."""
        if is_sound(path):
            return path
        folder = Path(self._stack.enter_context(TemporaryDirectory(prefix="fss_arm_bag_")))
        copy = folder / path.name
        self.recovered.append(recover(path, copy))
        return copy

    def __enter__(self) -> "Bags":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the bags and remove what was recovered."""
        self._stack.close()

    @property
    def topics(self) -> dict[str, Topic]:
        """The topics by name."""
        topics: dict[str, Topic] = {}
        for c in sorted(self._connections, key=lambda c: c.topic):
            _, count, qos, *_ = topics.get(c.topic, Topic("", 0, [], "", ""))
            count += c.msgcount
            qos = qos + cast(ConnectionExtRosbag2, c.ext).offered_qos_profiles
            mixed = c.msgtype in self._mixed
            topics[c.topic] = Topic(c.msgtype, count, qos, c.digest, c.msgdef.data, mixed)
        return topics

    @property
    def span(self) -> tuple[int, int]:
        """Times of receipt of the first and the last message [ns]; (0, 0) if there is none."""
        if not self.begins:
            return 0, 0
        return self.begins[0], max(reader.end_time for reader in self._readers) - 1

    @property
    def begins(self) -> list[int]:
        """Times of receipt of the first message of each bag that has one [ns], in order."""
        return sorted(reader.start_time for reader in self._readers if reader.message_count)

    def raw(
        self,
        topics: Collection[str] | None = None,
        start: int | None = None,
        stop: int | None = None,
    ) -> Iterator[tuple[str, str, int, bytes]]:
        """Topic, message type, time of receipt [ns] and serialized message, in order of receipt.

        Args:
            topics: names of those to read; all by default.
            start: the first time of receipt to read [ns].
            stop: the first one not to read [ns].

        Raises:
            BagError: damage is met on the way.
        """
        wanted = {c.topic for c in self._connections if topics is None or c.topic in topics}
        if not wanted:
            return
        try:
            for receipt, connection, data in self._received(wanted, start, stop):
                yield connection.topic, connection.msgtype, receipt, data
        except OSError:
            raise
        except Exception as error:  # rosbags parses damaged bytes as they come
            raise BagError(f"{_list(self.paths)}: damaged, try doctor --repair: {error}") from None

    def _received(
        self, wanted: set[str], start: int | None, stop: int | None
    ) -> Iterable[Received]:
        """Quickly where all is indexed; else as rosbags does it."""
        chunks = indexed(self._readers)
        if chunks is None:
            every = merge(
                *(
                    reader.messages(connections, start, stop)
                    for reader in self._readers
                    if (connections := [c for c in reader.connections if c.topic in wanted])
                ),
                key=itemgetter(1),
            )
            return ((receipt, connection, data) for connection, receipt, data in every)
        return in_order(chunks, wanted, start, stop)

    def messages(
        self, topics: Collection[str] | None = None
    ) -> Iterator[tuple[str, str, int, Any]]:
        """As `raw`, with the messages deserialized into rosbags' classes."""
        for topic, msgtype, receipt, data in self.raw(topics):
            yield topic, msgtype, receipt, self.deserialize(data, msgtype)

    def deserialize(self, data: bytes, msgtype: str) -> Any:
        """A message as one of rosbags' classes.

        Raises:
            BagError: the data are not of that type, or the bags hold two versions of it.
        """
        if msgtype in self._mixed:
            raise BagError(f"{_list(self.paths)}: {two_versions(msgtype)}")
        try:
            return self._of_type[msgtype].deserialize(data, msgtype)
        except Exception as error:  # rosbags parses damaged bytes as they come
            raise BagError(f"{_list(self.paths)}: damaged: {error}") from None


def two_versions(msgtype: str) -> str:
    """What is wrong with bags from before and after a message type grew."""
    return f"hold two versions of {msgtype}: give them one by one"


def _mixed(readers: Iterable[AnyReader]) -> set[str]:
    """The types of which bags hold two versions."""
    versions: dict[str, str] = {}
    mixed = set()
    for reader in readers:
        for c in reader.connections:
            if c.msgdef.format is not MessageDefinitionFormat.NONE:
                version = c.digest or reader.typestore.hash_rihs01(c.msgtype)
                if versions.setdefault(c.msgtype, version) != version:
                    mixed.add(c.msgtype)
    return mixed


def open_bags(paths: AnyPath | Iterable[AnyPath]) -> Bags:
    """Open one or several bags, or folders of bags, to be read as one.

    Raises:
        BagError: there is no bag, or one that cannot be read.
    """
    several = [paths] if isinstance(paths, str | PathLike) else list(paths)
    return Bags([Path(path) for path in several])


def find(path: Path) -> list[Path]:
    """The bags that a path names, numbered ones in the order of their numbers.

    Raises:
        BagError: there is none.
    """
    if not path.exists():
        raise BagError(f"{path}: no such file or folder")
    if path.is_file() or (path / "metadata.yaml").exists() or _storage_files(path):
        return [path]
    inner = [p for p in path.iterdir() if p.is_dir() and not p.name.startswith(".")]
    bags = [p for p in inner if (p / "metadata.yaml").exists() or _storage_files(p)]
    if not bags:
        raise BagError(f"{path}: holds no bag")
    return sorted(bags, key=lambda p: (len(p.name), p.name))


def digest(path: Path) -> str:
    """SHA-256 of a bag's storage files, one after the other.

    Raises:
        OSError: a file cannot be read.
    """
    hashed = sha256()
    for file in _storage_files(path):
        with file.open("rb") as stream:
            while block := stream.read(1 << 20):
                hashed.update(block)
    return hashed.hexdigest()


def is_sound(path: Path) -> bool:
    """Whether a bag has its index and metadata; its chunks are not looked at.

    Raises:
        BagError: it is of a kind that cannot be told, or of which nothing can be recovered.
    """
    try:
        with Reader(path):
            return True
    except Exception as error:  # rosbags parses damaged bytes as they come
        files = _storage_files(path)
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
        for file in _storage_files(path):
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
                elif isinstance(record, Message):  # what tells its type was in a damaged chunk
                    lost += len(record.data)
            lost += found.lost
    return Recovered(path, messages, lost)


def repair(path: Path) -> Recovered | None:
    """Replace a damaged bag by what can be recovered of it; None: it was sound.

    The damaged files stay beside it with `.damaged` appended to their names.

    Raises:
        BagError: nothing can be recovered, or the bag is being recorded.
        OSError: the result cannot be written.
    """
    if is_sound(path) and _reads_through(path):
        return None
    files = _storage_files(path)
    if not files or any(file.suffix != ".mcap" for file in files):
        raise BagError(f"{path}: damaged; only MCAP files can be repaired")
    first, *others = files
    if any(map(_locked, files)):
        raise BagError(f"{path}: is being recorded; stop the recorder first")
    with TemporaryDirectory(dir=first.parent, prefix=".repair_") as folder:
        copy = Path(folder, first.stem)  # its file has the name of the first, and takes its place
        recovered = recover(path, copy)
        metadata = path / "metadata.yaml"
        if metadata.exists() and not _kept(first).exists():  # else of an interrupted repair
            _keep(metadata)
        for file in files:
            _keep(file)
        if path.is_dir():  # metadata.yaml first: until the file follows, the bag shows its damage
            (copy / "metadata.yaml").replace(metadata)
        (copy / first.name).replace(first)
        for file in others:
            file.unlink(missing_ok=True)
    return recovered


def _reads_through(path: Path) -> bool:
    """Whether no chunk of a bag that has its index is damaged."""
    try:
        with open_bags(path) as bags:
            for _ in bags.raw():
                pass
    except BagError:
        return False
    return True


def _locked(file: Path) -> bool:
    """Whether a recorder has it open."""
    with file.open("rb") as stream:
        try:
            flock(stream, LOCK_SH | LOCK_NB)
        except BlockingIOError:
            return True
        except OSError:  # a file system without locks
            pass
    return False


def _keep(file: Path) -> None:
    """Let a damaged file be found beside what takes its place."""
    kept = _kept(file)
    try:
        link(file, kept)
    except FileExistsError:
        if not kept.samefile(file):  # else of a repair that was interrupted
            raise
    except OSError:  # a file system without second names, as exFAT
        file.rename(kept)


def _kept(file: Path) -> Path:
    """Where a damaged file is kept."""
    return file.with_name(f"{file.name}.damaged")


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
    except Exception:  # the parser takes damaged bytes as they come
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


def _storage_files(path: Path) -> list[Path]:
    """The storage files of a bag, in the order in which they were written."""
    if path.is_file():
        return [path]
    files = [p for p in path.iterdir() if p.suffix in (".mcap", ".db3")]
    return sorted(files, key=lambda p: (len(p.name), p.name))


def _list(paths: Iterable[Path]) -> str:
    return ", ".join(map(str, paths))
