"""Write a rosbag2 (MCAP) bag that survives a SIGKILL."""

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
from rosbags.rosbag2 import WriterError

from fss_arm_bags.definitions import definition
from fss_arm_bags.storage import CheckedWriter, Storage
from fss_arm_ros.convert import SECOND


def next_bag(folder: Path) -> Path:
    """Return the first of folder/bag_0, folder/bag_1, ... that follows all existing ones."""
    numbers = [p.name.removeprefix("bag_") for p in folder.glob("bag_*")]
    return folder / f"bag_{max((int(n) + 1 for n in numbers if n.isdecimal()), default=0)}"


@dataclass(frozen=True)
class Limits:
    """Limits at which the next bag is started; 0: no limit."""

    size: int = 0  # of its file [bytes]
    span: int = 0  # from its first message [ns]


class Recording:
    """The next numbered bags of a folder, the last one open for writing.

    Between two calls of `flush` messages are in memory only. A killed process leaves a bag
    without index and metadata.yaml, which `fss_arm_bags.reader` can still read. The lock (flock)
    on an open bag's file prevents its repair.

    While the disk is full or gone, the last chunk stays in memory, messages are counted as lost,
    and each `flush` tries again.
    """

    def __init__(self, folder: Path, limits: Limits = Limits()) -> None:
        """Open the first bag.

        Raises:
            OSError: it cannot be made.
        """
        if (folder / "metadata.yaml").exists():
            raise FileExistsError(f"{folder} is a bag itself; give a folder for bags")
        self.folder, self.limits = folder, limits
        self.topics: dict[str, Callable[[], Connection]] = {}  # each adds a topic to the open bag
        self.failure: OSError | None = None  # of the last attempt to write
        self.lost = 0  # messages that were not written
        self._open()

    def _open(self) -> None:
        """Open the next bag, with all known topics."""
        self.path = next_bag(self.folder)
        try:
            self.writer = CheckedWriter(self.path)
            self.writer.open()
        except WriterError:  # another recorder was faster
            raise FileExistsError(EEXIST, strerror(EEXIST), str(self.path)) from None
        except OSError:
            with suppress(OSError):  # the folder does not exist or is not empty
                (self.path / f"{self.path.name}.mcap").unlink(missing_ok=True)
                self.path.rmdir()
            raise
        with suppress(OSError):  # a file system without locks
            flock(self._storage.file, LOCK_EX | LOCK_NB)  # as long as the file is open
        self.connections = {topic: connect() for topic, connect in self.topics.items()}

    @property
    def _storage(self) -> Storage:
        return cast(Storage, self.writer.storage)

    def add(self, topic: str, msgtype: str, offered: Iterable[Any]) -> None:
        """Add a topic with the QoS profiles that its publishers offer.

        Raises:
            NotInstalledError: the type's definition is not installed.
        """
        text, digest = definition(msgtype)
        qos = [bag_qos(profile) for profile in offered]

        def connect() -> Connection:
            return self.writer.add_connection(
                topic, msgtype, msgdef=text, rihs01=digest, offered_qos_profiles=qos
            )

        self.topics[topic] = connect
        if self.writer.storage:  # otherwise the next bag starts with it
            self.connections[topic] = connect()

    def write(self, topic: str, receipt: int, data: bytes) -> bool:
        """Add a message received at `receipt` [ns]; return False if it is lost to a disk error."""
        if self.failure is None and self._is_full(receipt):
            self._split()
        if self.failure:
            self.lost += 1
            return False
        self.writer.write(self.connections[topic], receipt, data)
        self.failure = self._storage.failure
        return True

    def _split(self) -> None:
        """Continue in the next bag."""
        try:
            self.close()
            self._open()
        except OSError as error:
            self.failure = error
            self.abort()

    def _is_full(self, receipt: int) -> bool:
        """Return True if a message received at this time belongs in the next bag."""
        size, span = self.limits.size, self.limits.span
        start = min(self.writer.min_timestamp, receipt)  # a bag without messages has no start time
        return (0 < size <= self._storage.bio.tell()) or (0 < span <= receipt - start)

    def flush(self) -> None:
        """Write all pending messages to the operating system as a complete chunk.

        Raises:
            OSError: the disk is full or gone; messages are lost until this succeeds.
        """
        # The writer alone would keep up to 1 MiB in memory, and has no flush.
        try:
            if not self.writer.storage:
                self._open()
            if self._storage.chunk.msgs:
                self._storage.close_chunk()
        except OSError as error:
            self.failure = error
            raise
        self.failure = None

    def close(self) -> None:
        """Close the bag with index and metadata.

        Raises:
            OSError: the disk is full or gone.
        """
        if self.writer.storage:
            self.writer.close()

    def abort(self) -> None:
        """Close the bag without index and metadata."""
        if self.writer.storage:
            self.lost += sum(map(len, self._storage.chunk.msgs.values()))
            self.writer.abort()


def bag_qos(profile: Any) -> Qos:
    """Convert an rclpy QoS profile to that of a bag."""

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
