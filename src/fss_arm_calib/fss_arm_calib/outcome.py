"""What a calibration of any kind concludes: data, estimate, checks, and where it is from."""

import hashlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields
from datetime import UTC, datetime
from math import nan
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
import numpy.typing as npt
import yaml

from fss_arm_calib import __version__
from fss_arm_calib.acceptance import (
    NOT_EVALUATED,
    PASS,
    Check,
    conclude,
    frames_differ,
    suspected,
)
from fss_arm_calib.estimation.least_squares import Floats
from fss_arm_calib.segments.streams import Streams
from fss_arm_model.description import Arm
from fss_arm_model.description_file import to_yaml
from fss_arm_model.files import ContentError
from fss_arm_model.units import SECOND

LIVE = "live"  # source of data that came by topics


class Datum(Protocol):
    """What a calibration is solved from, or kept for its reason why not."""

    @property
    def start(self) -> int:
        """Of it [ns]."""

    @property
    def end(self) -> int:
        """Of it [ns]."""

    @property
    def used(self) -> bool:
        """Whether it may be solved from."""

    @property
    def reason(self) -> str:
        """Why not."""


D = TypeVar("D", bound=Datum)
S = TypeVar("S")
C = TypeVar("C")


def _none() -> Floats:
    return np.empty(0)


@dataclass(frozen=True)
class Estimate:
    """p parameters from s data, as Calibration.msg has them; what is not given is not known.

    Of parameters that the data cannot tell apart the values are NaN; of those and of parameters
    at a bound, which the data do not determine, the deviations are inf and the covariance is NaN.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    initial: Floats  # (p,) guess that was given
    values: Floats = field(default_factory=_none)  # (p,)
    covariance: Floats = field(default_factory=_none)  # (p, p)
    deviations: Floats = field(default_factory=_none)  # (p,) 1 sigma
    undetermined: tuple[str, ...] = ()  # names of parameters that the data cannot tell apart
    at_bound: tuple[str, ...] = ()  # names of those that they would move out of what is possible
    residuals: Floats = field(default_factory=lambda: np.empty((0, 3)))  # (rows, 3), as observed
    weights: Floats = field(default_factory=_none)  # (s,) 1: used; 0: rejected
    leverage: Floats = field(default_factory=_none)  # (s,)
    errors: Floats = field(default_factory=_none)  # (s,) against the others [deviations]
    reasons: tuple[str, ...] = ()  # (s,) why a datum was rejected, else empty
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
        sigma = np.sqrt(np.diag(self.covariance)) if p else _none()
        sigma = np.where(np.isnan(self.deviations), sigma, self.deviations)
        object.__setattr__(self, "values", np.where(lost, nan, self.values))
        lost |= np.isin(self.names, self.at_bound)
        object.__setattr__(self, "deviations", np.where(lost, np.inf, sigma))
        unknown = lost[:, None] | lost
        object.__setattr__(self, "covariance", np.where(unknown, nan, self.covariance))


@dataclass(frozen=True)
class Provenance:
    """From what a result was computed, as Provenance.msg has it."""

    software: str
    parameters: str  # the settings, as YAML
    data_hash: str  # SHA-256 of what was solved from
    source: str
    begin: int  # of the data [ns]
    end: int
    seed: int = 0  # of random choices; 0: none were made


@dataclass(frozen=True)
class Outcome(Generic[D, S]):
    """What is concluded from data."""

    data: tuple[D, ...]  # all that were found, in order of time
    used: tuple[D, ...]  # s of them that it was solved from, outliers included
    arm: Arm  # the guess
    settings: Any  # that it was computed by, of the kind's class
    streams: Streams
    checks: tuple[Check, ...]
    provenance: Provenance
    estimate: Estimate
    solution: S | None  # what the kind knows besides
    description: str  # the calibrated arm as YAML; empty unless the verdict is pass

    @property
    def verdict(self) -> str:
        """PASS, FAIL or NOT_EVALUATED."""
        return conclude(self.checks)[0]

    @property
    def reasons(self) -> tuple[str, ...]:
        """Of the verdict, in words; unless it is a pass, the likely cause first."""
        return conclude(self.checks)[1]

    @property
    def reason(self) -> str:
        """They in one line."""
        return "; ".join(self.reasons)

    @property
    def names(self) -> tuple[str, ...]:
        """(p) of the parameters."""
        return self.estimate.names

    @property
    def values(self) -> Floats:
        """(p,) of the parameters; NaN: not known."""
        return self.estimate.values

    @property
    def covariance(self) -> Floats:
        """(p, p) of the values."""
        return self.estimate.covariance

    @property
    def deviations(self) -> Floats:
        """(p,) 1 sigma of the values; inf: the data do not determine it."""
        return self.estimate.deviations

    @property
    def accepted(self) -> int:
        """Number of data that the estimate is from."""
        weights = self.estimate.weights
        return int(np.count_nonzero(weights)) if len(weights) else len(self.used)

    @property
    def left_out(self) -> int:
        """Number of data that were not solved from."""
        return len(self.data) - len(self.used)


def concluded(
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
    """The outcome of what was found.

    Args:
        data: all of them.
        used: those that were solved from.
        arrays: their numbers, that the hash is of.
        arm: the guess.
        settings: the settings, or those of a node, which has more.
        kind: the class of the settings that decide.
        streams: what happened to the streams that the data are from.
        source: of the data.
        checks: all of them.
        estimate: from the data.
        solution: what the kind knows besides.
        calibrated: the arm as it was found; called if all checks pass.
    """
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(array.tobytes())
    parameters = {f.name: _plain(getattr(settings, f.name)) for f in fields(kind)}
    provenance = Provenance(
        software=f"fss_arm_calib {__version__}",
        parameters=yaml.safe_dump(parameters, sort_keys=False),
        data_hash=digest.hexdigest(),
        source=source,
        begin=used[0].start if used else 0,
        end=used[-1].end if used else 0,
    )
    passed = conclude(checks)[0] == PASS
    if not passed:
        checks = [*checks, *suspected(streams)]
    elif differ := frames_differ(streams):
        checks = [*checks, Check("frames", NOT_EVALUATED, nan, nan, differ, needed=False)]
    description = ""
    if calibrated and passed:
        description = to_yaml(calibrated(), list(_origin(provenance, estimate)))
    return Outcome(
        tuple(data), tuple(used), arm, settings, streams, tuple(checks), provenance, estimate,
        solution, description,
    )  # fmt: skip


def _origin(provenance: Provenance, estimate: Estimate) -> Iterator[str]:
    """What a person who finds the description wants to know of it."""
    end = datetime.fromtimestamp(provenance.end / SECOND, UTC)
    e = estimate
    yield f"Calibrated by {provenance.software} from {provenance.source}, until {end:%F %R} UTC:"
    yield f"pass, chi-square {e.chi_square:.4g} for {e.degrees_of_freedom} degrees of freedom"
    for name, value, deviation, unit in zip(
        e.names, e.values, e.deviations, e.units, strict=True
    ):  # fmt: skip
        yield f"{name} = {value:.6g} +- {deviation:.2g} {unit}"


def _plain(value: Any) -> Any:
    """A setting as YAML takes it: numpy's numbers are given by who computes them."""
    if isinstance(value, tuple):
        return tuple(map(_plain, value))
    return value.item() if isinstance(value, np.generic) else value


def settings_of(parameters: str, kind: type[C], section: str = "") -> C:
    """The settings that a Provenance has.

    Args:
        parameters: as it has them.
        kind: of settings.
        section: the name of theirs, if there are several.

    Raises:
        ValueError: they are not those of `kind`.
    """
    try:
        given = yaml.safe_load(parameters)
    except yaml.YAMLError as error:
        raise ValueError(f"parameters are no YAML: {error}") from None
    given = given.get(section, given) if isinstance(given, dict) else given
    known = {f.name for f in fields(kind)}  # type: ignore[arg-type]  # a dataclass
    if not isinstance(given, dict):
        raise ContentError("parameters", parameters, f"those of {kind.__name__} as YAML")
    if others := given.keys() - known:
        raise ContentError("a parameter", min(others, key=str), f"one of {kind.__name__}")
    return kind(**{k: tuple(v) if isinstance(v, list) else v for k, v in given.items()})
