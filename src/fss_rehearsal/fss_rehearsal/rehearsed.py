"""Result of a rehearsal: checks of what happened, figures, reports and files."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from fss_arm_ros.report import Figure, Report, Table


class Check(NamedTuple):
    """Expectation of a rehearsal, with what happened."""

    expected: str
    happened: str
    passed: bool


@dataclass(frozen=True)
class Rehearsed:
    """Result of a rehearsal."""

    checks: Sequence[Check]
    figures: Sequence[Figure] = ()
    reports: Sequence[Report] = ()  # reports of its calibrations
    files: Mapping[str, str] = field(default_factory=dict)  # file in the folder: its content
    html: str = ""  # inserted unchanged above the figures
    invalid: str = ""  # why a failure does not count, such as an overloaded computer

    @property
    def passed(self) -> bool:
        """True if all checks passed."""
        return all(check.passed for check in self.checks)

    def report(self, title: str, about: str) -> Report:
        """Return the report of the result, for a page."""
        failed = [f"{c.happened}, expected: {c.expected}" for c in self.checks if not c.passed]
        count = f"{len(failed)} of {len(self.checks)} expectations not met; the first: "
        reasons = [self.invalid] if failed and self.invalid else []
        reasons += [f"{count * (len(failed) > 1)}{reason}" for reason in failed[:1]]
        rows = [(c.expected, c.happened, "yes" if c.passed else "NO") for c in self.checks]
        return Report(
            title,
            "fail" if failed else "pass",
            "; ".join(reasons) or "all expectations met",
            [Table("", ("expected", "happened", "passed"), rows, words=3)],
            about,
            self.figures,
            html=self.html,
        )
