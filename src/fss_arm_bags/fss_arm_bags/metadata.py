"""Compare a bag's metadata.yaml with its files."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from rosbags.interfaces import Qos
from rosbags.rosbag2.metadata import parse_qos

from fss_arm_bags.integrity import Contents, DamageError, profiles, qos
from fss_arm_bags.layout import file_names, listed_names
from fss_arm_model.files import read_yaml, short

TIME_TOLERANCE = 10**9  # [ns]


def read_metadata(path: Path) -> Mapping[str, Any]:
    """Return the contents of a bag's metadata.yaml.

    Raises:
        DamageError: it cannot be read, or does not describe a bag.
    """
    try:
        about = read_yaml(path / "metadata.yaml")["rosbag2_bagfile_information"]
    except FileNotFoundError:
        raise DamageError("it has no metadata.yaml") from None
    except Exception as error:  # not YAML, or values of the wrong type
        raise DamageError(f"metadata.yaml: {short(str(error).removeprefix(str(path)))}") from None
    if not isinstance(about, dict):
        raise DamageError(f"metadata.yaml describes the bag by {short(repr(about))}")
    return about


def file_list_problem(about: Mapping[str, Any], files: Iterable[Path]) -> str:
    """Return how the file list of metadata.yaml differs from the bag's files; empty: it does not.

    Whether files are compressed makes no difference.
    """
    try:
        return next(_listing(about, files), "")
    except Exception as error:  # values may be of any type
        return _interpretation_error(error)


def metadata_problem(
    about: Mapping[str, Any], files: Mapping[Path, Contents], hashes: Mapping[str, str]
) -> str:
    """Return the first difference between metadata.yaml and the bag's files; empty: none.

    Args:
        about: the contents of metadata.yaml.
        files: the contents of the files.
        hashes: RIHS01 of the types, by type name.
    """
    try:
        return next(_disagreements(about, files, hashes), "")
    except Exception as error:  # as above
        return _interpretation_error(error)


def _interpretation_error(error: Exception) -> str:
    return f"metadata.yaml cannot be interpreted: {short(repr(error))}"


def _differs(what: str, listed: object, actual: object) -> Iterator[str]:
    if listed != actual:
        yield f"{what} is {short(repr(listed))} in metadata.yaml, {short(repr(actual))} in files"


def _listing(about: Mapping[str, Any], files: Iterable[Path]) -> Iterator[str]:
    yield from _differs("the list of files", listed_names(about), file_names(files))


def _disagreements(
    about: Mapping[str, Any], files: Mapping[Path, Contents], hashes: Mapping[str, str]
) -> Iterator[str]:
    yield from _listing(about, files)
    yield from _differs("the storage", about["storage_identifier"], "mcap")
    if about["version"] not in range(1, 10):
        yield f"metadata.yaml has the unknown version {short(repr(about['version']))}"
    counts: Counter[tuple[str, str]] = Counter()
    offered: dict[tuple[str, str], list[Qos]] = {}
    for contents in files.values():
        messages_by_channel = (
            contents.statistics.channel_message_counts if contents.statistics else {}
        )
        for key, channel in contents.channels.items():
            name = channel.topic, contents.schemas[channel.schema_id].name
            counts[name] += messages_by_channel.get(key, 0)
            offered[name] = qos(channel)
    topics = [(t["topic_metadata"], t["message_count"]) for t in about["topics_with_message_count"]]
    listed = {(t["name"], t["type"]): count for t, count in topics if count}
    if any(contents.statistics is None for contents in files.values()):
        return
    yield from _differs("the number of messages by topic", listed, dict(+counts))
    yield from _differs("the number of messages", about["message_count"], counts.total())
    if len(listed) != sum(bool(count) for _, count in topics):
        yield "metadata.yaml lists a topic twice"
    for topic, _ in topics:
        name, kind = topic["name"], topic["type"]
        yield from _differs(f"{short(name)}'s format", topic["serialization_format"], "cdr")
        if digest := topic.get("type_description_hash"):
            yield from _differs(f"the hash of {short(kind)}", digest, hashes.get(kind, digest))
        if (name, kind) in offered:
            recorded = topic.get("offered_qos_profiles", [])
            recorded_qos = profiles(recorded) if isinstance(recorded, str) else parse_qos(recorded)
            yield from _differs(f"{short(name)}'s QoS", recorded_qos, offered[name, kind])
    if counts.total():
        ends = [s for c in files.values() if (s := c.statistics) and s.message_count]
        first = min(s.message_start_time for s in ends)
        last = max(s.message_end_time for s in ends)
        start = about["starting_time"]["nanoseconds_since_epoch"]
        duration = about["duration"]["nanoseconds"]
        if abs(start - first) > TIME_TOLERANCE or abs(start + duration - last) > TIME_TOLERANCE:
            yield "the times in metadata.yaml do not match the messages"
