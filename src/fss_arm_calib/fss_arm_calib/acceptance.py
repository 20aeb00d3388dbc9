"""What every calibration says about its result: the verdict of each stage, and where it is from."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy.typing as npt
import yaml
from scipy.special import gammaincc

from fss_arm_calib import __version__
from fss_arm_calib.segments.streams import Streams
from fss_arm_model.description import Arm

PASS, FAIL, NOT_EVALUATED = "pass", "fail", "not_evaluated"


@dataclass(frozen=True)
class Stage:
    """One of the things that a calibration must meet to pass, as Stage.msg tells it."""

    name: str
    verdict: str
    value: float
    threshold: float
    reason: str  # with value and threshold, in words
    needed: bool = True  # to be evaluated; a stage that fails always counts


def at_most(name: str, value: float, threshold: float, reason: str, failing: str = "") -> Stage:
    """A stage that passes if the value is not above the threshold; `failing` says what it means."""
    passed = value <= threshold  # NaN is not
    words = reason if passed or not failing else f"{failing}: {reason}"
    return Stage(name, PASS if passed else FAIL, value, threshold, words)


def by_chance(name: str, chi_square: float, freedom: int, least: float, failing: str) -> Stage:
    """A stage that passes unless residuals as large as found are less probable than `least`."""
    probability = float(gammaincc(freedom / 2, chi_square / 2)) if freedom else 1.0
    facts = (
        f"chi-square {chi_square:.4g} for {freedom} degrees of freedom, "
        f"probability {probability:.2g} (at least {least:g})"
    )
    passed = probability >= least
    reason = facts if passed else f"{failing}: {facts}"
    return Stage(name, PASS if passed else FAIL, probability, least, reason)


def joints_known(streams: Streams, arm: Arm) -> Stage:
    """Whether no joint was heard that the arm does not have."""
    strange = streams.strange
    reason = f"{', '.join(strange)} heard, but {arm.name!r} has {count(arm.n, 'joint')}"
    verdict = NOT_EVALUATED if strange else PASS
    return Stage("joints", verdict, arm.n + len(strange), arm.n, reason if strange else "")


def clocks_kept(streams: Streams, most: float) -> Stage:
    """Whether no clock ran back by more than `most` [s], which may have hidden what happened.

    Clocks too far apart to be aligned are only told: swapped subjects look the same.
    """
    name, back = max(streams.set_back.items(), key=lambda item: item[1], default=("", 0.0))
    reason, bad = "", back > most
    if bad:
        reason = f"clock of {name} ran back by {back:.3g} s (at most {most:g})"
    elif streams.offset_beyond:
        reason = f"by most moves the clocks differ by more than {streams.offset_beyond:g} s"
        reason += ", or the subjects are swapped"
    verdict = NOT_EVALUATED if reason else PASS
    return Stage("clocks", verdict, back, most, reason, needed=bad)


def conclude(stages: Sequence[Stage]) -> tuple[str, str]:
    """The verdict of all stages, and its reason: what lacks, what failed, what is well.

    What lacks something that is needed is not judged: a failure may follow from that.
    """
    missing = [s for s in stages if s.verdict == NOT_EVALUATED and s.needed]
    failed = [s for s in stages if s.verdict == FAIL]
    others = [s for s in stages if s not in missing and s not in failed]
    verdict = NOT_EVALUATED if missing else FAIL if failed else PASS
    return verdict, "; ".join(s.reason for s in [*missing, *failed, *others] if s.reason)


@dataclass(frozen=True)
class Provenance:
    """From what a result was computed, as Provenance.msg tells it."""

    software: str
    parameters: str  # the settings, as YAML
    data_hash: str  # SHA-256 of what was solved from
    source: str
    begin: int  # of the data [ns]
    end: int
    seed: int = 0  # of random choices; 0: none were made


def provenance(
    settings: Any,
    kind: type[Any],
    data: Sequence[npt.NDArray[Any]],
    source: str,
    begin: int,
    end: int,
) -> Provenance:
    """The provenance of what this package computes from `data` by settings of a kind."""
    digest = hashlib.sha256()
    for array in data:
        digest.update(array.tobytes())
    parameters = {f.name: getattr(settings, f.name) for f in fields(kind)}
    return Provenance(
        software=f"fss_arm_calib {__version__}",
        parameters=yaml.safe_dump(parameters, sort_keys=False),
        data_hash=digest.hexdigest(),
        source=source,
        begin=begin,
        end=end,
    )


def settings_of(provenance: Any, kind: type[Any]) -> Any:
    """The settings that a Provenance, or its message, tells.

    Raises:
        ValueError: they are not those of `kind`.
    """
    given = yaml.safe_load(provenance.parameters)
    known = {f.name: f for f in fields(kind)}
    if not isinstance(given, dict) or not given.keys() <= known.keys():
        raise ValueError(f"parameters are not those of {kind.__name__}")
    return kind(**{k: tuple(v) if isinstance(v, list) else v for k, v in given.items()})


def count(number: int, what: str) -> str:
    """A number of things in words."""
    return f"{number} {what}{'s' * (number != 1)}"


def numbers(which: Sequence[int]) -> str:
    """Observations counted from 1, in words."""
    return f"observation{'s' * (len(which) > 1)} {', '.join(str(k + 1) for k in which)}"
