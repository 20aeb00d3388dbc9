"""Parameters of the experiment, and conditions on its maneuvers."""

from dataclasses import dataclass
from itertools import zip_longest
from math import inf, nan

from fss_arm_model.guard.settings import GuardSettings
from fss_arm_model.settings import (
    FINITE,
    POSITIVE,
    Check,
    SettingError,
    Settings,
    at_least,
    like,
    one_of,
    setting,
)

SINGLE, SWEEP, LOOP = "single", "sweep", "loop"
KINDS = (SINGLE, SWEEP, LOOP)
JOINT = "joint"  # kind of maneuvers for the calibration of drives


def parse_goal_words(goal: str) -> list[tuple[str, float]]:
    """Parse the names and deviations of a goal, such as `b_i 0.002 I_4 0.001`.

    Raises:
        SettingError: a name is not followed by a positive number.
    """
    words, found = goal.split(), []
    for name, value in zip_longest(words[::2], words[1::2], fillvalue=""):
        try:
            deviation = float(value)
        except ValueError:
            deviation = nan
        if not deviation > 0.0:
            raise SettingError(f"goal has {name!r} {value!r}, expected a name and a deviation")
        found.append((name, deviation))
    return found


@dataclass(frozen=True)
class ExperimentSettings(Settings):
    """Parameters of an ExperimentNode."""

    arm: str = setting("", "description YAML of the arm; empty: the paper's arm")
    postures: tuple[float, ...] = setting(
        (),
        "joint readings of each posture, row after row; empty: default postures of the arm",
        unit="rad",
        check=FINITE,
    )
    maneuvers: str = setting(
        "", "plan of maneuvers to execute instead, written by `design`; empty: use postures"
    )
    goal: str = setting(
        "",
        "standard deviations at which to stop early, e.g. 'b_i 0.002 I_4 0.001', in SI units; "
        "of calibration/dynamic for maneuvers, of calibration/kinematic for postures; empty: none",
    )
    pause: float = setting(5.2, "rest before and after a maneuver", unit="s", check=POSITIVE)
    tolerance: float = setting(
        0.0175,
        "largest difference between a posture and its observation",
        unit="rad",
        check=POSITIVE,
    )
    rest: float = setting(
        3.0, "rest at each posture if no calibration node observes", unit="s", check=POSITIVE
    )
    observation_timeout: float = setting(
        20.0, "longest wait for an observation", unit="s", check=POSITIVE
    )
    retry: float = setting(
        1.0, "wait before a failed move is requested again", unit="s", check=POSITIVE
    )
    silence: float = setting(3.0, "timeout of a move without feedback", unit="s", check=POSITIVE)
    keep_alive: float = setting(
        0.5,
        "timeout of the keep-alive in real time, after which the arm stops",
        unit="s",
        check=POSITIVE,
    )
    base_radius: float = like(GuardSettings, "base_radius")
    link_radius: float = like(GuardSettings, "link_radius")
    margin: float = like(GuardSettings, "margin")
    state_file: str = setting("", "file that keeps the progress across restarts; empty: none")

    def __post_init__(self) -> None:
        super().__post_init__()
        parse_goal_words(self.goal)

    def guarded(self) -> GuardSettings:
        """Return the guard settings that keep the arm clear of itself.

        The experiment does not know where the base is on the table.
        """
        return GuardSettings(
            base_radius=self.base_radius, link_radius=self.link_radius, margin=self.margin
        )


@dataclass(frozen=True)
class Conditions(GuardSettings):
    """Conditions on a maneuver; the base starts at rest at the table's centre.

    Raises:
        SettingError: a condition is impossible.
    """

    duration: float = setting(8.0, "longest maneuver", unit="s", check=POSITIVE)
    rest: float = setting(5.0, "rest before and after a maneuver", unit="s", check=POSITIVE)
    repeats: int = setting(3, "largest number of repeats of a closed loop", check=at_least(1))
    total: float = setting(
        inf,
        "largest total time of maneuvers and rests",
        unit="s",
        check=Check("a positive number", lambda value: value > 0.0),
    )
    kinds: tuple[str, ...] = setting(KINDS, "kinds of maneuvers", check=one_of(*KINDS))

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.kinds:
            raise SettingError(f"kinds is empty, expected some of {', '.join(KINDS)}")
