"""Read bags as one stream in order of receipt, even if the recorder was killed.

A bag is a folder with metadata.yaml or a single file. A folder of bags, as `record` fills it
(bag_0, bag_1, ...), counts as one. MCAP files describe themselves: metadata.yaml is only compared
with them. A bag that is not complete (its recorder was killed) is read from a copy of its
undamaged chunks in a temporary folder.
"""

from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from hashlib import sha256
from heapq import merge
from itertools import chain
from operator import itemgetter
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple, cast

from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinitionFormat, Qos

from fss_arm_bags.chunks import Received, indexed_chunks, read_in_order
from fss_arm_bags.definitions import definition, extends, message_class, upgrade
from fss_arm_bags.inspection import Inspection, inspect
from fss_arm_bags.layout import STORAGE_SUFFIXES, storage_files
from fss_arm_bags.readers import TopicReader
from fss_arm_bags.recovery import BagError, Recovered, recover
from fss_arm_bags.unpacking import make_readable
from fss_arm_model.files import short

__all__ = [
    "BagError",
    "Bags",
    "Topic",
    "converter",
    "describe_source",
    "digest",
    "find_bags",
    "open_bags",
    "two_versions",
]

AnyPath = str | PathLike[str]


class Topic(NamedTuple):
    """The contents of the bags on one topic."""

    msgtype: str
    messages: int
    qos: list[Qos]  # as offered by its publishers
    hash: str  # RIHS01 of the type; empty: unknown
    definition: str  # of the type, as in the bag
    mixed: bool = False  # the bags hold the type in two versions


class Bags:
    """Several bags read as one; made by `open_bags`, a context manager."""

    def __init__(self, paths: Iterable[Path], *, thorough: bool = False) -> None:
        self.paths = [bag for path in paths for bag in find_bags(path)]
        if not self.paths:
            raise BagError("no bag is given")
        self.recovered: list[Recovered] = []
        self.left_out: list[str] = []  # topics that cannot be read, each with the reason
        self.unchecked: list[Path] = []  # bags without checksums: some damage stays undetected
        self._stack = ExitStack()
        try:
            # One reader for each bag: a common one would use the last bag's definitions for all.
            self._readers = [self._open(path, thorough) for path in self.paths]
        except BaseException:
            self._stack.close()
            raise
        self._connections = list(chain.from_iterable(map(_connections_with_hash, self._readers)))
        self._reader_of_type = {c.msgtype: r for r in self._readers for c in r.connections}
        self._mixed_types = _mixed_types(self._readers)

    def _open(self, path: Path, thorough: bool) -> AnyReader:
        bag = path  # or its unpacked copy
        try:
            bag = make_readable(path, self._folder)
            inspection = inspect(bag, thorough=thorough)
            if not (inspection.checked or inspection.damage):
                self.unchecked.append(path)
            reader = AnyReader(self._files_to_read(path, bag, inspection))
            readers = [TopicReader(file) for file in reader.paths]
            reader.readers = readers
            self._stack.enter_context(reader)
        except BagError as error:
            raise BagError(str(error).replace(str(bag), str(path))) from None
        except Exception as error:  # rosbags parses without checks, so any exception is possible
            raise BagError(f"{path}: {short(str(error))}") from None
        for topic, why in {k: v for r in readers for k, v in r.left_out.items()}.items():
            self.left_out.append(f"{path}: {short(topic)} is left out: {why}")
        return reader

    def _folder(self) -> Path:
        """Return a folder for copies, which is removed when the bags are closed."""
        return Path(self._stack.enter_context(TemporaryDirectory(prefix="fss_arm_bag_")))

    def _files_to_read(self, path: Path, bag: Path, inspection: Inspection) -> list[Path]:
        """Return the files to read: the bag's own, or an undamaged copy."""
        if not inspection.damage:
            if inspection.metadata:
                self.recovered.append(Recovered(path, inspection.messages, 0, inspection.metadata))
            return inspection.files
        copy = self._folder() / bag.name
        self.recovered.append(replace(recover(bag, copy, inspection.damage), path=path))
        return storage_files(copy)

    def __enter__(self) -> "Bags":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the bags and remove the recovered copies."""
        self._stack.close()

    @property
    def topics(self) -> dict[str, Topic]:
        """The topics by name."""
        topics: dict[str, Topic] = {}
        for c in sorted(self._connections, key=lambda c: c.topic):
            _, count, qos, *_ = topics.get(c.topic, Topic("", 0, [], "", ""))
            count += c.msgcount
            qos = qos + cast(ConnectionExtRosbag2, c.ext).offered_qos_profiles
            mixed = c.msgtype in self._mixed_types
            topics[c.topic] = Topic(c.msgtype, count, qos, c.digest, c.msgdef.data, mixed)
        return topics

    @property
    def span(self) -> tuple[int, int]:
        """Times of receipt of the first and the last message [ns]; (0, 0) if there is none."""
        if not self.starts:
            return 0, 0
        return self.starts[0], max(reader.end_time for reader in self._readers) - 1

    @property
    def starts(self) -> list[int]:
        """Times of receipt of the first message of each bag that has one [ns], in order."""
        return sorted(reader.start_time for reader in self._readers if reader.message_count)

    def raw(
        self,
        topics: Collection[str] | None = None,
        start: int | None = None,
        stop: int | None = None,
    ) -> Iterator[tuple[str, str, int, bytes]]:
        """Yield topic, type, time of receipt [ns] and serialized message, in order of receipt.

        Args:
            topics: names of the topics to read; all by default.
            start: the first time of receipt to read [ns].
            stop: the first time of receipt not to read [ns].

        Raises:
            BagError: a bag is damaged.
        """
        wanted = {c.topic for c in self._connections if topics is None or c.topic in topics}
        if not wanted:
            return
        try:
            for receipt, connection, data in self._received(wanted, start, stop):
                yield connection.topic, connection.msgtype, receipt, data
        except OSError:
            raise
        except Exception as error:  # rosbags does not check for damaged bytes
            raise BagError(f"{_join(self.paths)}: damaged: {short(str(error))}") from None

    def _received(
        self, wanted: set[str], start: int | None, stop: int | None
    ) -> Iterable[Received]:
        """Return the messages from indexed chunks if all are indexed (fast), else by rosbags."""
        chunks = indexed_chunks(self._readers)
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
        return read_in_order(chunks, wanted, start, stop)

    def messages(
        self, topics: Collection[str] | None = None
    ) -> Iterator[tuple[str, str, int, Any]]:
        """Yield the same as `raw`, with the messages deserialized into rosbags' classes."""
        for topic, msgtype, receipt, data in self.raw(topics):
            yield topic, msgtype, receipt, self.deserialize(data, msgtype)

    def deserialize(self, data: bytes, msgtype: str) -> Any:
        """Return a message as one of rosbags' classes.

        Raises:
            BagError: the data are not of that type, or the bags hold two versions of it.
        """
        if msgtype in self._mixed_types:
            raise BagError(f"{_join(self.paths)}: {two_versions(msgtype)}")
        try:
            return self._reader_of_type[msgtype].deserialize(data, msgtype)
        except Exception as error:  # rosbags does not check for damaged bytes
            raise BagError(f"{_join(self.paths)}: damaged: {short(str(error))}") from None


def two_versions(msgtype: str) -> str:
    """Return the error text for bags recorded before and after a message type was extended."""
    return f"contain two versions of {msgtype}: open them one by one"


def _mixed_types(readers: Iterable[AnyReader]) -> set[str]:
    """Return the types of which the bags hold two versions."""
    versions: dict[str, str] = {}
    mixed = set()
    for reader in readers:
        for c in reader.connections:
            if c.msgdef.format is not MessageDefinitionFormat.NONE:
                version = c.digest or reader.typestore.hash_rihs01(c.msgtype)
                if versions.setdefault(c.msgtype, version) != version:
                    mixed.add(c.msgtype)
    return mixed


def _connections_with_hash(reader: AnyReader) -> list[Connection]:
    """Return a bag's connections; a missing hash is computed from the definition."""
    return [
        c
        if c.digest or c.msgdef.format is MessageDefinitionFormat.NONE
        else c._replace(digest=reader.typestore.hash_rihs01(c.msgtype))
        for c in reader.connections
    ]


def open_bags(paths: AnyPath | Iterable[AnyPath], *, thorough: bool = False) -> Bags:
    """Open one or several bags, or folders of bags, to be read as one.

    Args:
        paths: the bags.
        thorough: check for damage also in data that reading does not use.

    Raises:
        BagError: there is no bag, or a bag cannot be read.
    """
    several = [paths] if isinstance(paths, str | PathLike) else list(paths)
    return Bags([Path(path) for path in several], thorough=thorough)


def find_bags(path: Path) -> list[Path]:
    """Return the bags that a path names, numbered ones in the order of their numbers.

    Raises:
        BagError: there is no bag.
    """
    if not path.exists():
        raise BagError(f"{path}: no such file or folder")
    if path.is_file() and not path.name.endswith(STORAGE_SUFFIXES):
        raise BagError(f"{path}: no bag, expected a folder or a file {', '.join(STORAGE_SUFFIXES)}")
    if path.is_file() or (path / "metadata.yaml").exists() or storage_files(path):
        return [path]
    inner = [p for p in path.iterdir() if p.is_dir() and not p.name.startswith(".")]
    bags = [p for p in inner if (p / "metadata.yaml").exists() or storage_files(p)]
    if not bags:
        raise BagError(f"{path}: contains no bag")
    return sorted(bags, key=lambda p: (len(p.name), p.name))


def digest(path: Path) -> str:
    """Return the SHA-256 of a bag's storage files, one after the other.

    Raises:
        OSError: a file cannot be read.
    """
    hashed = sha256()
    for file in storage_files(path):
        with file.open("rb") as stream:
            while block := stream.read(1 << 20):
                hashed.update(block)
    return hashed.hexdigest()


def converter(bags: Bags, topic: str) -> Callable[[Any], Any]:
    """Return a function that converts messages of a topic to the installed version of their type.

    Raises:
        BagError: the installed version lacks a field of the recorded one.
        NotInstalledError: the type is not installed.
    """
    about = bags.topics[topic]
    if about.hash in ("", definition(about.msgtype).hash):
        return lambda message: message
    if not extends(about.msgtype, about.definition):
        raise BagError(
            f"{topic}: {about.msgtype} is installed in another version than was recorded; "
            "use `from_bag` to calibrate again from the measurements"
        )
    kind = message_class(about.msgtype)
    return lambda message: upgrade(message, kind)


def describe_source(bags: Bags) -> str:
    """Return the names of the bags, the SHA-256 of their data and the losses of damaged bags."""
    words = "({0.messages} messages recovered, {0.lost} bytes lost)"
    lost = {one.path: f" {words.format(one)}" for one in bags.recovered}
    return ", ".join(f"{path.name} {digest(path)}{lost.get(path, '')}" for path in bags.paths)


def _join(paths: Iterable[Path]) -> str:
    return ", ".join(map(str, paths))
