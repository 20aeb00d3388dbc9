"""Writing a rosbag2 (MCAP) bag that outlives a SIGKILL."""

from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from errno import EEXIST
from fcntl import LOCK_EX, LOCK_NB, flock
from os import strerror
from pathlib import Path
from typing import Any, cast

from rosbags.interfaces import (
    Connection,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import StoragePlugin, Writer, WriterError
from rosbags.rosbag2.storage_mcap import McapWriter

from fss_arm_bags.definitions import definition
from fss_arm_ros.convert import SECOND


def next_bag(folder: Path) -> Path:
    """The first of folder/bag_0, folder/bag_1, ... that follows all there are."""
    numbers = [p.name.removeprefix("bag_") for p in folder.glob("bag_*")]
    return folder / f"bag_{max((int(n) + 1 for n in numbers if n.isdecimal()), default=0)}"


@dataclass(frozen=True)
class Limits:
    """When the next bag is begun; 0: never for that reason."""

    size: int = 0  # of its file [bytes]
    span: int = 0  # from its first message [ns]


class Recording:
    """The next numbered bags of a folder, the last one open for writing.

    Between two calls of `flush` messages are in memory only. A killed process leaves a bag
    without index and metadata.yaml; `fss_arm_bags.reader` reads it all the same. The lock (flock)
    on an open bag's file keeps a repair away.
    """

    def __init__(self, folder: Path, limits: Limits = Limits()) -> None:
        """Open the first bag.

        Raises:
            OSError: it cannot be made.
        """
        if (folder / "metadata.yaml").exists():
            raise FileExistsError(f"{folder} is a bag itself; give a folder for bags")
        self.folder, self.limits = folder, limits
        self.topics: dict[str, Callable[[], Connection]] = {}  # each begins a topic in a bag
        self._open()

    def _open(self) -> None:
        """Begin the next bag, with all topics there are."""
        self.path = next_bag(self.folder)
        try:
            self.writer = Writer(self.path, version=9, storage_plugin=StoragePlugin.MCAP)
            self.writer.open()
        except WriterError:  # another recorder was quicker
            raise FileExistsError(EEXIST, strerror(EEXIST), str(self.path)) from None
        with suppress(OSError):  # of a file system without locks
            flock(self._storage.bio, LOCK_EX | LOCK_NB)  # for as long as the file is open
        self._storage.bio.flush()
        self.connections = {topic: begin() for topic, begin in self.topics.items()}

    @property
    def _storage(self) -> McapWriter:
        return cast(McapWriter, self.writer.storage)

    def add(self, topic: str, msgtype: str, offered: Iterable[Any]) -> None:
        """Begin a topic with the QoS profiles that its publishers offer.

        Raises:
            NotInstalledError: the type's definition is not there.
        """
        text, digest = definition(msgtype)
        qos = [bag_qos(profile) for profile in offered]

        def begin() -> Connection:
            return self.writer.add_connection(
                topic, msgtype, msgdef=text, rihs01=digest, offered_qos_profiles=qos
            )

        self.topics[topic], self.connections[topic] = begin, begin()

    def write(self, topic: str, receipt: int, data: bytes) -> None:
        """Keep a serialized message, received at `receipt` [ns].

        Raises:
            OSError: as of `flush`, which a full chunk does not wait for.
        """
        if self._full(receipt):
            self.close()
            self._open()
        self.writer.write(self.connections[topic], receipt, data)

    def _full(self, receipt: int) -> bool:
        """Whether a message received then belongs into the next bag."""
        size, span = self.limits.size, self.limits.span
        begun = min(self.writer.min_timestamp, receipt)  # a bag without messages has none
        return (0 < size <= self._storage.bio.tell()) or (0 < span <= receipt - begun)

    def flush(self) -> None:
        """Hand everything to the operating system as a whole chunk.

        Raises:
            OSError: the disk is full or gone.
        """
        # The writer alone would hold back 1 MiB, and knows no flush of its own.
        if self._storage.chunk.msgs:
            self._storage.close_chunk()
        self._storage.bio.flush()

    def close(self) -> None:
        """End the bag with index and metadata.

        Raises:
            OSError: the disk is full or gone.
        """
        if self.writer.storage:
            self.writer.close()

    def abort(self) -> None:
        """Leave the bag as it is on the disk."""
        with suppress(OSError):  # the rest of the buffer, which failed before
            self.writer.abort()


def bag_qos(profile: Any) -> Qos:
    """An rclpy QoS profile as a bag keeps it."""

    def time(duration: Any) -> QosTime:
        return QosTime(*divmod(duration.nanoseconds, SECOND))

    return Qos(
        QosHistory(profile.history.value),
        profile.depth,
        QosReliability(profile.reliability.value),
        QosDurability(profile.durability.value),
        time(profile.deadline),
        time(profile.lifespan),
        QosLiveliness(profile.liveliness.value),
        time(profile.liveliness_lease_duration),
        profile.avoid_ros_namespace_conventions,
    )
