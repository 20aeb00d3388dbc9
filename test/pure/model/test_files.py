"""Files from outside: whatever stands in them, they are read or refused at once, in one line."""

import math
import time
from pathlib import Path

import pytest

from fss_arm_model.description import paper_arm
from fss_arm_model.description_fields import DescriptionError
from fss_arm_model.description_file import from_yaml, load, to_yaml
from fss_arm_model.files import ContentError, read_text, read_yaml, write_text
from fss_sim.faults import FaultError, read_script

LINK = "{a: 0.4, theta_0: 0, mass: 3, inertia: 0.03, b: 0.2}"
ARM = "name: x\nbase: {mass: 10, inertia: 0.25}\nlinks: [%s]\n"
EVENT = "{at: %s, part: link_1, fault: loss, value: %s}"
LAUGHS = "a: &a [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]\n" + "".join(
    f"{b}: &{b} [{', '.join(10 * [f'*{a}'])}]\n"
    for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)
HOSTILE = {
    "a million keys": "".join(f"k{i}: {i}\n" for i in range(10**6)),
    "as many as fit": "".join(f"k{i}: 1\n" for i in range(24_000)),
    "deep lists": 10**5 * "[",
    "deep blocks": 10**5 * "- ",
    "20,000 links": ARM % ", ".join(20_000 * [LINK]),
    "20,000 aliases": f"l: &l {LINK}\n" + ARM % ", ".join(20_000 * ["*l"]),
    "laughs": LAUGHS,
    "itself": "&a {name: *a}",
    "a long value": ARM % f"{{a: {58_200 * 'x'}}}",
    "a long key": f"{58_200 * 'x'}: 1",
    "a long number": ARM % LINK.replace("0.4", 5000 * "9"),
    "a long hexadecimal": ARM % LINK.replace("0.4", "0x" + 5000 * "f"),
    "infinite counts": ARM % LINK.replace("}", ", drive: {counts_per_turn: .inf}}"),
    "too many counts": ARM % LINK.replace("}", f", drive: {{counts_per_turn: 1{400 * '0'}}}}}"),
    "a list": "[1, 2]",
    "a word": "word",
    "no alias": "[*a]",
    "a set": "!!set {a, b}",
    "not text": "\0",
}


def assert_refused_at_once(read, text, error, max_length):
    """Check that a text is refused within seconds, in one line of at most some characters."""
    begin = time.process_time()
    with pytest.raises(error) as refusal:
        read(text)
    assert time.process_time() - begin < 5.0
    assert "\n" not in str(refusal.value)
    assert len(str(refusal.value)) < max_length


@pytest.mark.parametrize("text", [*HOSTILE.values(), ""], ids=[*HOSTILE, "empty"])
def test_what_is_no_description_is_refused_at_once_in_one_short_line(text):
    assert_refused_at_once(from_yaml, text, DescriptionError, 300)


EVENTS = {
    "infinite": EVENT % (".inf", 1),
    "no number": EVENT % (".nan", 1),
    "a long integer": EVENT % (f"1{400 * '0'}", 1),
    "a value too large": EVENT % (1, f"1{400 * '0'}"),
    "a long value": EVENT % (58_200 * "x", 1),
    "a long part": EVENT.replace("loss", 58_200 * "x") % (1, f"[{58_200 * 'y'}]"),
    "a long key": f"{{{58_200 * 'x'}: 1}}",
    "a list": "[1, 2]",
}


@pytest.mark.parametrize(
    "text",
    [HOSTILE["20,000 aliases"], *(f"- {event}" for event in EVENTS.values())],
    ids=["20,000 aliases", *EVENTS],
)
def test_what_is_no_fault_script_is_refused_at_once_in_one_short_line(text):
    assert_refused_at_once(read_script, text, FaultError, 400)


def test_aliases_and_merges_serve_and_keys_stand_once():
    given = read_yaml("a: &a {x: 1e-5, y: [1, 2]}\nb: {<<: *a, z: 3}\nc: [*a, *a]\nd: &d 1\ne: *d")
    assert given["b"] == {"x": 1e-5, "y": [1, 2], "z": 3}
    assert given["c"] == [given["a"], given["a"]]
    assert given["e"] == 1
    with pytest.raises(ContentError, match=r"^a is 'given twice', expected once \(line 2\)"):
        read_yaml("a: 1\na: 2")


def test_json_is_read_to_the_last_bit():
    assert read_yaml(f'{{"a": [{math.pi!r}, 1e-05, 1.5e+16, null, true]}}') == {
        "a": [math.pi, 1e-5, 1.5e16, None, True]
    }


def test_a_file_is_named_and_bounded(tmp_path):
    file = tmp_path / "arm.yaml"
    file.write_text(to_yaml(paper_arm()) + 2**20 * "#")
    with pytest.raises(DescriptionError, match=f"^{file}: size is 'too large', expected at most"):
        load(file)
    file.write_text("a: 1\n- b")
    with pytest.raises(ContentError, match=f"^{file}: line 2 is"):
        read_yaml(file)
    with pytest.raises(OSError, match="infinite"):
        read_text(tmp_path / "infinite")
    with pytest.raises(ContentError, match=r"^/dev/zero: size is 'too large'"):
        read_text("/dev/zero")


@pytest.mark.parametrize(("text", "line"), [("a:\n\tb: 1", 2), ("a: 1\n\tb: 2", 2), ("\ta: 1", 1)])
def test_a_tab_is_named(text, line):
    with pytest.raises(ContentError, match=f"^line {line} is 'indented with a tab', expected spac"):
        read_yaml(text)


def test_a_file_is_the_old_one_or_the_new_one(tmp_path, monkeypatch):
    file = tmp_path / "new" / "text"
    write_text(file, "old")
    monkeypatch.setattr(Path, "replace", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        write_text(file, "new")
    assert [(f.name, f.read_text()) for f in file.parent.iterdir()] == [("text", "old")]


def test_a_file_that_cannot_be_written_is_named_and_not_what_was_to_replace_it(tmp_path):
    folder = tmp_path / "folder"
    folder.mkdir()
    with pytest.raises(OSError, match="directory") as error:
        write_text(folder, "text")
    assert error.value.filename == str(folder)
    assert list(tmp_path.iterdir()) == [folder]
