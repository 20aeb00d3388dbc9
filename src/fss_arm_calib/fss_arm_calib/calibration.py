"""A kind of calibration, written once: what node, bag, recomputation, state and report need."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

from fss_arm_calib.acceptance import Check, clocks_kept
from fss_arm_calib.estimation.evidence import Evidence
from fss_arm_calib.outcome import Datum, Outcome
from fss_arm_calib.report import Report, Table
from fss_arm_calib.report_tables import table_report
from fss_arm_calib.segments.streams import Streams
from fss_arm_model.description import Arm
from fss_arm_model.description_file import from_yaml
from fss_arm_model.files import write_text
from fss_arm_model.settings import Settings
from fss_arm_model.urdf import urdf

CAUSES = "search for causes"  # one of the things that a kind may lack

D = TypeVar("D", bound=Datum)
C = TypeVar("C", bound=Settings)


class Finder(Protocol[D]):
    """Fed samples, finds data in them; how it is fed is an Input's matter."""

    def close(self) -> list[D]:
        """What can be said with no more samples to come."""

    def streams(self) -> Streams:
        """What happened to the streams so far."""


@dataclass(frozen=True)
class Input:
    """A topic that a finder is fed from; each feeding returns the data that it completes."""

    topic: str
    message: type[Any]  # of ROS
    feed: Callable[[Any, Any], Sequence[Any]]  # the finder, with a message
    bulk: Callable[[Any, Sequence[bytes]], Sequence[Any]] | None = None  # with serialized ones
    needed: bool = True  # from a bag without it nothing can be found
    subject: str = ""  # whose poses they are
    latched: bool = False  # who comes late gets the last message

    @property
    def type(self) -> str:
        """The message's name, as bags have it."""
        return f"{self.message.__module__.split('.')[0]}/msg/{self.message.__name__}"


@dataclass(frozen=True)
class Data(Generic[D]):
    """The data of a kind of calibration, as they are kept and published."""

    noun: str  # what a datum is
    type: type[D]  # a dataclass
    topic: str
    to_message: Callable[[Sequence[D], str], Any]  # with a frame id
    from_message: Callable[[Any], list[D]]
    summary: Callable[[D], str] = lambda _: ""  # of one that is used, for the log


@dataclass(frozen=True)
class Calibration(Generic[D, C]):
    """A kind of calibration."""

    name: str  # of its node and executable; its topic is calibration/NAME, its option --NAME
    about: str  # what it estimates, and from what
    settings: type[C]
    data: Data[D]
    most: Callable[[C], int]  # data that a result is from
    inputs: Callable[[C, int], Sequence[Input]]  # of an arm of n links, in the order of feeding
    finder: Callable[[Arm, C, Sequence[D]], Finder[D]]  # of an arm, after the data kept so far
    calibrate: Callable[[Sequence[D], Arm, C, Streams, str], Outcome[D, Any]]
    message: type[Any]
    to_message: Callable[[Outcome[D, Any], str], Any]  # with a frame id
    numbers: tuple[str, ...] = ()  # fields of the message beyond the common ones, to recompute
    frame: str = "fss"  # of the results
    report: Callable[[Outcome[D, Any], Arm | None], Report] = table_report
    output: Callable[[Outcome[D, Any]], str] = lambda outcome: outcome.description
    written: str = "calibrated description"  # what `output` is
    has_urdf: bool = True  # `output` is a description, and its URDF goes beside it
    clocks: Callable[[Streams, Any], Check] = lambda heard, s: clocks_kept(heard, s.joint_gap)
    stale: Callable[[Outcome[D, Any], Streams], str] = lambda *_: ""  # why a result holds no more
    health: Callable[[Any], Mapping[str, object]] = field(default=lambda _: {})  # of the finder
    lacks: Mapping[str, str] = field(default_factory=dict)  # what it cannot have, and why
    evidence: Callable[[Sequence[D], Arm, C], Evidence] | None = None  # for a joint estimate
    after: Mapping[str, type[Any]] = field(default_factory=dict)  # results to begin from

    def report_of(self, outcome: Outcome[D, Any], truth: Arm | None = None) -> Report:
        """The report of an outcome, with what such a calibration cannot have.

        Args:
            outcome: of this kind.
            truth: the simulated arm, to compare with.
        """
        report = self.report(outcome, truth)
        if not self.lacks:
            return report
        rows = list(self.lacks.items())
        table = Table("What it does not have", ["", "reason"], rows, words=2)
        return replace(report, details=[*report.details, table])

    def write(self, path: str, outcome: Outcome[D, Any]) -> None:
        """Write what has passed.

        Raises:
            OSError: it cannot be written.
        """
        write_described(path, outcome) if self.has_urdf else write_text(path, self.output(outcome))

    @property
    def topic(self) -> str:
        """Where its results are published."""
        return f"calibration/{self.name}"


def write_described(path: str, outcome: Outcome[Any, Any]) -> None:
    """Write the description of what has passed, and its URDF beside it.

    Raises:
        OSError: they cannot be written.
    """
    write_text(path, outcome.description)
    write_text(Path(path).with_suffix(".urdf"), urdf(from_yaml(outcome.description)))
