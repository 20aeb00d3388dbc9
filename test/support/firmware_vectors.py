"""Writes the examples that the Python codecs and the firmware's must both agree with.

    python test/support/firmware_vectors.py

A line is a request to the firmware's `core_pipe` or `base_pipe` and, after ` = `, its answer: what
docs/reference/protocol.md and base_protocol.md say, by the Python codecs.
"""

import random
from collections.abc import Iterable, Iterator
from dataclasses import astuple, replace
from hashlib import blake2s
from itertools import chain, islice
from pathlib import Path
from types import ModuleType
from typing import Any

from driver_frames import sealed

from fss_arm_driver import protocol as links
from fss_arm_driver.protocol import (
    LAST_SEGMENT,
    Command,
    LinkCommandFlag,
    Mode,
    Segment,
    Slow,
    Telemetry,
)
from fss_base_driver import protocol as board
from fss_base_driver.protocol import (
    NO_ON_TIMES,
    VALVES,
    BaseCommand,
    BaseCommandFlag,
    BaseSlow,
    BaseTelemetry,
)
from fss_link.protocol import FrameError, StreamDecoder, pack

MODES = [mode for mode in Mode if mode is not Mode.PATH]
KEYS = [None, bytes(range(16)), bytes(range(100, 132))]
TELEMETRY_KINDS = (b"\x53\x46\x02\x01", b"\x53\x46\x02\x04")


def hexed(data: bytes | None) -> str:
    """Bytes as the pipes read and write them."""
    return data.hex() if data else "-"


def field_text(frame: Any) -> str:
    """The fields of a frame as the pipes have them."""
    values = (value if isinstance(value, tuple) else (value,) for value in astuple(frame))
    return " ".join(str(int(value)) for value in chain.from_iterable(values))


def verdict(protocol: ModuleType, data: bytes, key: bytes | None) -> str:
    """The answer to `decode`: of a frame as electronics read it, which take no telemetry."""
    if len(data) == 72 and data.startswith(TELEMETRY_KINDS):
        return "kind"
    try:
        frame = protocol.decode(data, key)
    except FrameError as error:
        return str(error.reason.value)
    return f"{type(frame).__name__.lower().removeprefix('base')} {field_text(frame)}"


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
    arm, stop = LinkCommandFlag.ARM, LinkCommandFlag.STOP
    flags = [0, arm, stop, arm | LinkCommandFlag.HOLD, stop | LinkCommandFlag.CLEAR_FAULTS]
    flags.append(arm | LinkCommandFlag.HOME)
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


def base_telemetries(rng: random.Random) -> Iterator[BaseTelemetry]:
    """Random ones, with extreme values among them."""

    def pick(bits: int) -> int:
        high = (1 << bits) - 1
        return rng.choice([0, high, rng.randint(0, high), rng.randint(0, high)])

    while True:
        yield BaseTelemetry(
            link=0, flags=pick(5), boot=pick(16) or 1, sequence=pick(32), clock=pick(64),
            echo=pick(32), turnaround=pick(32), gyro_sum=pick(32), gyro_samples=pick(16),
            valves=pick(8), gripper=pick(3), pulse=pick(16), pulse_age=pick(16),
            slow_id=rng.choice(list(BaseSlow)), slow_value=pick(32) - (1 << 31),
        )  # fmt: skip


def base_commands(rng: random.Random) -> Iterator[BaseCommand]:
    """Random ones, with extreme values among them."""
    while True:
        command = BaseCommand(
            link=0, flags=rng.choice([0, BaseCommandFlag.STOP, *3 * [BaseCommandFlag.ARM]]),
            boot=rng.choice([1, 7, 0xFFFF]), sequence=rng.getrandbits(32),
            clock=rng.choice([0, 1 << 63, rng.getrandbits(64)]),
            expiry=rng.choice([1, (1 << 64) - 1, rng.getrandbits(50) + 1]),
            pulse=0, watchdog=rng.choice([1, 500, 0xFFFF]), on_times=NO_ON_TIMES,
        )  # fmt: skip
        if command.flags == BaseCommandFlag.ARM:
            pulse = rng.choice([0, 1, 0xFFFF, rng.getrandbits(16)])
            times = tuple(rng.choice([0, 1, 0xFFFF, rng.getrandbits(16)]) for _ in range(VALVES))
            times = times if pulse else NO_ON_TIMES
            command = replace(command, pulse=pulse, on_times=times, gripper=rng.randrange(3))
        yield command


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


def frame_cases(
    rng: random.Random,
    protocol: ModuleType,
    telemetries: Iterable[Any],
    orders: Iterable[Any],
    damages: int,
    frames: list[bytes],
) -> Iterator[tuple[str, str]]:
    """Telemetry to encode, orders to decode, then damaged frames; `frames` collects them all."""
    for telemetry in telemetries:
        key = rng.choice(KEYS)
        frames.append(protocol.encode(telemetry, key))
        yield f"encode {hexed(key)} {field_text(telemetry)}", frames[-1].hex()
    for order in orders:
        key = rng.choice(KEYS)
        frames.append(protocol.encode(order, key))
        yield f"decode {hexed(key)} {frames[-1].hex()}", verdict(protocol, frames[-1], key)
    for _ in range(damages):
        key = rng.choice(KEYS)
        data = damaged(rng, rng.choice(frames), key)
        yield f"decode {hexed(key)} {hexed(data)}", verdict(protocol, data, key)


def link_orders(rng: random.Random, count: int) -> Iterator[Command | Segment]:
    """Return `count` commands and as many segments."""
    yield from [*islice(commands(rng), count), *islice(segments(rng), count)]


def cases(seed: int, count: int) -> Iterator[tuple[str, str]]:
    """Requests to a link's firmware and their answers, with `count` frames of each kind."""
    rng = random.Random(seed)
    for size in (0, 1, 55, 56, 63, 64, 65, 128, 200):
        data, key = rng.randbytes(size), KEYS[size % 3]
        digest = blake2s(data, digest_size=16, key=key or b"").digest()
        yield f"blake2s {hexed(key)} {hexed(data)} 16", hexed(digest)
    frames = [bytes(72), bytes([255]) * 72]
    frames += [bytes(rng.choice([0, 0, 0, 1, 255]) for _ in range(72)) for _ in range(count)]
    told = islice(telemetries(rng), count)
    yield from frame_cases(rng, links, told, link_orders(rng, count), 3 * count, frames)
    for frame in frames:
        yield f"stream {frame.hex()}", pack(frame).hex()
        stream = rng.randbytes(rng.randrange(200)) + pack(frame)[:-1] + pack(frame)
        yield f"unstream {stream.hex()}", hexed(b"".join(StreamDecoder().feed(stream)))


def base_cases(seed: int, count: int) -> Iterator[tuple[str, str]]:
    """Requests to the board's firmware and their answers, with `count` frames of each kind."""
    rng = random.Random(seed)
    told, orders = islice(base_telemetries(rng), count), islice(base_commands(rng), count)
    yield from frame_cases(rng, board, told, orders, 4 * count, [])


#: Files of examples, and what writes them.
VECTORS = {
    Path(__file__).parents[1] / "vectors/firmware.txt": cases,
    Path(__file__).parents[1] / "vectors/base_firmware.txt": base_cases,
}


def main() -> None:
    """Write the files."""
    for file, make in VECTORS.items():
        file.write_text("".join(f"{asked} = {answer}\n" for asked, answer in make(1, 40)))


if __name__ == "__main__":
    main()
