"""Result of a rehearsal: checks of what happened, figures, reports and files."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from fss_arm_calib.report import Figure, Report, Table


class Check(NamedTuple):
    """Expectation of a rehearsal, with what happened."""

    expected: str
    happened: str
    held: bool


@dataclass(frozen=True)
class Rehearsed:
    """Result of a rehearsal."""

    checks: Sequence[Check]
    figures: Sequence[Figure] = ()
    reports: Sequence[Report] = ()  # reports of its calibrations
    files: Mapping[str, str] = field(default_factory=dict)  # file in the folder: its content
    html: str = ""  # inserted unchanged above the figures

    @property
    def held(self) -> bool:
        """True if all checks held."""
        return all(check.held for check in self.checks)

    def report(self, title: str, about: str) -> Report:
        """Return the report of the result, for a page."""
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
