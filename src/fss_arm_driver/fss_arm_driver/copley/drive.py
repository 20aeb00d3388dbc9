"""Driver of a servo drive on a serial line, without I/O: bytes in, bytes out, and the time.

The caller sets a demand. The lines to send follow from the drive's answers and from the mode that
it reports, so a lost reply, a disconnected cable or a drive that was off needs no special case. The
dialogue is a generator that yields wherever it must wait.
"""

from collections.abc import Callable, Generator
from dataclasses import dataclass
from enum import IntEnum
from itertools import cycle
from typing import TypeVar

from fss_arm_driver.copley.language import (
    FIRST_BAUD,
    HOMING,
    MAX_LENGTH,
    REFERENCED,
    RESET,
    Error,
    LineError,
    Ok,
    Reply,
    Trajectory,
    Value,
    Variable,
    get_variable,
    parse,
    set_variable,
    trajectory,
)
from fss_arm_driver.protocol import Mode

MILLISECOND = 1000  # [us]
REPLY_TIMEOUT = 200 * MILLISECOND
DISCARD_TIME = 50 * MILLISECOND  # after an empty line, in which late bytes are discarded
BAUD_SWITCH_TIME = 150 * MILLISECOND  # to send the command at the old rate, and to switch
REST_TIMEOUT = 3000 * MILLISECOND  # for a joint to come to rest before the drive is switched off
MOTION_THRESHOLD = 1000  # a slower drive is at rest [0.1 counts/s]
STATE_VARIABLES = (
    Variable.VELOCITY,
    Variable.CURRENT,
    Variable.STATUS,
    Variable.TRAJECTORY_STATUS,
    Variable.DESIRED_STATE,
)
#: Start of the commands that set a mode.
SET_MODE = set_variable(Variable.DESIRED_STATE, 0).removesuffix(b"0\r")
SLOW_VARIABLES = (  # one in each round
    Variable.ABORT_DECELERATION,  # first: to brake a joint that is found in motion
    Variable.FAULTS,
    Variable.SUPPLY,
    Variable.TEMPERATURE,
)


class DriveGoal(IntEnum):
    """Goal of the drive; those up to HOLD bring the joint to rest."""

    RELEASE = 0  # decelerate, then switch off
    HOLD = 1  # decelerate, then hold the position
    HOME = 2  # find the encoder's zero
    CURRENT = 3  # give the motor the current `set_point`
    VELOCITY = 4  # turn at the velocity `set_point`
    POSITION = 5  # move to the position `set_point` by a profile
    FOLLOW = 6  # the velocity that `steer` returns for each position


MODES = {
    DriveGoal.RELEASE: Mode.OFF,
    DriveGoal.HOLD: Mode.POSITION,
    DriveGoal.HOME: Mode.POSITION,
    DriveGoal.CURRENT: Mode.CURRENT,
    DriveGoal.VELOCITY: Mode.VELOCITY,
    DriveGoal.POSITION: Mode.POSITION,
    DriveGoal.FOLLOW: Mode.VELOCITY,
}


@dataclass(frozen=True, slots=True)
class Demand:
    """Goal with its set point and limits, in the drive's units."""

    goal: DriveGoal = DriveGoal.RELEASE
    set_point: int = 0  # [0.01 A], [0.1 counts/s] or [counts], by the goal
    velocity: int = 0  # of the profile, for POSITION [0.1 counts/s]
    acceleration: int = 0  # [10 counts/s^2]; 0: the drive's own setting

    @property
    def mode(self) -> Mode:
        """Mode that the goal needs."""
        return MODES[self.goal]


@dataclass(frozen=True, slots=True)
class Reading:
    """State of the drive, its values read one after another."""

    clock: int = 0  # when the position was read [us]
    position: int = 0  # [counts]
    velocity: int = 0  # [0.1 counts/s]
    current: int = 0  # [0.01 A]
    status: int = 0  # status word
    trajectory: int = 0  # status word of the profile
    mode: int = 0  # Mode, as the drive has it


@dataclass(frozen=True, slots=True)
class _Query:
    """Line that the drive answers."""

    line: bytes


@dataclass(frozen=True, slots=True)
class _Send:
    """Line that is not answered, and a pause in which received bytes are discarded [us]."""

    line: bytes
    pause: int


class _NoAnswerError(Exception):
    """Error of a missing, late or invalid answer."""


class _ResetError(Exception):
    """Error of a drive that was reset or switched off externally.

    The connection is set up again. Meanwhile there is no `reading`, so the link disarms and no
    motion resumes by itself.
    """


T = TypeVar("T")
#: Part of the dialogue: yields lines to send, receives replies, returns a result.
Dialogue = Generator[_Query | _Send, Reply | None, T]
#: Position [counts], its time [us] and the last velocity [0.1 counts/s] to the velocity to command;
#: None: there is no path.
Steer = Callable[[int, int, int], int | None]


class Drive:
    """Drive. Set `demand`; `reading` is the last complete round, None while it does not answer.

    Args:
        baud: working rate; the drive starts at 9600.
        steer: called with each position, whatever the goal; returns the velocity for FOLLOW.
    """

    def __init__(self, baud: int = 115_200, steer: Steer = lambda *_: None) -> None:
        self.demand = Demand()
        self.clear_faults = False
        self.reading: Reading | None = None
        self.slow = dict.fromkeys(SLOW_VARIABLES, 0)
        self.homings = 0  # how often the drive was found referenced, also when it is found again
        self.refusal = ""  # of the present demand, with the drive's error
        self.switched_off = False  # it refused even to hold, and is switched off despite the demand
        self._done: Demand | None = None  # the last demand that was sent completely
        self._mode = int(Mode.OFF)  # of the drive, as read or acknowledged
        self._referenced = False  # as read; False after a command to home
        self.baud = FIRST_BAUD  # to which the line must be set now
        self._fast, self._steer = baud, steer
        self._now = self._until = 0
        self._buffer = b""
        self._script = self._dialogue()
        self._step = next(self._script)
        self._sent = False

    @property
    def referenced(self) -> bool:
        """True if the drive is homed, and no command to home is pending or refused."""
        sent = self.demand.goal != DriveGoal.HOME or (
            self.demand == self._done and not self.refusal
        )
        return bool(self.reading) and self._referenced and sent

    def poll(self, data: bytes, now: int) -> bytes:
        """Process the bytes received until `now` [us]; return the bytes to send, at `baud`."""
        self._now = now
        self._buffer += data
        while True:
            if not self._sent:
                wait = REPLY_TIMEOUT if isinstance(self._step, _Query) else self._step.pause
                self._until, self._sent, self._buffer = now + wait, True, b""
                return self._step.line
            if isinstance(self._step, _Send):
                if now < self._until:
                    return b""
                self._resume(None)
            elif b"\r" in self._buffer:
                line, _, self._buffer = self._buffer.partition(b"\r")
                self._process_reply(line)
            elif now > self._until or len(self._buffer) > MAX_LENGTH:
                self._fail()
            else:
                return b""

    def _resume(self, reply: Reply | None) -> None:
        self._step, self._sent = self._script.send(reply), False

    def _fail(self) -> None:
        self._step, self._sent = self._script.throw(_NoAnswerError()), False

    def _process_reply(self, line: bytes) -> None:
        try:
            reply = parse(line)
        except LineError:
            self._fail()
        else:
            self._resume(reply)

    # --- the dialogue ---

    def _dialogue(self) -> Dialogue[None]:
        for baud in cycle((FIRST_BAUD, self._fast)):
            try:
                yield from self._connect(baud)
                for slow in cycle(SLOW_VARIABLES):
                    yield from self._read(slow)
                    yield from self._apply_demand()
            except (_NoAnswerError, _ResetError):
                self.reading = None

    def _connect(self, baud: int) -> Dialogue[None]:
        """Find the drive at this rate, and set it to the working rate."""
        self.baud = baud
        self._done = None  # the drive's state is unknown after a loss
        self._mode, self._referenced = Mode.OFF, False
        yield _Send(b"\r", DISCARD_TIME)  # ends an incomplete line in the drive's buffer
        yield _Query(get_variable(Variable.STATUS))
        if baud != self._fast:
            yield _Send(set_variable(Variable.BAUD, self._fast), BAUD_SWITCH_TIME)
            self.baud = self._fast
            yield _Query(get_variable(Variable.STATUS))

    def _value(self, variable: Variable) -> Dialogue[int]:
        """Read a variable; try again once if the answer is missing or invalid."""
        try:
            reply = yield _Query(get_variable(variable))
        except _NoAnswerError:
            yield _Send(b"\r", DISCARD_TIME)
            reply = yield _Query(get_variable(variable))
        if isinstance(reply, Value):
            return reply.number
        if isinstance(reply, Error) and variable in SLOW_VARIABLES:
            return 0  # not every drive has it
        raise _NoAnswerError

    def _read(self, slow: Variable) -> Dialogue[Reading]:
        """Read one round of variables into `reading`, with one slow variable.

        Raises:
            _ResetError: the drive was reset or switched off externally.
        """
        last = self.reading
        clock, position = yield from self._track()
        values = []
        for variable in STATE_VARIABLES:
            values.append((yield from self._value(variable)))
            if self.demand.goal == DriveGoal.FOLLOW:  # a velocity at least 50 times a second
                yield from self._track()
        velocity, current, status, trajectory, mode = values
        status &= 0xFFFFFFFF
        reading = Reading(clock, position, velocity, current, status, trajectory, mode)
        self.slow[slow] = yield from self._value(slow)
        was_reset = bool(last and status & ~last.status & RESET)
        if was_reset or (reading.mode == Mode.OFF and self._mode != Mode.OFF):
            raise _ResetError
        self._mode = reading.mode
        self.reading = reading
        referenced = reading.trajectory & (REFERENCED | HOMING) == REFERENCED
        self.homings += referenced and not self._referenced
        self._referenced = referenced
        return reading

    def _track(self) -> Dialogue[tuple[int, int]]:
        """Read the position and its time; update the velocity of a drive that follows a path."""
        position = yield from self._value(Variable.POSITION)
        clock, demand = self._now, self.demand
        speed = self._steer(position, clock, self.reading.velocity if self.reading else 0)
        if speed is not None and demand.goal == DriveGoal.FOLLOW and demand == self._done:
            done = yield from self._send_commands(
                [set_variable(Variable.COMMANDED_VELOCITY, speed)]
            )
            self._done = demand if done else None
        return clock, position

    def _apply_demand(self) -> Dialogue[None]:
        """Send the commands that bring the drive to the demand."""
        reading, demand = self.reading, self.demand
        assert reading
        if self.clear_faults and reading.mode == Mode.OFF:
            faults = yield from self._value(Variable.FAULTS)
            yield _Query(set_variable(Variable.FAULTS, faults))  # writing a bit clears it
            self.clear_faults = False
        if demand == self._done and (reading.mode == demand.mode or self.refusal):
            return
        self._done, self.refusal, self.switched_off = None, "", False
        # A joint whose demand is refused is held, and a drive that refuses to hold is switched off.
        # A round is read before each attempt, so that telemetry continues.
        done = yield from self._reach(demand, demand)
        if not done and demand.goal > DriveGoal.HOLD:
            yield from self._read(Variable.FAULTS)
            done = yield from self._reach(Demand(DriveGoal.HOLD), demand)
        self.switched_off = not done and demand.goal != DriveGoal.RELEASE
        while not done:
            yield from self._read(Variable.FAULTS)
            done = yield from self._send_commands([set_variable(Variable.DESIRED_STATE, Mode.OFF)])
        if demand == self.demand:
            self._done = demand

    def _reach(self, target: Demand, demand: Demand) -> Dialogue[bool]:
        """Bring the drive to a target while `demand` is unchanged; return False if it refuses.

        To hold, the joint must come to rest first, however long that takes; to release, only for
        REST_TIMEOUT.
        """
        reading = self.reading
        assert reading
        if target.goal <= DriveGoal.HOLD or reading.mode != target.mode:
            brake = _brake(reading.mode, self.slow[Variable.ABORT_DECELERATION])
            if not (yield from self._send_commands(brake)):
                return False
            end = self._now + REST_TIMEOUT
            while reading.mode != Mode.OFF:
                reading = yield from self._read(Variable.FAULTS)
                if demand != self.demand:
                    return True
                too_long = target.goal == DriveGoal.RELEASE and self._now > end
                if too_long or abs(reading.velocity) <= MOTION_THRESHOLD:
                    break
        return (yield from self._send_commands(_program(target, reading.mode)))

    def _send_commands(self, lines: list[bytes]) -> Dialogue[bool]:
        """Send commands until one is refused; return True if none was."""
        for line in lines:
            reply = yield _Query(line)
            if isinstance(reply, Error):
                self.refusal = self.refusal or f"{line.decode().strip()}: {reply}"
                return False
            if not isinstance(reply, Ok):
                raise _NoAnswerError
            if line.startswith(SET_MODE):
                self._mode = int(line.removeprefix(SET_MODE))
            if line == trajectory(Trajectory.HOME):
                self._referenced = False
        return True


def _in_velocity_mode(acceleration: int) -> int:
    """Convert an acceleration [10 counts/s^2] to the unit of velocity mode [1000 counts/s^2]."""
    return max(1, acceleration // 100)


def _brake(mode: int, abort: int) -> list[bytes]:
    """Return commands that bring the joint to rest.

    Args:
        mode: present mode.
        abort: the drive's own abort deceleration [10 counts/s^2]; 0: unknown.
    """
    if mode == Mode.OFF:
        return []
    if mode == Mode.POSITION:
        return [trajectory(Trajectory.ABORT)]
    limit = [set_variable(Variable.DECELERATION_LIMIT, _in_velocity_mode(abort))] if abort else []
    stop = set_variable(Variable.COMMANDED_VELOCITY, 0)
    return [*limit, stop, set_variable(Variable.DESIRED_STATE, Mode.VELOCITY)]


def _program(demand: Demand, mode: int) -> list[bytes]:
    """Return commands for the demand of a joint at rest, or moving in the required mode.

    Currents and velocities are set before their mode, else the drive follows an old set point.
    """
    state = [] if mode == demand.mode else [set_variable(Variable.DESIRED_STATE, demand.mode)]
    acceleration = demand.acceleration
    if demand.goal == DriveGoal.CURRENT:
        return [set_variable(Variable.COMMANDED_CURRENT, demand.set_point), *state]
    if demand.goal in (DriveGoal.VELOCITY, DriveGoal.FOLLOW):
        limit = _in_velocity_mode(acceleration)
        limits = [
            set_variable(Variable.ACCELERATION_LIMIT, limit),
            set_variable(Variable.DECELERATION_LIMIT, limit),
        ]
        speed = set_variable(Variable.COMMANDED_VELOCITY, demand.set_point)
        return [*(limits if acceleration else []), speed, *state]
    if demand.goal == DriveGoal.HOME:
        return [*state, trajectory(Trajectory.HOME)]
    if demand.goal == DriveGoal.POSITION:
        profile = Variable.PROFILE_ACCELERATION, Variable.PROFILE_DECELERATION
        return [
            *state,
            set_variable(Variable.PROFILE_TYPE, 0),
            set_variable(Variable.TARGET, demand.set_point),
            set_variable(Variable.PROFILE_VELOCITY, demand.velocity),
            *(set_variable(limit, acceleration) for limit in profile if acceleration),
            trajectory(Trajectory.START),
        ]
    return state  # RELEASE and HOLD: the mode is all
