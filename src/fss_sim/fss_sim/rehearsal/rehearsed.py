"""What a rehearsal leaves: what was expected and what happened, pictures, and what else."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from fss_arm_calib.report import Figure, Report, Table


class Check(NamedTuple):
    """Something that was expected of a rehearsal."""

    expected: str
    happened: str
    held: bool


@dataclass(frozen=True)
class Rehearsed:
    """How a rehearsal went."""

    checks: Sequence[Check]
    figures: Sequence[Figure] = ()
    reports: Sequence[Report] = ()  # of calibrations in it
    files: Mapping[str, str] = field(default_factory=dict)  # what is in which, in its folder
    html: str = ""  # above the figures, as it is

    @property
    def held(self) -> bool:
        """Whether all went as expected."""
        return all(check.held for check in self.checks)

    def report(self, title: str, about: str) -> Report:
        """As a page has it."""
        missed = [check.expected for check in self.checks if not check.held]
        rows = [(c.expected, c.happened, "yes" if c.held else "NO") for c in self.checks]
        return Report(
            title,
            "fail" if missed else "pass",
            f"not as expected: {'; '.join(missed)}" if missed else "all as expected",
            [Table("", ("expected", "happened", "held"), rows, words=3)],
            about,
            self.figures,
            html=self.html,
        )
