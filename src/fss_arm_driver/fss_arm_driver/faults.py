"""Fault table of the servo drive: the meaning of each bit, and whether it blocks motion.

`python -m fss_arm_driver.faults` writes docs/reference/faults.md from it.
"""

from dataclasses import dataclass
from enum import Enum

IN_MOTION = 1 << 27


class Word(Enum):
    """Fault words of the drive in telemetry."""

    STATUS = "status"  # variable 0xa0, present state
    FAULTS = "faults"  # variable 0xa4, latched until cleared


@dataclass(frozen=True)
class Fault:
    """Meaning of one bit; `blocks`: motion is refused while it is set.

    `rehearsal`: how to cause it on the simulated test bed; a name is that of a fault of `drive_<i>`
    there.
    """

    word: Word
    bit: int
    name: str
    blocks: bool
    rehearsal: str
    remedy: str = ""


def _status(bit: int, name: str, rehearsal: str, remedy: str = "") -> Fault:
    return Fault(Word.STATUS, bit, name, bool(remedy), rehearsal, remedy)


def _latched(bit: int, name: str, rehearsal: str, remedy: str) -> Fault:
    return Fault(Word.FAULTS, bit, name, True, rehearsal, remedy)


_COOL = "let it cool; look for what loads it"
_CABLE = "check the motor's cable"
_ENCODER = "check the encoder's cable"
_SERVICE = "power-cycle; if it stays, the drive needs service"

_SAG = "`supply` -6; or `link_<i>.resistance` 5 and full current"
_STUCK = "`blocked` and a move, a second long"
_HEATED = "`motor_heat` 80; or full current for minutes"

#: Status bits that only describe the state do not block motion; those with a remedy do.
FAULTS = (
    _status(0, "short circuit", "`short_circuit`", _CABLE),
    _status(1, "drive too hot", "`drive_heat` 50", _COOL),
    _status(2, "supply too high", "`supply` 40", "check the battery; lower max_acceleration"),
    _status(3, "supply too low", _SAG, "charge the battery"),
    _status(4, "motor too hot", _HEATED, _COOL),
    _status(5, "feedback error", "`encoder`", _ENCODER),
    _status(6, "phasing error", "`phasing`", _ENCODER + " and the motor's"),
    _status(7, "current limited", "`blocked` and a move"),
    _status(8, "voltage limited", "`voltage_limit`"),
    _status(9, "positive limit switch", "`positive_limit`"),
    _status(10, "negative limit switch", "`negative_limit`"),
    _status(
        11,
        "enable input inactive",
        "`enable_open`",
        "release the emergency stop; check the enable input",
    ),
    _status(12, "disabled by software", "disarm"),
    _status(13, "stopping", "stop a move"),
    _status(14, "brake on", "disarm"),
    _status(15, "outputs disabled", "disarm"),
    _status(16, "positive soft limit", "move there"),
    _status(17, "negative soft limit", "move there"),
    _status(18, "tracking error", _STUCK, "look for what blocks the joint, then disarm and arm"),
    _status(19, "tracking warning", "`blocked` and a move"),
    _status(20, "was reset", "`supply` -24, then 0"),
    _status(21, "position wrapped", "`wrapped`"),
    _status(22, "latched fault", "as any fault below", "see the faults; clear them"),
    _status(26, "home switch", "move above 0"),
    _status(27, "in motion", "move"),
    _latched(0, "flash memory damaged", "`flash`", _SERVICE),
    _latched(1, "internal error", "`internal`", _SERVICE),
    _latched(2, "short circuit", "`short_circuit`", _CABLE),
    _latched(3, "drive too hot", "`drive_heat` 50", _COOL),
    _latched(4, "motor too hot", _HEATED, _COOL),
    _latched(5, "supply too high", "`supply` 40", "check the battery; lower max_acceleration"),
    _latched(6, "supply too low", _SAG, "charge the battery"),
    _latched(7, "feedback error", "`encoder`", _ENCODER),
    _latched(8, "phasing error", "`phasing`", _ENCODER + " and the motor's"),
    _latched(9, "tracking error", _STUCK, "remove what blocks the joint, then clear the fault"),
    _latched(10, "current too high", "`overcurrent`", "look for what loads the joint"),
    _latched(11, "logic failure", "`logic`", _SERVICE),
    _latched(12, "command input lost", "`command_input`", "clear the fault"),
)


_BLOCKING = sum(1 << f.bit for f in FAULTS if f.word is Word.STATUS and f.blocks)  # of the status


def active_faults(status: int, faults: int) -> list[Fault]:
    """Return the entries of the table that are set in the drive's two words."""
    words = {Word.STATUS: status, Word.FAULTS: faults}
    return [fault for fault in FAULTS if words[fault.word] >> fault.bit & 1]


def blocking_faults(status: int, faults: int) -> list[str]:
    """Return the names of the faults that block motion, each once, without a redundant summary."""
    if not (status & _BLOCKING or faults):
        return []
    names = [fault.name for fault in active_faults(status, faults) if fault.blocks]
    known = {fault.bit for fault in FAULTS if fault.word is Word.FAULTS}
    names += [f"latched fault {bit}" for bit in range(32) if faults >> bit & 1 and bit not in known]
    if len(names) > 1 and "latched fault" in names:
        names.remove("latched fault")
    return list(dict.fromkeys(names))


def as_markdown() -> str:
    """Return the text of docs/reference/faults.md."""
    lines = [
        "# Faults of the servo drive",
        "",
        "Written by `python -m fss_arm_driver.faults` from the table in that module. The bits are",
        "those of Copley drives; that ours is one is assumed",
        "([`hardware.md`](../start/hardware.md)). While a bit that blocks motion is set, motion is",
        "refused and a moving link is disarmed. The service `link_<i>/clear_faults` clears latched",
        "faults once their cause is gone, as `scripts/fss_arm.sh clear` does for all links. A",
        "power cycle or feedback error loses the reference: `scripts/fss_arm.sh home`.",
        "",
        "The last column says how the [simulated test bed](../explanation/simulator.md) has each:",
        "a name is a fault of `drive_<i>`, with the number given or 1, as in a fault script or",
        "`-p drive_2.short_circuit:=1.0`. `link_<i>.dead` for a while is a power cycle.",
        "",
        "| word | bit | meaning | blocks motion | what to do | on the simulated test bed |",
        "|---|---:|---|---|---|---|",
    ]
    lines += [
        f"| {f.word.value} | {f.bit} | {f.name} | {'yes' if f.blocks else ''} | {f.remedy} "
        f"| {f.rehearsal} |"
        for f in FAULTS
    ]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(as_markdown(), end="")
