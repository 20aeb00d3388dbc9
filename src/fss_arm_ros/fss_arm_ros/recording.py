"""Writing a rosbag2 (MCAP) bag that outlives a SIGKILL."""

from collections.abc import Iterable
from contextlib import suppress
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

from .convert import SECOND
from .definitions import definition


def next_bag(folder: Path) -> Path:
    """The first of folder/bag_0, folder/bag_1, ... that follows all there are."""
    numbers = [p.name.removeprefix("bag_") for p in folder.glob("bag_*")]
    return folder / f"bag_{max((int(n) + 1 for n in numbers if n.isdecimal()), default=0)}"


class Recording:
    """The next numbered bag of a folder, open for writing.

    Between two calls of `flush` messages are in memory only. A killed process leaves a bag
    without index and metadata.yaml; `fss_arm_ros.bags` reads it all the same.
    """

    def __init__(self, folder: Path) -> None:
        """Open the bag.

        Raises:
            OSError: it cannot be made.
        """
        if (folder / "metadata.yaml").exists():
            raise FileExistsError(f"{folder} is a bag itself; give a folder for bags")
        self.path = next_bag(folder)
        self.writer = Writer(self.path, version=9, storage_plugin=StoragePlugin.MCAP)
        try:
            self.writer.open()
        except WriterError as error:  # another recorder was quicker
            raise FileExistsError(str(error)) from None
        self._storage.bio.flush()

    @property
    def _storage(self) -> McapWriter:
        return cast(McapWriter, self.writer.storage)

    def add(self, topic: str, msgtype: str, offered: Iterable[Any]) -> Connection:
        """Begin a topic with the QoS profiles that its publishers offer.

        Raises:
            NotInstalledError: the type's definition is not there.
        """
        text, digest = definition(msgtype)
        return self.writer.add_connection(
            topic,
            msgtype,
            msgdef=text,
            rihs01=digest,
            offered_qos_profiles=[bag_qos(profile) for profile in offered],
        )

    def write(self, connection: Connection, receipt: int, data: bytes) -> None:
        """Keep a serialized message, received at `receipt` [ns].

        Raises:
            OSError: as of `flush`, which a full chunk does not wait for.
        """
        self.writer.write(connection, receipt, data)

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
