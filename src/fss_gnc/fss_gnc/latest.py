"""The newest message of a topic, valid until it is too old."""

from typing import Generic, TypeVar

from fss_arm_model.units import SECOND
from fss_gnc.reference import Body

T = TypeVar("T")


class Latest(Generic[T]):
    """Newest value of one topic, with its stamp.

    Args:
        name: of the topic.
        max_age: largest age of a value, and largest lead of its stamp over the clock [s].
    """

    def __init__(self, name: str, max_age: float) -> None:
        self.name, self.max_age = name, max_age
        self.stamp: int | None = None  # [ns]
        self.value: T | None = None

    def store(self, stamp: int, value: T) -> None:
        """Store a value with its stamp [ns]."""
        self.stamp, self.value = stamp, value

    def clear(self) -> None:
        """Forget the value."""
        self.stamp = self.value = None

    def age(self, now: int) -> float:
        """Return the age of the value [s]; infinite if there is none."""
        return float("inf") if self.stamp is None else (now - self.stamp) / SECOND

    def valid_value(self, now: int) -> T | None:
        """Return the value; None if there is none that is valid at `now` [ns]."""
        return self.value if abs(self.age(now)) <= self.max_age else None

    def problem(self, now: int) -> str:
        """Return why there is no valid value; empty if there is one."""
        if self.stamp is None:
            return f"waiting for {self.name}"
        if (age := self.age(now)) > self.max_age:
            return f"{self.name} is {age:.1f} s old"
        return f"{self.name} is stamped {-age:.1f} s in the future" if age < -self.max_age else ""


def body_at(topic: Latest[Body], now: int) -> Body | None:
    """Return the state extrapolated to `now` [ns]; None if there is none that is valid then."""
    body = topic.valid_value(now)
    return body and body.extrapolate(topic.age(now))
