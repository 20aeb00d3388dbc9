"""Bags of the standard recorder, with all its options, complete and after a kill."""

import sqlite3
from contextlib import closing
from dataclasses import replace

import pytest
from ros_bags import states
from standard_bags import EVENTS, FEEDBACK, JOINTS, SILENT, SILENT_COMMANDS, UNDEFINED, Standard

from fss_arm_bags.doctor.command import main as doctor
from fss_arm_bags.reader import digest, open_bags

OPTIONS = {
    "mcap": Standard(),
    "fastwrite": Standard(preset="fastwrite"),
    "zstd_fast": Standard(preset="zstd_fast"),
    "mcap, each file packed": Standard(mode="file"),
    "sqlite3": Standard("sqlite3"),
    "sqlite3, each file packed": Standard("sqlite3", mode="file"),
    "sqlite3, each message packed": Standard("sqlite3", mode="message"),
    "sqlite3, resilient": Standard("sqlite3", preset="resilient"),
}
OLDER_TYPE = replace(UNDEFINED, name="/older", msgtype="std_msgs/msg/Empty")
LEFT_OUT = (FEEDBACK, *EVENTS, OLDER_TYPE)


@pytest.fixture(params=OPTIONS.values(), ids=OPTIONS)
def options(request):
    return request.param


def test_standard_bags_are_read_and_healthy(options, tmp_path, capsys):
    bag = replace(options, files=3, others=(SILENT, SILENT_COMMANDS)).record(tmp_path / "bag")
    with open_bags(bag) as bags:
        assert not bags.recovered
        assert not bags.left_out
        assert states(bags.messages()) == list(range(90))
        assert bags.topics[JOINTS.name].messages == 90
        assert bags.topics[JOINTS.name].hash == JOINTS.hash
    assert doctor([str(bag)]) == 2
    wrong = [line for line in capsys.readouterr().out.splitlines() if line.startswith("/")]
    assert wrong[-1] == f"{SILENT.name}: has no messages"
    assert not any(SILENT_COMMANDS.name in line for line in wrong if "no messages" in line)


def test_a_bag_killed_before_its_first_chunk_is_empty(tmp_path, capsys):
    bag = tmp_path / "bag"
    bag.mkdir()
    (bag / "bag_0.mcap").touch()
    assert doctor(["--repair", str(bag)]) == 2
    assert doctor([str(bag)]) == 2
    assert f"{bag}: contains no messages" in capsys.readouterr().out.splitlines()


def test_only_topics_that_cannot_be_decoded_are_left_out(options, tmp_path, capsys):
    bag = replace(options, others=(UNDEFINED, *LEFT_OUT)).record(tmp_path / "bag")
    with open_bags(bag) as bags:
        assert not bags.recovered
        assert set(bags.topics) == {JOINTS.name, UNDEFINED.name}
        assert {line.partition(": ")[2].partition(" ")[0] for line in bags.left_out} == {
            one.name for one in LEFT_OUT
        }
        messages = list(bags.messages())
    assert states(messages) == list(range(30))
    assert [m.data for topic, _, _, m in messages if topic == UNDEFINED.name] == ["a text"]
    assert doctor([str(bag)]) == 2
    assert f"{FEEDBACK.name} is left out" in capsys.readouterr().out


def test_a_bag_is_read_after_a_kill(options, tmp_path, capsys):
    others = (UNDEFINED, *LEFT_OUT)
    bag = replace(options, files=2, killed=True, others=others).record(tmp_path / "bag")
    with open_bags(bag) as bags:
        (recovered,) = bags.recovered
        read = states(bags.messages())
        assert set(bags.topics) == {JOINTS.name, UNDEFINED.name}
    assert recovered.path == bag
    assert "it has no metadata.yaml" in str(recovered) or "without an index" in str(recovered)
    assert read == list(range(len(read)))
    assert len(read) == 60 if options.storage == "sqlite3" else 30 < len(read) <= 60
    assert doctor([str(bag)]) == 2
    can_repair = options.storage == "mcap" and not options.mode
    advice = "doctor --repair" if can_repair else "ros2 bag reindex"
    assert f"repair it with {advice}" in capsys.readouterr().out
    doctor(["--repair", str(bag)])
    assert ("repaired" in capsys.readouterr().out) == can_repair


def test_compressed_bags_have_different_digests(tmp_path):
    variants = [replace(OPTIONS["mcap, each file packed"], each=each) for each in (10, 11)]
    bags = [one.record(tmp_path / str(one.each)) for one in variants]
    assert len({digest(bag) for bag in bags}) == 2


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_partly_compressed_file_counts_once(tmp_path, storage):
    bag = Standard(storage, mode="file", files=2).record(tmp_path / "bag")
    last = sorted(bag.glob("*.zstd"))[-1]
    whole = Standard(storage, files=2).record(tmp_path / "whole")
    packed = last.read_bytes()
    (bag / last.stem).write_bytes((whole / last.stem.replace("bag_", "whole_")).read_bytes())
    last.write_bytes(packed[: len(packed) // 2])
    with open_bags(bag) as bags:
        assert states(bags.messages()) == list(range(60))


def test_the_start_of_a_truncated_compressed_file_is_read(tmp_path):
    bag = replace(OPTIONS["mcap, each file packed"], each=3000).record(tmp_path / "bag")
    (file,) = bag.glob("*.zstd")
    file.write_bytes(file.read_bytes()[:-10_000])
    with open_bags(bag) as bags:
        (recovered,) = bags.recovered
        read = states(bags.messages())
    assert recovered.path == bag
    assert read == list(range(len(read)))
    assert 100 < len(read) < 3000


def test_sqlite_bags_do_not_need_the_qos_of_metadata(tmp_path):
    """rosbags silently drops a topic if its QoS differs in metadata.yaml."""
    bag = OPTIONS["sqlite3"].record(tmp_path / "bag")
    metadata = bag / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("depth: 10", "depth: 11"))
    with open_bags(bag) as bags:
        assert states(bags.messages()) == list(range(30))


def test_a_bag_without_definitions_is_read_with_installed_ones(tmp_path):
    """Humble writes such bags: version 3 of the tables."""
    bag = OPTIONS["sqlite3"].record(tmp_path / "bag")
    with closing(sqlite3.connect(next(bag.glob("*.db3")))) as db, db:
        db.execute("DROP TABLE message_definitions")
        db.execute("ALTER TABLE topics DROP COLUMN type_description_hash")
        db.execute("UPDATE schema SET schema_version = 3")
    with open_bags(bag) as bags:
        assert states(bags.messages()) == list(range(30))
    assert doctor([str(bag)]) == 0
