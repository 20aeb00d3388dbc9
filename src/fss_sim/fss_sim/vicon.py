"""Model of VICON's cameras and markers: the visible markers, and the resulting pose errors.

A camera sees a marker if no body crosses the line between them. A marker is visible if two cameras
see it, and a subject if three of its markers are visible. A marker is displaced by e_k, which is
white noise plus the common distortion of the cameras. The pose of a rigid subject is fitted to
markers at r_k from their centroid c. To first order in e / r, its error at the origin o is then

    dtheta = sum r_k x e_k / sum |r_k|^2        dx = mean e_k + dtheta i (o - c)

White noise of standard deviation s gives s / sqrt(N) in position at the centroid and
s / (r sqrt(N)) in heading, where r is the root mean square of |r_k|. The cameras cannot separate
markers of two subjects that are too close: these markers are lost for both subjects.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fss_arm_model.arrays import Floats
from fss_arm_model.clearance import point_distance, segment_distance
from fss_arm_model.extents import Extents
from fss_arm_model.kernels import kernel
from fss_arm_model.kinematics import cross, joint_positions
from fss_arm_model.settings import FINITE, NOT_NEGATIVE, POSITIVE, Settings, setting
from fss_sim.noise import Noise
from fss_sim.random_numbers import RandomNumbers, Stream, random_generator

Pose = tuple[float, float, float]  # x [m], y [m], heading [rad]

MIN_CAMERAS, MIN_MARKERS = 2, 3
BASE, TIP, TARGET = range(3)  # kinds of subjects, and their indices in Room.heights

_CAMERA_POSITIONS = (
    3.0, 3.0, 3.0, 0.0, 3.2, 3.0, -3.0, 3.0, 3.0, -3.2, 0.0, 3.0,
    -3.0, -3.0, 3.0, 0.0, -3.2, 3.0, 3.0, -3.0, 3.0, 3.2, 0.0, 3.0,
)  # fmt: skip


def _marker_setting(default: tuple[float, ...], subject: str) -> tuple[float, ...]:
    """Return a field for markers in the frame of a subject."""
    about = f"positions of the markers on the {subject} in its subject's frame, x, y of each"
    markers: tuple[float, ...] = setting(default, about, unit="m", check=FINITE)
    return markers


@dataclass(frozen=True)
class Room(Settings):
    """Positions of VICON's cameras and markers; they are assumed, not from the paper."""

    cameras: tuple[float, ...] = setting(
        _CAMERA_POSITIONS,
        "positions of VICON's cameras in the world frame, x, y, z of each",
        unit="m",
        check=FINITE,
    )
    base_markers: tuple[float, ...] = _marker_setting(
        (0.15, 0.06, 0.02, 0.16, -0.14, 0.05, -0.10, -0.12, 0.07, -0.15), "base"
    )
    tip_markers: tuple[float, ...] = _marker_setting(
        (-0.02, 0.05, -0.03, -0.05, -0.11, 0.04, -0.16, -0.05), "end effector"
    )
    target_markers: tuple[float, ...] = _marker_setting(
        (0.14, -0.06, 0.04, 0.15, -0.15, 0.03, -0.07, -0.13, 0.09, -0.13), "target"
    )
    heights: tuple[float, ...] = setting(
        (0.5, 0.3, 0.3),
        "heights of the tops of base, links and target above the table",
        unit="m",
        check=NOT_NEGATIVE,
        size=3,
    )
    stalk: float = setting(
        0.03, "height of the markers above the top of their body", unit="m", check=POSITIVE
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, each, minimum in (
            ("cameras", 3, MIN_CAMERAS),
            ("base_markers", 2, MIN_MARKERS),
            ("tip_markers", 2, MIN_MARKERS),
            ("target_markers", 2, MIN_MARKERS),
        ):
            count, rest = divmod(len(getattr(self, name)), each)
            if rest or count < minimum:
                raise RoomError(name, len(getattr(self, name)), each, minimum)

    def markers(self, kind: int) -> Floats:
        """Return a subject's markers (k, 3): x, y in its frame, height above the table [m]."""
        positions = (self.base_markers, self.tip_markers, self.target_markers)[kind]
        flat = np.reshape(positions, (-1, 2))
        return np.column_stack([flat, np.full(len(flat), self.heights[kind] + self.stalk)])

    def bodies(
        self,
        p: npt.ArrayLike,
        q: npt.ArrayLike,
        extents: Extents | None = None,
    ) -> Floats:
        """Return a vehicle's bodies, which can hide markers, (b, 6).

        Each row is a line from x, y to x, y, a radius about it, and a height [m].

        Args:
            p: (8 + 6 n,) Arm.vector().
            q: (3 + n,) state of base and arm.
            extents: radii of base and links [m].
        """
        size, q = extents or Extents(), np.asarray(q, dtype=float)
        base = self.disc(BASE, q, size.base_radius)
        if len(q) == 3:
            return base
        ends = joint_positions(p, q)
        wide = np.broadcast_to([size.link_radius, self.heights[TIP]], (len(ends) - 1, 2))
        return np.concatenate([base, np.hstack([ends[:-1], ends[1:], wide])])

    def disc(self, kind: int, pose: Floats, radius: float) -> Floats:
        """Return a round subject, which can hide markers, as a row (1, 6) of `bodies`."""
        return np.array([[*pose[:2], *pose[:2], radius, self.heights[kind]]])


class RoomError(ValueError):
    """Exception for an incomplete list of camera or marker positions, or one that is too short."""

    def __init__(self, name: str, count: int, each: int, minimum: int) -> None:
        super().__init__(
            f"{name} has {count} numbers, expected {each} for each of at least {minimum}"
        )


class MarkerResult(NamedTuple):
    """Result of a picture for one subject."""

    error: Pose  # error of its pose
    markers: int  # number of visible markers
    identified_as: int  # subject whose pose is reported for this one; normally itself
    visible: bool = True  # True if it has a pose


NOT_VISIBLE = MarkerResult((0.0, 0.0, 0.0), 0, -1, visible=False)


class Vicon:
    """Cameras of a room, which observe its subjects in one frame after another.

    Args:
        noise: errors of the markers, and whether bodies hide them.
        room: positions of cameras and markers.
        seed: seed of the errors.
        kinds: kind of each subject: BASE, TIP or TARGET.
        volume: sides of the calibrated area, centred at the origin [m].
    """

    def __init__(
        self,
        noise: Noise,
        room: Room,
        seed: int,
        kinds: Sequence[int],
        volume: tuple[float, ...] = (4.0, 4.0),
    ) -> None:
        self._noise, self._seed, self.room = noise, seed, room
        self.occlusion = noise.vicon_occlusion > 0.0  # True if bodies hide markers
        self._cameras = np.reshape(room.cameras, (-1, 3)).astype(float)
        markers = [room.markers(kind) for kind in kinds]
        self._markers = np.concatenate(markers)
        self._owners = np.repeat(np.arange(float(len(kinds))), [len(m) for m in markers])
        self._chance = RandomNumbers(seed, 2 * len(self._markers), Stream.MARKER)
        angle = random_generator(seed, Stream.DISTORTION, 0).uniform(-np.pi, np.pi)
        edge = noise.vicon_edge_error * np.cos(angle), noise.vicon_edge_error * np.sin(angle)
        half = 0.5 * volume[0], 0.5 * volume[1]
        self._control = np.array([noise.marker_noise, *edge, *half, noise.vicon_merge_distance])
        self._merges: dict[tuple[int, int], bool] = {}  # present merges; True: subjects are swapped

    def take_picture(
        self, frame: int, poses: npt.ArrayLike, bodies: npt.ArrayLike = (), noise_frame: int = -1
    ) -> list[MarkerResult]:
        """Return the result of a picture for each subject.

        Args:
            frame: number of the frame, which selects the random numbers.
            poses: (s, 3) true poses in the world frame.
            bodies: (b, 6) of Room.bodies; bodies that hide nothing can be omitted.
            noise_frame: number that selects the white noise; by default that of the frame.
        """
        white = self._chance.normal(frame if noise_frame < 0 else noise_frame).reshape(-1, 2)
        occluders = np.reshape(bodies, (-1, 6)) if self.occlusion else np.empty((0, 6))
        errors, visible, partner = _observe_markers(
            self._cameras, self._markers, self._owners, poses, occluders, white, self._control
        )
        identities = self._identities(frame, partner.astype(int).tolist())
        true, counts = np.asarray(poses, dtype=float), visible.astype(int).tolist()
        errors = errors[identities] + (true[identities] - true)
        return [
            MarkerResult((x, y, turn), count, other, counts[other] >= MIN_MARKERS)
            for (x, y, turn), count, other in zip(errors.tolist(), counts, identities, strict=True)
        ]

    def _identities(self, frame: int, partners: list[int]) -> list[int]:
        """Return for each subject the one whose pose is reported for it.

        `partners` are the subjects with which it has merged markers (-1: none). Whether a merge
        swaps the subjects is drawn once, when the merge starts.
        """
        pairs = {(min(i, k), max(i, k)) for i, k in enumerate(partners) if k >= 0}
        for pair in pairs - self._merges.keys():
            draw = random_generator(self._seed, Stream.MERGE, frame).random()
            self._merges[pair] = draw < self._noise.vicon_merge_swap
        self._merges = {pair: swaps for pair, swaps in self._merges.items() if pair in pairs}
        identities = list(range(len(partners)))
        for (i, k), swaps in self._merges.items():
            if swaps:
                identities[i], identities[k] = identities[k], identities[i]
        return identities


@kernel("(c,w),(k,w),(k),(s,w),(b,x),(k,y),(z)->(s,w),(s),(s)")
def _observe_markers(  # type: ignore[no-untyped-def]
    cameras, markers, owners, poses, bodies, white, control, errors, visible, partner
):
    count = owners.size
    at, off = np.empty((2, count), np.complex128)
    ok = np.empty(count, np.bool_)
    distortion, half_x, half_y = complex(control[1], control[2]), control[3], control[4]
    for s in range(visible.size):
        visible[s], partner[s] = 0.0, -1.0
        errors[s, 0] = errors[s, 1] = errors[s, 2] = 0.0
    for k in range(count):
        pose = poses[int(owners[k])]
        turn = complex(np.cos(pose[2]), np.sin(pose[2]))
        at[k] = complex(pose[0], pose[1]) + turn * complex(markers[k, 0], markers[k, 1])
        out = complex(at[k].real / half_x, at[k].imag / half_y)
        off[k] = control[0] * complex(white[k, 0], white[k, 1]) + abs(out) ** 2 * out * distortion
        camera_count = 0
        for c in range(cameras.shape[0]):
            sight = complex(cameras[c, 0], cameras[c, 1]) - at[k]
            rise, free = cameras[c, 2] - markers[k, 2], True
            for b in range(bodies.shape[0]):
                below = bodies[b, 5] - markers[k, 2]
                if below <= 0.0:
                    continue
                share = min(below / rise, 1.0) if rise > 0.0 else 1.0
                a = complex(bodies[b, 0], bodies[b, 1])
                along = complex(bodies[b, 2], bodies[b, 3]) - a
                if abs(along) > 1e-9:
                    apart = segment_distance(at[k], share * sight, a, along)
                else:
                    apart = point_distance(at[k], share * sight, a)
                free = free and apart > bodies[b, 4]
            camera_count += free
        ok[k] = camera_count >= MIN_CAMERAS
    for k in range(count):
        for i in range(k):
            apart = np.hypot(abs(at[k] - at[i]), markers[k, 2] - markers[i, 2])
            if owners[i] != owners[k] and apart < control[5]:
                ok[i] = ok[k] = False
                partner[int(owners[i])], partner[int(owners[k])] = owners[k], owners[i]
    for s in range(visible.size):
        middle, mean = 0j, 0j
        for k in range(count):
            if ok[k] and owners[k] == s:
                visible[s] += 1.0
                middle += at[k]
                mean += off[k]
        if visible[s] == 0.0:
            continue
        middle, mean = middle / visible[s], mean / visible[s]
        moment = square = 0.0
        for k in range(count):
            if ok[k] and owners[k] == s:
                moment += cross(at[k] - middle, off[k])
                square += abs(at[k] - middle) ** 2
        turned = moment / square if square > 0.0 else 0.0
        error = mean + 1j * turned * (complex(poses[s, 0], poses[s, 1]) - middle)
        errors[s, 0], errors[s, 1], errors[s, 2] = error.real, error.imag, turned
