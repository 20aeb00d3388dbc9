"""Session of the driver with the base's board: pulses for its valves, commands for its gripper.

Frames are described in docs/reference/base_protocol.md. All times are the caller's, in integer
nanoseconds.
"""

from collections.abc import Sequence
from math import isfinite
from typing import NamedTuple

from fss_arm_model.units import SECOND
from fss_base_driver.protocol import (
    BOARD,
    NO_ON_TIMES,
    TIME_UNIT,
    VALVES,
    BaseCommand,
    BaseCommandFlag,
    BaseSlow,
    BaseState,
    BaseTelemetry,
    Gripper,
    GripperFlag,
    decode,
    encode,
)
from fss_link.session import CommandError, Partner, Session

NAME = "the base's board"
UNIT = 1000 * TIME_UNIT  # of on-times [ns]
MAX_START_DELAY = SECOND // 10  # largest delay of a pulse's start by repetition [ns]
FLAG_WORDS: dict[int, str] = {
    BaseState.STOPPED: "it is stopped",
    BaseState.WATCHDOG: "its watchdog tripped",
    BaseState.SPENT: "its valves' total time is used up",
    BaseState.LIMITED: "a valve was closed by a limit",
}
LATCHES = BaseState.STOPPED | BaseState.WATCHDOG | BaseState.SPENT


class BoardSample(NamedTuple):
    """An accepted telemetry frame."""

    frame: BaseTelemetry
    stamp: int  # host time of the measurement [ns]


class Pulse(NamedTuple):
    """Pulse sent to the valves."""

    number: int = 0
    on_times: tuple[int, ...] = NO_ON_TIMES  # [TIME_UNIT]
    given: int = 0  # host time [ns]
    expiry: int = 0

    @property
    def longest(self) -> int:
        """On-time of the valve that is open longest [ns]."""
        return UNIT * max(self.on_times)


NO_PULSE = Pulse()


class Unrestricted:
    """Plausibility rules that accept any telemetry of the board."""

    def is_plausible(self, frame: BaseTelemetry) -> bool:
        """Return True: any frame is plausible."""
        return True

    def is_reachable(self, before: BaseTelemetry, frame: BaseTelemetry) -> bool:
        """Return True: any frame may follow any other."""
        return True


class BoardSession(Session[BaseTelemetry]):
    """State of the session with the board, and the commands to it.

    Args:
        timeout: silence after which the board is lost [s].
        watchdog: silence after which the board must disarm itself [s].
        lifetime: of a pulse that has not started [s].
        longest: largest accepted on-time [s].
        resolution: of the caller's clock [s].
        key: for the signatures of frames; None: frames are not signed.
        empty: voltage of the board's battery at which it must be switched off [V].
        epoch: offset from the caller's clock to the time of day [ns].
    """

    def __init__(
        self,
        timeout: float = 1.0,
        watchdog: float = 0.5,
        lifetime: float = 0.5,
        longest: float = 1.0,
        resolution: float = 0.0,
        key: bytes | None = None,
        empty: float = 0.0,
        epoch: int = 0,
    ) -> None:
        partner = Partner(
            name=NAME,
            label=NAME,
            number=BOARD,
            telemetry=BaseTelemetry,
            decode=decode,
            rules=Unrestricted(),
            latches=LATCHES,
            battery=BaseSlow.BATTERY,
            refused=BaseSlow.REFUSED,
            armed_by="scripts/fss_arm.sh valves",
            unconfirmed="does not confirm that its valves are closed",
            threat="open the valves",
            flag_words=FLAG_WORDS,
        )
        super().__init__(partner, timeout, watchdog, resolution, key, empty, epoch)
        self.counts["wrenches_clipped"] = 0
        self.pulse = self._reported = NO_PULSE  # active pulse, and that of the last report
        self._lifetime, self._longest = round(1e9 * lifetime), longest
        self._number = 0  # of the last pulse
        self._grip = Gripper.KEEP  # requested, and not confirmed yet
        self._grip_time = 0  # time of that request

    @property
    def remarks(self) -> list[str]:
        """Valves whose current does not match their command."""
        bits = self.slow.get(BaseSlow.FAULTS, 0)
        dead = [f"valve {i + 1} draws no current" for i in range(VALVES) if bits >> i & 1]
        live = [i + 1 for i in range(VALVES) if bits >> i + 8 & 1]
        return [*dead, *(f"valve {valve} draws current without a command" for valve in live)]

    def thrust(self, on_times: Sequence[float], given: int, now: int) -> None:
        """Open the valves for these times [s], requested at `given`; all 0 closes them.

        Raises:
            CommandError: the command is rejected; the active pulse continues.
        """
        self.tick(now)
        self.require_armed()
        if now > given + self._lifetime:
            raise CommandError(f"the command is {1e-9 * (now - given):.3f} s old")
        times = self._in_units(on_times)
        if not any(times):
            self.pulse = NO_PULSE
            return
        self._number = self._number % 0xFFFF + 1
        ends = now + UNIT * max(times) + MAX_START_DELAY + self.echoes.delay
        expiry = max(given + self._lifetime, ends)
        self.pulse = Pulse(self._number, times, now, expiry)

    def _in_units(self, on_times: Sequence[float]) -> tuple[int, ...]:
        times = tuple(map(float, on_times))
        good = all(isfinite(time) and 0.0 <= time <= self._longest for time in times)
        if len(times) != VALVES or not good:
            raise CommandError(
                f"on times are {list(times)}, expected {VALVES} from 0 to {self._longest:g} s"
            )
        return tuple(round(1e9 * time / UNIT) for time in times)

    def take_pulse_change(self, now: int) -> list[float] | None:
        """Return the on-times of the valves [s] if the pulse has changed since the last call.

        They are 0 if the last pulse was ended early, at time `now`. None: no change, or the pulse
        has ended by itself.
        """
        last, self._reported = self._reported, self.pulse
        if self.pulse.number == last.number:
            return None
        if self.pulse.number:
            return [1e-6 * TIME_UNIT * time for time in self.pulse.on_times]
        return VALVES * [0.0] if now < last.given + last.longest else None

    def grip(self, close: bool, now: int) -> None:
        """Close the gripper, or open it.

        Raises:
            CommandError: the board is not armed.
        """
        self.tick(now)
        self.require_armed()
        self._grip, self._grip_time = Gripper.CLOSE if close else Gripper.OPEN, now

    def command(self, now: int) -> bytes:
        """Return the frame to send now."""
        self.tick(now)
        flags, expiry, pulse, grip = self.command_flags(now), 0, NO_PULSE, Gripper.KEEP
        if flags == BaseCommandFlag.ARM:
            pulse, grip = self.pulse, self._grip
            expiry = pulse.expiry if pulse.number else now + self.timeout
        return encode(
            BaseCommand(
                **self.command_header(flags, now),
                expiry=self.to_partner_clock(expiry),
                pulse=pulse.number,
                on_times=pulse.on_times,
                gripper=grip,
            ),
            self.key,
        )

    def feed(self, data: bytes, now: int) -> BoardSample | None:
        """Process a datagram; return its frame if it is accepted."""
        if accepted := self.accept(data, now):
            self.update_state(accepted[0])
        return BoardSample(*accepted) if accepted else None

    def is_off(self, frame: BaseTelemetry) -> bool:
        """Return True if all valves are closed."""
        return not frame.valves

    def cancel_command(self, why: str) -> None:
        """Drop the active pulse and the command to the gripper."""
        self.pulse, self._grip = NO_PULSE, Gripper.KEEP

    def advance_command(self, now: int) -> None:
        """Drop the active pulse when it has expired."""
        if now > self.pulse.expiry:
            self.pulse = NO_PULSE

    def update_progress(self, frame: BaseTelemetry, echoed: int | None) -> None:
        """Synchronize the pulse number with the board, and check for the gripper's confirmation."""
        if not self.armed:
            self._number = frame.pulse
        commanded = Gripper.CLOSE if frame.gripper & GripperFlag.COMMANDED_CLOSED else Gripper.OPEN
        if echoed is not None and echoed >= self._grip_time and commanded is self._grip:
            self._grip = Gripper.KEEP
