"""State of the reception of poses: the time without any, its reason, and problems of subjects."""

from collections.abc import Collection, Sequence

from fss_arm_model.units import SECOND
from fss_base_driver.mocap.subjects import MAX_SUBJECTS, Subjects

CHOOSE_SUBJECTS = "list the required ones in the parameter subjects"


class Reception:
    """State of the reception from one source. Times are in nanoseconds, in a steady clock.

    Args:
        source: name of the source, for messages.
        now: the time at the start.
    """

    def __init__(self, source: str, now: int) -> None:
        self.source = source
        self.frames = 0  # number of frames
        self.failure = ""  # why the receiving process ended; until the next pose
        self._last_pose = now
        self._empty = False  # the last frame had no subject, as of a VRPN server that is down

    def add(self, count: int, now: int) -> None:
        """Count a frame with poses of `count` subjects."""
        self.frames, self._empty = self.frames + 1, not count
        if count:
            self._last_pose, self.failure = now, ""

    def silence(self, now: int) -> float:
        """Return the time since the last frame with a subject [s]."""
        return (now - self._last_pose) / SECOND

    def loss_reason(self, connected: bool | None, waiting: Sequence[str]) -> str:
        """Return why no poses arrive, in words.

        Args:
            connected: whether the source has answered; None: it consists of relays only.
            waiting: relays that are not available yet, with reasons.
        """
        if connected is False:
            return f"waiting for {self.source}: it does not answer"
        if self._empty:
            return f"no subject in the frames of {self.source}"
        reasons = [f"waiting for {'; '.join(waiting)}"] if connected is None and waiting else []
        if self.frames or not reasons:
            reasons.insert(0, f"no frame {'any more' if self.frames else 'yet'} from {self.source}")
        return "; ".join(reasons)


def describe_problems(
    subjects: Subjects,
    required: Collection[str],
    invalid: Collection[str],
    now: int,
    timeout: float,
) -> list[str]:
    """Return the problems with subjects, in words.

    Args:
        subjects: received ones.
        required: names of those that the operator has listed.
        invalid: names that are not valid in topics.
        now: the time [ns].
        timeout: age at which a pose is out of date [s].
    """
    words = [f"{name} {why}" for name, why in subjects.rejection_reasons(now).items()]
    silent = subjects.stale_subjects(now, timeout).items()
    words += [f"{name} has no new pose for {age:.1f} s" for name, age in silent]
    words += [f"{name} was not seen yet" for name in required if name not in subjects.subjects]
    words += [f"{n!r} is no valid topic name: rename it, or {CHOOSE_SUBJECTS}" for n in invalid]
    if subjects.ignored:
        words.append(f"more than {MAX_SUBJECTS} subjects: the rest is ignored; {CHOOSE_SUBJECTS}")
    return words
