"""Signatures of frames, and the file that the keys are kept in.

A signature is BLAKE2s (RFC 7693) under the link's key, cut to 16 bytes, over the 56 bytes before
it. It says that a holder of the key made the frame; that it is not made up of old ones is for
clocks and sequence numbers to say.
"""

import re
import stat
from collections.abc import Mapping
from hashlib import blake2s
from hmac import compare_digest
from pathlib import Path

SIGNATURE_SIZE = 16
UNSIGNED = bytes(SIGNATURE_SIZE)
_LINE = re.compile(r"(\d{1,3})\s+((?:[0-9a-fA-F]{2}){16,32})")


class KeyFileError(ValueError):
    """A file does not hold keys, or not for its owner alone; the message shows no key."""


def sign(data: bytes, key: bytes | None) -> bytes:
    """The signature of `data` under a key of 16 to 32 bytes; zeros without a key."""
    return blake2s(data, digest_size=SIGNATURE_SIZE, key=key).digest() if key else UNSIGNED


def is_signed(data: bytes, signature: bytes, key: bytes | None) -> bool:
    """Whether `signature` is that of `data` (in a time that gives nothing of the key away)."""
    return compare_digest(signature, sign(data, key))


def parse_keys(text: str, name: str = "keys") -> Mapping[int, bytes]:
    """Keys by link: one line each, its number (0: the base's board), 32 to 64 hexadecimal digits.

    Raises:
        KeyFileError: a line says something else, or a link or a key stands twice.
    """
    keys: dict[int, bytes] = {}
    for number, line in enumerate(text.splitlines(), 1):
        if not (entry := line.partition("#")[0].strip()):
            continue
        if not (match := _LINE.fullmatch(entry)) or (link := int(match[1])) > 255:
            raise KeyFileError(
                f"{name}, line {number}: expected a link from 0 to 255 and 32 to 64 hex digits"
            )
        key = bytes.fromhex(match[2])
        if link in keys or key in keys.values():
            raise KeyFileError(f"{name}, line {number}: expected each link and each key once")
        keys[link] = key
    return keys


def key_of(path: str, number: int, name: str) -> bytes | None:
    """The key that the frames of a link are signed under, by its number; None without a file.

    Raises:
        OSError: the file cannot be read.
        ValueError: it holds no keys, or none for the link of this name.
    """
    keys = load_keys(path) if path else {}
    if path and number not in keys:
        raise ValueError(f"keys is {path!r}, which holds no key for {name}")
    return keys.get(number)


def load_keys(path: str | Path) -> Mapping[int, bytes]:
    """Read the keys of the links.

    Raises:
        OSError: the file cannot be read.
        KeyFileError: others than its owner may read or write it, or it does not hold keys.
    """
    with Path(path).open(encoding="utf-8", errors="replace") as file:
        mode = stat.S_IMODE(Path(path).stat().st_mode)
        if mode & 0o077:
            raise KeyFileError(f"{path} has mode {mode:o}, expected 600: it is its owner's alone")
        return parse_keys(file.read(), str(path))
