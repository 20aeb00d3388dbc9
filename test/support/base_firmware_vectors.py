"""Writes the examples that the Python codec and the board's firmware must both agree with.

    python test/support/base_firmware_vectors.py > test/vectors/base_firmware.txt

As firmware_vectors.py does for the links, from docs/reference/base_protocol.md.
"""

import random
from collections.abc import Iterator
from dataclasses import astuple, replace
from itertools import chain, islice

from firmware_vectors import KEYS, damaged, hexed

from fss_base_driver.protocol import (
    NO_ON_TIMES,
    VALVES,
    BaseCommand,
    BaseCommandFlag,
    BaseFrame,
    BaseSlow,
    BaseTelemetry,
    decode,
    encode,
)
from fss_link.protocol import FrameError


def words(frame: BaseFrame) -> str:
    """The fields as `base_pipe` has them."""
    values = (value if isinstance(value, tuple) else (value,) for value in astuple(frame))
    return " ".join(str(int(value)) for value in chain.from_iterable(values))


def verdict(data: bytes, key: bytes | None) -> str:
    """The answer to `decode`: of a frame as the board reads it, which takes no telemetry."""
    if len(data) == 72 and data[:4] == b"\x53\x46\x02\x04":
        return "kind"
    try:
        frame = decode(data, key)
    except FrameError as error:
        return error.reason.value
    return f"command {words(frame)}"


def telemetries(rng: random.Random) -> Iterator[BaseTelemetry]:
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


def commands(rng: random.Random) -> Iterator[BaseCommand]:
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


def cases(seed: int, count: int) -> Iterator[tuple[str, str]]:
    """Requests and answers; so many frames of each kind."""
    rng = random.Random(seed)
    frames = []
    for telemetry in islice(telemetries(rng), count):
        key = rng.choice(KEYS)
        frames.append(encode(telemetry, key))
        yield f"encode {hexed(key)} {words(telemetry)}", frames[-1].hex()
    for command in islice(commands(rng), count):
        key = rng.choice(KEYS)
        frames.append(encode(command, key))
        yield f"decode {hexed(key)} {frames[-1].hex()}", f"command {words(command)}"
    for _ in range(4 * count):
        key = rng.choice(KEYS)
        data = damaged(rng, rng.choice(frames), key)
        yield f"decode {hexed(key)} {hexed(data)}", verdict(data, key)


def main() -> None:
    """Write the file."""
    for request, answer in cases(seed=1, count=40):
        print(request, "=", answer)


if __name__ == "__main__":
    main()
