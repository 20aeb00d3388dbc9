"""Activities of the guidance, one at a time, without ROS and without a clock.

The node steps an activity at its rate with the known state. It executes the commands that the
activity returns, until they contain an outcome. After that, and whenever the base is unknown, the
base coasts.
"""

from dataclasses import KW_ONLY, dataclass, field, replace
from typing import NamedTuple, Protocol

import numpy as np

from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_model.held import Target
from fss_arm_model.settings import SettingError
from fss_arm_model.units import angle_beyond
from fss_gnc.guidance.mission_settings import MissionSettings
from fss_gnc.guidance.other_vehicles import OtherVehicle
from fss_gnc.reference import Body, Path

HeldBody = tuple[Target, Floats]  # a body and its place (3,) in the last link's frame (held.py)


class ActivityError(ValueError):
    """Failure to start or to continue an activity; the message says why."""


@dataclass(frozen=True)
class Observation:
    """Known state at one time."""

    t: float  # since the activity started [s]
    base: Body | None = None  # None: not known now
    target: Body | None = None
    q: Floats | None = None  # (n,) [rad]; None: not all joints are known
    qd: Floats | None = None  # (n,) [rad/s]
    effort: Floats | None = None  # (n,) [N m]
    holds: bool | None = None  # whether the gripper holds the target; None: not known
    propellant: float = np.nan  # left [kg]; NaN: not known
    _: KW_ONLY
    last_q: Floats | None = None  # (n,) last received joint angles [rad]; None: none yet
    joints_age: float = np.inf  # of these [s]; negative: stamped in the future
    held_body: HeldBody | None = None  # held body as measured; None: not measured yet
    open_valves: tuple[int, ...] = ()  # valves that do not close, from 1
    unknown_push: bool = False  # momentum changes without a known cause
    armed: bool | None = None  # whether the valves may open; None: not known
    stall: str = ""  # why control has dropped the reference; empty: it follows
    others: tuple[OtherVehicle, ...] = ()  # other vehicles on the table
    unknown: tuple[str, ...] = ()  # why states of base, joints or target are unknown

    @property
    def keep_gripper(self) -> bool | None:
        """Gripper command that keeps the present state: close if it holds a target, open if not."""
        return None if self.holds is None else bool(self.holds)

    def with_joints_at_rest(self) -> "Observation":
        """Return this with the joints at rest where they were last, if they are unknown."""
        if self.q is not None or self.last_q is None:
            return self
        return replace(self, q=self.last_q, qd=np.zeros(self.last_q.size))

    @property
    def floating_state(self) -> tuple[Floats, Floats]:
        """State of base and arm and its rate, (3 + n,) each.

        Raises:
            ActivityError: base or joints are not known.
        """
        if self.base is None:
            raise ActivityError("base/state is not known")
        if self.q is None or self.qd is None:
            raise ActivityError("arm/joint_states are not known")
        return np.concatenate([self.base.pose, self.q]), np.concatenate([self.base.twist, self.qd])


def tracking_problem(obs: Observation, offset: Floats, settings: MissionSettings) -> str:
    """Return a reason if the base is too far from its reference; empty if it follows.

    Args:
        obs: state now.
        offset: (3,) from the reference.
        settings: limits.
    """
    distance, turn = float(np.hypot(*offset[:2])), abs(float(offset[2]))
    if distance <= settings.max_offset and turn <= settings.max_turn:
        return ""
    limits = f"{settings.max_offset:g} m and {np.degrees(settings.max_turn):.0f} deg"
    reason = f"the base is {distance:.3f} m and {np.degrees(turn):.1f} deg off its reference"
    cause = "; its board is disarmed: scripts/fss_arm.sh valves" if obs.armed is False else ""
    return f"{reason}, expected at most {limits}{cause}"


class Outcome(NamedTuple):
    """Result of an activity."""

    success: bool
    message: str = ""  # reason of a failure or of a requested abort; else empty


@dataclass(frozen=True)
class Commands:
    """Commands until the next step.

    By default the valves are closed and the arm gets no commands.
    """

    phase: str
    path: Path | None = None  # of the base, by the activity's time; None: coast
    rates: Floats | None = None  # (n,) of the joints [rad/s]; None: no command
    close_gripper: bool | None = None  # close the gripper, or open it; None: unchanged
    keep_out: float = 0.0  # radius of the keep-out zone about the target [m]
    fixture_distance: float = np.nan  # from the end effector to the target's fixture [m]
    reason: str = ""  # why it aborts, brakes or assumes a state; empty: not so
    outcome: Outcome | None = None
    plan: Path | None = None  # of the base, for other vehicles; None: it drifts


class Activity(Protocol):
    """Behaviour of the guidance, executed in steps."""

    def tolerates(self, obs: Observation) -> bool:
        """Return True if it continues although base or joints are unknown."""

    def step(self, obs: Observation) -> Commands:
        """Return the commands until the next step.

        Raises:
            ActivityError: it cannot continue, and so has failed.
        """

    def cancel(self, reason: str) -> None:
        """End within the next steps, as the operator requests."""

    def interrupt(self, reason: str) -> None:
        """End within the next steps, and fail."""


@dataclass(frozen=True)
class Craft:
    """Spacecraft model of the guidance.

    Raises:
        SettingError: the posture does not fit this arm.
    """

    arm: Arm
    settings: MissionSettings = field(default_factory=MissionSettings)

    def __post_init__(self) -> None:
        posture, links = self.settings.posture, self.arm.links
        if posture and len(posture) != len(links):
            raise SettingError(f"posture has {len(posture)} angles, expected {len(links)} or none")
        for i, (q, link) in enumerate(zip(posture, links, strict=False), 1):
            if not link.q_min <= q <= link.q_max:
                words = angle_beyond(q, link.q_min, link.q_max)
                raise SettingError(f"posture of joint {i} is {words}")
