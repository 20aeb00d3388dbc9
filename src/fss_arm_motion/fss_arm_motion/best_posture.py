"""Find the posture in which the end effector moves best along a direction, and the way there.

Joint rates of norm 1 give the tip velocities within the ellipsoid v^T (J J^T)^-1 v <= 1 (Yoshikawa
1985), which reaches along a direction u

    r = 1 / sqrt(u^T (J J^T)^-1 u)                                            (Chiu 1988)

its velocity ratio [m/s per rad/s]. J is the generalized Jacobian on a floating base without
momentum, or the tip's with the base held; directions and places are in the base frame. r has many
maxima over the postures: SLSQP starts from the best of many random postures and maximizes r within
joint limits and with bodies apart, and with the tip at a place if one is given.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_model.kinematics import tip_in_base, tip_jacobian
from fss_arm_model.momentum import generalized_jacobian
from fss_arm_model.settings import (
    FINITE,
    SettingError,
    Settings,
    at_least,
    one_of,
    setting,
)
from fss_arm_motion.plan import Plan, PlanError, Start
from fss_arm_motion.point_to_point import PointToPoint, point_to_point

FLOATING, FIXED = "floating", "fixed"
SAMPLE_COUNT = 20_000
MAX_CLIMBS = 24
STEP = 1e-6  # of central differences [rad]
PLACE_TOLERANCE = 1e-6  # largest distance from a place that is reached [m]


@dataclass(frozen=True)
class BestPosture(Settings):
    """Motion to the posture in which the end effector moves best along a direction.

    Raises:
        SettingError: a place does not have two numbers.
    """

    direction: float = setting(
        0.0, "direction of the velocity, seen from the base", unit="rad", check=FINITE
    )
    place: tuple[float, ...] = setting(
        (),
        "place of the end effector, seen from the base: x, y; none: anywhere",
        unit="m",
        check=FINITE,
    )
    base: str = setting(FLOATING, "base during the motion", check=one_of(FLOATING, FIXED))
    seed: int = setting(0, "seed of the search", check=at_least(0))

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.place) not in (0, 2):
            raise SettingError(f"place has {len(self.place)} numbers, expected 2 or none")


def velocity_ratio(arm: Arm, q: npt.ArrayLike, direction: float, base: str = FLOATING) -> Floats:
    """Return the ratio r of postures (..., n) along a direction [rad], (...) [m]; 0 if singular.

    Raises:
        ValueError: shapes do not fit.
    """
    q = np.asarray(q, dtype=float)
    p, state = arm.vector(), np.concatenate([np.zeros((*q.shape[:-1], 3)), q], axis=-1)
    J = generalized_jacobian(p, state) if base == FLOATING else tip_jacobian(p, state)[..., 3:]
    x, y = J[..., 0, :], J[..., 1, :]
    xx, xy, yy = (x * x).sum(axis=-1), (x * y).sum(axis=-1), (y * y).sum(axis=-1)
    c, s = np.cos(direction), np.sin(direction)
    across = c * c * yy - 2.0 * c * s * xy + s * s * xx  # u^T adj(J J^T) u
    return np.sqrt((xx * yy - xy * xy).clip(0.0) / np.maximum(across, 1e-300))


def best(start: Start, request: BestPosture) -> tuple[Floats, float]:
    """Return the best posture (n,) and its ratio.

    Raises:
        PlanError: no posture within limits has the tip at the place.
    """
    arm, rng = start.arm, np.random.default_rng(request.seed)
    low, high = start.limits.bounds.T
    place = np.array(request.place) if request.place else None
    q = rng.uniform(low, high, (SAMPLE_COUNT, arm.n))
    q = q[start.gap(q) >= start.limits.margin]
    if place is not None:
        q = _move_to_place(start, q, place)
    if not len(q):
        raise PlanError(
            f"place is {list(request.place)} m from the base, expected one that the end effector "
            f"reaches within joint limits, bodies {start.limits.margin:g} m apart"
        )
    r = velocity_ratio(arm, q, request.direction, request.base)
    found = [_climb(start, q[k], place, request) for k in np.argsort(-r)[:MAX_CLIMBS]]
    ratios = [float(velocity_ratio(arm, one, request.direction, request.base)) for one in found]
    k = int(np.argmax(ratios))
    return found[k], ratios[k]


def _move_to_place(start: Start, q: Floats, place: Floats) -> Floats:
    """Return postures near a place with the tip moved there and within limits, from (k, n)."""
    p, (low, high) = start.arm.vector(), start.limits.bounds.T
    off = np.linalg.norm(tip_in_base(p, q)[:, :2] - place, axis=1)
    q = q[np.argsort(off)[:400]]
    for _ in range(30):
        state = np.concatenate([np.zeros((len(q), 3)), q], axis=1)
        J = tip_jacobian(p, state)[:, :2, 3:]
        error = place - tip_in_base(p, q)[:, :2]
        JJ = J @ np.swapaxes(J, 1, 2) + 1e-9 * np.eye(2)
        step = np.einsum("krn,kr->kn", J, np.linalg.solve(JJ, error[..., None])[..., 0])
        q = np.clip(q + step.clip(-0.3, 0.3), low, high)
    off = np.linalg.norm(tip_in_base(p, q)[:, :2] - place, axis=1)
    return q[(off < PLACE_TOLERANCE) & (start.gap(q) >= start.limits.margin)]


def _climb(start: Start, q: Floats, place: Floats | None, request: BestPosture) -> Floats:
    """Return a local maximum of the ratio, or the posture itself if none is within limits."""
    from scipy.optimize import minimize

    arm, p, steps = start.arm, start.arm.vector(), STEP * np.eye(start.arm.n)

    def loss(q: Floats) -> Floats:
        r = velocity_ratio(arm, q, request.direction, request.base)
        return -np.log(np.maximum(r, 1e-12))

    def slope(function: Any, q: Floats) -> Floats:
        return (function(q + steps) - function(q - steps)) / (2.0 * STEP)

    def margins(q: Floats) -> Floats:
        return np.minimum(start.gap(q), 1.0) - start.limits.margin

    held: list[dict[str, Any]] = [
        {"type": "ineq", "fun": margins, "jac": lambda q: slope(margins, q)},
    ]
    if place is not None:
        held.append(
            {
                "type": "eq",
                "fun": lambda q: tip_in_base(p, q)[:2] - place,
                "jac": lambda q: tip_jacobian(p, np.append(np.zeros(3), q))[:2, 3:],
            }
        )
    got = minimize(
        loss,
        q,
        jac=lambda q: slope(loss, q),
        bounds=start.limits.bounds,
        constraints=held,
        method="SLSQP",
        options={"maxiter": 100, "ftol": 1e-9},
    ).x.clip(*start.limits.bounds.T)
    good = margins(got) > -1e-6
    if place is not None:
        good &= np.linalg.norm(tip_in_base(p, got)[:2] - place) < PLACE_TOLERANCE
    return got if good and loss(got) < loss(q) else q


def best_posture(start: Start, request: BestPosture) -> Plan:
    """Plan the fastest motion to the best posture.

    Raises:
        PlanError: no posture has the tip at the place, or limits cannot be kept.
    """
    q, ratio = best(start, request)
    plan = point_to_point(start, PointToPoint(tuple(q.tolist())))
    here = float(velocity_ratio(start.arm, start.q, request.direction, request.base))
    arguments = {
        "direction": request.direction,
        "place": list(request.place),
        "base": request.base,
        "seed": request.seed,
    }
    notes = {"ratio": ratio, "ratio_before": here}
    return Plan(
        "best_posture", arguments, plan.times, plan.q, plan.qd, plan.prediction, plan.used, notes
    )
