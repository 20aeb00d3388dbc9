"""Conversion of a wrench to pulses, one of each valve per period, while it is active."""

from collections.abc import Collection
from typing import Any

from fss_arm_model.units import SECOND
from fss_base_driver.allocation import Allocation
from fss_base_driver.protocol import VALVES
from fss_base_driver.session import BoardSession
from fss_base_driver.settings import BaseSettings
from fss_base_driver.wrench import planar_wrench
from fss_link.session import CommandError


class WrenchFollower:
    """Allocation of the active wrench to the valves that work. Times are in nanoseconds.

    A wrench is active until it is replaced, is older than its lifetime, is rejected by the session,
    or has become zero, which closes all valves once.

    Args:
        settings: the valves, the base's frame, the period and the lifetime of a wrench.
    """

    def __init__(self, settings: BaseSettings) -> None:
        self._options = settings.valves(), settings.wrench_period, settings.minimum_on_time
        self._period = SECOND * settings.wrench_period
        self._lifetime = SECOND * settings.wrench_lifetime
        self._frame, self._limit = settings.base_frame, settings.max_wrench()
        self._wrench: tuple[tuple[float, float, float], int] | None = None  # with its time
        self._commanded = 0  # time of the last pulses
        self.exclude((), ())

    @property
    def active(self) -> bool:
        """True if there is a wrench."""
        return self._wrench is not None

    def exclude(self, stuck_open: Collection[int], stuck_closed: Collection[int]) -> None:
        """Exclude stuck valves, numbered from 0; the impulse carried over is dropped."""
        self._stuck = stuck_open, stuck_closed
        self._allocation = Allocation(*self._options, *self._stuck)

    def follow(self, message: Any, given: int) -> None:
        """Activate the wrench of a geometry_msgs/WrenchStamped.

        Raises:
            CommandError: it is not valid; the active wrench stays active.
        """
        self._wrench = planar_wrench(message, self._frame, self._limit), given

    def cancel(self) -> None:
        """Deactivate the wrench, if there is one."""
        self._wrench = None

    def is_due(self, now: int) -> bool:
        """Return True if the last pulses were commanded at least a period ago."""
        return not 0 <= now - self._commanded < self._period

    def command_pulses(self, session: BoardSession, now: int) -> bool:
        """Command the pulses of the next period; return False if no wrench is active.

        The session counts the wrenches that the valves cannot produce as `wrenches_clipped`.

        Raises:
            CommandError: the session rejects them; the wrench is no longer active.
        """
        if self._wrench is None:
            return False
        wrench, given = self._wrench
        expired = not 0 <= now - given <= self._lifetime  # a simulated clock can be set back
        if expired or not any(wrench):
            self.cancel()
            self.exclude(*self._stuck)
        if expired:
            return False  # the last pulse ends by itself
        on_times = VALVES * [0.0]
        if any(wrench):
            on_times = self._allocation.on_times(wrench).tolist()
            session.counts["wrenches_clipped"] += self._allocation.clipped
        try:
            session.thrust(on_times, now, now)
        except CommandError:
            self.cancel()  # so that it opens no valve after the board is armed again
            raise
        self._commanded = now
        return True
