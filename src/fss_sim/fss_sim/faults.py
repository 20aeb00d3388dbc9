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

from fss_arm_model.files import ContentError, format_value, read_yaml
from fss_arm_model.settings import (
    FINITE,
    NOT_NEGATIVE,
    Check,
    SettingError,
    Settings,
    between,
    setting,
)
from fss_arm_model.thrusters import THRUSTER_COUNT


class FaultError(ValueError):
    """Exception for an unknown fault or an invalid value; the message says what is valid."""


def fault(about: str, unit: str = "", minimum: float = 0.0, maximum: float = 1.0) -> Any:
    """Return a field of a class of faults; 0 means no fault."""
    return setting(0.0, about, unit=unit, check=between(minimum, maximum))


@dataclass(frozen=True)
class LinkFaults(Settings):
    """Faults of a link's or board's power, and of both directions of communication."""

    loss: float = fault("share of the datagrams that are lost")
    delay: float = fault("delay of every datagram", "s", maximum=10.0)
    jitter: float = fault(
        "largest deviation from the delay, uniform in both directions", "s", maximum=10.0
    )
    duplication: float = fault("share of the datagrams that arrive twice")
    reordering: float = fault("share of the datagrams that arrive after the next one")
    corruption: float = fault("share of the datagrams with a bit flipped")
    dead: float = fault(
        "above 0: without power; after its return, it restarts, and a link's drive has no reference"
    )
    reset: float = fault("above 0: its microcontroller is held in reset; a link's drive continues")
    resistance: float = fault("resistance added to that of its battery", "ohm", maximum=100.0)


@dataclass(frozen=True)
class DriveFaults(Settings):
    """Faults of a link's servo drive, its motor, its encoder and its joint."""

    short_circuit: float = fault("above 0: the motor's cable is short-circuited")
    overcurrent: float = fault("above 0: the motor draws too much current")
    drive_heat: float = fault("temperature rise added to that of the drive", "K", maximum=200.0)
    motor_heat: float = fault("temperature rise added to that of the motor", "K", maximum=200.0)
    supply: float = fault("supply voltage added to the drive's; -24: none", "V", -24.0, 100.0)
    encoder: float = fault("above 0: the encoder's cable is unplugged")
    phasing: float = fault("above 0: the motor's phases do not match the encoder")
    blocked: float = fault("above 0: an obstacle blocks the joint")
    hand: float = fault("torque of a hand on the joint, while the drive is off", "N m", -2.0, 2.0)
    enable_open: float = fault("above 0: the enable input is open, as by an emergency stop")
    positive_limit: float = fault("above 0: the positive limit switch is pressed")
    negative_limit: float = fault("above 0: the negative limit switch is pressed")
    voltage_limit: float = fault("above 0: the motor needs all the available voltage")
    wrapped: float = fault("above 0: the position has overflowed its 32 bits")
    flash: float = fault("above 0: the drive detects damaged flash memory")
    internal: float = fault("above 0: the drive detects an internal error")
    logic: float = fault("above 0: the drive's logic has failed")
    command_input: float = fault("above 0: the drive's command input is lost")


@dataclass(frozen=True)
class SubjectFaults(Settings):
    """Faults of a VICON subject."""

    dropout: float = fault("share of the frames that are not published")
    occlusion: float = fault("share of the frames without the subject: pose and quaternion zero")
    swap: float = fault(
        "share of the frames in which it is swapped with the other subject; a target: with the base"
    )
    turn: float = fault("rotation of the pose, as by swapped markers", "rad", -pi, pi)
    frozen: float = fault("above 0: the last pose is repeated with fresh stamps")
    latency: float = fault("age of the poses at their stamps", "s")


@dataclass(frozen=True)
class GyroFaults(Settings):
    """Faults of the FOG."""

    dropout: float = fault("share of the samples that are not published")
    bias: float = fault("step of the bias", "rad/s", -1.0, 1.0)


@dataclass(frozen=True)
class RadioFaults(Settings):
    """Faults of the radio channel, if links and base share one."""

    interference: float = fault("share of the airtime that other devices use", maximum=0.95)


@dataclass(frozen=True)
class ValveFaults(Settings):
    """Faults of a thruster's valve, which override its commands."""

    stuck_open: float = fault("above 0: the valve does not close")
    stuck_closed: float = fault("above 0: the valve does not open, and draws no current")


FaultsByPart = dict[str, Any]  # LinkFaults, DriveFaults, SubjectFaults, ..., by part
BASE, TIP, TARGET, GYRO = "fss", "end_effector", "target", "fog"
BOARD, RADIO = "board", "radio"
VALVES = [f"valve_{i}" for i in range(1, THRUSTER_COUNT + 1)]
NO_FAULTS, NO_DRIVE_FAULTS = LinkFaults(), DriveFaults()


def fault_classes(n: int) -> dict[str, type]:
    """Return the parts of a test bed with n links, and the class of each part's faults."""
    links = {f"link_{i}": LinkFaults for i in range(1, n + 1)}
    drives = {f"drive_{i}": DriveFaults for i in range(1, n + 1)}
    others = {**dict.fromkeys((BASE, TIP, TARGET), SubjectFaults), GYRO: GyroFaults}
    others |= {BOARD: LinkFaults, RADIO: RadioFaults}
    return {**links, **drives, **others, **dict.fromkeys(VALVES, ValveFaults)}


@dataclass(frozen=True)
class Event(Settings):
    """Entry of a fault script."""

    at: float = setting(MISSING, "time at which the fault starts", unit="s", check=NOT_NEGATIVE)
    part: str = setting(MISSING, "part of the test bed that has the fault")
    fault: str = setting(MISSING, "kind of the fault")
    value: float = setting(1.0, "size of the fault, in the unit of its kind", check=FINITE)
    duration: float = setting(
        inf, "duration of the fault", unit="s", check=Check("above 0", lambda value: value > 0.0)
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
        self._n, groups = n, {part: kind() for part, kind in fault_classes(n).items()}
        self._set_by_hand = groups
        self._script = sorted(script, key=lambda event: event.at)
        self._event_times = sorted(
            {t for e in script for t in (e.at, e.at + e.duration)}, reverse=True
        )
        self._now = 0.0
        self._activate(groups)
        for event in script:
            self._with_fault(groups, event.part, event.fault, event.value)

    def set(self, part: str, name: str, value: float) -> None:
        """Set a fault by hand; 0 removes it.

        Raises:
            FaultError: if the fault is unknown or the value invalid.
        """
        self._set_by_hand = self._with_fault(self._set_by_hand, part, name, value)
        self._update()

    def advance(self, now: float) -> bool:
        """Advance the script to a time [s]; return True if the active faults have changed."""
        self._now = now
        passed = False
        while self._event_times and self._event_times[-1] <= now:
            self._event_times.pop()
            passed = True
        if not passed:
            return False
        before = self._active
        self._update()
        return before != self._active

    def active(self) -> list[tuple[str, str, float]]:
        """Return part, name and value of each active fault."""
        return [
            (part, f.name, getattr(group, f.name))
            for part, group in self._active.items()
            for f in fields(group)
            if getattr(group, f.name)
        ]

    def _update(self) -> None:
        groups = self._set_by_hand
        for e in self._script:
            if e.at <= self._now < e.at + e.duration:
                groups = self._with_fault(groups, e.part, e.fault, e.value)
        self._activate(groups)

    def _activate(self, groups: FaultsByPart) -> None:
        self._active = groups
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
    def _with_fault(groups: FaultsByPart, part: str, name: str, value: float) -> FaultsByPart:
        if part not in groups:
            raise FaultError(
                f"there is no part {format_value(part)}, expected one of {', '.join(groups)}"
            )
        names = [f.name for f in fields(groups[part])]
        if name not in names:
            raise FaultError(
                f"{part} has no fault {format_value(name)}, expected one of {', '.join(names)}"
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
        raise FaultError(f"invalid fault script: {error}") from None


def _event(entry: Any) -> Event:
    types = {"at": float, "part": str, "fault": str, "value": float, "duration": float}
    try:
        return Event(**{key: types[key](value) for key, value in dict(entry).items()})
    except (TypeError, ValueError, KeyError, OverflowError) as error:
        reason = format_value(str(error))
        raise FaultError(f"{format_value(entry)}, expected {', '.join(types)}: {reason}") from None
