"""A servo drive at the other end of a serial line: bytes in, bytes out, and the time.

The drive is given a demand; what to say to get there follows from what it answers and from the mode
that it reports, so that a lost reply, a pulled cable or a drive that was off needs no care. The
conversation is a script that stops wherever it must wait.
"""

from collections.abc import Callable, Generator
from dataclasses import dataclass
from enum import IntEnum
from itertools import count, cycle

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
    get,
    parse,
    put,
    trajectory,
)
from fss_arm_driver.protocol import Mode

MILLISECOND = 1000  # [us]
REPLY_TIME = 200 * MILLISECOND  # at most
LINE_TIME = 50 * MILLISECOND  # for what is still under way after a failure
SWITCH_TIME = 150 * MILLISECOND  # for the order to leave at the old rate, and the drive's own
REST_TIMEOUT = 3000 * MILLISECOND  # with a joint that does not come to rest and shall be released
MOTION_THRESHOLD = 1000  # a slower drive is at rest [0.1 counts/s]
STATE_VARIABLES = (
    *(Variable.VELOCITY, Variable.CURRENT, Variable.STATUS),
    *(Variable.TRAJECTORY_STATUS, Variable.DESIRED_STATE),
)
STATE = put(Variable.DESIRED_STATE, 0).removesuffix(b"0\r")  # what orders a mode begin with
SLOW = (Variable.FAULTS, Variable.SUPPLY, Variable.TEMPERATURE, Variable.ABORT_DECELERATION)


class Goal(IntEnum):
    """What the drive is to do."""

    RELEASE = 0  # decelerate, then switch off
    HOLD = 1  # decelerate, then hold that place
    HOME = 2
    CURRENT = 3
    VELOCITY = 4
    POSITION = 5
    FOLLOW = 6  # the velocity that `steer` says, at each position


MODES = {
    Goal.RELEASE: Mode.OFF,
    Goal.CURRENT: Mode.CURRENT,
    Goal.VELOCITY: Mode.VELOCITY,
    Goal.FOLLOW: Mode.VELOCITY,
}


@dataclass(frozen=True, slots=True)
class Demand:
    """A goal, in the drive's units."""

    goal: Goal = Goal.RELEASE
    set_point: int = 0
    velocity: int = 0
    acceleration: int = 0  # [10 counts/s^2]; 0: as the drive has it

    @property
    def mode(self) -> Mode:
        """That the goal needs."""
        return MODES.get(self.goal, Mode.POSITION)


@dataclass(frozen=True, slots=True)
class Reading:
    """The drive's state; all that belongs to a round was read after the one before."""

    clock: int = 0  # when the position was read [us]
    position: int = 0
    velocity: int = 0
    current: int = 0
    status: int = 0
    trajectory: int = 0
    mode: int = 0


@dataclass(frozen=True, slots=True)
class _Ask:
    """A line that is answered."""

    line: bytes


@dataclass(frozen=True, slots=True)
class _Tell:
    """A line that is not; then a time in which nothing that comes is meant for us [us]."""

    line: bytes
    pause: int


class _NoAnswerError(Exception):
    """Nothing came in time, or nothing that a drive would say."""


class _ResetError(Exception):
    """It was reset or switched off by others: it is met anew, so that nothing goes on by itself."""


Script = Generator[_Ask | _Tell, Reply | None, None]
Steer = Callable[[int, int, int], int | None]


class Drive:
    """One drive. Set `demand`; `reading` is the last whole round, None while it does not answer.

    Args:
        baud: the rate to work at; the drive begins at 9600.
        steer: told each position [counts] with its time [us] and the last velocity
            [0.1 counts/s]; says what velocity to FOLLOW with, or None.
    """

    def __init__(self, baud: int = 115_200, steer: Steer = lambda *_: None) -> None:
        self.demand = Demand()
        self.clear_faults = False
        self.reading: Reading | None = None
        self.slow = dict.fromkeys(SLOW, 0)
        self.homings = 0
        self.refusal = ""  # of the present demand, in the drive's words
        self.let_go = False  # it refused even to hold, and is switched off whatever is demanded
        self._done: Demand | None = None  # the demand that was sent to the drive last, in full
        self._mode = int(Mode.OFF)  # that the drive is in, as read or acknowledged
        self._referenced = False  # as read; not since it was ordered to home
        self.baud = FIRST_BAUD  # that the line must be set to now
        self._fast, self._steer = baud, steer
        self._now = self._until = 0
        self._buffer = b""
        self._script = self._talk()
        self._step = next(self._script)
        self._said = False

    @property
    def referenced(self) -> bool:
        """Whether it is homed; not while it is ordered to home and has not begun, or refuses to."""
        begun = self.demand.goal != Goal.HOME or (self.demand == self._done and not self.refusal)
        return bool(self.reading) and self._referenced and begun

    def poll(self, data: bytes, now: int) -> bytes:
        """Take what has come until `now` [us]; return what to send, at `baud`."""
        self._now = now
        self._buffer += data
        while True:
            if not self._said:
                wait = REPLY_TIME if isinstance(self._step, _Ask) else self._step.pause
                self._until, self._said, self._buffer = now + wait, True, b""
                return self._step.line
            if isinstance(self._step, _Tell):
                if now < self._until:
                    return b""
                self._go(None)
            elif b"\r" in self._buffer:
                line, _, self._buffer = self._buffer.partition(b"\r")
                self._answer(line)
            elif now > self._until or len(self._buffer) > MAX_LENGTH:
                self._fail()
            else:
                return b""

    def _go(self, reply: Reply | None) -> None:
        self._step, self._said = self._script.send(reply), False

    def _fail(self) -> None:
        self._step, self._said = self._script.throw(_NoAnswerError()), False

    def _answer(self, line: bytes) -> None:
        try:
            reply = parse(line)
        except LineError:
            self._fail()
        else:
            self._go(reply)

    # --- the script ---

    def _talk(self) -> Script:
        for baud in cycle((FIRST_BAUD, self._fast)):
            try:
                yield from self._connect(baud)
                for turn in count():
                    yield from self._read(SLOW[turn % len(SLOW)])
                    yield from self._act()
            except (_NoAnswerError, _ResetError):
                self.reading = None

    def _connect(self, baud: int) -> Script:
        """Find the drive at this rate, and set it to the one to work at."""
        self.baud = baud
        self._done = None  # what a drive does that was out of reach is not known
        self._mode, self._referenced = Mode.OFF, False
        yield _Tell(b"\r", LINE_TIME)  # ends whatever is left in the drive's buffer
        yield _Ask(get(Variable.STATUS))
        if baud != self._fast:
            yield _Tell(put(Variable.BAUD, self._fast), SWITCH_TIME)
            self.baud = self._fast
            yield _Ask(get(Variable.STATUS))

    def _value(self, variable: Variable) -> Generator[_Ask | _Tell, Reply | None, int]:
        """Read a variable; twice, if the first answer is none."""
        try:
            reply = yield _Ask(get(variable))
        except _NoAnswerError:
            yield _Tell(b"\r", LINE_TIME)
            reply = yield _Ask(get(variable))
        if isinstance(reply, Value):
            return reply.number
        if isinstance(reply, Error) and variable in SLOW:
            return 0  # not every drive has it
        raise _NoAnswerError

    def _read(self, slow: Variable) -> Generator[_Ask | _Tell, Reply | None, Reading]:
        """A round of readings."""
        last = self.reading
        clock, position = yield from self._track()
        values = []
        for variable in STATE_VARIABLES:
            values.append((yield from self._value(variable)))
            if self.demand.goal == Goal.FOLLOW:
                yield from self._track()
        velocity, current, status, trajectory, mode = values
        status &= 0xFFFFFFFF
        reading = Reading(clock, position, velocity, current, status, trajectory, mode)
        self.slow[slow] = yield from self._value(slow)
        rose = reading.status & ~last.status if last else 0
        if rose & RESET or self._mode != Mode.OFF == reading.mode:
            raise _ResetError
        self._mode = reading.mode
        self.reading = reading
        referenced = reading.trajectory & (REFERENCED | HOMING) == REFERENCED
        self.homings += referenced and not self._referenced
        self._referenced = referenced
        return reading

    def _track(self) -> Generator[_Ask | _Tell, Reply | None, tuple[int, int]]:
        """Read the position and when it was; a drive that follows is steered by it."""
        position = yield from self._value(Variable.POSITION)
        clock, demand = self._now, self.demand
        speed = self._steer(position, clock, self.reading.velocity if self.reading else 0)
        if speed is not None and demand.goal == Goal.FOLLOW and demand == self._done:
            done = yield from self._say([put(Variable.COMMANDED_VELOCITY, speed)])
            self._done = demand if done else None
        return clock, position

    def _act(self) -> Script:
        """Say what brings the drive to what is demanded of it."""
        reading, demand = self.reading, self.demand
        assert reading
        if self.clear_faults and reading.mode == Mode.OFF:
            yield _Ask(put(Variable.FAULTS, self.slow[Variable.FAULTS]))
            self.clear_faults = False
        if demand == self._done and (reading.mode == demand.mode or self.refusal):
            return
        self._done, self.refusal, self.let_go = None, "", False
        done = yield from self._pursue(demand, demand)
        if not done and demand.goal > Goal.HOLD:  # what cannot be done is held,
            yield from self._read(Variable.FAULTS)
            done = yield from self._pursue(Demand(Goal.HOLD), demand)
        self.let_go = not done
        while not done:  # and what cannot be held is switched off
            yield from self._read(Variable.FAULTS)
            done = yield from self._say([put(Variable.DESIRED_STATE, Mode.OFF)])
        if demand == self.demand:
            self._done = demand

    def _pursue(self, goal: Demand, demand: Demand) -> Generator[_Ask | _Tell, Reply | None, bool]:
        """Bring the drive to a goal while `demand` is what is asked; False: it refuses."""
        reading = self.reading
        assert reading
        if goal.goal <= Goal.HOLD or reading.mode != goal.mode:
            brake = _brake(reading.mode, self.slow[Variable.ABORT_DECELERATION])
            if not (yield from self._say(brake)):
                return False
            end = self._now + REST_TIMEOUT
            while reading.mode != Mode.OFF:
                reading = yield from self._read(Variable.FAULTS)
                if demand != self.demand:
                    return True
                too_long = goal.goal == Goal.RELEASE and self._now > end
                if too_long or abs(reading.velocity) <= MOTION_THRESHOLD:
                    break
        return (yield from self._say(_program(goal, reading.mode)))

    def _say(self, lines: list[bytes]) -> Generator[_Ask | _Tell, Reply | None, bool]:
        """Give orders until one is refused; whether none was."""
        for line in lines:
            reply = yield _Ask(line)
            if isinstance(reply, Error):
                self.refusal = self.refusal or f"{line.decode().strip()}: {reply}"
                return False
            if not isinstance(reply, Ok):
                raise _NoAnswerError
            if line.startswith(STATE):
                self._mode = int(line.removeprefix(STATE))
            if line == trajectory(Trajectory.HOME):
                self._referenced = False
        return True


def _limit(acceleration: int) -> int:
    """An acceleration [10 counts/s^2] as velocity mode has it [1000 counts/s^2]."""
    return max(1, acceleration // 100)


def _brake(mode: int, abort: int) -> list[bytes]:
    """Orders that bring the joint to rest, by the drive's own abort deceleration."""
    if mode == Mode.OFF:
        return []
    if mode == Mode.POSITION:
        return [trajectory(Trajectory.ABORT)]
    limit = [put(Variable.DECELERATION_LIMIT, _limit(abort))] if abort else []
    stop = put(Variable.COMMANDED_VELOCITY, 0)
    return [*limit, stop, put(Variable.DESIRED_STATE, Mode.VELOCITY)]


def _program(demand: Demand, mode: int | None) -> list[bytes]:
    """Orders for what is demanded of a joint at rest, or moving in the mode that it needs.

    The mode comes last where a set-point left over from before would be followed.
    """
    state = [] if mode == demand.mode else [put(Variable.DESIRED_STATE, demand.mode)]
    acceleration = demand.acceleration
    if demand.goal == Goal.CURRENT:
        return [put(Variable.COMMANDED_CURRENT, demand.set_point), *state]
    if demand.goal in (Goal.VELOCITY, Goal.FOLLOW):
        limit = _limit(acceleration)
        limits = [put(Variable.ACCELERATION_LIMIT, limit), put(Variable.DECELERATION_LIMIT, limit)]
        speed = put(Variable.COMMANDED_VELOCITY, demand.set_point)
        return [*(limits if acceleration else []), speed, *state]
    if demand.goal == Goal.HOME:
        return [*state, trajectory(Trajectory.HOME)]
    if demand.goal == Goal.POSITION:
        gains = Variable.PROFILE_ACCELERATION, Variable.PROFILE_DECELERATION
        return [
            *state,
            put(Variable.PROFILE_TYPE, 0),
            put(Variable.TARGET, demand.set_point),
            put(Variable.PROFILE_VELOCITY, demand.velocity),
            *(put(gain, acceleration) for gain in gains if acceleration),
            trajectory(Trajectory.START),
        ]
    return state
