"""The file of keys."""

import pytest

from fss_link.protocol import KeyFileError, load_keys, parse_keys

KEY = bytes(range(16))


def test_keys_are_read_by_link():
    text = f"# keys\n0 {'0a' * 16}\n\n 12\t{'FF' * 32}  # the last\n"
    assert parse_keys(text) == {0: b"\x0a" * 16, 12: b"\xff" * 32}


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (f"256 {'0a' * 16}", "expected a link from 0 to 255 and 32 to 64 hex digits"),
        (f"2 {'0a' * 15}", "expected a link"),
        (f"2 {'0a' * 33}", "expected a link"),
        (f"2 {'0a' * 16}0", "expected a link"),
        ("2", "expected a link"),
        (f"1 {'0b' * 16}", "expected each link and each key once"),
        (f"2 {'00' * 16}", "expected each link and each key once"),
    ],
)
def test_a_line_that_is_no_key_is_named_and_not_shown(line, words):
    with pytest.raises(KeyFileError, match=f"keys, line 2: {words}") as error:
        parse_keys(f"1 {'00' * 16}\n{line}\n")
    assert "0a0a" not in str(error.value)


def test_a_file_of_keys_must_be_its_owners_alone(tmp_path):
    path = tmp_path / "keys"
    path.write_text(f"1 {KEY.hex()}\n")
    path.chmod(0o600)
    assert load_keys(path) == {1: KEY}
    path.chmod(0o640)
    with pytest.raises(KeyFileError, match=r"mode 640, expected 600\): chmod 600 /"):
        load_keys(path)
