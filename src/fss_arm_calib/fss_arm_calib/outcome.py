"""Outcome of a calibration of any kind: data, estimate, checks and provenance."""

import hashlib
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from math import isfinite, nan, radians
from typing import Any, Generic, TypeVar

import numpy as np
import numpy.typing as npt
import yaml

from fss_arm_calib import __version__
from fss_arm_calib.acceptance import (
    NOT_EVALUATED,
    PASS,
    Check,
    decide_verdict,
    format_uncertain,
    summarize,
)
from fss_arm_calib.checks import frame_mismatch, stream_causes
from fss_arm_calib.precision import MASS_UNITS, MAX_USABLE_DEVIATION
from fss_arm_calib.segments.streams import Datum, Streams
from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_model.description_file import to_yaml
from fss_arm_model.estimation import outliers
from fss_arm_model.files import ContentError
from fss_arm_ros.dates import format_time

#: Settings of earlier results that no longer exist, with the values that keep a result.
FORMER_SETTINGS = {
    "inertia_deviation": 0.02,
    "max_base_turn": 3.0,
    "max_speed": 5.0,
    "max_turn": 10.0,
    "min_moving": 20.0,
    "min_travel": 0.05,
    "same_posture": radians(1.0),
}

DATA_FIELDS = "weights", "leverage", "errors", "reasons"  # of an Estimate, from a Solution

LIVE = "live"  # source of data received from topics
BAG_HASH = re.compile(r"(?:^|, )(.+?) [0-9a-f]{64}(?: \([^)]*\))?(?=, |$)", re.DOTALL)
CALIBRATED = ", calibrated "


D = TypeVar("D", bound=Datum)
S = TypeVar("S")
C = TypeVar("C")


def _empty() -> Floats:
    return np.empty(0)


@dataclass(frozen=True)
class Estimate:
    """Estimate of p parameters from s data, with the fields of Calibration.msg.

    Values, covariance and deviations that are not given are NaN, i.e. not known. For parameters
    that the data cannot separate, the values are NaN. For these and for parameters at a bound,
    which the data do not determine, the deviations are inf and the covariance is NaN. Those that
    come mostly from a vague prior have deviations of inf, too, but a covariance with that prior.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    initial: Floats  # (p,) initial guess
    values: Floats = field(default_factory=_empty)  # (p,)
    covariance: Floats = field(default_factory=_empty)  # (p, p)
    deviations: Floats = field(default_factory=_empty)  # (p,) 1 sigma
    undetermined: tuple[str, ...] = ()  # names of parameters that the data cannot separate
    at_bound: tuple[str, ...] = ()  # names of parameters that would otherwise cross a bound
    unmeasured: tuple[str, ...] = ()  # names of parameters that come mostly from a vague prior
    residuals: Floats = field(default_factory=lambda: np.empty((0, 3)))  # (rows, 3), as observed
    weights: Floats = field(default_factory=_empty)  # (s,) 1: used; 0: rejected
    leverage: Floats = field(default_factory=_empty)  # (s,)
    errors: Floats = field(default_factory=_empty)  # (s,) of each datum [deviations]
    reasons: tuple[str, ...] = ()  # (s,) why a datum was rejected; empty if it was not
    position_residual: float = nan  # root mean square [m]
    heading_residual: float = nan  # root mean square [rad]
    chi_square: float = nan
    degrees_of_freedom: int = 0
    condition_number: float = nan
    iterations: int = 0
    last_update: float = nan  # [deviations]

    def __post_init__(self) -> None:
        p, lost = len(self.names), np.isin(self.names, self.undetermined)
        known = {"values": (p,), "covariance": (p, p), "deviations": (p,)}
        for name, shape in known.items():
            if getattr(self, name).shape != shape:
                object.__setattr__(self, name, np.full(shape, nan))
        sigma = np.sqrt(np.diag(self.covariance)) if p else _empty()
        sigma = np.where(np.isnan(self.deviations), sigma, self.deviations)
        object.__setattr__(self, "values", np.where(lost, nan, self.values))
        lost |= np.isin(self.names, self.at_bound)
        unmeasured = lost | np.isin(self.names, self.unmeasured)
        object.__setattr__(self, "deviations", np.where(unmeasured, np.inf, sigma))
        unknown = lost[:, None] | lost
        object.__setattr__(self, "covariance", np.where(unknown, nan, self.covariance))

    @property
    def uncertain(self) -> dict[str, float]:
        """Relative deviations of masses and inertias too uncertain to use, the largest first."""
        with np.errstate(divide="ignore", invalid="ignore"):
            shares = self.deviations / np.abs(self.values)
        shares = np.where(np.isinf(self.deviations), np.inf, shares)
        found = {
            name: float(share)
            for name, unit, share in zip(self.names, self.units, shares, strict=True)
            if unit in MASS_UNITS and share > MAX_USABLE_DEVIATION
        }
        return dict(sorted(found.items(), key=lambda item: -item[1]))


def estimate_of_fit(r: Any, data: outliers.Solution[Any] | None = None, **more: Any) -> Estimate:
    """Return the estimate of a Fit, with what is known of each datum and with `more` fields."""
    problem, m = r.problem, r.minimum
    of_data = {name: getattr(data, name) for name in DATA_FIELDS} if data else {}
    found = {
        "undetermined": r.undetermined,
        "at_bound": r.at_bound,
        "degrees_of_freedom": problem.degrees_of_freedom,
        "condition_number": r.condition_number,
        "iterations": m.iterations,
        "last_update": m.last_update,
    }
    fields = {**found, **of_data, **more}
    return Estimate(problem.names, problem.units, problem.guess, r.values, r.covariance, **fields)


@dataclass(frozen=True)
class Provenance:
    """Provenance of a result, with the fields of Provenance.msg."""

    software: str
    parameters: str  # the settings, as YAML
    data_hash: str  # SHA-256 of the data used in the solution
    source: str
    begin: int  # start of the data [ns]
    end: int
    seed: int = 0  # seed of random choices; 0: there were none


@dataclass(frozen=True)
class Outcome(Generic[D, S]):
    """Outcome of a calibration."""

    data: tuple[D, ...]  # all data found, in order of time
    used: tuple[D, ...]  # the s data used in the solution, including outliers
    arm: Arm  # the initial guess
    settings: Any  # settings of the calibration, of the kind's class
    streams: Streams
    checks: tuple[Check, ...]
    provenance: Provenance
    estimate: Estimate
    solution: S | None  # additional results of the kind
    description: str  # the calibrated arm as YAML; empty unless the verdict is pass

    @property
    def verdict(self) -> str:
        """Verdict: PASS, FAIL or NOT_EVALUATED."""
        return decide_verdict(self.checks)[0]

    @property
    def reasons(self) -> tuple[str, ...]:
        """Reasons for the verdict; unless it is a pass, the likely cause comes first."""
        return decide_verdict(self.checks)[1]

    @property
    def reason(self) -> str:
        """Reasons for the verdict in one line."""
        return "; ".join(self.reasons)

    @property
    def summary(self) -> str:
        """Reason for the verdict in one line; a pass names what is too uncertain to use."""
        return summarize(self.checks, self.estimate.uncertain)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters (p)."""
        return self.estimate.names

    @property
    def values(self) -> Floats:
        """Values of the parameters (p,); NaN: not known."""
        return self.estimate.values

    @property
    def covariance(self) -> Floats:
        """Covariance of the values (p, p)."""
        return self.estimate.covariance

    @property
    def deviations(self) -> Floats:
        """Standard deviations of the values (p,); inf: the data do not determine the value."""
        return self.estimate.deviations

    @property
    def accepted(self) -> int:
        """Number of data with a weight in the estimate."""
        weights = self.estimate.weights
        return int(np.count_nonzero(weights)) if len(weights) else len(self.used)

    @property
    def left_out(self) -> int:
        """Number of data that were not used in the solution."""
        return len(self.data) - len(self.used)


def make_outcome(
    data: Sequence[D],
    used: Sequence[D],
    arrays: Sequence[npt.NDArray[Any]],
    arm: Arm,
    settings: Any,
    kind: type[Any],
    streams: Streams,
    source: str,
    checks: Sequence[Check],
    estimate: Estimate,
    solution: S | None = None,
    calibrated: Callable[[], Arm] | None = None,
) -> Outcome[D, S]:
    """Assemble the outcome of a calibration: provenance, additional checks and description.

    The hash is computed from `arrays`, the numbers of the data that are `used` in the solution. Of
    the settings, those of class `kind` are recorded. `calibrated` returns the calibrated arm; it is
    called only if the verdict is pass.
    """
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(array.tobytes())
    parameters = {f.name: _to_yaml_type(getattr(settings, f.name)) for f in fields(kind)}
    provenance = Provenance(
        software=f"fss_arm_calib {__version__}",
        parameters=yaml.safe_dump(parameters, sort_keys=False),
        data_hash=digest.hexdigest(),
        source=source,
        begin=used[0].start if used else 0,
        end=used[-1].end if used else 0,
    )
    passed = decide_verdict(checks)[0] == PASS
    if not passed:
        checks = [*checks, *stream_causes(streams)]
    else:  # a good fit shows that clocks too far apart to be aligned are not
        checks = [replace(c, verdict=PASS, reason="") if c.name == "clocks" else c for c in checks]
        if differ := frame_mismatch(streams):
            checks.append(Check("frames", NOT_EVALUATED, nan, nan, differ, needed=False))
    description = ""
    if calibrated and passed:
        result = replace(calibrated(), name=calibrated_name(arm.name, source, provenance.end))
        if (known := result.known) != arm.known:
            result = replace(result, known=known.during(provenance.begin, provenance.end))
        description = to_yaml(result, list(_origin_lines(provenance, checks, estimate)))
    found = tuple(data), tuple(used), arm, settings, streams, tuple(checks)
    return Outcome(*found, provenance, estimate, solution, description)


def calibrated_name(arm: str, source: str, end: int) -> str:
    """Return the name of a calibrated arm, from that of the initial one, which may be calibrated.

    The data end at `end` [ns]; their source is `live`, or names and SHA-256 of bags.
    """
    bags = BAG_HASH.findall(source)
    origin = f"from {', '.join(bags)}" if bags else source
    name = f"{arm.partition(CALIBRATED)[0]}{CALIBRATED}{origin}, {format_time(end)}"
    return "".join(letter if letter.isprintable() else "?" for letter in name)


def _origin_lines(
    provenance: Provenance, checks: Sequence[Check], estimate: Estimate
) -> Iterator[str]:
    """Yield lines about the origin of a calibrated description, for its readers."""
    e, end = estimate, format_time(provenance.end)
    source = f"{provenance.source}{' data' * (provenance.source == LIVE)}"
    yield f"Calibrated by {provenance.software} from {source}, until {end}:"
    yield f"pass: {summarize(checks)}"
    if e.uncertain:
        yield f"too uncertain to use: {format_uncertain(e.uncertain)}"
    for name, value, deviation, unit in zip(e.names, e.values, e.deviations, e.units, strict=True):
        known = f" +- {deviation:.2g} {unit}" if isfinite(deviation) else f" {unit}, not determined"
        yield f"{name} = {value:.6g}{known}"


def _to_yaml_type(value: Any) -> Any:
    """Convert a setting to a type that YAML supports; computed settings may be numpy numbers."""
    if isinstance(value, tuple):
        return tuple(map(_to_yaml_type, value))
    return value.item() if isinstance(value, np.generic) else value


def parse_settings(parameters: str, kind: type[C], section: str = "") -> C:
    """Return the settings in a Provenance; those that are none now must have their values.

    Their class is `kind`. If the YAML has several sections, theirs has the name `section`.

    Raises:
        ValueError: the parameters are not those of `kind`.
    """
    try:
        given = yaml.safe_load(parameters)
    except yaml.YAMLError as error:
        raise ValueError(f"parameters are no YAML: {error}") from None
    given = given.get(section, given) if isinstance(given, dict) else given
    known = {f.name for f in fields(kind)}  # type: ignore[arg-type]  # a dataclass
    if not isinstance(given, dict):
        expected = f"those of {kind.__name__} as YAML"
        expected += "" if parameters else "; earlier versions did not record them: use from_bag"
        raise ContentError("parameters", parameters, expected)
    for name in sorted(FORMER_SETTINGS.keys() & given.keys() - known):
        if (value := given.pop(name)) != FORMER_SETTINGS[name]:
            raise ContentError(name, value, f"{FORMER_SETTINGS[name]:g}; it is no setting now")
    if others := given.keys() - known:
        raise ContentError("a parameter", min(others, key=str), f"one of {kind.__name__}")
    return kind(**{k: tuple(v) if isinstance(v, list) else v for k, v in given.items()})
