"""Keep the arm clear of itself, of its base and target, and all of them on the table.

A path is checked as a whole, not at samples: from a time t, no gap g can shrink to its margin
before t + (g - margin) / V, V being a bound on how fast its two bodies approach each other in the
window that is looked at (conservative advancement; Mirtich 1996). In a window of length h from t,
with w_k the rate of body k against the base and alpha_k the most that it changes by in a second,

    two bodies i < j of the arm         V = sum_{m=i+1..j} (|w_m - w_i| + (alpha_m + alpha_i) h) a_m
    a point of the arm in the world     V = |P| / M + sum_k C_k Psi_k

as bodies turn about pivots whose distances a_m stay. The floating base's motion follows from its
momentum (P, L), which stays: with centroidal.py's A and n_k = sum_j A_jk, all of its terms turning
with the bodies,

    psi'_0 = (L - sum_k n_k w_k) / sum_k n_k,      psi'_k = psi'_0 + w_k

The base's heading is integrated along (Simpson), its place follows from the centre of mass, and
Psi_k bounds |psi'_k| in the window, as |n_k'| <= sum_j |S_j| |T_k| |w_k - w_j| and the like.

What begins nearer than its margin may only get clearer: until it has its margin, no gap may shrink
by more than RELIEF from the largest that it had on the path.
"""

from dataclasses import dataclass
from math import degrees

import numpy as np
import numpy.typing as npt

from fss_arm_model.clearance import (
    EDGE,
    GRIPPER,
    TARGET,
    body_name,
    gaps,
    links_and_base,
    sizes,
    with_edge,
    with_target,
)
from fss_arm_model.description import Arm
from fss_arm_model.kernels import Floats
from fss_arm_motion.guard_settings import GuardSettings

SELF, AGAINST_EDGE, AGAINST_TARGET = "self", "edge", "target"
RELIEF = 0.001  # [m]


@dataclass(frozen=True)
class Clear:
    """Nothing comes nearer than its margin; of what was looked at, this comes nearest to it."""

    guards: tuple[str, ...]  # what was checked: SELF, AGAINST_EDGE, AGAINST_TARGET
    bodies: tuple[str, str]  # by name
    distance: float  # between them at the least [m]; infinite where there are no two
    time: float  # when [s]


class GuardError(ValueError):
    """Two bodies would come nearer to each other than they may.

    Attributes:
        bodies: by name: "base", "link 3", "gripper", "target", "table edge".
        distance: between them, the least from there on [m]; below 0 they collide.
        margin: what it has to be [m].
        time: on the path, from when on it would be less [s].
        q: joint readings at the least distance (n) [rad].
        guards: what was checked.
    """

    def __init__(
        self,
        bodies: tuple[str, str],
        distance: float,
        margin: float,
        time: float,
        q: tuple[float, ...],
        guards: tuple[str, ...],
    ) -> None:
        self.bodies, self.distance, self.margin = bodies, distance, margin
        self.time, self.q, self.guards = time, q, guards
        joints = ", ".join(f"{degrees(angle):.1f}" for angle in q)
        super().__init__(
            f"{bodies[0]} and {bodies[1]} would be {distance:.3f} m apart with the joints at "
            f"({joints}) deg, from {time:.2f} s on less than the {margin:.3f} m expected"
        )


class Guard:
    """Answers, for one arm, whether a motion keeps all bodies clear of each other and the edge.

    Everywhere: base is the base's pose in the world (x, y [m], heading [rad]) and twist its
    velocity (vx, vy [m/s], omega [rad/s]) at the begin; without a twist, base and arm together
    have no momentum. target is the pose of what the gripper is to grip, (3,), or pose and twist,
    (2, 3), in the world. Without base, the arm is guarded against itself and the base alone; which
    guards there were, each answer says.

    Raises, everywhere:
        GuardError: two bodies would come too near.
        ValueError: shapes do not fit, times do not ascend, or a number is not finite.
    """

    def __init__(self, arm: Arm, settings: GuardSettings | None = None) -> None:
        self.arm, self.settings = arm, settings or GuardSettings()

    def guards(
        self, base: npt.ArrayLike | None = None, target: npt.ArrayLike | None = None
    ) -> tuple[str, ...]:
        """What is checked, if this is known."""
        raise NotImplementedError

    def check_posture(
        self,
        q: npt.ArrayLike,
        base: npt.ArrayLike | None = None,
        target: npt.ArrayLike | None = None,
    ) -> Clear:
        """Whether a posture (n) [rad] has all margins."""
        raise NotImplementedError

    def check_path(
        self,
        times: npt.ArrayLike,
        q: npt.ArrayLike,
        qd: npt.ArrayLike,
        base: npt.ArrayLike | None = None,
        twist: npt.ArrayLike | None = None,
        target: npt.ArrayLike | None = None,
    ) -> Clear:
        """Whether a path keeps all margins, cubic between its knots, as the links interpolate it.

        Args:
            times: (k,) of the knots, ascending [s]; base, twist and target are those at the first.
            q: (k, n) readings there [rad].
            qd: (k, n) rates there [rad/s].
            base: pose, see above.
            twist: see above.
            target: see above.
        """
        raise NotImplementedError

    def check_command(
        self,
        q: npt.ArrayLike,
        qd: npt.ArrayLike,
        horizon: float = 0.0,
        *,
        velocity: npt.ArrayLike | None = None,
        position: npt.ArrayLike | None = None,
        max_velocity: npt.ArrayLike | None = None,
        max_acceleration: npt.ArrayLike | None = None,
        base: npt.ArrayLike | None = None,
        twist: npt.ArrayLike | None = None,
        target: npt.ArrayLike | None = None,
    ) -> Clear:
        """Whether the arm still keeps clear if it follows a command, and comes to rest after it.

        With `position`, the drives go there, each by its own trapezoid, and rest. Else they turn at
        `velocity` (as now, by default) for the horizon and then brake; braking at once must keep
        clear as well, so that a command that is refused next leaves a way to rest.

        Args:
            q: (n) present readings [rad].
            qd: (n) present rates [rad/s].
            horizon: how long the command may act until the next one is checked [s].
            velocity: (n) commanded [rad/s].
            position: (n) commanded [rad].
            max_velocity: (n) of the trapezoids [rad/s]; the drives' limits by default.
            max_acceleration: (n) to speed up and brake with [rad/s^2]; the same.
            base: pose, see above.
            twist: see above.
            target: see above.
        """
        raise NotImplementedError

    def drift(
        self,
        base: npt.ArrayLike,
        twist: npt.ArrayLike,
        q: npt.ArrayLike,
        qd: npt.ArrayLike | None = None,
        longest: float = 60.0,
    ) -> float:
        """How long until the drifting base brings a body to the edge's margin [s].

        The arm brakes from qd (at rest by default) and then is held. Infinite if not within
        `longest` [s]; 0 if one is within the margin and comes nearer.
        """
        raise NotImplementedError

    def braking(self, qd: npt.ArrayLike) -> float:
        """How long the drives take to come to rest from rates (n) [s]."""
        raise NotImplementedError
