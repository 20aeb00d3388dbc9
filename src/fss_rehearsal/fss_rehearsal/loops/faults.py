"""Faults that a campaign injects in a phase of a capture."""

from dataclasses import dataclass
from typing import Any

from fss_arm_model.settings import NOT_NEGATIVE, SettingError, Settings, between, one_of, setting

LOST_LINK = 1  # joint whose link a fault silences, from 0
SUBJECTS = "fss", "end_effector", "target"
KILLABLE = "navigation", "control", "guidance", "base", "arm", "links"


def fault_kind(kind: str, words: str) -> Any:
    """Return the setting of a fault's kind: one of those of all loops, or this one."""
    return setting(
        "",
        f"fault: no poses (outage), a valve stuck open or closed, gyro or a link lost, {words} "
        f"({kind}); empty: none",
        check=one_of("", "outage", "open", "closed", "gyro", "link", kind),
    )


@dataclass(frozen=True)
class FaultSettings(Settings):
    """A fault that occurs in a phase of the mission."""

    kind: str = fault_kind("gripper", "no gripper/state")
    phase: str = setting(
        "", "phase of the fault", check=one_of("", "approach", "reach", "grip", "detumble")
    )
    delay: float = setting(0.1, "time from the start of the phase", unit="s", check=NOT_NEGATIVE)
    duration: float = setting(
        0.0, "duration of the fault; 0: until the end", unit="s", check=NOT_NEGATIVE
    )
    valve: int = setting(3, "number of the stuck valve", check=between(1, 8))

    def check(self) -> None:
        """Raise SettingError if the fault has no phase."""
        if self.kind and not self.phase:
            raise SettingError(f"fault.phase is '', expected a phase for the fault {self.kind!r}")


@dataclass(frozen=True)
class GraphFaultSettings(FaultSettings):
    """A fault that occurs in a phase of the mission, or a node that is killed."""

    kind: str = fault_kind("kill", "a node killed")
    node: str = setting("", "node to kill", check=one_of("", *KILLABLE))

    def check(self) -> None:
        """Raise SettingError if the fault has no phase, or no node to kill."""
        super().check()
        if self.kind == "kill" and not self.node:
            raise SettingError(f"fault.node is '', expected one of {', '.join(KILLABLE)}")

    def parameters(self) -> dict[str, float]:
        """Return the parameters of the test bed that cause the fault."""
        return {
            "outage": {f"{subject}.dropout": 1.0 for subject in SUBJECTS},
            "open": {f"valve_{self.valve}.stuck_open": 1.0},
            "closed": {f"valve_{self.valve}.stuck_closed": 1.0},
            "gyro": {"fog.dropout": 1.0},
            "link": {f"link_{LOST_LINK + 1}.dead": 1.0},
        }[self.kind]
