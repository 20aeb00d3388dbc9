"""Parameters of the experiment, and conditions on its maneuvers."""

from dataclasses import dataclass
from itertools import zip_longest
from math import inf, nan

from fss_arm_calib.segments.settings import positive
from fss_arm_model.guard.settings import GuardSettings
from fss_arm_model.settings import (
    FINITE,
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
ABOUT_KINDS = (
    "kinds of maneuvers: single moves one joint, sweep moves all through random postures, loop "
    "repeats a round trip"
)
JOINT = "joint"  # kind of maneuvers for the calibration of drives


def parse_goal_words(goal: str) -> list[tuple[str, float]]:
    """Parse names and deviations, such as `b_i 0.002 I_4 0.001`; SettingError: others are given."""
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

    arm: str = setting("", "arm: file or built in (paper, cad, truth); empty: paper")
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
        "stop early when calibration/dynamic (maneuvers) or calibration/kinematic (postures) has "
        "these standard deviations, such as 'b_i 0.002 I_4 0.001', in SI units; empty: none",
    )
    pause: float = positive(
        5.2,
        "s",
        "rest before the first maneuver and after each: more than settle_time + 2 max_duration of "
        "`dynamic`",
    )
    tolerance: float = positive(
        0.0175,
        "rad",
        "largest error of a joint's posture in `kinematic`'s observation",
    )
    rest: float = positive(3.0, "s", "rest at each posture if no `kinematic` runs")
    observation_timeout: float = positive(20.0, "s", "longest wait for an observation")
    keep_alive: float = positive(
        0.5, "s", "the arm stops if this process hangs for longer, in real time"
    )
    base_radius: float = like(GuardSettings, "base_radius")
    link_radius: float = like(GuardSettings, "link_radius")
    margin: float = like(GuardSettings, "margin")
    state_file: str = setting("", "file that keeps the progress across restarts; empty: none")

    def __post_init__(self) -> None:
        super().__post_init__()
        parse_goal_words(self.goal)

    def guarded(self) -> GuardSettings:
        """Return settings to keep the arm clear of itself; where the base is, is not known."""
        return GuardSettings(
            base_radius=self.base_radius, link_radius=self.link_radius, margin=self.margin
        )


@dataclass(frozen=True)
class Conditions(GuardSettings):
    """Conditions on a maneuver; the base starts at rest at the table's centre."""

    duration: float = positive(8.0, "s", "longest maneuver")
    rest: float = positive(5.0, "s", "rest before and after a maneuver")
    repeats: int = setting(3, "largest number of repeats of a closed loop", check=at_least(1))
    total: float = setting(
        inf,
        "largest total time of maneuvers and rests",
        unit="s",
        check=Check("a positive number", lambda value: value > 0.0),
    )
    kinds: tuple[str, ...] = setting(KINDS, ABOUT_KINDS, check=one_of(*KINDS))

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.kinds:
            raise SettingError(f"kinds is empty, expected some of {', '.join(KINDS)}")
