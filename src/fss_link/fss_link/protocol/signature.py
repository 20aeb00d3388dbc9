"""Signatures of frames (message authentication codes), and the file of keys.

A signature is the BLAKE2s hash (RFC 7693) of the 56 bytes before it, keyed with the link's key and
16 bytes long. It proves that a holder of the key made the frame. It does not detect replayed
frames: clocks and sequence numbers do.
"""

import os
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
    """Error of a key file that is invalid or accessible to others; the message shows no key."""


def sign(data: bytes, key: bytes | None) -> bytes:
    """Return the signature of `data` with a key of 16 to 32 bytes; zeros without a key."""
    return blake2s(data, digest_size=SIGNATURE_SIZE, key=key).digest() if key else UNSIGNED


def is_signed(data: bytes, signature: bytes, key: bytes | None) -> bool:
    """Return True if `signature` is that of `data`, without a key all zeros; in constant time."""
    return compare_digest(signature, sign(data, key))


def parse_keys(text: str, name: str = "keys") -> Mapping[int, bytes]:
    """Parse the keys of links and board: in each line a number and 32 to 64 hex digits.

    Numbers are those of the links; 0 is the base's board.

    Raises:
        KeyFileError: a line has another form, or a link or a key appears twice.
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


def load_key(path: str, number: int, name: str) -> bytes | None:
    """Return the key that signs the frames of a link, by its number; None without a file.

    Raises:
        OSError: the file cannot be read.
        ValueError: the file is invalid, or has no key for the link of this name.
    """
    keys = load_keys(path) if path else {}
    if path and number not in keys:
        raise ValueError(f"keys is {path!r}, which has no key for {name}")
    return keys.get(number)


def load_keys(path: str | Path) -> Mapping[int, bytes]:
    """Read the keys of the links.

    Raises:
        OSError: the file cannot be read.
        KeyFileError: users other than its owner have access to it, or it is invalid.
    """
    with Path(path).open(encoding="utf-8", errors="replace") as file:
        mode = stat.S_IMODE(os.fstat(file.fileno()).st_mode)
        if mode & 0o077:
            raise KeyFileError(
                f"{path} can be read by others (mode {mode:o}, expected 600): chmod 600 {path}"
            )
        return parse_keys(file.read(), str(path))
