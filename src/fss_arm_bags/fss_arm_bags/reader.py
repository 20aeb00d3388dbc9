"""Reading bags as one stream in order of receipt, whatever became of their recorder.

A bag is a folder with metadata.yaml or a single file. A folder of bags, as `record` fills it
(bag_0, bag_1, ...), counts as one. MCAP files tell all by themselves: metadata.yaml is only
compared. A bag that is not whole, as one whose recorder was killed, is read from a copy of its
whole chunks in a temporary folder.
"""

import re
from collections.abc import Collection, Iterable, Iterator
from contextlib import ExitStack
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
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

from fss_arm_bags.chunks import Received, in_order, indexed
from fss_arm_bags.inspection import Inspected, inspect
from fss_arm_bags.recovery import BagError, Recovered, recover, storage_files
from fss_arm_model.files import short

__all__ = ["BagError", "Bags", "Topic", "digest", "find", "open_bags", "two_versions"]

AnyPath = str | PathLike[str]


class Topic(NamedTuple):
    """What the bags hold of one topic."""

    msgtype: str
    messages: int
    qos: list[Qos]  # as offered by its publishers
    hash: str  # RIHS01 of the type; empty: not known
    definition: str  # of the type, as in the bag
    mixed: bool = False  # the bags hold the type in two versions


class _Reader(Reader):
    """rosbags' reader, without the topics of whose types a bag holds something else.

    By itself rosbags refuses a bag with one such topic as a whole.
    """

    left_out: dict[str, str]  # why, by topic

    def open(self) -> None:
        """Open the bag."""
        super().open()
        whys = {c.topic: _why_not(c) for c in self.storage.connections}
        self.left_out = {topic: why for topic, why in whys.items() if why}

    @property
    def connections(self) -> list[Connection]:
        """What can be read."""
        return [c for c in super().connections if c.topic not in self.left_out]


def _why_not(c: Connection) -> str:
    """Why a topic's messages cannot be told; empty: they can."""
    if not c.digest or c.msgdef.format is MessageDefinitionFormat.NONE:
        return ""
    store = get_typestore(Stores.EMPTY)
    try:
        if c.msgdef.format is MessageDefinitionFormat.MSG:
            store.register(get_types_from_msg(c.msgdef.data, c.msgtype))
        else:
            for text in c.msgdef.data.split("=" * 80 + "\n"):
                store.register(get_types_from_idl(re.sub(r"\AIDL: .*\n", "", text)))
        present = store.hash_rihs01(c.msgtype)
    except Exception as error:  # rosbags parses what there is as it comes
        return f"its definition of {c.msgtype} is not understood: {short(str(error))}"
    if present == c.digest:
        return ""
    return f"its definition of {c.msgtype} has not the hash {short(c.digest)} that the bag gives it"


class Bags:
    """Several bags read as one; made by `open_bags`, a context manager."""

    def __init__(self, paths: Iterable[Path], *, thorough: bool = False) -> None:
        self.paths = [bag for path in paths for bag in find(path)]
        if not self.paths:
            raise BagError("no bag is given")
        self.recovered: list[Recovered] = []
        self.left_out: list[str] = []  # topics that cannot be read, each with the reason
        self.unchecked: list[Path] = []  # bags without checksums: not all damage to them is seen
        self._stack = ExitStack()
        try:
            # One for each: together they would read all by the definitions of the last one.
            self._readers = [self._open(path, thorough) for path in self.paths]
        except BaseException:
            self._stack.close()
            raise
        self._connections = list(chain.from_iterable(map(_hashed, self._readers)))
        self._of_type = {c.msgtype: r for r in self._readers for c in r.connections}
        self._mixed = _mixed(self._readers)

    def _open(self, path: Path, thorough: bool) -> AnyReader:
        try:
            inspected = inspect(path, thorough=thorough)
            if not (inspected.checked or inspected.damage):
                self.unchecked.append(path)
            reader = AnyReader(self._sound(path, inspected))
            readers = [_Reader(file) for file in reader.paths]
            reader.readers = readers
            self._stack.enter_context(reader)
        except BagError:
            raise
        except Exception as error:  # rosbags parses what there is as it comes
            raise BagError(f"{path}: {short(str(error))}") from None
        for topic, why in {k: v for r in readers for k, v in r.left_out.items()}.items():
            self.left_out.append(f"{path}: {short(topic)} is left out: {why}")
        return reader

    def _sound(self, path: Path, inspected: Inspected) -> list[Path]:
        """The files to read: a bag's own, or a copy without damage."""
        if inspected.files and not inspected.damage:
            if inspected.metadata:
                self.recovered.append(Recovered(path, inspected.messages, 0, inspected.metadata))
            return inspected.files
        if not inspected.damage:
            return [path]
        folder = Path(self._stack.enter_context(TemporaryDirectory(prefix="fss_arm_bag_")))
        copy = folder / path.name
        self.recovered.append(recover(path, copy, inspected.damage))
        return storage_files(copy)

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
            raise BagError(f"{_list(self.paths)}: damaged: {short(str(error))}") from None

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
            raise BagError(f"{_list(self.paths)}: damaged: {short(str(error))}") from None


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


def _hashed(reader: AnyReader) -> list[Connection]:
    """A bag's connections; those without it get the hash that their definition has."""
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
        thorough: look for damage also where reading does not.

    Raises:
        BagError: there is no bag, or one that cannot be read.
    """
    several = [paths] if isinstance(paths, str | PathLike) else list(paths)
    return Bags([Path(path) for path in several], thorough=thorough)


def find(path: Path) -> list[Path]:
    """The bags that a path names, numbered ones in the order of their numbers.

    Raises:
        BagError: there is none.
    """
    if not path.exists():
        raise BagError(f"{path}: no such file or folder")
    if path.is_file() or (path / "metadata.yaml").exists() or storage_files(path):
        return [path]
    inner = [p for p in path.iterdir() if p.is_dir() and not p.name.startswith(".")]
    bags = [p for p in inner if (p / "metadata.yaml").exists() or storage_files(p)]
    if not bags:
        raise BagError(f"{path}: holds no bag")
    return sorted(bags, key=lambda p: (len(p.name), p.name))


def digest(path: Path) -> str:
    """SHA-256 of a bag's storage files, one after the other.

    Raises:
        OSError: a file cannot be read.
    """
    hashed = sha256()
    for file in storage_files(path):
        with file.open("rb") as stream:
            while block := stream.read(1 << 20):
                hashed.update(block)
    return hashed.hexdigest()


def _list(paths: Iterable[Path]) -> str:
    return ", ".join(map(str, paths))
