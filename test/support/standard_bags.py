"""Bags as `ros2 bag record` of Jazzy writes them, by the MCAP library and by SQLite itself.

After rosbag2 0.26: sequential_writer.cpp, sequential_compression_writer.cpp, mcap_storage.cpp,
sqlite_storage.cpp, local_message_definition_source.cpp, metadata_io.hpp.
"""

import sqlite3
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from backports import zstd
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rclpy.serialization import serialize_message
from ros_bags import START, STEP, joint_state
from std_msgs.msg import String

from fss_arm_bags.definitions import definition

FOREVER = {"sec": 9223372036, "nsec": 854775807}
QOS = [
    {
        "history": "unknown",  # as discovery does not tell it
        "depth": 0,
        "reliability": "reliable",
        "durability": "volatile",
        "deadline": FOREVER,
        "lifespan": FOREVER,
        "liveliness": "automatic",
        "liveliness_lease_duration": FOREVER,
        "avoid_ros_namespace_conventions": False,
    }
]
RULE = "=" * 80
SET_BOOL = f"{RULE}\nSRV: std_srvs/srv/SetBool\nbool data\n---\nbool success\nstring message\n"
SET_MODE = (
    f"{RULE}\nSRV: other/srv/SetMode\nstd_msgs/Header header\n---\n\n"
    f"{RULE}\nMSG: std_msgs/Header\nstring frame_id\n"
)
TABLES = """
CREATE TABLE schema(schema_version INTEGER PRIMARY KEY,ros_distro TEXT NOT NULL);
CREATE TABLE metadata(id INTEGER PRIMARY KEY,metadata_version INTEGER NOT NULL,
  metadata TEXT NOT NULL);
CREATE TABLE topics(id INTEGER PRIMARY KEY,name TEXT NOT NULL,type TEXT NOT NULL,
  serialization_format TEXT NOT NULL,offered_qos_profiles TEXT NOT NULL,
  type_description_hash TEXT NOT NULL);
CREATE TABLE message_definitions(id INTEGER PRIMARY KEY,topic_type TEXT NOT NULL,
  encoding TEXT NOT NULL,encoded_message_definition TEXT NOT NULL,
  type_description_hash TEXT NOT NULL);
CREATE TABLE messages(id INTEGER PRIMARY KEY,topic_id INTEGER NOT NULL,
  timestamp INTEGER NOT NULL, data BLOB NOT NULL);
CREATE INDEX timestamp_idx ON messages (timestamp ASC);
INSERT INTO schema VALUES (4, 'jazzy');
"""


@dataclass(frozen=True)
class Heard:
    """A topic of which messages were recorded."""

    name: str
    msgtype: str
    encoding: str = "ros2msg"
    text: str = ""
    hash: str = "RIHS01_" + 64 * "0"
    of: str = ""  # type that the definition is of, if another

    @classmethod
    def defined(cls, name: str, msgtype: str) -> "Heard":
        text, digest = definition(msgtype)
        return cls(name, msgtype, "ros2msg", text, digest)


JOINTS = Heard.defined("/joint_states", "sensor_msgs/msg/JointState")
SILENT = Heard.defined("/fog/imu", "sensor_msgs/msg/Imu")
SILENT_COMMANDS = Heard.defined("/arm/joint_commands", "sensor_msgs/msg/JointState")
#: Of whose type the recorder found no definition: one that is installed here, ...
UNDEFINED = Heard("/text", "std_msgs/msg/String", "", hash=definition("std_msgs/msg/String").hash)
#: ... the feedback of an action, by `--include-hidden-topics`; and the events of services, one
#: without and one with a type of a message in it.
FEEDBACK = Heard("/arm/move/_action/feedback", "fss_arm_msgs/action/MoveArm_FeedbackMessage", "")
EVENTS = tuple(
    Heard(f"{service}/_service_event", f"{kind}_Event", encoding, text, of=kind)
    for service, kind, encoding, text in (
        ("/link_1/arm", "std_srvs/srv/SetBool", "unknown", SET_BOOL),
        ("/mode", "other/srv/SetMode", "ros2msg", SET_MODE),
    )
)


@dataclass(frozen=True)
class Standard:
    """How a bag is recorded: joint states 10 ms apart, and a message of each other topic."""

    storage: str = "mcap"
    preset: str = ""  # of MCAP: zstd_fast, fastwrite; of SQLite: resilient
    mode: str = ""  # of compression: file or message
    each: int = 30  # joint states a file
    files: int = 1
    others: tuple[Heard, ...] = ()
    killed: bool = False  # there is no metadata.yaml, and the last file has no end

    @property
    def topics(self) -> tuple[Heard, ...]:
        return (JOINTS, *self.others)

    def record(self, bag: Path) -> Path:
        bag.mkdir()
        end = {"mcap": ".mcap", "sqlite3": ".db3"}[self.storage]
        files = [bag / f"{bag.name}_{k}{end}" for k in range(self.files)]
        for k, file in enumerate(files):
            rows = self.rows(k)
            if self.storage == "mcap":
                self.mcap(file, rows)
            else:
                self.sqlite(file, rows)
            if self.mode == "file" and not (self.killed and file == files[-1]):
                packed = file.with_name(f"{file.name}.zstd")
                packed.write_bytes(zstd.compress(file.read_bytes()))
                file.unlink()
                files[k] = packed
        if self.killed and self.storage == "mcap":
            data = files[-1].read_bytes()
            files[-1].write_bytes(data[: len(data) - 400])
        if not self.killed:
            text = yaml.safe_dump({"rosbag2_bagfile_information": self.about(files)})
            (bag / "metadata.yaml").write_text(text)
        return bag

    def rows(self, part: int) -> list[tuple[Heard, int, bytes]]:
        rows = [
            (JOINTS, START + k * STEP, serialize_message(joint_state(k)))
            for k in range(self.each * part, self.each * (part + 1))
        ]
        text = serialize_message(String(data="a text"))
        rows += [
            (one, START + self.each * part * STEP + 1, text)
            for one in self.others
            if one not in (SILENT, SILENT_COMMANDS)
        ]
        return sorted(rows, key=lambda row: row[1])

    def mcap(self, file: Path, rows: list[tuple[Heard, int, bytes]]) -> None:
        """By mcap_storage.cpp; topics without messages are in the file, too."""
        packs = self.preset.startswith("zstd")
        with file.open("wb") as stream:
            writer = McapWriter(
                stream,
                chunk_size=1000,
                use_chunking=self.preset != "fastwrite",
                compression=CompressionType.ZSTD if packs else CompressionType.NONE,
                enable_crcs=False,
            )
            writer.start(profile="ros2", library="libmcap 1.3.0")
            writer.add_metadata("rosbag2", {"serialized_metadata": "version: 9"})
            channels: dict[str, int] = {}
            for one in self.topics:
                schema = writer.register_schema(one.msgtype, one.encoding, one.text.encode())
                about = {"offered_qos_profiles": yaml.safe_dump(QOS), "topic_type_hash": one.hash}
                channels[one.name] = writer.register_channel(one.name, "cdr", schema, about)
            for one, receipt, data in rows:
                writer.add_message(channels[one.name], receipt, data, receipt)
            writer.finish()

    def sqlite(self, file: Path, rows: list[tuple[Heard, int, bytes]]) -> None:
        """By sqlite_storage.cpp."""
        place = file.with_name("recording.db3")
        with closing(sqlite3.connect(place)) as db:
            if self.preset == "resilient":
                db.execute("PRAGMA journal_mode=WAL")
            db.executescript(TABLES)
            for k, one in enumerate(self.topics, 1):
                topic = one.name, one.msgtype, "cdr", yaml.safe_dump(QOS), one.hash
                db.execute("INSERT INTO topics VALUES (?, ?, ?, ?, ?, ?)", (k, *topic))
                known = one.of or one.msgtype, one.encoding, one.text, one.hash
                db.execute("INSERT INTO message_definitions VALUES (?, ?, ?, ?, ?)", (k, *known))
            for one, receipt, data in rows:
                packed = zstd.compress(data) if self.mode == "message" else data
                row = self.topics.index(one) + 1, receipt, packed
                db.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", row)
            db.commit()
            for end in ("", "-wal", "-shm") if self.killed else ():  # as they are now
                if (now := Path(f"{place}{end}")).exists():
                    Path(f"{file}{end}").write_bytes(now.read_bytes())
        for end in ("-wal", "-shm"):
            Path(f"{place}{end}").unlink(missing_ok=True)
        if self.killed:
            place.unlink()
        else:
            place.rename(file)

    def about(self, files: list[Path]) -> dict[str, Any]:
        """By metadata_io.hpp, version 9."""
        counts = {
            one.name: self.files * (one not in (SILENT, SILENT_COMMANDS)) for one in self.others
        }
        counts[JOINTS.name] = self.each * self.files
        total = sum(counts.values())
        return {
            "version": 9,
            "storage_identifier": self.storage,
            "duration": {"nanoseconds": (self.each * self.files - 1) * STEP},
            "starting_time": {"nanoseconds_since_epoch": START},
            "message_count": total,
            "topics_with_message_count": [
                {
                    "topic_metadata": {
                        "name": one.name,
                        "type": one.msgtype,
                        "serialization_format": "cdr",
                        "offered_qos_profiles": QOS,
                        "type_description_hash": one.hash,
                    },
                    "message_count": counts[one.name],
                }
                for one in self.topics
            ],
            "compression_format": "zstd" if self.mode else "",
            "compression_mode": self.mode.upper(),
            "relative_file_paths": [file.name for file in files],
            "files": [
                {
                    "path": file.name,
                    "starting_time": {"nanoseconds_since_epoch": START + self.each * k * STEP},
                    "duration": {"nanoseconds": (self.each - 1) * STEP},
                    "message_count": total // self.files,
                }
                for k, file in enumerate(files)
            ],
            "custom_data": None,
            "ros_distro": "jazzy",
        }
