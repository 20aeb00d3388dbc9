"""Stream of joint commands: each JointState takes effect at once, for some or all joints.

Exactly one of position, velocity and effort is filled, for the joints in `name`; an effort is
converted to a current by the joint's torque constant. An invalid message moves no joint.

A rate is reached when the next message is due, but within RAMP_TIME if the acceleration allows. The
joint then accelerates as the rates do, and not in pulses of the largest acceleration. The next one
is due after the longer of the last two intervals, because stamps are irregular. A joint may lag, as
datagrams are late or lost: it catches up with a rate that stays the same at the last acceleration,
or at CATCH_UP of the largest one.
"""

from collections import Counter
from collections.abc import Iterator
from reprlib import repr as short
from typing import Any, NamedTuple

from fss_arm_driver.protocol import Mode
from fss_arm_driver.scale import MAX_MAGNITUDE
from fss_arm_model.description import Arm, joint_names
from fss_arm_model.units import SECOND, angle_beyond

MAX_LEAD = SECOND // 10  # largest lead of a stamp, because computers' clocks differ [ns]
RAMP_TIME = 0.1  # longest time in which a joint reaches a new rate, if it can [s]
CATCH_UP = 0.25  # least share of the largest acceleration at a rate that stays the same
SAME_RATE = 1e-6  # difference of rates that are the same [rad/s]
FIELDS = {"position": Mode.POSITION, "velocity": Mode.VELOCITY, "effort": Mode.CURRENT}


class StreamError(ValueError):
    """Error of a refused message: the kind of the reason, and the reason."""

    def __init__(self, kind: str, words: str) -> None:
        super().__init__(words)
        self.kind = kind


class SetPoint(NamedTuple):
    """Set point of one joint."""

    link: int
    mode: Mode
    value: float  # [rad], [rad/s] or [A], by mode


class Ramp:
    """Rate of a joint that follows a stream of rates.

    Args:
        rate: its rate at the start [rad/s].
        limit: its largest acceleration [rad/s^2].
    """

    def __init__(self, rate: float, limit: float) -> None:
        self._rate = self._goal = rate
        self._limit = self._acceleration = limit
        self._time: float | None = None  # of the last command [s]
        self._interval = 0.0  # between the last two commands [s]

    def acceleration(self, goal: float, time: float) -> float:
        """Return the acceleration [rad/s^2] towards a rate that is commanded at a time [s]."""
        before = time if self._time is None else self._time
        time = max(time, before)  # an earlier stamp counts as the last one
        interval = time - before
        change = self._acceleration * interval
        self._rate += min(max(self._goal - self._rate, -change), change)
        self._goal, self._time, missing = goal, time, abs(goal - self._rate)
        due, self._interval = max(interval, self._interval), interval or self._interval
        if missing > SAME_RATE:
            ramp_time = min(due, RAMP_TIME)
            is_slow = missing < self._limit * ramp_time
            self._acceleration = missing / ramp_time if is_slow else self._limit
        else:
            self._acceleration = max(self._acceleration, CATCH_UP * self._limit)
        return self._acceleration

    def is_current(self, time: float, time_to_live: float) -> bool:
        """Return True if the last command still applies at a time [s]; else the joint brakes."""
        return self._time is not None and time <= self._time + time_to_live


class Stream:
    """Parser of the messages; it counts refused ones by reason.

    Args:
        arm: with the joints.
        time_to_live: of a message after its stamp [s].
    """

    def __init__(self, arm: Arm, time_to_live: float) -> None:
        self._arm, self._time_to_live = arm, round(time_to_live * SECOND)
        self._links = {name: i for i, name in enumerate(joint_names(arm.n), 1)}
        self.accepted = 0
        self.refused: Counter[str] = Counter()
        self.kind = ""  # of the last message's refusal; empty: it was accepted

    def start_time(self, stamp: int, now: int) -> int:
        """Return the start of a message's time to live, from its stamp [ns]; stamp 0: now.

        Raises:
            StreamError: the message is too old, or its stamp too far in the future.
        """
        given = stamp or now
        if given + self._time_to_live < now:
            raise StreamError(
                "old",
                f"stamp is {(now - given) / SECOND:.3f} s old, expected less "
                f"than {self._time_to_live / SECOND:g} s",
            )
        if given > now + MAX_LEAD:
            ahead = (given - now) / SECOND
            raise StreamError(
                "future",
                f"stamp is {ahead:.3f} s in the future, expected at most {MAX_LEAD / SECOND:g} s: "
                "synchronize the clocks",
            )
        return min(given, now)

    def parse(self, message: Any) -> list[SetPoint]:
        """Return the set points in a message.

        Raises:
            StreamError: the message is invalid, or a position is beyond its joint's limits.
        """
        filled = [name for name in FIELDS if len(getattr(message, name))]
        if len(filled) != 1:
            words = " and ".join(filled) or "nothing"
            raise StreamError("fields", f"{words} is filled, expected one of {', '.join(FIELDS)}")
        names, values = message.name, getattr(message, filled[0])
        if len(names) != len(values):
            raise StreamError(
                "fields", f"{filled[0]} has {len(values)} numbers for {len(names)} names"
            )
        if len(set(names)) < len(names):
            ((name, _),) = Counter(names).most_common(1)
            raise StreamError("names", f"name has {short(name)} twice")
        return list(self._set_points(names, values, filled[0]))

    def _set_points(self, names: Any, values: Any, kind: str) -> Iterator[SetPoint]:
        for name, number in zip(names, values, strict=True):
            i, value = self._links.get(name), float(number)
            if i is None:
                expected = f"joint_1 to joint_{self._arm.n}"
                raise StreamError("names", f"name is {short(name)}, expected {expected}")
            if not abs(value) <= MAX_MAGNITUDE:  # NaN, too
                expected = f"a finite number of at most {MAX_MAGNITUDE:g} in size"
                raise StreamError("number", f"{kind} of {name} is {value}, expected {expected}")
            link = self._arm.links[i - 1]
            if kind == "position" and not link.q_min <= value <= link.q_max:
                raise StreamError(
                    "limits",
                    f"position of {name} is {angle_beyond(value, link.q_min, link.q_max)}",
                )
            if kind == "effort":
                value /= link.drive.torque_constant
            yield SetPoint(i, FIELDS[kind], value)

    def count_accepted(self) -> None:
        """Count an accepted message."""
        self.accepted, self.kind = self.accepted + 1, ""

    def count_refusal(self, error: StreamError) -> bool:
        """Count a refused message; return True if the reason differs from the last one's."""
        self.refused[error.kind] += 1
        self.kind, before = error.kind, self.kind
        return before != error.kind
