"""What is kept across restarts, and files that somebody else wrote."""

import json
from math import nan

import pytest

from fss_arm_calib.segments.drifts import Drift
from fss_arm_calib.segments.maneuvers import Maneuver
from fss_arm_calib.segments.rests import Observation
from fss_arm_calib.segments.streams import Streams
from fss_arm_calib.state import Flags, restore, save
from fss_arm_ros.state_file import MAX_FILE_SIZE, StateError

FLAGS = Flags(("joint_7",), {"joint_2": 9.83}, {"fss occluded": 12})
DATA = [
    Observation(0, 1, (0.1, nan), (0.1, 1 / 3, 0.0), boots=(3, 9), homings=(1, 0)),
    Observation(2, 3, (0.1, -1e-17), used=False, reason="a gap"),
    Maneuver(1, 9, ((0.5,), (0.1, 0.2)), ((0.3,), (0.1, 1 / 7)), ((0.0,), (1.0, 2.0)),
             (0.2, 0.7), ((0.1, 0.2, 9.0),) * 2, (10, 11), (0.5, 0.5), (0.1, 0.2, 0.3), 0.01),
    Drift(1, 9, (0.1, 0.2), (0.0, 0.5), ((0.1, 0.2, -7.0),) * 2, (50, 49), (0.5, 0.49)),
]  # fmt: skip


@pytest.mark.parametrize("datum", DATA, ids=lambda one: type(one).__name__)
def test_data_are_kept_to_the_last_bit(tmp_path, datum):
    path = tmp_path / "new" / "state.json"
    save(path, "toy", 2, [datum, datum], FLAGS)
    data, flags = restore(path, "toy", 2, type(datum))
    assert repr(data) == repr([datum, datum])
    assert flags == FLAGS
    assert restore(tmp_path / "none.json", "toy", 2, Observation) == ([], Flags())


def test_what_happened_to_the_streams_adds_up():
    streams = Streams(
        unknown=("joint_9",),
        rejected={"fss jump": 1, "fss occluded": 2},
        set_back={"joint_1": 0.5, "joint_2": 1.0},
    )
    after = FLAGS.and_then(streams)
    assert after.unknown == ("joint_7", "joint_9")
    assert after.set_back == {"joint_1": 0.5, "joint_2": 9.83}
    assert after.rejected == {"fss jump": 1, "fss occluded": 14}
    assert Flags.of(FLAGS.and_then(Streams())) == FLAGS


def state(**changed):
    good = {"start": 0, "end": 1, "q": [0.0, 0.0]}
    flags = {"unknown": [], "set_back": {}, "rejected": {}}
    whole = {"kind": "toy", "joints": 2, "data": [good | changed.pop("datum", {})], "flags": flags}
    return json.dumps(whole | changed)


HOSTILE = {
    "broken": ("{", "cannot be read: Expecting"),
    "not text": ("\udcff", "cannot be read: 'utf-8' codec"),
    "deep": ("[" * 100_000 + "]" * 100_000, "nested too deeply"),
    "large": (" " * (MAX_FILE_SIZE + 1), f"more than {MAX_FILE_SIZE} bytes"),
    "infinite": (state().replace('"end": 1', '"end": Infinity'), "Infinity is no number"),
    "too late": (state(datum={"end": 2**63}), "expected an integer from 0 on"),
    "a large number": (state().replace("[0.0, 0.0]", "[1e301, 0.0]"), "expected a number"),
    "null": ("null", ""),
    "a datum no object": (state(data=[3]), "data[0] is 3, expected an object of start, end, q"),
    "a text for a number": (state(datum={"q": ["0", "0"]}), "data[0].q[0] is '0', expected a num"),
    "true for a number": (state(datum={"q": [True, 0]}), "data[0].q[0] is True, expected a num"),
    "flags": (state(flags={"set_back": {"a": "b"}}), "flags.set_back.a is 'b', expected a number"),
    "another kind": (state(kind="other"), "kind is 'other', expected 'toy'"),
    "another arm": (state(joints=5), "joints is 5, expected 2"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_wrong_file_ends_in_one_line_that_names_it(tmp_path, name):
    text, message = HOSTILE[name]
    path = tmp_path / "state.json"
    path.write_bytes(text.encode(errors="surrogateescape"))
    if name == "null":
        assert restore(path, "toy", 2, Observation) == ([], Flags())
        return
    with pytest.raises(StateError) as caught:
        restore(path, "toy", 2, Observation)
    said = str(caught.value)
    assert str(path) in said
    assert message in said
    assert "\n" not in said
    assert len(said) < len(str(path)) + 500
