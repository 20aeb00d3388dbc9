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
            asked = float(value)
        except ValueError:
            asked = nan
        if not asked > 0.0:
            raise SettingError(f"goal has {name!r} {value!r}, expected a name and a deviation")
        found.append((name, asked))
    return found


@dataclass(frozen=True)
class ExperimentSettings(Settings):
    """Parameters of an ExperimentNode."""

    arm: str = setting("", "description YAML of the arm; empty: the paper's arm")
    postures: tuple[float, ...] = setting(
        (), "joint readings of each posture, row after row; empty: chosen for the arm",
        unit="rad", check=FINITE,
    )  # fmt: skip
    maneuvers: str = setting(
        "", "file of maneuvers to make instead, as `design` writes it; empty: postures"
    )
    goal: str = setting(
        "", "deviations at which to stop sooner, as 'b_i 0.002 I_4 0.001' of calibration/dynamic "
        "for maneuvers or of calibration/kinematic for postures, in SI units; empty: none",
    )  # fmt: skip
    pause: float = setting(5.2, "rest before and after a maneuver", unit="s", check=POSITIVE)
    tolerance: float = setting(
        0.0175, "a posture observed this close is the one wanted", unit="rad", check=POSITIVE
    )
    rest: float = setting(3.0, "rest at each posture if nobody observes", unit="s", check=POSITIVE)
    observation_timeout: float = setting(
        20.0, "longest wait for an observation", unit="s", check=POSITIVE
    )
    retry: float = setting(
        1.0, "wait before a move that failed is asked for again", unit="s", check=POSITIVE
    )
    silence: float = setting(
        3.0, "a move without feedback for this long is lost", unit="s", check=POSITIVE
    )
    keep_alive: float = setting(
        0.5, "silence of this node, in real time, that ends its move", unit="s", check=POSITIVE
    )
    base_radius: float = like(GuardSettings, "base_radius")
    link_radius: float = like(GuardSettings, "link_radius")
    margin: float = like(GuardSettings, "margin")
    state_file: str = setting("", "progress is kept here across restarts; empty: nowhere")

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
    repeats: int = setting(3, "most repeats of a closed loop", check=at_least(1))
    total: float = setting(
        inf, "most time that all maneuvers and rests take", unit="s",
        check=Check("a positive number", lambda value: value > 0.0),
    )  # fmt: skip
    kinds: tuple[str, ...] = setting(KINDS, "kinds of maneuvers", check=one_of(*KINDS))

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.kinds:
            raise SettingError(f"kinds is empty, expected some of {', '.join(KINDS)}")
