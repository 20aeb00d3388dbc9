"""The newest that a topic has said, for as long as it is not too old."""

from typing import Generic, TypeVar

from fss_arm_model.units import SECOND

T = TypeVar("T")


class Latest(Generic[T]):
    """One topic's newest value with its stamp.

    Args:
        name: of the topic.
        max_age: of a value, and most that it may be ahead of the clock [s].
    """

    def __init__(self, name: str, max_age: float) -> None:
        self.name, self.max_age = name, max_age
        self.stamp: int | None = None  # [ns]
        self.value: T | None = None

    def take(self, stamp: int, value: T) -> None:
        """Keep what was said at a time [ns]."""
        self.stamp, self.value = stamp, value

    def age(self, now: int) -> float:
        """Since it was said [s]; infinite: never."""
        return float("inf") if self.stamp is None else (now - self.stamp) / SECOND

    def at(self, now: int) -> T | None:
        """The value; None if there is none that still holds [ns]."""
        return self.value if abs(self.age(now)) <= self.max_age else None

    def trouble(self, now: int) -> str:
        """Why there is no value, in words; empty: there is one."""
        if self.stamp is None:
            return f"{self.name} was not heard yet"
        if (age := self.age(now)) > self.max_age:
            return f"{self.name} is {age:.1f} s old"
        return f"{self.name} is {-age:.1f} s ahead of the clock" if age < -self.max_age else ""
