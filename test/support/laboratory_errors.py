"""Errors that laboratories make, applied to what a bag of foreign_bags.py will hold."""

import re
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from foreign_bags import COUNTS, JOINT_RATE, Heard

from fss_arm_model.units import SECOND

Rng = np.random.Generator


class Kind:
    """A way to spoil a bag, what the verdict must begin with, and settings that are given."""

    def __init__(
        self, name: str, says: str, spoil: Callable[..., None], *args: Any, **options: object
    ) -> None:
        self.name, self.says, self.options = name, says, options
        self._spoil, self._args = spoil, args

    def spoil(self, what: Heard, rng: Rng) -> None:
        self._spoil(what, rng, *self._args)

    def named(self, reasons: tuple[str, ...], n: int) -> bool:
        """Return True if the first reason names the error of an arm of n links."""
        says = self.says.replace("JOINT", wrong_joint(n))
        return bool(reasons) and bool(re.search(says, reasons[0]))


def _millimeters(what: Heard, _: Rng, *names: str) -> None:
    for name in names or what.poses:
        what.poses[name][:, 2:5] *= 1e3


def wrong_joint(n: int) -> str:
    """Return the one joint of n that has an error."""
    return f"joint_{2 + n // 3}"


def _joint(what: Heard, _: Rng, change: Callable[[np.ndarray], None]) -> None:
    change(what.joints[wrong_joint(len(what.joints))])


def _joints(what: Heard, _: Rng, change: Callable[[np.ndarray], None]) -> None:
    for track in what.joints.values():
        change(track)


def _degrees(track: np.ndarray) -> None:
    track[:, 2:] *= np.degrees(1.0)


def _negated(track: np.ndarray) -> None:
    track[:, 2:] *= -1.0


def _counts(track: np.ndarray) -> None:
    track[:, 2:] *= COUNTS / (2 * np.pi)
    track[:, 2] = np.round(track[:, 2])


def _wrap(what: Heard, _: Rng) -> None:
    for name in list(what.joints)[1:2]:
        q = what.joints[name][:, 2]
        middle = 0.5 * (q.max() + q.min())
        what.joints[name][:, 2] = (q - middle) % (2 * np.pi) + middle


def _exchange(what: Heard, rng: Rng) -> None:
    names = list(what.joints)
    k = int(rng.integers(0, len(names) - 1))
    a, b = names[k], names[k + 1]
    what.joints[a], what.joints[b] = what.joints[b], what.joints[a]


def _columns(what: Heard, _: Rng, order: list[int], signs: list[int]) -> None:
    for track in what.poses.values():
        track[:, 2:] = track[:, 2:][:, order] * signs


def _swap(what: Heard, _: Rng) -> None:
    a, b = what.poses["fss"], what.poses["end_effector"]
    what.poses.update({"fss": b, "end_effector": a})


def _late(what: Heard, _: Rng, by: float) -> None:
    for track in [*what.joints.values(), what.gyro]:
        track[:, 0] += by


def _boot(what: Heard, _: Rng) -> None:
    what.start.update({"joints": 4321 * SECOND, "gyro": 4321 * SECOND})


def _renamed(what: Heard, _: Rng) -> None:
    what.joints = {f"q{i}": track for i, track in enumerate(what.joints.values(), 1)}


def _rare(what: Heard, _: Rng) -> None:
    what.joints = {name: track[:: 2 * JOINT_RATE] for name, track in what.joints.items()}


def _restless(what: Heard, rng: Rng) -> None:
    for track in what.joints.values():
        track[:, 2] += 0.003 * rng.standard_normal(len(track))


def _relative(what: Heard, _: Rng) -> None:
    base, tip = what.poses["fss"], what.poses["end_effector"]
    turn = [2.0 * np.arctan2(track[:, 7], track[:, 8]) for track in (base, tip)]
    away = (tip[:, 2] - base[:, 2]) + 1j * (tip[:, 3] - base[:, 3])
    away = away * np.exp(-1j * turn[0])
    half = 0.5 * (turn[1] - turn[0])
    tip[:, 2], tip[:, 3] = away.real, away.imag
    tip[:, 7], tip[:, 8] = np.sin(half), np.cos(half)
    what.frames["end_effector"] = "fss"


def _gyro_degrees(what: Heard, _: Rng) -> None:
    what.gyro[:, 2] = np.degrees(what.gyro[:, 2])


def _jump(what: Heard, _: Rng, by: float) -> None:
    """The joints' clock, set in the middle of the bag."""
    for track in [*what.joints.values(), what.gyro]:
        track[track[:, 0] > 0.5 * track[-1, 0], 0] += by


def _backwards(track: np.ndarray) -> None:
    track[:, 0] = track[-1, 0] - track[:, 0]


def _unstamped(what: Heard, _: Rng) -> None:
    what.start["joints"] = 0
    for track in what.joints.values():
        track[:, 0] = 0.0


def _no_turn(what: Heard, _: Rng) -> None:
    what.poses["fss"][:, 5:] = 0.0


def _turned(what: Heard, _: Rng) -> None:
    """The end effector's subject, by 90 degrees."""
    track = what.poses["end_effector"]
    half = np.arctan2(track[:, 7], track[:, 8]) + 0.25 * np.pi
    track[:, 7], track[:, 8] = np.sin(half), np.cos(half)


def _fast(track: np.ndarray) -> None:
    track[:, 3] = np.degrees(track[:, 3])


def _scaled(track: np.ndarray, by: float) -> None:
    track[:, 2:] *= by


def _moved(what: Heard, _: Rng, by: float, *names: str) -> None:
    """Multiply the positions of subjects."""
    for name in names or what.poses:
        what.poses[name][:, 2:5] *= by


def _from_the_tip(what: Heard, _: Rng) -> None:
    what.joints = dict(zip(what.joints, reversed(what.joints.values()), strict=True))


def _stuck_reading(track: np.ndarray) -> None:
    track[len(track) // 8 :, 2:] = track[len(track) // 8, 2], 0.0


def _homed(track: np.ndarray) -> None:
    """Add an offset from the middle of the bag on, as after homing again."""
    track[len(track) // 2 :, 2] += 0.3


def _fast_clock(what: Heard, _: Rng, rate: float) -> None:
    for track in what.joints.values():
        track[:, 0] = track[0, 0] + rate * (track[:, 0] - track[0, 0])


def _early_cameras(what: Heard, _: Rng, by: float) -> None:
    for track in what.poses.values():
        track[:, 0] += by


def _stuck_pose(what: Heard, _: Rng, name: str) -> None:
    track = what.poses[name]
    track[len(track) // 8 :, 2:] = track[len(track) // 8, 2:]


def _no_heading(what: Heard, _: Rng, name: str) -> None:
    what.poses[name][:, 5:] = 0.0, 0.0, 0.0, 1.0


def _one_missing(what: Heard, _: Rng) -> None:
    del what.joints[list(what.joints)[-1]]


def _hidden(what: Heard, _: Rng, name: str) -> None:
    """Let cameras lose a subject for 9 of 10 s."""
    track = what.poses[name]
    what.poses[name] = track[track[:, 0] % 10.0 < 1.0]


def _full_turns(what: Heard, _: Rng) -> None:
    for track in what.joints.values():
        track[:, 2] %= 2.0 * np.pi


def _moored(what: Heard, rng: Rng) -> None:
    """Keep the base where it was: no air in its bearings."""
    _relative(what, rng)
    tip, base = what.poses["end_effector"], what.poses["fss"]
    turn = 2.0 * np.arctan2(base[0, 7], base[0, 8])
    away = (tip[:, 2] + 1j * tip[:, 3]) * np.exp(1j * turn)
    tip[:, 2], tip[:, 3] = base[0, 2] + away.real, base[0, 3] + away.imag
    half = np.arctan2(tip[:, 7], tip[:, 8]) + 0.5 * turn
    tip[:, 7], tip[:, 8] = np.sin(half), np.cos(half)
    what.frames["end_effector"] = what.frames["fss"]
    noise = 1e-4 * rng.standard_normal((len(base), 3))
    base[:, 2:4] = base[0, 2:4] + noise[:, :2]
    half = 0.5 * (turn + noise[:, 2])
    base[:, 7], base[:, 8] = np.sin(half), np.cos(half)
    what.gyro[:, 2] = 2e-4 * rng.standard_normal(len(what.gyro))


def _rates(what: Heard, _: Rng, by: float) -> None:
    for track in what.joints.values():
        track[:, 3] *= by


def _gyro(what: Heard, _: Rng, by: float) -> None:
    what.gyro[:, 2] *= by


def _same(_: Heard, __: Rng) -> None:
    """Nothing is spoilt but what is asked."""


STRAIGHT = [0, 1, 2, 3, 4, 5, 6]  # order of the columns of poses
MILLIMETERS = Kind(
    "millimeters", r"^position in millimeters\?", _millimeters, "fss", "end_effector"
)
DEGREES = Kind("degrees", r"^joints in degrees\?", _joints, _degrees)
SIGN = Kind("one sign", r"^JOINT with the wrong sign\?", _joint, _negated)
ORDER = Kind("order", r"^joint_\d and joint_\d swapped\?", _exchange)
SIGNS = Kind("all signs", r"^all joints with the wrong sign\?", _joints, _negated)
MIRRORED = Kind("mirrored", r"^poses mirrored\?", _columns, STRAIGHT, [1, -1, 1, -1, 1, -1, 1])
W_FIRST = Kind("w first", r"^quaternions with w first\?", _columns, [0, 1, 2, 6, 3, 4, 5], [1] * 7)
Y_UP = Kind("y up", r"^poses with y up\?", _columns, [0, 2, 1, 3, 5, 4, 6], [1, 1, -1, 1, 1, -1, 1])
SWAPPED = Kind("swapped", r"^base and end effector are swapped", _swap)
HOUR_APART = Kind("an hour", r"^clock of the joints .*\(an hour\) ahead", _late, 3600.0)
STREAMS = [
    Kind(
        "clock set",
        r"^clock of the joints(, gyro)? jumps ahead by 30 s, \d+ s after its first message",
        _jump,
        30.0,
    ),
    Kind("clock backwards", r"^clock of the joints runs backwards", _joints, _backwards),
    Kind("no stamps", r"^stamps of the joints are 0", _unstamped),
    Kind("no quaternions", r"^quaternions of fss are 0", _no_turn),
]  # fmt: skip

COMMON = [
    Kind("centimeters", r"^position in centimeters\?", _moved, 100.0),
    Kind("base in millimeters", r"^position of fss in millimeters\?", _moved, 1e3, "fss"),
    Kind("x up", r"^poses with x up\?", _columns, [2, 0, 1, 5, 3, 4, 6], [1] * 7),
    Kind("positions mirrored", r"^positions mirrored\?", _columns, STRAIGHT,
         [1, -1, 1, 1, 1, 1, 1]),
    Kind("from the tip", r"^(joints counted from the tip|joint_1 and joint_3 swapped)\?",
         _from_the_tip),
    Kind("four times", r"^JOINT turns 0\.25 times its reading\?", _joint,
         partial(_scaled, by=4.0)),
    Kind("another gear", r"^JOINT turns 0\.8 times its reading\?", _joint,
         partial(_scaled, by=1.25)),
    Kind("reading stuck", r"^reading of JOINT frozen", _joint, _stuck_reading),
    Kind("homed again", r"^reading of JOINT jumps by 17(\.\d+)? deg", _joint, _homed),
    Kind("clock set back", r"^clock of the joints(, gyro)? jumps back by 30 s", _jump, -30.0),
    Kind("clock fast", r"^clock of the joints runs 10 % fast", _fast_clock, 1.1),
    Kind("cameras an hour", r"^clock of (fss|end_effector), .*\(an hour\) ahead", _early_cameras,
         3600.0),
    Kind("base frozen", r"^pose of fss frozen for \d+ s", _stuck_pose, "fss"),
    Kind("no heading, base", r"^heading of fss frozen", _no_heading, "fss"),
    Kind("a joint missing", r"^the data have \d joints", _one_missing),
    Kind("end effector frozen", r"^pose of end_effector frozen for \d+ s", _stuck_pose,
         "end_effector"),
    Kind("headings clockwise", r"^headings clockwise\?", _columns, STRAIGHT,
         [1, 1, 1, 1, 1, -1, 1]),
    Kind("clocks 3 s apart", r"^clock of the joints.* (3|2\.9\d|3\.0\d) s ahead", _late, 3.0),
    Kind("since boot", r"^clock of the joints.* from its start", _boot),
    Kind("other names", r"^joints named q1, q2", _renamed),
    Kind("seen from the base", r"^end effector already relative to the base\?", _relative),
]  # fmt: skip

KINEMATIC = [
    MILLIMETERS, DEGREES, SIGN, ORDER, SIGNS, MIRRORED, W_FIRST, Y_UP, SWAPPED, HOUR_APART,
    *STREAMS, *COMMON,
    Kind("no heading, end effector", r"^heading of end_effector frozen", _no_heading,
         "end_effector"),
    Kind("hidden", r"end_effector silent", _hidden, "end_effector"),
    Kind("millimeters, one", r"^position of end_effector in millimeters\?", _millimeters,
         "end_effector"),
    Kind("end effector turned", r"^end effector's subject rotated .* with --theta-e", _turned),
    Kind("degrees, one joint", r"^JOINT in degrees\?", _joint, _degrees),
    Kind("counts", r"^joints in counts\?", _joints, _counts),
    Kind("taken as equal", r"^links of different lengths", _same, parametrization="equal"),
    Kind("joints at 0.5 Hz", r"^joints sampled only every 2 s", _rare),
    Kind("never still", r"^joints never at rest", _restless),
]  # fmt: skip
DYNAMIC = [
    MILLIMETERS, DEGREES, SIGN, ORDER, SIGNS, MIRRORED, W_FIRST, Y_UP, SWAPPED, HOUR_APART,
    *STREAMS, *COMMON,
    Kind("0 to 360", r"^joint_\d.* wrapped\?", _full_turns),
    Kind("hidden", r"fss silent", _hidden, "fss"),
    Kind("rates reversed", r"^joint velocities with the wrong sign\?", _rates, -1.0),
    Kind("gyro reversed", r"^gyro with the wrong sign\?", _gyro, -1.0),
    Kind("base held", r"^the base moved by at most .*does it float", _moored),
    Kind("deg/s", r"^joint velocities in degrees per second\?", _joints, _fast),
    Kind("one wrapped", r"^joint_\d wrapped\?", _wrap),
    Kind("gyro in degrees", r"^gyro in degrees per second\?", _gyro_degrees),
]  # fmt: skip
