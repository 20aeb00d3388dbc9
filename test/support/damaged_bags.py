"""Damaged copies of bags, and what becomes of each: read, looked at and repaired by `doctor`.

Run by itself it prints a table, also when it is interrupted: damaged_bags.py --count 1000
"""

import argparse
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from io import StringIO
from itertools import islice
from pathlib import Path
from shutil import copytree, rmtree
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
import yaml
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rclpy.serialization import serialize_message
from ros_bags import FIRST, START, STEP, joint_state, make_bag, make_killed_bag
from rosbags.rosbag2 import StoragePlugin, Writer
from std_msgs.msg import String

from fss_arm_bags.definitions import definition
from fss_arm_bags.doctor.command import main as doctor
from fss_arm_bags.reader import BagError, open_bags
from fss_arm_bags.recorder import bag_qos
from fss_arm_ros.qos import LATCHED, SENSOR

PATIENCE = 10.0  # [s] of the processor's time within which each step must end
TYPES = {
    "/robot_description": ("std_msgs/msg/String", LATCHED),
    "/joint_states": ("sensor_msgs/msg/JointState", SENSOR),
}

Rng = np.random.Generator


def told(count: int = 100) -> Iterator[tuple[int, str, bytes]]:
    """Times of receipt, topics and messages as `make_bag` has them."""
    yield START, "/robot_description", serialize_message(String(data="arm"))
    for k in range(count):
        yield START + k * STEP, "/joint_states", serialize_message(joint_state(k))


def make_plain(folder: Path) -> Path:
    """A bag as rosbags writes it: no checksums."""
    with Writer(folder / "plain", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topics = {}
        for topic, (msgtype, qos) in TYPES.items():
            text, digest = definition(msgtype)
            topics[topic] = writer.add_connection(
                topic, msgtype, msgdef=text, rihs01=digest, offered_qos_profiles=[bag_qos(qos)]
            )
        for k, (receipt, topic, data) in enumerate(told()):
            writer.write(topics[topic], receipt, data)
            if k % 10 == 0 and k:
                writer.storage.close_chunk()
    return folder / "plain"


def make_standard(folder: Path) -> Path:
    """A file as the standard recorder writes it: checksums of chunks and summary; compressed."""
    path = folder / "standard.mcap"
    folder.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as stream:
        writer = McapWriter(stream, chunk_size=1000, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library="other")
        topics = {}
        for topic, (msgtype, _) in TYPES.items():
            schema = writer.register_schema(msgtype, "ros2msg", definition(msgtype).text.encode())
            topics[topic] = writer.register_channel(topic, "cdr", schema)
        for receipt, topic, data in told():
            writer.add_message(topics[topic], receipt, data, receipt)
        writer.finish()
    return path


def make_first(folder: Path) -> Path:
    return Path(copytree(FIRST, folder / "first"))


BAGS: dict[str, Callable[[Path], Path]] = {
    "recorded": make_bag,
    "killed": make_killed_bag,
    "plain": make_plain,
    "standard": make_standard,
    "first": make_first,
}
#: Bags without checksums.
UNCHECKED = "plain", "first"


def storage(bag: Path) -> Path:
    return bag if bag.is_file() else next(bag.glob("*.mcap"))


def edit(file: Path, change: Callable[[bytearray], Any]) -> None:
    data = bytearray(file.read_bytes())
    changed = change(data)
    file.write_bytes(data if changed is None else changed)


def places(data: bytes) -> list[tuple[int, int, int]]:
    """Kind, begin and end of the records of a whole file."""
    found, at = [], 8
    while at < len(data) - 8:
        end = at + 9 + int.from_bytes(data[at + 1 : at + 9], "little")
        found.append((data[at], at, end))
        at = end
    return found


def flip(rng: Rng, data: bytearray) -> None:
    for _ in range(rng.integers(1, 4)):
        data[rng.integers(len(data))] ^= 1 << int(rng.integers(8))


def a_range(rng: Rng, data: bytearray) -> slice:
    at = int(rng.integers(len(data)))
    return slice(at, min(at + int(10 ** rng.uniform(0, 4)), len(data)))


def zeros(rng: Rng, data: bytearray) -> None:
    place = a_range(rng, data)
    data[place] = bytes(place.stop - place.start)


def noise(rng: Rng, data: bytearray) -> None:
    place = a_range(rng, data)
    data[place] = rng.bytes(place.stop - place.start)


def cut(rng: Rng, data: bytearray) -> None:
    del data[int(rng.integers(len(data))) :]


def cut_out(rng: Rng, data: bytearray) -> None:
    del data[a_range(rng, data)]


def length(rng: Rng, data: bytearray) -> None:
    records = places(data)
    _, at, _ = records[int(rng.integers(len(records)))]
    many = [2**63, 2**63 - 1, 2**64 - 1, 2**40, len(data), 0, 1, 10**6]
    data[at + 1 : at + 9] = int(rng.choice(np.array(many, np.uint64))).to_bytes(8, "little")


def size_within(rng: Rng, data: bytearray) -> None:
    """Lengths and times within records: any four or eight bytes of a record's first forty."""
    records = [r for r in places(data) if r[2] - r[1] > 20]
    _, at, end = records[int(rng.integers(len(records)))]
    size = int(rng.choice([4, 8]))
    place = at + 9 + int(rng.integers(min(40, end - at - 9 - size)))
    data[place : place + size] = bytes([0xFF] * (size - 1) + [int(rng.choice([0x7F, 0xFF]))])


def chunks(rng: Rng, data: bytearray) -> bytes:
    """One removed, doubled or swapped with another, with or without its index."""
    records = places(data)
    firsts = [k for k, (kind, *_) in enumerate(records) if kind == 6]
    groups = []
    index = bool(rng.integers(2))
    for k in firsts:
        last = k
        while index and last + 1 < len(records) and records[last + 1][0] == 7:
            last += 1
        groups.append((records[k][1], records[last][2]))
    one, other = sorted(rng.choice(len(groups), 2, replace=len(groups) < 2))
    (a, b), (c, d) = groups[one], groups[other]
    match rng.integers(3):
        case 0:
            return bytes(data[:a] + data[b:])
        case 1:
            return bytes(data[:d] + data[a:b] + data[d:])
        case _:
            return bytes(data[:a] + data[c:d] + data[b:c] + data[a:b] + data[d:])


def hostile(rng: Rng, data: bytearray) -> bytes:
    """A metadata.yaml as somebody might write it who means no good."""
    text = data.decode()
    whole = yaml.safe_load(text)
    about = whole["rosbag2_bagfile_information"]
    match rng.integers(14):
        case 0:
            return b"[" * 10 ** int(rng.integers(1, 6))
        case 1:
            deep = "{a: " * 3000 + "1" + "}" * 3000
            return f"{text.rstrip()}\n  deep: {deep}\n".encode()
        case 2:
            numbers = [10**30, -1, 2**63, float("inf"), float("nan"), 1.5, 10**400]
            key = rng.choice(["message_count", "version"])
            about[key] = numbers[rng.integers(len(numbers))]
        case 3:
            number = [10**30, -1, 2**64, 1.5][rng.integers(4)]
            about["duration"] = about["starting_time"] = {
                "nanoseconds": number,
                "nanoseconds_since_epoch": number,
            }
        case 4:
            key = list(about)[rng.integers(len(about))]
            about[key] = [None, [], {}, "text", 1, [1, 2], {"a": 1}, True][rng.integers(8)]
        case 5:
            outside = ["../x.mcap", "/etc/passwd", "..", "", "/", ".", "a\0b", "x" * 5000]
            about["relative_file_paths"] = [outside[rng.integers(len(outside))]]
        case 6:
            return b"rosbag2_bagfile_information:\n  x:\n" + b"  - 1\n" * 10**6
        case 7:
            topics = about["topics_with_message_count"]
            topic = topics[rng.integers(len(topics))]["topic_metadata"]
            key = list(topic)[rng.integers(len(topic))]
            topic[key] = [None, [], "x" * 10000, 7, {"a": []}, [[[]]]][rng.integers(6)]
        case 8:
            topics = about["topics_with_message_count"]
            if rng.integers(2):
                topics.pop(int(rng.integers(len(topics))))
            else:
                topics.append(topics[rng.integers(len(topics))])
        case 9:
            return b"a: &a [x, x, x, x, x, x, x, x, x]\n" + b"".join(
                b"%c: &%c [*%c, *%c, *%c, *%c, *%c, *%c, *%c, *%c]\n" % (k + 1, k + 1, *[k] * 8)
                for k in range(97, 120)
            )
        case 10:
            about["relative_file_paths"] *= int(rng.choice([0, 2, 1000]))
        case 11:
            return bytes(rng.bytes(int(rng.integers(1, 5000))))
        case 12:
            return b"rosbag2_bagfile_information: !!python/object/apply:os.system [exit 3]\n"
        case _:
            del about[list(about)[rng.integers(len(about))]]
    return yaml.safe_dump(whole).encode()


#: Of the storage file, and of metadata.yaml.
DAMAGES: dict[str, tuple[str, Callable[[Rng, bytearray], Any]]] = {
    "bits flipped": ("mcap", flip),
    "bytes zeroed": ("mcap", zeros),
    "bytes overwritten": ("mcap", noise),
    "cut": ("mcap", cut),
    "bytes cut out": ("mcap", cut_out),
    "lengths": ("mcap", length),
    "sizes, times": ("mcap", size_within),
    "chunks": ("mcap", chunks),
    "metadata hostile": ("yaml", hostile),
    "metadata bits": ("yaml", flip),
    "metadata cut": ("yaml", cut),
}


def replaced(rng: Rng, bag: Path) -> None:
    """A file emptied, removed, or a folder in its place."""
    files = [bag] if bag.is_file() else sorted(bag.iterdir())
    file = files[rng.integers(len(files))]
    match rng.integers(3):
        case 0:
            file.write_bytes(b"")
        case 1:
            file.unlink()
            file.mkdir()
        case _:
            file.unlink()


class Case(NamedTuple):
    bag: str
    damage: str
    seed: int


def cases(bags: Any = BAGS, first: int = 0) -> Iterator[Case]:
    """Ever more cases, kind after kind."""
    seed = first
    while True:
        for bag in bags:
            for damage in [*DAMAGES, "files replaced"]:
                if damage.startswith("metadata") and bag in ("killed", "standard"):
                    continue
                yield Case(bag, damage, seed)
                seed += 1


def damage(case: Case, bag: Path) -> None:
    """Damage a bag."""
    rng = np.random.default_rng(case.seed)
    if case.damage not in DAMAGES:
        replaced(rng, bag)
        return
    kind, change = DAMAGES[case.damage]
    file = storage(bag) if kind == "mcap" else bag / "metadata.yaml"
    edit(file, lambda data: change(rng, data))


class Hang(BaseException):
    """A step took too long."""


@contextmanager
def within(seconds: float) -> Iterator[None]:
    def over(*_: Any) -> None:
        raise Hang

    before = signal.signal(signal.SIGPROF, over)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def contents(bag: Path) -> tuple[list[Any], Any, list[str]]:
    """All messages in order, what is known of the topics, and what is said of damage."""
    with open_bags(bag) as bags:
        topics = {n: (t.msgtype, t.messages, t.definition, t.qos) for n, t in bags.topics.items()}
        messages = list(bags.raw())
        for topic, _, _, data in messages:
            bags.deserialize(data, bags.topics[topic].msgtype)
        return messages, topics, [str(r) for r in bags.recovered]


def same_but_bytes(messages: list[Any], topics: Any, whole: Any) -> bool:
    """Return True if only serialized bytes differ from the whole bag, none of them in length."""
    some, others = ([(*m[:3], len(m[3])) for m in one] for one in (messages, whole[0]))
    return bool(topics == whole[1] and some == others)


REPORTED, UNDETECTABLE, REFUSED = "reported", "undetectable", "refused"
TRACEBACK, HANG, SILENT = "TRACEBACK", "HANG", "SILENT"
LONG, UNSEEN = "REFUSED AT LENGTH", "UNSEEN"
WRONG = TRACEBACK, HANG, SILENT, LONG, UNSEEN


def attempt(step: Callable[[], str]) -> str:
    """The result of a step; what it raises is one, too."""
    try:
        with within(PATIENCE):
            return step()
    except Hang:
        return HANG
    except (BagError, OSError) as error:
        text = str(error)
        return REFUSED if "\n" not in text and len(text) < 700 else LONG
    except Exception as error:
        return f"{TRACEBACK} {type(error).__name__}"


def of_reading(bag: Path, whole: Any, kept: list[float]) -> str:
    """Result of reading a damaged bag; damage of messages without checksums is undetectable."""
    messages, topics, said = contents(bag)
    kept.append(min(1.0, len(messages) / len(whole[0])))
    if len(said) > len(whole[2]) or (said and (messages, topics) != whole[:2]):
        return REPORTED
    return UNDETECTABLE if same_but_bytes(messages, topics, whole) else SILENT


def doctored(*args: str) -> tuple[int, str]:
    """The exit code of `doctor`, and what it said."""
    out, err = StringIO(), StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = doctor(list(args))
    lines = err.getvalue().splitlines()
    if len(lines) > 1 or any(len(line) > 700 for line in lines):
        return code, LONG
    return code, out.getvalue() + err.getvalue()


def of_doctor(bag: Path, whole_said: str, whole_bag: Path) -> str:
    """Result of `doctor` on a damaged bag."""
    code, said = doctored(str(bag))
    if said == LONG:
        return LONG
    unseen = code == 0 and said.replace(str(bag), str(whole_bag)) == whole_said
    return UNSEEN if unseen else REPORTED


def of_repair(bag: Path, whole: Any) -> str:
    """Result of the repair of a damaged bag."""
    code, said = doctored(str(bag), "--repair")
    if said == LONG or code == 1:
        return LONG if said == LONG else REFUSED
    messages, topics, after = contents(bag)
    mended = "repaired:" in said or same_but_bytes(messages, topics, whole)
    return REPORTED if mended and not after else SILENT


class Outcome(NamedTuple):
    """What became of a damaged bag, step by step."""

    read: str
    seen: str
    mended: str
    kept: float = 1.0  # messages that are read of those there were; 0: it is refused


def wrong(outcome: tuple[Any, ...]) -> bool:
    """Whether a step of it ended as none should."""
    return any(str(result).startswith(WRONG) for result in outcome)


class Trial:
    """The bags, whole, in a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.bags = {name: make(folder / "whole" / name) for name, make in BAGS.items()}
        self.whole = {name: contents(bag) for name, bag in self.bags.items()}
        self.said = {name: doctored(str(bag))[1] for name, bag in self.bags.items()}

    def run(self, case: Case) -> Outcome:
        """Damage a copy, and see."""
        source, whole = self.bags[case.bag], self.whole[case.bag]
        room = self.folder / "damaged"
        bag = room / source.name
        rmtree(room, ignore_errors=True)
        room.mkdir()
        if source.is_file():
            bag.write_bytes(source.read_bytes())
        else:
            copytree(source, bag)
        damage(case, bag)
        if unharmed(bag, source):
            return Outcome(UNDETECTABLE, UNDETECTABLE, UNDETECTABLE)
        kept: list[float] = []
        read = attempt(lambda: of_reading(bag, whole, kept))
        seen = attempt(lambda: of_doctor(bag, self.said[case.bag], source))
        unchecked = case.bag in UNCHECKED or case.damage.startswith("metadata")
        if seen == UNSEEN and read == UNDETECTABLE and (unchecked or renamed(bag, source)):
            seen = UNDETECTABLE
        return Outcome(read, seen, attempt(lambda: of_repair(bag, whole)), sum(kept))


def unharmed(bag: Path, source: Path) -> bool:
    """Whether the damage changed nothing, as zeros where zeros were."""
    if bag.is_file() and source.is_file():
        return bag.read_bytes() == source.read_bytes()
    if not bag.is_dir() or not source.is_dir():
        return False
    names = {file.name for file in source.iterdir()}
    return names == {file.name for file in bag.iterdir()} and all(
        (bag / n).is_file() and (bag / n).read_bytes() == (source / n).read_bytes() for n in names
    )


def renamed(bag: Path, source: Path) -> bool:
    """Whether all the damage is in the name of who wrote a file, which no checksum is of."""
    if not bag.is_file() or not source.is_file():
        return False
    data, whole = bag.read_bytes(), source.read_bytes()
    _, begin, end = places(whole)[0]  # the header, of two names after their lengths
    begin += 9 + 4 + int.from_bytes(whole[begin + 9 : begin + 13], "little") + 4
    return data[:begin] + whole[begin:end] + data[end:] == whole


def main() -> int:
    """Print a table of the results, by kind of damage."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    options = parser.parse_args()
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background ignores it
    found: dict[str, list[Outcome]] = {}
    bad = 0
    with TemporaryDirectory() as folder, suppress(KeyboardInterrupt):
        trial = Trial(Path(folder))
        for case in islice(cases(BAGS, options.first), options.count):
            outcome = trial.run(case)
            found.setdefault(case.damage, []).append(outcome)
            if wrong(outcome):
                bad += 1
                print(case, outcome, flush=True)
    found["all"] = [outcome for outcomes in found.values() for outcome in outcomes]
    print("| damage | bags | refused | messages read, mean [%] |")
    for name, outcomes in sorted(found.items()):
        refused = sum(outcome.read == REFUSED for outcome in outcomes)
        kept = np.mean([100.0 * outcome.kept for outcome in outcomes])
        print(f"| {name} | {len(outcomes)} | {refused} | {kept:.0f} |")
    print(f"{bad} of {len(found['all'])} bags ended as none should")
    return 1 if bad else 0


if __name__ == "__main__":
    raise SystemExit(main())
