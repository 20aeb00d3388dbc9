"""A link's electronics in a few lines, for the driver's tests: it turns as it is told, at once."""

from dataclasses import replace

from fss_arm_driver.protocol import (
    Command,
    Mode,
    Order,
    Slow,
    State,
    Telemetry,
    decode,
    encode,
    newer,
)

SECOND = 1_000_000_000
MILLISECOND = 1_000_000
SAMPLE = Telemetry(
    link=1, flags=0, boot=1, sequence=0, clock=0, echo=0, turnaround=0, position=0, velocity=0,
    current=0, mode=Mode.OFF, slow_id=Slow.SUPPLY, status=0, torque=0, torque_age=0,
    slow_value=240,
)  # fmt: skip


class FakeLink:
    """Telemetry of a link whose clock began at host time `born` [ns]."""

    def __init__(self, number: int = 1, boot: int = 1, born: int = 0, sequence: int = 0) -> None:
        self.frame = replace(SAMPLE, link=number, boot=boot, sequence=sequence)
        self.born = born
        self.taken: Command | None = None
        self.arrived = 0
        self.flags = State(0)
        self.position = 0

    def clock(self, now: int) -> int:
        return (now - self.born) // 1000

    def take(self, data: bytes, now: int) -> None:
        command = decode(data)
        assert isinstance(command, Command)
        assert command.boot in (0, self.frame.boot)
        assert self.taken is None or newer(command.sequence, self.taken.sequence)
        assert command.expiry == 0 or self.clock(now) <= command.expiry
        self.taken, self.arrived = command, now
        latches = self.flags & (State.STOPPED | State.WATCHDOG)
        if command.flags & Order.STOP:
            self.flags = State.STOPPED
        elif not command.flags & Order.ARM:
            self.flags = State(0)
        elif not latches:
            self.flags = State.ARMED
            if command.mode == Mode.POSITION:
                self.position = command.set_point

    def telemetry(self, now: int, **changes: int) -> bytes:
        """The next frame, measured at host time `now`."""
        taken = self.taken
        self.frame = replace(
            self.frame,
            flags=int(self.flags),
            sequence=(self.frame.sequence + 1) & 0xFFFFFFFF,
            clock=self.clock(now),
            echo=taken.clock & 0xFFFFFFFF if taken else 0,
            turnaround=self.clock(now) - self.clock(self.arrived) if taken else 0,
            position=self.position,
        )
        return encode(replace(self.frame, **changes))
