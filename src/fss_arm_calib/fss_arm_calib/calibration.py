"""Definition of a kind of calibration, used by its node, bag command, recomputation and report."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

from fss_arm_calib import checks
from fss_arm_calib.acceptance import CAUSE, FAIL, PASS, Check, format_count
from fss_arm_calib.outcome import LIVE, Outcome
from fss_arm_calib.report_parts import table_report
from fss_arm_calib.segments.streams import Datum, Streams
from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_model.description_file import from_yaml
from fss_arm_model.estimation.least_squares import Linear
from fss_arm_model.files import write_text
from fss_arm_model.settings import Settings
from fss_arm_model.urdf import urdf
from fss_arm_ros.report import Report, Table

CAUSES = "search for causes"  # a key of Calibration.unavailable

D = TypeVar("D", bound=Datum)
C = TypeVar("C", bound=Settings)


class Finder(Protocol[D]):
    """Object that receives samples and finds data in them; an Input defines how to feed it."""

    def close(self) -> list[D]:
        """Return the data that are complete if no samples follow."""

    def streams(self) -> Streams:
        """Return the state of the streams."""


class Measurements(Protocol):
    """Measurements of one kind in the joint estimate, with own unknowns of no other data.

    All other quantities that they depend on are in z, (8 + 6 n + 5): Arm.vector(), then
    SURROUNDINGS of fss_arm_model.drifting.
    """

    @property
    def degrees_of_freedom(self) -> int:
        """Number of observations and of priors on the own unknowns, minus these unknowns."""

    def initial_unknowns(self) -> Floats:
        """Return initial values of the own unknowns."""

    def linearize(self, z: Floats, unknowns: Floats) -> Linear:
        """Linearize the residuals in z; `extend` appends the step of the own unknowns."""


@dataclass(frozen=True)
class Input:
    """Topic that feeds a finder; feeding a message returns the data that it completes."""

    topic: str
    message: type[Any]  # ROS message class
    feed: Callable[[Any, Any], Sequence[Any]]  # takes the finder and a message
    bulk: Callable[[Any, Sequence[bytes]], Sequence[Any]] | None = None  # serialized messages
    needed: bool = True  # a bag must have this topic
    subject: str = ""  # motion-capture subject of the poses
    option: str = ""  # option of from_bag that names the topic
    latched: bool = False  # a late subscriber receives the last message
    rule: Any = None  # validation.Rule of a latched topic's messages; None: that of their type

    @property
    def type(self) -> str:
        """Name of the message type, as in bags."""
        return f"{self.message.__module__.split('.')[0]}/msg/{self.message.__name__}"


@dataclass(frozen=True)
class Data(Generic[D]):
    """Data of a kind of calibration, as stored and published."""

    noun: str  # name of a datum
    topic: str
    message: type[Any]  # ROS message class
    type: type[D]  # a dataclass
    to_message: Callable[[Sequence[D], str], Any]  # takes the data and a frame id
    from_message: Callable[[Any], list[D]]
    summary: Callable[[D], str] = lambda _: ""  # log text of a datum that is used
    rule: Any = None  # validation.Rule of the messages; None: that of their type
    is_replaced: bool = False  # a new datum replaces the previous one, so it has the same number

    def describe(self, one: D, number: int) -> str:
        """Return the log text of a datum, which is the one with this number."""
        what = self.summary(one) if one.used else f"not used: {one.reason}"
        return f"{self.noun} {number}: {what}"


@dataclass(frozen=True)
class Calibration(Generic[D, C]):
    """Kind of calibration: its settings, inputs, finder, solver, messages and report."""

    name: str  # node and executable; the topic is calibration/NAME, the option --NAME
    settings: type[C]
    data: Data[D]
    max_data: Callable[[C], int]  # largest number of data in a result
    inputs: Callable[[C, int], Sequence[Input]]  # for an arm of n links, in the order of feeding
    finder: Callable[[Arm, C, Sequence[D]], Finder[D]]  # for an arm, given the data already kept
    calibrate: Callable[[Sequence[D], Arm, C, Streams, str], Outcome[D, Any]]
    message: type[Any]
    to_message: Callable[[Outcome[D, Any], str], Any]  # takes the outcome and a frame id
    recomputed_fields: tuple[str, ...] = ()  # message fields to recompute besides the common ones
    frame: str = ""  # frame id of the results; empty: the base's
    report: Callable[[Outcome[D, Any], Arm | None], Report] = table_report
    output: Callable[[Outcome[D, Any]], str] = lambda outcome: outcome.description
    output_name: str = "calibrated description"  # name of the `output`
    has_urdf: bool = True  # `output` is a description; its URDF is written next to it
    clocks: Callable[[Streams, Any], Check] = lambda streams, s: checks.clocks(streams, s.joint_gap)
    stale: Callable[[Outcome[D, Any], Streams], str] = lambda *_: ""  # why a result is outdated
    early_cause: Callable[[Sequence[D], Arm, C], str] = lambda *_: ""  # of few data; empty: none
    health: Callable[[Any], Mapping[str, object]] = field(default=lambda _: {})  # of the finder
    unavailable: Mapping[str, str] = field(default_factory=dict)  # features, with reasons
    #: Measurements for a joint estimate.
    measurements: Callable[[Sequence[D], Arm, C], Measurements] | None = None
    #: Topics of the results to start from.
    prior_results: Mapping[str, type[Any]] = field(default_factory=dict)

    @property
    def about(self) -> str:
        """The estimated parameters and the data used."""
        return self.settings.ABOUT

    def describe_start(self, settings: Any, joints: int, restored: int) -> str:
        """Describe the start of the node for its log, with the number of restored data."""
        if restored:
            what = format_count(restored, self.data.noun)
            return f"resumed with {what} from {settings.state_file}"
        topics = ", ".join(one.topic for one in self.inputs(settings, joints))
        return f"subscribed to {topics} (joints: {joints})"

    def report_of(self, outcome: Outcome[D, Any], truth: Arm | None = None) -> Report:
        """Return the report of an outcome, with the features that this kind does not have."""
        report = self.report(outcome, truth)
        if not self.unavailable:
            return report
        rows = list(self.unavailable.items())
        table = Table("Not available", ["", "reason"], rows, words=2)
        return replace(report, details=[*report.details, table])

    def problem(self, outcome: Outcome[D, Any], streams: Streams, settings: C) -> str:
        """Return why the latest outcome cannot be valid, from the live streams; empty if it can."""
        if streams.silent:
            return f"waiting for {', '.join(streams.silent)}"
        if streams.unknown:
            return f"the arm has no {', '.join(streams.unknown)}"
        if (clocks := self.clocks(streams, settings)).needed and clocks.reason:
            return f"{clocks.reason}: call {self.name}/forget to reset"
        causes = (check.reason for check in outcome.checks if check.name == CAUSE)
        likely = next(causes, "") if outcome.verdict != PASS else ""
        return likely or self.stale(outcome, streams)

    def solve(self, data: Sequence[D], arm: Arm, settings: C, streams: Streams) -> Outcome[D, Any]:
        """Calibrate from live data; if it does not pass, name a likely cause that few data show."""
        outcome = self.calibrate(data, arm, settings, streams, LIVE)
        if outcome.verdict == PASS or any(check.name == CAUSE for check in outcome.checks):
            return outcome
        words = self.early_cause(outcome.data, outcome.arm, outcome.settings)
        found = (checks.cause(words, outcome.verdict),) if words else ()
        return replace(outcome, checks=(*found, *outcome.checks))

    def describe(self, outcome: Outcome[D, Any], streams: Streams) -> str:
        """Describe an outcome in one line, with why it is outdated, or how to find a cause."""
        outdated = self.stale(outcome, streams)
        words = f"{outcome.verdict}: {outcome.summary}{'; but ' * bool(outdated)}{outdated}"
        known = any(check.name == CAUSE for check in outcome.checks)
        if outcome.verdict == FAIL and not known and CAUSES not in self.unavailable:
            words += "; to find the cause, run from_bag on a recording"
        return words

    def write(self, path: str, outcome: Outcome[D, Any]) -> None:
        """Write the output of a calibration that has passed; beside a description its URDF."""
        write_text(path, self.output(outcome))
        if self.has_urdf:
            write_text(Path(path).with_suffix(".urdf"), urdf(from_yaml(outcome.description)))

    @property
    def topic(self) -> str:
        """Topic of the results."""
        return f"calibration/{self.name}"
