"""Frames of the base's board, and one that has taken some."""

from dataclasses import replace

from fss_base_driver.protocol import (
    NO_ON_TIMES,
    BaseCommand,
    BaseCommandFlag,
    BaseSlow,
    BaseState,
    BaseTelemetry,
    BoardState,
    GripperFlag,
    board_gate,
    encode,
)

BOOT, SECOND = 7, 1_000_000
KEY = bytes(range(16))
SAMPLE = BaseTelemetry(
    link=0, flags=BaseState.ARMED | BaseState.LIMITED, boot=3, sequence=1000, clock=200_000_000,
    echo=0x89ABCDEF, turnaround=1500, gyro_sum=0xFFFFFB2E, gyro_samples=1234, valves=0b10000001,
    gripper=GripperFlag.COMMANDED_CLOSED | GripperFlag.CLOSED, pulse=41, pulse_age=123,
    slow_id=BaseSlow.SUPPLY, slow_value=7001,
)  # fmt: skip
ORDER = BaseCommand(
    link=0, flags=BaseCommandFlag.ARM, boot=3, sequence=77, clock=1_700_000_000_000_000,
    expiry=201_000_000, pulse=42, watchdog=500, on_times=(300, 0, 0, 1000, 0, 0, 0, 55),
    gripper=2,
)  # fmt: skip
QUIET = BaseCommand(
    link=0, flags=0, boot=BOOT, sequence=1, clock=5, expiry=0, pulse=0, watchdog=500
)
GO = replace(
    QUIET, flags=BaseCommandFlag.ARM, sequence=2, expiry=3 * SECOND, pulse=1,
    on_times=(1000, 2000, 0, 0, 0, 0, 0, 0),
)  # fmt: skip
STOP = replace(QUIET, flags=BaseCommandFlag.STOP)


def numbered(commands, begin=1):
    """The same commands with sequences and stamps one after another."""
    return [replace(c, sequence=i, clock=i) for i, c in enumerate(commands, begin)]


def board(*commands, clock=SECOND, key=None, limits=None):
    """A board that has taken these."""
    state = BoardState(board_gate(BOOT, key), limits)
    for command in commands:
        assert state.receive(encode(command, key), clock)
    return state


def opens(on_times=NO_ON_TIMES, pulse=1, sequence=2, expiry=1 << 63, **changes):
    """A command that begins a pulse."""
    return replace(
        GO,
        pulse=pulse,
        sequence=sequence,
        clock=sequence,
        on_times=tuple(on_times),
        expiry=expiry,
        **changes,
    )
