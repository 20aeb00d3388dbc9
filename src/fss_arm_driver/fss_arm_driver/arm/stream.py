"""A stream of commands: a JointState each, that some or all joints shall follow at once.

Exactly one of position, velocity and effort is filled, for the joints in `name`; an effort is a
current through the joint's torque constant. A message that is not understood whole moves nothing.
"""

from collections import Counter
from collections.abc import Iterator
from math import isfinite
from reprlib import repr as short
from typing import Any, NamedTuple

from fss_arm_driver.protocol import Mode
from fss_arm_model.description import Arm

SECOND = 1_000_000_000  # [ns]
AHEAD = SECOND // 10  # that a stamp may be in the future, as computers' clocks differ [ns]
FIELDS = {"position": Mode.POSITION, "velocity": Mode.VELOCITY, "effort": Mode.CURRENT}


class StreamError(ValueError):
    """A message that was refused: of which kind the reason is, and the reason."""

    def __init__(self, kind: str, words: str) -> None:
        super().__init__(words)
        self.kind = kind


class SetPoint(NamedTuple):
    """What one joint shall do."""

    link: int
    mode: Mode
    value: float  # [rad], [rad/s] or [A], by mode


class Stream:
    """Takes messages, and counts those refused by reason.

    Args:
        arm: whose joints.
        time_to_live: of a message after its stamp [s].
    """

    def __init__(self, arm: Arm, time_to_live: float) -> None:
        self._arm, self._lives = arm, round(time_to_live * SECOND)
        self._links = {f"joint_{i}": i for i in range(1, arm.n + 1)}
        self.taken = 0
        self.refused: Counter[str] = Counter()
        self.kind = ""  # of the last message's refusal; empty: it was taken

    def given(self, stamp: int, now: int) -> int:
        """When a message was given, by its stamp and the time [ns]; stamp 0: now.

        Raises:
            StreamError: it is too old, or from the future.
        """
        given = stamp or now
        if given + self._lives < now:
            raise StreamError("old", f"stamp is {(now - given) / SECOND:.3f} s old, expected less "
                              f"than {self._lives / SECOND:g} s")  # fmt: skip
        if given > now + AHEAD:
            ahead = (given - now) / SECOND
            raise StreamError("future", f"stamp is {ahead:.3f} s in the future, expected the past")
        return min(given, now)

    def read(self, message: Any) -> list[SetPoint]:
        """What a message asks for.

        Raises:
            StreamError: it is not understood, or beyond the joints' limits.
        """
        filled = [name for name in FIELDS if len(getattr(message, name))]
        if len(filled) != 1:
            words = " and ".join(filled) or "nothing"
            raise StreamError("fields", f"{words} is filled, expected one of {', '.join(FIELDS)}")
        names, values = message.name, getattr(message, filled[0])
        if len(names) != len(values):
            raise StreamError("fields", f"{filled[0]} has {len(values)} numbers for {len(names)} "
                              "names")  # fmt: skip
        if len(set(names)) < len(names):
            raise StreamError("names", "name has a joint twice")
        return list(self._set_points(names, values, filled[0]))

    def _set_points(self, names: Any, values: Any, kind: str) -> Iterator[SetPoint]:
        for name, number in zip(names, values, strict=True):
            i, value = self._links.get(name), float(number)
            if i is None:
                expected = f"joint_1 to joint_{self._arm.n}"
                raise StreamError("names", f"name is {short(name)}, expected {expected}")
            if not isfinite(value):
                raise StreamError("number", f"{kind} of {name} is {value}, expected a number")
            link = self._arm.links[i - 1]
            if kind == "position" and not link.q_min <= value <= link.q_max:
                raise StreamError(
                    "limits",
                    f"position of {name} is {value} rad, expected "
                    f"{link.q_min:.6g} to {link.q_max:.6g}",
                )
            if kind == "effort":
                value /= link.drive.torque_constant
            yield SetPoint(i, FIELDS[kind], value)

    def accept(self) -> None:
        """Count a message that was taken."""
        self.taken, self.kind = self.taken + 1, ""

    def refuse(self, error: StreamError) -> bool:
        """Count a message that was not taken; whether the last one was not for the same reason."""
        self.refused[error.kind] += 1
        self.kind, before = error.kind, self.kind
        return before != error.kind
