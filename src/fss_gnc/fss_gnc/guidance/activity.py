"""Activities: what the guidance can do, one at a time. No ROS, no clock.

The node steps an activity at its rate with what is seen, and carries out the orders that it answers
with, until they say how it ended. After that, and whenever the base is unknown, the base coasts.
"""

from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from fss_arm_model.description import Arm
from fss_arm_model.held import Target
from fss_arm_model.settings import SettingError
from fss_gnc.guidance.mission_settings import MissionSettings
from fss_gnc.reference import Body, Path

Floats = npt.NDArray[np.float64]
Held = tuple[Target, Floats]  # a body and its place (3,) in the last link's frame (held.py)


class ActivityError(ValueError):
    """An activity cannot begin, or go on; the message says why."""


@dataclass(frozen=True)
class Seen:
    """What is known at a moment."""

    t: float  # since the activity began [s]
    base: Body | None = None  # None: not known now
    target: Body | None = None
    q: Floats | None = None  # (n,) [rad]; None: not all joints are known
    qd: Floats | None = None  # (n,) [rad/s]
    effort: Floats | None = None  # (n,) [N m]
    holds: bool | None = None  # the gripper the target; None: not known
    propellant: float = np.nan  # left [kg]; NaN: not known
    last_q: Floats | None = None  # (n,) as the joints were last heard [rad]; None: never
    held: Held | None = None  # what the gripper holds, as measured; None: it is not yet
    open_valves: tuple[int, ...] = ()  # that do not close, from 1
    pushed: bool = False  # momentum changes as nothing known explains

    @property
    def keeping(self) -> bool | None:
        """The order to the gripper that lets go of nothing: close if it holds, open if not."""
        return None if self.holds is None else bool(self.holds)

    @property
    def floating(self) -> tuple[Floats, Floats]:
        """State of base and arm and its rate, (3 + n,) each.

        Raises:
            ActivityError: base or joints are not known.
        """
        if self.base is None:
            raise ActivityError("base/state is not known")
        if self.q is None or self.qd is None:
            raise ActivityError("arm/joint_states are not known")
        return np.concatenate([self.base.pose, self.q]), np.concatenate([self.base.twist, self.qd])


class Ended(NamedTuple):
    """How an activity ended."""

    well: bool
    message: str = ""  # why not, if not


@dataclass(frozen=True)
class Orders:
    """What to do until the next step; by default valves are closed and the arm is left alone."""

    phase: str
    path: Path | None = None  # of the base, by the activity's time; None: coast
    rates: Floats | None = None  # (n,) of the joints [rad/s]; None: the arm is left alone
    close: bool | None = None  # the gripper; None: as it is
    keep_out: float = 0.0  # radius about the target that it keeps off [m]
    fixture_distance: float = np.nan  # from the end effector to the target's fixture [m]
    reason: str = ""  # why it aborts or brakes; empty: it does not
    ended: Ended | None = None


class Activity(Protocol):
    """Something that the guidance does."""

    blind: bool  # whether it goes on while base or joints are unknown

    def step(self, seen: Seen) -> Orders:
        """Orders for now.

        Raises:
            ActivityError: it cannot go on, and so has failed.
        """

    def cancel(self, reason: str) -> None:
        """Come to an end within the next steps."""


@dataclass(frozen=True)
class Craft:
    """The spacecraft as the guidance knows it.

    Raises:
        SettingError: the posture is not one of this arm.
    """

    arm: Arm
    settings: MissionSettings = field(default_factory=MissionSettings)

    def __post_init__(self) -> None:
        posture, links = self.settings.posture, self.arm.links
        if posture and len(posture) != len(links):
            raise SettingError(f"posture has {len(posture)} angles, expected {len(links)} or none")
        for i, (q, link) in enumerate(zip(posture, links, strict=False), 1):
            if not link.q_min <= q <= link.q_max:
                raise SettingError(
                    f"posture has {q:g} rad for joint {i}, expected {link.q_min:g} to "
                    f"{link.q_max:g} rad"
                )
