"""Faults of the test bed: kinds of faults, active faults, and fault scripts.

A script is a YAML list with entries such as

    {at: 12.0, part: link_2, fault: loss, value: 0.2, duration: 30.0}

`at` and `duration` are in seconds of simulation time. Without `duration` the fault lasts until the
end. `part` is link_<i>, drive_<i>, fss, end_effector, target, fog, board, radio or valve_<i>.
`value` is 1 by default.
"""

from collections.abc import Sequence
from dataclasses import MISSING, dataclass, fields, replace
from math import inf, pi
from typing import Any

from fss_arm_model.files import ContentError, read_yaml, shown
from fss_arm_model.settings import (
    FINITE,
    NOT_NEGATIVE,
    Check,
    SettingError,
    Settings,
    between,
    setting,
)
from fss_arm_model.thrusters import COUNT


class FaultError(ValueError):
    """Exception for an unknown fault or an invalid value; the message says what is valid."""


def fault(about: str, unit: str = "", least: float = 0.0, most: float = 1.0) -> Any:
    """Return a field of a class of faults; 0 means no fault."""
    return setting(0.0, about, unit=unit, check=between(least, most))


@dataclass(frozen=True)
class LinkFaults(Settings):
    """Faults of a link's or board's power, and of both directions of communication."""

    loss: float = fault("share of the datagrams that are lost")
    delay: float = fault("delay of every datagram", "s", most=10.0)
    jitter: float = fault("most that the delay is longer or shorter by, evenly", "s", most=10.0)
    duplication: float = fault("share of the datagrams that come twice")
    reordering: float = fault("share of the datagrams that come after the next one")
    corruption: float = fault("share of the datagrams with a bit flipped")
    dead: float = fault("1: without power; then it starts anew, a link's drive without reference")
    reset: float = fault("1: its micro-controller is held in reset; a link's drive goes on")
    resistance: float = fault("resistance beside its battery's own", "ohm", most=100.0)


@dataclass(frozen=True)
class DriveFaults(Settings):
    """Faults of a link's servo drive, its motor, its encoder and its joint."""

    short_circuit: float = fault("1: the motor's cable is short-circuited")
    overcurrent: float = fault("1: the motor takes more current than it should")
    drive_heat: float = fault("heat of the drive beside its own", "K", most=200.0)
    motor_heat: float = fault("heat of the motor beside its own", "K", most=200.0)
    supply: float = fault("supply voltage added to the drive's; -24: none", "V", -24.0, 100.0)
    encoder: float = fault("1: the encoder's cable is off")
    phasing: float = fault("1: the motor's phases do not fit the encoder")
    blocked: float = fault("1: something holds the joint fast")
    hand: float = fault("torque on the joint by hand, while the drive is off", "N m", -2.0, 2.0)
    enable: float = fault("1: the enable input is open, as by an emergency stop")
    positive_limit: float = fault("1: the positive limit switch is pressed")
    negative_limit: float = fault("1: the negative limit switch is pressed")
    voltage_limit: float = fault("1: the motor takes all the voltage that there is")
    wrapped: float = fault("1: the position has run over its 32 bits")
    flash: float = fault("1: the drive finds its flash memory damaged")
    internal: float = fault("1: the drive finds an error of its own")
    logic: float = fault("1: the drive's logic has failed")
    command_input: float = fault("1: the drive's command input is lost")


@dataclass(frozen=True)
class SubjectFaults(Settings):
    """Faults of a VICON subject."""

    dropout: float = fault("share of the frames that are not published")
    occlusion: float = fault("share of the frames without the subject: pose and quaternion zero")
    swap: float = fault(
        "share of the frames in which it is taken for the other subject; a target: for the base"
    )
    turn: float = fault("markers are taken for each other: turned by", "rad", -pi, pi)
    frozen: float = fault("1: the last pose is repeated with fresh stamps")
    latency: float = fault("how much older than their stamps the poses are", "s")


@dataclass(frozen=True)
class GyroFaults(Settings):
    """Faults of the FOG."""

    dropout: float = fault("share of the samples that are not published")
    bias: float = fault("step of the bias", "rad/s", -1.0, 1.0)


@dataclass(frozen=True)
class RadioFaults(Settings):
    """Faults of the radio channel, if links and base share one."""

    interference: float = fault("share of the airtime that others take", most=0.95)


@dataclass(frozen=True)
class ValveFaults(Settings):
    """Faults of a thruster's valve, which override its commands."""

    stuck_open: float = fault("1: the valve does not close")
    stuck_closed: float = fault("1: the valve does not open, and draws no current")


Groups = dict[str, Any]  # LinkFaults, DriveFaults, SubjectFaults, ..., by part
BASE, TIP, TARGET, GYRO = "fss", "end_effector", "target", "fog"
BOARD, RADIO = "board", "radio"
VALVES = [f"valve_{i}" for i in range(1, COUNT + 1)]
NO_FAULTS, NO_DRIVE_FAULTS = LinkFaults(), DriveFaults()


def kinds(n: int) -> dict[str, type]:
    """Return the parts of a test bed with n links, and the class of each part's faults."""
    links = {f"link_{i}": LinkFaults for i in range(1, n + 1)}
    drives = {f"drive_{i}": DriveFaults for i in range(1, n + 1)}
    others = {**dict.fromkeys((BASE, TIP, TARGET), SubjectFaults), GYRO: GyroFaults}
    others |= {BOARD: LinkFaults, RADIO: RadioFaults}
    return {**links, **drives, **others, **dict.fromkeys(VALVES, ValveFaults)}


@dataclass(frozen=True)
class Event(Settings):
    """Entry of a fault script."""

    at: float = setting(MISSING, "when the fault begins", unit="s", check=NOT_NEGATIVE)
    part: str = setting(MISSING, "part of the test bed that has the fault")
    fault: str = setting(MISSING, "kind of the fault")
    value: float = setting(1.0, "size of the fault, in the unit of its kind", check=FINITE)
    duration: float = setting(
        inf, "how long the fault lasts", unit="s", check=Check("above 0", lambda value: value > 0.0)
    )


class Faults:
    """Active faults: those set by hand, overridden by those of a script.

    Args:
        n: number of links.
        script: events of the script; if two of the same kind overlap, the later one counts.

    Raises:
        FaultError: if an event has an unknown part or fault, or an invalid value.
    """

    def __init__(self, n: int, script: Sequence[Event] = ()) -> None:
        self._n, groups = n, {part: kind() for part, kind in kinds(n).items()}
        self._set = groups
        self._script = sorted(script, key=lambda event: event.at)
        self._edges = sorted({t for e in script for t in (e.at, e.at + e.duration)}, reverse=True)
        self._now = 0.0
        self._take(groups)
        for event in script:
            self._changed(groups, event.part, event.fault, event.value)

    def set(self, part: str, name: str, value: float) -> None:
        """Set a fault by hand; 0 removes it.

        Raises:
            FaultError: if the fault is unknown or the value invalid.
        """
        self._set = self._changed(self._set, part, name, value)
        self._renew()

    def advance(self, now: float) -> bool:
        """Advance the script to a time [s]; return True if the active faults have changed."""
        self._now = now
        passed = False
        while self._edges and self._edges[-1] <= now:
            self._edges.pop()
            passed = True
        if not passed:
            return False
        before = self._all
        self._renew()
        return before != self._all

    def in_force(self) -> list[tuple[str, str, float]]:
        """Return part, name and value of each active fault."""
        return [
            (part, f.name, getattr(group, f.name))
            for part, group in self._all.items()
            for f in fields(group)
            if getattr(group, f.name)
        ]

    def _renew(self) -> None:
        groups = self._set
        for e in self._script:
            if e.at <= self._now < e.at + e.duration:
                groups = self._changed(groups, e.part, e.fault, e.value)
        self._take(groups)

    def _take(self, groups: Groups) -> None:
        self._all = groups
        self.base: SubjectFaults = groups[BASE]
        self.tip: SubjectFaults = groups[TIP]
        self.target: SubjectFaults = groups[TARGET]
        self.gyro: GyroFaults = groups[GYRO]
        self.board: LinkFaults = groups[BOARD]
        self.radio: RadioFaults = groups[RADIO]
        self.links: list[LinkFaults] = [groups[f"link_{i}"] for i in range(1, self._n + 1)]
        self.drives: list[DriveFaults] = [groups[f"drive_{i}"] for i in range(1, self._n + 1)]
        valves: list[ValveFaults] = [groups[valve] for valve in VALVES]
        self.stuck_open = [valve.stuck_open > 0.0 for valve in valves]
        self.stuck_closed = [valve.stuck_closed > 0.0 for valve in valves]

    @staticmethod
    def _changed(groups: Groups, part: str, name: str, value: float) -> Groups:
        if part not in groups:
            raise FaultError(f"no faults of {shown(part)}, expected one of {', '.join(groups)}")
        known = [f.name for f in fields(groups[part])]
        if name not in known:
            raise FaultError(
                f"{part} has no fault {shown(name)}, expected one of {', '.join(known)}"
            )
        try:
            return {**groups, part: replace(groups[part], **{name: float(value)})}
        except SettingError as error:
            raise FaultError(f"{part}.{error}") from None


def read_script(text: str) -> list[Event]:
    """Return the events of a fault script; none if it is empty.

    Raises:
        FaultError: if the text is not a valid script; the message says why.
    """
    try:
        given = read_yaml(text)
        if not isinstance(given, list | None):
            raise FaultError(f"{type(given).__name__}, expected a list")
        return [_event(entry) for entry in given or ()]
    except (ContentError, FaultError) as error:
        raise FaultError(f"no fault script: {error}") from None


def _event(entry: Any) -> Event:
    kinds = {"at": float, "part": str, "fault": str, "value": float, "duration": float}
    try:
        return Event(**{key: kinds[key](value) for key, value in dict(entry).items()})
    except (TypeError, ValueError, KeyError, OverflowError) as error:
        why = shown(str(error))
        raise FaultError(f"{shown(entry)}, expected {', '.join(kinds)}: {why}") from None
