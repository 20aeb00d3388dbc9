"""Bags: written, read by others, cut anywhere, and read again."""

import re
import shutil
from errno import EPERM
from os import strerror
from pathlib import Path
from zlib import crc32

import pytest
import yaml
from damaged_bags import make_plain, places
from mcap.reader import make_reader
from mcap.records import Chunk, DataEnd, Footer
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import Writer as McapWriter
from rclpy.serialization import serialize_message
from ros_bags import START, STEP, fill, joint_state, make_bag, make_killed_bag, states
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from std_msgs.msg import String

from fss_arm_bags.definitions import definition
from fss_arm_bags.doctor.command import main as doctor
from fss_arm_bags.doctor.repair import repair
from fss_arm_bags.inspection import is_sound
from fss_arm_bags.integrity import examine
from fss_arm_bags.reader import BagError, digest, find_bags, open_bags
from fss_arm_bags.recorder import Limits, Recording, bag_qos, next_bag
from fss_arm_model.units import SECOND
from fss_arm_ros.qos import LATCHED, SENSOR


def test_rosbags_reads_what_was_written(tmp_path):
    bag = make_bag(tmp_path)
    with AnyReader([bag]) as reader:  # which checks the type hashes against the definitions
        by_topic = {c.topic: c for c in reader.connections}
        assert by_topic["/joint_states"].msgcount == 100
        assert by_topic["/joint_states"].digest == definition("sensor_msgs/msg/JointState").hash
        assert by_topic["/joint_states"].ext.offered_qos_profiles == [bag_qos(SENSOR)]
        text = by_topic["/robot_description"].ext.offered_qos_profiles[0]
        assert text.durability == QosDurability.TRANSIENT_LOCAL
        got = [
            (t, reader.deserialize(raw, c.msgtype))
            for c, t, raw in reader.messages([by_topic["/joint_states"]])
        ]
    for k, (t, message) in enumerate(got):
        sent = joint_state(k)
        assert t == START + k * SECOND // 100
        assert message.header.stamp.nanosec == sent.header.stamp.nanosec
        assert message.name == sent.name
        assert message.position.tolist() == sent.position.tolist()
        assert message.effort.tolist() == sent.effort.tolist()


def test_bags_are_numbered_consecutively(tmp_path):
    assert [make_bag(tmp_path, 1).name for _ in range(3)] == ["bag_0", "bag_1", "bag_2"]
    (tmp_path / "bag_11").mkdir()
    (tmp_path / "bag_old").mkdir()
    assert next_bag(tmp_path).name == "bag_12"


def test_a_bag_is_rejected_as_a_folder_for_bags(tmp_path):
    with pytest.raises(FileExistsError, match="is a bag itself"):
        Recording(make_bag(tmp_path))


def test_numbered_bags_are_read_as_one_even_if_killed(tmp_path):
    for number in range(12):
        make = make_killed_bag if number % 3 == 1 else make_bag
        make(tmp_path, 10, first=10 * number)
    with open_bags(tmp_path) as bags:
        assert [path.name for path in bags.paths] == [f"bag_{n}" for n in range(12)]
        assert len(bags.recovered) == 4
        assert states(bags.messages(["/joint_states"])) == list(range(120))
        assert bags.topics["/joint_states"].messages == 120
        receipts = [receipt for _, _, receipt, _ in bags.raw()]
    assert receipts == sorted(receipts)


def test_several_paths_are_read_as_one(tmp_path):
    late, early = make_bag(tmp_path / "a", 10, first=10), make_bag(tmp_path / "b", 10)
    with open_bags([late, early / "bag_0.mcap"]) as bags:
        assert states(bags.messages()) == list(range(20))
        assert list(bags.raw(["/no_such"])) == []


def test_a_bag_without_messages(tmp_path):
    Recording(tmp_path).close()
    Recording(tmp_path).abort()
    with open_bags(tmp_path) as bags:
        assert bags.topics == {}
        assert list(bags.messages()) == []


def chunk_ends(file):
    return [end for kind, _, end in places(file.read_bytes()) if kind == 6]


def overwrite_with_zeros(file, begin, end):
    """Overwrite a part of a file with zeros, like blocks that a disk has lost."""
    data = bytearray(file.read_bytes())
    data[begin:end] = bytes(end - begin)
    file.write_bytes(data)


def test_a_file_cut_anywhere_keeps_its_complete_chunks(tmp_path):
    whole = make_bag(tmp_path / "whole", 20)
    data = (whole / "bag_0.mcap").read_bytes()
    ends, chunks = [8, *(end for _, _, end in places(data))], chunk_ends(whole / "bag_0.mcap")
    assert len(chunks) == 2
    around = {end + d for end in ends[::5] for d in (-1, 0, 5) if 0 <= end + d < len(data)}
    for cut in sorted({0, 1, 7, *around, *range(8, len(data), 29_989)}):
        bag = tmp_path / f"cut_{cut}"
        bag.mkdir()
        (bag / "bag_0.mcap").write_bytes(data[:cut])
        with open_bags(bag) as bags:
            assert states(bags.messages()) == list(range(10 * sum(c <= cut for c in chunks)))
            assert len(bags.recovered) == 1
        shutil.rmtree(bag)


def test_repair_makes_a_standard_bag_and_keeps_the_damaged_file(tmp_path):
    """The file ends in zeros, as after a loss of power."""
    bag = make_killed_bag(tmp_path)
    before = (bag / "bag_0.mcap").read_bytes() + bytes(4096)
    (bag / "bag_0.mcap").write_bytes(before)
    assert not is_sound(bag)
    recovered = repair(bag)
    assert recovered is not None
    assert recovered.messages == 101
    assert (bag / "bag_0.mcap.damaged").read_bytes() == before
    files = {p.name for p in bag.iterdir()}
    assert files == {"bag_0.mcap", "bag_0.mcap.damaged", "metadata.yaml"}
    with Reader(bag) as reader:
        assert reader.message_count == 101
        (joints,) = (c for c in reader.connections if c.topic == "/joint_states")
        assert joints.ext.offered_qos_profiles == [bag_qos(SENSOR)]
    assert repair(bag) is None
    with open_bags(tmp_path) as bags:
        assert states(bags.messages()) == list(range(100))
    (file,) = make_killed_bag(tmp_path / "file").iterdir()
    repair(file)  # without its folder
    with Reader(file) as reader:
        assert reader.message_count == 101


def no_link(*_):
    raise PermissionError(EPERM, strerror(EPERM))


@pytest.mark.parametrize("place", ["here", "exFAT"])
def test_repair_of_a_bag_whose_files_have_other_names(tmp_path, monkeypatch, place):
    """Names and splits of `ros2 bag record`; also on a file system without hard links."""
    bag = tmp_path / "monday"
    bag.mkdir()
    for part in range(2):
        made = make_killed_bag(tmp_path / "made", 50, first=50 * part)
        (made / f"{made.name}.mcap").rename(bag / f"bag_{part}.mcap")
    before = [(bag / f"bag_{part}.mcap").read_bytes() for part in range(2)]
    if place == "exFAT":
        monkeypatch.setattr("fss_arm_bags.doctor.repair.link", no_link)
    assert repair(bag).messages == 102
    assert [(bag / f"bag_{part}.mcap.damaged").read_bytes() for part in range(2)] == before
    assert not (bag / "bag_1.mcap").exists()
    assert is_sound(bag)
    assert digest(bag) == digest(bag / "bag_0.mcap")
    with open_bags(bag) as bags:
        assert states(bags.messages()) == list(range(100))


def make_bag_with_damaged_chunk(folder):
    """Make a bag whose last chunk is damaged."""
    bag = make_bag(folder)
    ends = chunk_ends(bag / "bag_0.mcap")
    overwrite_with_zeros(bag / "bag_0.mcap", ends[-1] - 300, ends[-1] - 100)
    return bag


@pytest.mark.parametrize("step", ["metadata.yaml", "bag_0.mcap"])
@pytest.mark.parametrize(
    ("make", "count"), [(make_killed_bag, 101), (make_bag_with_damaged_chunk, 91)]
)
def test_an_interrupted_repair_can_be_repeated(tmp_path, monkeypatch, step, make, count):
    bag = make(tmp_path)
    before = {file.name: file.read_bytes() for file in bag.iterdir()}
    replace = Path.replace

    def interrupted(file, target):
        if target == bag / step:
            raise KeyboardInterrupt
        return replace(file, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", interrupted)
        with pytest.raises(KeyboardInterrupt):
            repair(bag)
    assert (bag / "bag_0.mcap.damaged").exists()
    assert repair(bag).messages == count
    assert repair(bag) is None
    kept = {file.stem: file.read_bytes() for file in bag.glob("*.damaged")}
    assert kept == before


def test_repair_does_not_overwrite_an_earlier_damaged_file(tmp_path):
    bag = make_killed_bag(tmp_path)
    kept = bag / "bag_0.mcap.damaged"
    kept.write_text("of an earlier repair")
    with pytest.raises(FileExistsError):
        repair(bag)
    assert kept.read_text() == "of an earlier repair"
    assert not is_sound(bag)


def test_a_bag_still_being_recorded_is_not_repaired(tmp_path, capsys):
    recording = Recording(tmp_path)
    fill(recording, 45)
    assert doctor([str(tmp_path), "--repair"]) == 1
    said = capsys.readouterr().err
    assert said == f"doctor: {recording.path}: is being recorded; stop the recorder first\n"
    assert doctor([str(tmp_path)]) == 2  # reading is possible
    with open_bags(recording.path) as bags:
        assert states(bags.messages()) == list(range(40))
    recording.close()
    assert is_sound(recording.path)
    assert not list(recording.path.glob("*.damaged"))


def test_invalid_paths_are_named(tmp_path):
    text = tmp_path / "text.mcap"
    text.write_text("this is not a bag, whatever its name says")
    empty = tmp_path / "empty"
    empty.mkdir()
    other = tmp_path / "text.txt"
    other.write_text("neither is this")
    for path, wrong in [
        (tmp_path / "none", "no such file"),
        (empty, "contains no bag"),
        (text, "not an MCAP file"),
        (other, r"no bag, expected a folder or a file \.mcap, \.db3"),
    ]:
        with pytest.raises(BagError, match=wrong) as error:
            open_bags(path)
        assert str(error.value).count(path.name) == 1
        assert str(path) in str(error.value)
    with pytest.raises(BagError, match="no bag is given"):
        open_bags([])


def test_a_chunk_with_a_wrong_checksum_is_left_out(tmp_path):
    """All of it could be decoded: a digit of one message has changed."""
    file = make_bag(tmp_path) / "bag_0.mcap"
    data, effort = bytearray(file.read_bytes()), joint_state(45).effort.tobytes()
    data[data.index(effort)] ^= 1
    file.write_bytes(data)
    with open_bags(tmp_path) as bags:
        assert states(bags.messages()) == [*range(40), *range(50, 100)]
        assert len(bags.recovered) == 1


@pytest.mark.parametrize("chunks", [(0, 0), (3, 3), (4, 6), (9, 9)])
def test_the_advised_repair_of_a_damaged_bag_works(tmp_path, capsys, chunks):
    bag = make_bag(tmp_path)
    make_bag(tmp_path, 10, first=100)
    first, last = chunks
    kept = [k for k in range(110) if not 10 * first <= k < 10 * (last + 1)]
    ends = chunk_ends(bag / "bag_0.mcap")  # of these chunks and of what is between them
    overwrite_with_zeros(bag / "bag_0.mcap", ends[first] - 300, ends[last] - 100)
    before = {file.name: file.read_bytes() for file in bag.iterdir()}
    with open_bags(bag) as bags:
        assert states(bags.messages()) == [k for k in kept if k < 100]
        (recovered,) = bags.recovered
    lost = f"its data are damaged, {101 - recovered.messages} messages are missing, "
    assert recovered.damage.startswith(lost if first else "its data are damaged")
    assert doctor([str(tmp_path)]) == 2
    assert "repair it with doctor --repair" in capsys.readouterr().out
    doctor([str(tmp_path), "--repair"])
    said = capsys.readouterr()
    assert said.err == ""
    count = len(kept) - 10 + (first > 0)  # the text is in the first chunk
    assert re.search(f"repaired: {bag}: {count} messages recovered, [1-9]", said.out)
    assert {name: (bag / f"{name}.damaged").read_bytes() for name in before} == before
    with open_bags(tmp_path) as bags:
        assert states(bags.messages()) == kept
        assert len(bags.topics["/robot_description"].qos) == 2
    with Reader(bag) as reader:
        assert reader.message_count == count
    assert repair(bag) is None


def test_messages_of_a_lost_type_count_as_lost(tmp_path, capsys):
    bag = make_killed_bag(tmp_path, 30)
    ends = chunk_ends(bag / "bag_0.mcap")
    # The first chunk is the only one with schemas and channels.
    overwrite_with_zeros(bag / "bag_0.mcap", ends[0] - 300, ends[0])
    with open_bags(bag) as bags:
        assert list(bags.raw()) == []
        (recovered,) = bags.recovered
    assert recovered.messages == 0
    assert recovered.lost > ends[0] / 2
    assert doctor([str(bag)]) == 2
    assert "0 messages recovered" in capsys.readouterr().out


def test_doctor_reports_and_sets_its_exit_code(tmp_path, capsys):
    good, bad = make_bag(tmp_path / "good"), make_killed_bag(tmp_path / "bad")
    assert doctor([str(good)]) == 0
    said = capsys.readouterr().out
    assert "101 messages, 0.990 s" in said
    assert "/joint_states" in said
    assert "100.00" in said
    assert "healthy" in said
    assert doctor([str(good), str(bad)]) == 2
    assert "101 messages recovered" in capsys.readouterr().out
    assert doctor([str(bad), "--repair"]) == 0
    assert doctor([str(bad)]) == 0
    assert doctor([str(tmp_path / "none")]) == 1
    assert "no such file" in capsys.readouterr().err
    file = good / "bag_0.mcap"
    file.write_bytes(file.read_bytes()[:100])
    assert doctor([str(good)]) == 2
    assert "; nothing can be recovered" in capsys.readouterr().out


def test_doctor_examines_all_bags_also_after_one_that_is_not_readable(tmp_path, capsys):
    good, bad = make_bag(tmp_path / "good"), make_killed_bag(tmp_path / "bad")
    none, text = tmp_path / "none", tmp_path / "notes.txt"
    text.write_text("no bag")
    assert doctor([str(none), str(text), str(good)]) == 1
    said = capsys.readouterr()
    assert "101 messages" in said.out
    assert [line.partition(" no ")[0] for line in said.err.splitlines()] == [
        f"doctor: {none}:",
        f"doctor: {text}:",
    ]
    assert doctor([str(none), str(bad)]) == 2


def test_doctor_prints_brackets_in_names_of_topics(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("fss_arm_bags.doctor.command.remark", lambda _: "remarkable")
    recording = Recording(tmp_path)
    recording.add("/a[red]b", "std_msgs/msg/String", [LATCHED])
    recording.write("/a[red]b", START, serialize_message(String(data="arm")))
    recording.close()
    assert doctor([str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert said.count("/a[red]b") == 2  # in the table and with the remark
    assert "remarkable: /a[red]b" in said


@pytest.mark.parametrize("limits", [Limits(size=20_000), Limits(span=SECOND)])
def test_a_split_recording_is_read_as_one(tmp_path, limits):
    recording = Recording(tmp_path, limits)
    fill(recording, 350)
    recording.close()
    bags = find_bags(tmp_path)
    assert len(bags) > 2
    for bag in bags:
        assert bag.stat().st_size
        assert is_sound(bag)
        with Reader(bag) as reader:  # each has all topics
            assert {c.topic for c in reader.connections} == {"/joint_states", "/robot_description"}
            assert reader.duration <= (limits.span or reader.duration)
            size = (bag / f"{bag.name}.mcap").stat().st_size
            assert size <= (2 * limits.size or size)  # what a chunk and the index add
    with open_bags(tmp_path) as whole:
        assert states(whole.messages()) == list(range(350))
        assert whole.topics["/robot_description"].messages == 1


def test_recorded_bags_have_checksums(tmp_path):
    file = make_bag(tmp_path) / "bag_0.mcap"
    contents = examine(file)
    assert contents.checked
    with file.open("rb") as stream:  # the MCAP library's own reader checks them
        found = list(StreamReader(stream, emit_chunks=True, validate_crcs=True).records)
    (closing,) = (r for r in found if isinstance(r, DataEnd))
    (footer,) = (r for r in found if isinstance(r, Footer))
    chunks = [r for r in found if isinstance(r, Chunk)]
    assert len(chunks) == 10
    assert all(c.uncompressed_crc for c in chunks)
    assert closing.data_section_crc
    for chunk in chunks:
        breakup_chunk(chunk, validate_crc=True)
    data = file.read_bytes()
    assert footer.summary_crc == crc32(data[footer.summary_start : -12])


def test_a_bag_without_checksums_is_healthy_with_a_remark(tmp_path, capsys):
    bag = make_plain(tmp_path)
    assert doctor([str(bag)]) == 0
    said = capsys.readouterr().out
    assert f"{bag}: not all data have checksums" in said
    assert doctor([str(make_bag(tmp_path))]) == 0
    assert "data have checksums" not in capsys.readouterr().out


def test_our_bags_have_the_standard_layout(tmp_path):
    bag = make_bag(tmp_path)
    information = yaml.safe_load((bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert information["version"] == 9
    assert information["storage_identifier"] == "mcap"
    assert information["relative_file_paths"] == ["bag_0.mcap"]
    assert information["message_count"] == 101
    names = [t["topic_metadata"]["name"] for t in information["topics_with_message_count"]]
    assert names == ["/robot_description", "/joint_states"]
    with (bag / "bag_0.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        for channel in reader.get_summary().channels.values():
            assert channel.message_encoding == "cdr"
            assert "offered_qos_profiles" in channel.metadata
        assert {s.encoding for s in reader.get_summary().schemas.values()} == {"ros2msg"}
        assert [m.name for m in reader.iter_metadata()] == ["rosbag2"]


def test_only_the_topic_with_another_hash_is_left_out(tmp_path, capsys):
    """Other tools write such bags; rosbags rejects the whole bag."""
    bag, good, odd = tmp_path / "bag", "sensor_msgs/msg/JointState", "std_msgs/msg/String"
    with Writer(bag, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        text, hash_ = definition(good)
        joints = writer.add_connection("/joint_states", good, msgdef=text, rihs01=hash_)
        hash_ = "RIHS01_" + 64 * "0"
        said = writer.add_connection("/odd", odd, msgdef=definition(odd).text, rihs01=hash_)
        for k in range(10):
            writer.write(joints, START + k * STEP, serialize_message(joint_state(k)))
            writer.write(said, START + k * STEP, serialize_message(String(data="odd")))
    with open_bags(bag) as bags:
        assert states(bags.messages()) == list(range(10))
        assert set(bags.topics) == {"/joint_states"}
        (left_out,) = bags.left_out
    assert "/odd is left out" in left_out
    assert "std_msgs/msg/String does not have the hash RIHS01_000" in left_out
    assert doctor([str(bag)]) == 2
    assert "/odd is left out" in capsys.readouterr().out


def test_a_topic_left_out_of_one_bag_is_read_from_the_next(tmp_path):
    """Its messages in the first bag, of another version without definition, are not decoded."""
    kind = "std_msgs/msg/String"
    for k, (text, hash_) in enumerate([("", "RIHS01_" + 64 * "0"), definition(kind)[:2]]):
        (tmp_path / f"bag_{k}").mkdir()
        with (tmp_path / f"bag_{k}" / "bag_0.mcap").open("wb") as stream:
            writer = McapWriter(stream)
            writer.start(profile="ros2", library="test")
            schema = writer.register_schema(kind, "ros2msg" if text else "", text.encode())
            hashes = {"topic_type_hash": hash_}
            topic = writer.register_channel("/older", "cdr", schema, metadata=hashes)
            data = serialize_message(String(data=f"bag_{k}"))
            writer.add_message(topic, START + k, data, START + k)
            writer.finish()
    with open_bags(tmp_path) as bags:
        (left_out,) = bags.left_out
        assert "bag_0: /older is left out" in left_out
        assert bags.topics["/older"].messages == 1
        assert [message.data for *_, message in bags.messages()] == ["bag_1"]


def test_a_bag_that_cannot_be_repaired_does_not_keep_others_from_it(tmp_path, capsys):
    recorded = Recording(tmp_path)
    fill(recorded, 100)
    recorded.flush()
    make_killed_bag(tmp_path)
    assert doctor([str(tmp_path), "--repair"]) == 1
    said = capsys.readouterr()
    assert "bag_0: is being recorded" in said.err
    assert f"repaired: {tmp_path / 'bag_1'}" in said.out
    recorded.close()
