"""Lag between the clocks of joints and motion capture, from the motion that both record."""

import numpy as np

from fss_arm_bags.doctor.reading_faults import relative_heading
from fss_arm_bags.recorded import Recorded, Track, unwrap_headings
from fss_arm_model.arrays import Floats
from fss_arm_model.planar import project_to_plane
from fss_arm_model.units import SECOND

LAG_STEP = 0.1  # resolution of the lag [s]


def estimate_lag(recorded: Recorded, base: str, tip: str, max_duration: float) -> float:
    """Estimate how much later joints' stamps are than subjects' in motion [s]; 0: not known.

    The arm turns the end effector, subject `tip`, against the base, or only the base if that is not
    recorded. The lag maximizes the correlation of these turns with those of the joints. Recordings
    longer than `max_duration` [s] by a clock are too long for it.
    """
    fixed, moving = (recorded.poses.get(name) for name in (base, tip))
    joints = list(recorded.joints.values())
    if fixed is None or not joints or min(len(track.t) for track in [fixed, *joints]) < 10:
        return 0.0
    begins = np.array([min(int(t.t[0]) for t in joints), int(fixed.t[0])])
    ends = np.array([max(int(t.t[-1]) for t in joints), int(fixed.t[-1])])
    if np.max(ends - begins) > max_duration * SECOND:
        return 0.0
    seconds = (ends - begins) / SECOND

    def changes(k: int, track: Track, angles: Floats) -> Floats:
        """Return the size of the changes of angles (m,) at the stamps of a track, in steps."""
        at = np.arange(0.0, seconds[k], LAG_STEP)
        return np.abs(np.diff(np.interp(at, (track.t - begins[k]) / SECOND, angles)))

    if moving is not None and len(moving.t) > 10:
        seen = relative_heading(fixed, moving)
    else:
        seen = unwrap_headings(project_to_plane(fixed.values)[:, 2])
    there = changes(1, fixed, seen)
    here = np.sum([changes(0, track, track.values[:, 0]) for track in joints], axis=0)
    size = len(here) + len(there)
    spectra = (np.fft.rfft(part - part.mean(), size) for part in (here, there))
    k = int(np.argmax(np.fft.irfft(next(spectra) * np.conj(next(spectra)), size)))
    later = LAG_STEP * (k if k < len(here) else k - size)
    return later + float(begins[0] - begins[1]) / SECOND
