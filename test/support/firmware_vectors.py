"""Writes the examples that the Python codec and the firmware's must both agree with.

    python test/support/firmware_vectors.py > test/vectors/firmware.txt

A line is a request to the firmware's `core_pipe` and, after ` = `, its answer: what
docs/reference/protocol.md says, by the Python codec.
"""

import random
from collections.abc import Iterator
from dataclasses import astuple
from hashlib import blake2s
from itertools import islice

from driver_frames import sealed

from fss_arm_driver.protocol import (
    LAST_SEGMENT,
    Command,
    LinkCommandFlag,
    Mode,
    Segment,
    Slow,
    Telemetry,
    decode,
    encode,
)
from fss_link.protocol import FrameError, StreamDecoder, pack

MODES = [mode for mode in Mode if mode is not Mode.PATH]
KEYS = [None, bytes(range(16)), bytes(range(100, 132))]


def hexed(data: bytes | None) -> str:
    """Bytes as `core_pipe` reads and writes them."""
    return data.hex() if data else "-"


def verdict(data: bytes, key: bytes | None) -> str:
    """The answer to `decode`: of a frame as a link reads it, which takes no telemetry."""
    if len(data) == 72 and data[:4] == b"\x53\x46\x02\x01":
        return "kind"
    try:
        frame = decode(data, key)
    except FrameError as error:
        return error.reason.value
    kind = type(frame).__name__.lower()
    return " ".join([kind, *(str(int(value)) for value in astuple(frame))])


def telemetries(rng: random.Random) -> Iterator[Telemetry]:
    """Random ones, with extreme values among them."""

    def pick(bits: int, signed: bool = False) -> int:
        low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if signed else (0, (1 << bits) - 1)
        return rng.choice([low, high, 0, rng.randint(low, high), rng.randint(low, high)])

    while True:
        yield Telemetry(
            link=rng.randint(1, 255), flags=rng.randint(0, 63), boot=pick(16) or 1,
            sequence=pick(32), clock=pick(64), echo=pick(32), turnaround=pick(32),
            position=pick(32, True), velocity=pick(32, True), current=pick(16, True),
            mode=rng.choice(MODES), slow_id=rng.choice(list(Slow)), status=pick(32),
            torque=pick(24, True), torque_age=pick(8), slow_value=pick(32, True),
        )  # fmt: skip


def commands(rng: random.Random) -> Iterator[Command]:
    """Random ones, with extreme values among them."""
    flags = [
        0,
        LinkCommandFlag.ARM,
        LinkCommandFlag.STOP,
        LinkCommandFlag.ARM | LinkCommandFlag.HOLD,
        LinkCommandFlag.STOP | LinkCommandFlag.CLEAR_FAULTS,
    ]
    flags.append(LinkCommandFlag.ARM | LinkCommandFlag.HOME)
    while True:
        mode = rng.choice(list(Mode))
        set_point = rng.choice([-(1 << 31), (1 << 31) - 1, rng.getrandbits(16)])
        yield Command(
            link=rng.randint(1, 255), flags=rng.choice(flags), boot=rng.choice([1, 7, 0xFFFF]),
            sequence=rng.getrandbits(32), clock=rng.choice([0, 1 << 63, rng.getrandbits(64)]),
            expiry=rng.choice([1, (1 << 64) - 1, rng.getrandbits(50) + 1]),
            mode=mode, watchdog=rng.choice([1, 2000, 0xFFFF]),
            set_point=rng.choice([1, 0xFFFF]) if mode == Mode.PATH else set_point,
            velocity=rng.getrandbits(31), acceleration=rng.getrandbits(31),
        )  # fmt: skip


def segments(rng: random.Random) -> Iterator[Segment]:
    """Random ones, with extreme values among them."""

    def signed() -> int:
        return rng.choice([-(1 << 31), (1 << 31) - 1, 0, rng.randint(-(1 << 31), (1 << 31) - 1)])

    while True:
        flags = rng.choice([0, 0, LAST_SEGMENT])
        duration = rng.choice([1000, 60_000_000, rng.randint(1000, 60_000_000)])
        yield Segment(
            link=rng.randint(1, 255), flags=flags, boot=rng.choice([1, 7, 0xFFFF]),
            sequence=rng.getrandbits(32), clock=rng.choice([0, 1 << 63, rng.getrandbits(64)]),
            path=rng.choice([1, 0xFFFF, rng.randint(1, 0xFFFF)]),
            index=rng.choice([0, 0xFFFE, rng.randint(0, 0xFFFE)]),
            begin=rng.choice([0, (1 << 64) - 1 - duration, rng.getrandbits(50)]),
            duration=duration, position=signed(), velocity=signed(), end_position=signed(),
            end_velocity=0 if flags else signed(),
        )  # fmt: skip


def damaged(rng: random.Random, data: bytes, key: bytes | None) -> bytes:
    """A frame with some bits or bytes changed, cut or sealed anew."""
    kind = rng.randrange(8)
    if kind == 0:
        return data[: rng.randrange(72)] + rng.randbytes(rng.choice([0, 1, 80]))
    changed = bytearray(data)
    for _ in range(rng.randint(1, 3)):
        at = rng.randrange(72 if kind < 4 else 52)
        changed[at] = rng.choice([0, 0xFF, changed[at] ^ 1 << rng.randrange(8)])
    if kind < 4:
        return bytes(changed)
    return sealed(bytes(changed), key if kind < 7 else rng.choice(KEYS))


def cases(seed: int, count: int) -> Iterator[tuple[str, str]]:
    """Requests and answers; so many frames of each kind."""
    rng = random.Random(seed)
    for size in (0, 1, 55, 56, 63, 64, 65, 128, 200):
        data, key = rng.randbytes(size), KEYS[size % 3]
        digest = blake2s(data, digest_size=16, key=key or b"").digest()
        yield f"blake2s {hexed(key)} {hexed(data)} 16", hexed(digest)
    frames = [bytes(72), bytes([255]) * 72]
    frames += [bytes(rng.choice([0, 0, 0, 1, 255]) for _ in range(72)) for _ in range(count)]
    for telemetry in islice(telemetries(rng), count):
        key = rng.choice(KEYS)
        frames.append(encode(telemetry, key))
        values = " ".join(str(int(value)) for value in astuple(telemetry))
        yield f"encode {hexed(key)} {values}", frames[-1].hex()
    orders = [*islice(commands(rng), count), *islice(segments(rng), count)]
    for order in orders:
        key = rng.choice(KEYS)
        frames.append(encode(order, key))
        yield f"decode {hexed(key)} {frames[-1].hex()}", verdict(frames[-1], key)
    for _ in range(3 * count):
        key = rng.choice(KEYS)
        data = damaged(rng, rng.choice(frames), key)
        yield f"decode {hexed(key)} {hexed(data)}", verdict(data, key)
    for frame in frames:
        yield f"stream {frame.hex()}", pack(frame).hex()
        stream = rng.randbytes(rng.randrange(200)) + pack(frame)[:-1] + pack(frame)
        yield f"unstream {stream.hex()}", hexed(b"".join(StreamDecoder().feed(stream)))


def main() -> None:
    """Write the file."""
    for request, answer in cases(seed=1, count=40):
        print(request, "=", answer)


if __name__ == "__main__":
    main()
