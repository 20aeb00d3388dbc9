"""Parameters of a loop: values of the true arm, and settings that have no effect."""

from fnmatch import fnmatch

import numpy as np

from fss_arm_model.description import MAX_LINKS, Arm
from fss_arm_model.files import ContentError
from fss_arm_model.parameters import parameter_names, values, with_values


class ArmValues(dict[str, float]):
    """Values by the names of fss_arm_model.parameters: m_0, b_2, theta_0_3, ... [SI units]."""

    @staticmethod
    def names() -> tuple[str, ...]:
        """Return the names for arms of all sizes."""
        return parameter_names(MAX_LINKS)

    def apply(self, arm: Arm) -> Arm:
        """Return an arm with these values.

        Raises:
            ContentError: the arm has no such parameter.
            DescriptionError: a value is invalid.
        """
        names, changed = parameter_names(arm.n), np.array(values(arm))
        for name, value in self.items():
            if name not in names:
                raise ContentError(name, value, f"a parameter of an arm with {arm.n} links")
            changed[names.index(name)] = value
        return with_values(arm, changed) if self else arm


class Without:
    """Patterns of settings without effect on a run, for `Annotated[SomeSettings, Without(...)]`."""

    def __init__(self, *patterns: str) -> None:
        self.patterns = patterns

    def includes(self, name: str) -> bool:
        """Return True if a field has no effect on the run."""
        return any(fnmatch(name, pattern) for pattern in self.patterns)


#: Parameters of the test bed without effect where no nodes run.
WITHOUT_NODES = (
    "vehicles",
    "serials",
    "without_arm",
    "host",
    "transports",
    "ports",
    "terminals",
    "board_*",
    "keys",
    "keep_clock",
    "speed",
    "paused",
    "truth_rate",
    "state_file",
    "*_frame",
    "*_topic",
    "frame_prefix",
)
