"""The fast chunk reader gives the same as rosbags: overlapping and compressed chunks."""

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer
from rclpy.serialization import serialize_message
from ros_bags import START, joint_state
from rosbags.highlevel import AnyReader

from fss_arm_bags.chunks import MESSAGE, RECORD, ChunkError, indexed_chunks, records
from fss_arm_bags.definitions import definition
from fss_arm_bags.reader import open_bags

TYPE = "sensor_msgs/msg/JointState"


def make(folder, seed, count=300, compression=CompressionType.NONE, chunk=2000):
    """A file whose messages come up to 0.1 s out of order, on three topics, in many chunks."""
    rng = np.random.default_rng(seed)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"bag_{seed}.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=chunk, compression=compression)
        writer.start(profile="ros2", library="test")
        schema = writer.register_schema(TYPE, "ros2msg", definition(TYPE).text.encode())
        topics = [writer.register_channel(f"/topic_{k}", "cdr", schema) for k in range(3)]
        for k in range(count):
            at = START + 10**7 * k + int(rng.integers(0, 10**8))
            data = serialize_message(joint_state(k))
            writer.add_message(topics[k % 3], at, data, at, k)
        writer.finish()
    return path


def as_rosbags(paths, topics=None, start=None, stop=None):
    with AnyReader(paths) as reader:
        wanted = [c for c in reader.connections if topics is None or c.topic in topics]
        return [(c.topic, c.msgtype, t, d) for c, t, d in reader.messages(wanted, start, stop)]


@pytest.mark.parametrize(
    ("compression", "files"),
    [(CompressionType.NONE, 3), (CompressionType.LZ4, 1), (CompressionType.ZSTD, 1)],
)
def test_all_messages_are_read_in_order(tmp_path, compression, files):
    paths = [make(tmp_path, seed, compression=compression) for seed in range(files)]
    with open_bags(paths) as bags:
        assert len(indexed_chunks(bags._readers)) > 5 * files
        got = list(bags.raw())
    assert got == as_rosbags(paths)
    receipts = [receipt for _, _, receipt, _ in got]
    assert receipts == sorted(receipts)


@pytest.mark.parametrize("topics", [["/topic_1"], ["/topic_0", "/topic_2"], None])
def test_topics_and_times_are_selected(tmp_path, topics):
    path = make(tmp_path, 7)
    receipts = [receipt for _, _, receipt, _ in as_rosbags([path])]
    begin, end = receipts[100], receipts[200]  # exactly those of messages
    with open_bags(path) as bags:
        for start, stop in ((None, None), (begin, None), (None, end), (begin, end), (end, begin)):
            got = list(bags.raw(topics, start, stop))
            assert got == as_rosbags([path], topics, start, stop)


@pytest.mark.parametrize("size", range(1, RECORD.size))
def test_a_chunk_that_is_cut_off_is_damaged(size):
    record = RECORD.pack(MESSAGE, 4) + bytes(4)
    assert list(records(record)) == [(MESSAGE, RECORD.size, len(record))]
    with pytest.raises(ChunkError, match="the record at byte 13 of a chunk is cut off"):
        list(records(record + record[:size]))
